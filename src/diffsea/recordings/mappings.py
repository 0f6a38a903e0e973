"""Channels of recordings, their units, and how the columns of a foreign file become them.

A recording has the native channels `t`, `x`, `y`, `psi`, `u`, `v`, `r`, `cmd_...` and
`exec_...` of actuators, and wind and roll, in SI units, radians and NED axes. A mapping is a TOML
file, one per data set, so that nobody edits data in order to read it:

    format = 1
    [file]
    delimiter = "whitespace"    # default ","
    header_lines = 4            # lines before the first row of numbers
    encoding = "cp1252"         # default UTF-8
    decimal = ","               # default "."
    columns = ["time", "yaw"]   # names, where the file has none
    time_step = 0.1             # s, where the file has no time column
    start = 12.0                # s on the recording's clock: what is before is left out
    end = 300.0                 # s: what is after is left out
    velocity_axes = "earth"     # u and v are velocities north and east; default "body"
    frame = "ENU"               # x east, y north, yaw anticlockwise from east; default "NED"
    origin = [63.44, 10.39]     # deg, of x and y that come from latitude and longitude
    clock = "/imu"              # logs: the topic whose samples become the rows
    stamps = "receive"          # ROS bags: the recorder's clock; default "header"
    times = { gps = { column = "stamp", unit = "ms" } }  # folders of tables: where t is not it
    [columns]
    t = { column = "time", unit = "ms" }
    psi = { column = "yaw", unit = "deg" }
    u = "surge"
    # psi = { column = "sin_yaw", cosine = "cos_yaw" }
    # u = { column = "SOG", unit = "kn", course = "COG" }  # and v: of velocity_axes "earth"

A channel is `sign * (scale * number + offset)` in the stated unit, then converted to SI:
an offset of 5 with the unit `deg` turns the heading by five degrees. With `delay = 0.8` the
channel was stamped 0.8 s late and is shifted to where it belongs; what is shifted, turned or
rescaled here is a repair that an audit may ask for. The channels `latitude` and `longitude`
become x and y. In logs with several topics a column is named `topic:field`; so it is in a folder
of tables, where the topic is the table's file name without its ending.
"""

import dataclasses
import math
import string
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from diffsea.errors import UserError, nearest
from diffsea.outside.documents import read_toml
from diffsea.trajectory import Samples, Series, Trajectory


# Factors to SI by dimension. Revolutions stay revolutions: propellers are ordered in rev/s, and
# nobody's yaw rate is.
_FACTORS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "nmi": 1852.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "angular rate": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "deg/min": math.pi / 10800.0},
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6, "kn": 1852.0 / 3600.0, "ft/s": 0.3048},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605},
    "revolutions": {"rev/s": 1.0, "Hz": 1.0, "rps": 1.0, "rpm": 1.0 / 60.0},
    "ratio": {"%": 0.01, "1": 1.0},
}
# unit -> (dimension, factor to SI)
UNITS: dict[str, tuple[str, float]] = {
    unit: (dimension, factor)
    for dimension, factors in _FACTORS.items()
    for unit, factor in factors.items()
}

# The dimension of every channel; actuator channels may have any.
CHANNEL_DIMENSIONS = {"t": "time", "x": "length", "y": "length", "psi": "angle"}
CHANNEL_DIMENSIONS |= {"u": "speed", "v": "speed", "r": "angular rate"}
_EXTRA = {"wind_speed": "speed", "wind_direction": "angle", "phi": "angle", "p": "angular rate"}
_EXTRA |= {"apparent_wind_speed": "speed", "apparent_wind_angle": "angle"}
_EXTRA |= {"armed": "ratio"}  # one where the autopilot lets orders reach the actuators, else zero
CHANNEL_DIMENSIONS |= _EXTRA
EXTRA_CHANNELS = tuple(_EXTRA)  # beside motion and actuation
ACTUATOR_PREFIXES = ("cmd_", "exec_")

# The first words of the notes of the provenance on rows that reading left out.
REPEATED_TIMES = "merged rows whose time stamp repeats the row before"
EMPTY_ROWS = "dropped empty rows"


# What a mapping may name besides, and what becomes of it: x and y.
_GEODETIC = {"latitude": "angle", "longitude": "angle"}

# East-north-up axes with forward-port-up body axes, turned into those of this package.
_TURNED = {"psi": math.pi / 2, "wind_direction": math.pi / 2, "v": 0.0, "r": 0.0}
_TURNED |= {"apparent_wind_angle": 0.0}
_SWAPPED = {"x": "y", "y": "x"}

MAY_BE_CONSTANT = ("wind_speed", "wind_direction", "phi")  # and orders
MOST_HEADER_LINES = 100_000
_ASCII = string.printable.encode("ascii")
_CHOICES = {
    "velocity_axes": ("body", "earth"),
    "frame": ("NED", "ENU"),
    "stamps": ("header", "receive"),
}
_TEXTS = dict.fromkeys(("delimiter", "encoding", "decimal"), "text")
_TEXTS |= {"clock": "the name of a topic"}


def is_channel(name: str) -> bool:
    """Whether `name` is a column of the native recording format."""
    return name in CHANNEL_DIMENSIONS or any(
        name.startswith(prefix) and len(name) > len(prefix) for prefix in ACTUATOR_PREFIXES
    )


def is_held(channel: str) -> bool:
    """Whether a channel holds from its time stamp until the next, as orders do."""
    return channel.startswith(ACTUATOR_PREFIXES) or channel == "armed"


def native_channels(run: Trajectory) -> dict[str, Samples]:
    """All channels of a run by their native names, `t` first: SI units, as NumPy arrays."""
    channels = {"t": run.t} | run.motion
    channels |= {f"cmd_{name}": series for name, series in run.commanded.items()}
    channels |= {f"exec_{name}": series for name, series in run.executed.items()} | run.extra
    return {name: np.asarray(series, dtype=float) for name, series in channels.items()}


def with_channels(run: Trajectory, channels: dict[str, Samples], **fields: Any) -> Trajectory:
    """The run with other series for channels of these native names, and with other `fields`."""

    def changed(old: dict[str, Series], prefix: str = "") -> dict[str, Float[Any, "new"]]:
        return {name: channels.get(prefix + name, series) for name, series in old.items()}

    return dataclasses.replace(
        run,
        **changed({"t": run.t} | run.motion),
        commanded=changed(run.commanded, "cmd_"),
        executed=changed(run.executed, "exec_"),
        extra=changed(run.extra),
        **fields,
    )


@dataclasses.dataclass(frozen=True)
class Column:
    """Where one channel comes from: `sign * (scale * number + offset)` in `unit`.

    In SI that is `gain * number + shift`. A mapping file names the fields as they are named here.
    With a `cosine`, another column of a table, `column` is the sine of an angle in rad. With a
    `course`, another column in deg (or `course_unit`) clockwise from north, it is a speed over
    ground, and u and v are its parts to north and east.
    """

    column: str
    unit: str | None = None  # None: SI already
    sign: float = 1.0
    scale: float = 1.0
    offset: float = 0.0  # in `unit`
    delay: float = 0.0  # s, by how much the channel is stamped late
    cosine: str | None = None
    course: str | None = None
    course_unit: str = "deg"

    @property
    def names(self) -> tuple[str, ...]:
        """The columns that it is made of."""
        beside = self.cosine or self.course
        return (self.column,) if beside is None else (self.column, beside)

    def made_of(self, channel: str, parts: Sequence[Samples]) -> Samples:
        """What a channel is before its gain and shift, of the columns of `names`."""
        if self.cosine is not None:
            return np.arctan2(*parts)
        if self.course is not None:
            along = np.cos if channel == "u" else np.sin
            return parts[0] * along(parts[1] * UNITS[self.course_unit][1])
        return parts[0]

    @property
    def gain(self) -> float:
        """SI value per number in the file."""
        return self.sign * self.scale * self._factor

    @property
    def shift(self) -> float:
        """What is added after the gain, in SI."""
        return self.sign * self.offset * self._factor

    @property
    def topic_and_field(self) -> tuple[str, str]:
        """Of a column of a log, `topic:field`; the topic is empty where the name has none."""
        topic, _, field = self.column.rpartition(":")
        return topic, field

    def opposite(self, beyond: float) -> "Column":
        """The column of `beyond` minus this channel, in SI."""
        offset = self.offset - beyond / (self.sign * self._factor)
        return dataclasses.replace(self, sign=-self.sign, offset=offset)

    @property
    def _factor(self) -> float:
        return 1.0 if self.unit is None else UNITS[self.unit][1]


@dataclasses.dataclass(frozen=True)
class Mapping:
    """How to read one data set. `name` is the file the mapping came from.

    The other fields but `channels` and `constants` stand under [file] of a mapping file by their
    names here; the `columns` of the file are those without a line of names. Channels of which the
    recording has no column, since they never changed, are `constants`, in SI.
    """

    channels: dict[str, Column]
    name: str = "mapping"
    delimiter: str = ","
    header_lines: int | None = None  # None: the line of names, if the file has one
    encoding: str = "utf-8-sig"  # UTF-8 with or without a byte-order mark
    decimal: str = "."
    columns: tuple[str, ...] | None = None
    time_step: float | None = None  # s
    start: float | None = None  # s on the recording's clock
    end: float | None = None
    velocity_axes: str = "body"  # or "earth"
    frame: str = "NED"  # or "ENU": what the channels are as they stand in the file
    origin: tuple[float, float] | None = None  # latitude and longitude, rad
    clock: str | None = None  # topic of a log
    stamps: str = "header"  # or "receive"
    times: dict[str, Column] = dataclasses.field(default_factory=dict)  # of tables of a folder
    constants: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def ned_channels(self) -> dict[str, Column]:
        """The channels in NED and forward-starboard-down axes, whatever the file's frame."""
        if self.frame == "NED":
            return self.channels
        turned, swapped = _TURNED, _SWAPPED
        if self.velocity_axes == "earth":
            turned = {name: beyond for name, beyond in _TURNED.items() if name != "v"}
            swapped = _SWAPPED | {"u": "v", "v": "u"}
        return {
            swapped.get(name, name): column.opposite(turned[name]) if name in turned else column
            for name, column in self.channels.items()
        }

    def channel_of(self, column: str) -> str:
        """The channel under which the mapping has a column, before a frame turned it."""
        return next(name for name, entry in self.channels.items() if entry.column == column)


def read_mapping(path: str | Path) -> Mapping:
    """Read a mapping file.

    Raises `UserError` for a missing or broken file, an unknown key, channel or unit, a
    unit that does not fit the channel, and for a mapping that yields no time.
    """
    path = Path(path)
    return mapping_from(read_toml(path, "the mapping"), path)


def mapping_for(given: "Mapping | str | Path | None", recording: str | Path) -> Mapping | None:
    """The mapping by which a recording is read: one that is given, or that of `mapping_path`."""
    if given is None or isinstance(given, Mapping):
        return given
    file = mapping_path(given, recording)
    return None if file is None else read_mapping(file)


def mapping_path(given: str | Path, recording: str | Path) -> Path | None:
    """The mapping's file: the one given, or of a folder `STEM.mapping.toml` where it has that.

    `diffsea check` writes such a file for each log that needs one; others are read without.
    """
    if not Path(given).is_dir():
        return Path(given)
    own = Path(given) / f"{Path(recording).stem}.mapping.toml"
    return own if own.exists() else None


def check_stems(given: "Mapping | str | Path | None", recordings: Iterable[str | Path]) -> None:
    """Raise `UserError` where a folder of mappings could not tell two recordings apart."""
    if not isinstance(given, str | Path) or not Path(given).is_dir():
        return
    seen: dict[str, Path] = {}
    for path in map(Path, recordings):
        other = seen.setdefault(path.stem, path)
        if other != path:
            raise UserError(
                f"{given} has one {path.stem}.mapping.toml for {other} and {path}: read them in "
                "turn, each with its own mapping file, or give them unlike names"
            )


def mapping_from(table: dict[str, Any], path: Path) -> Mapping:
    """The mapping in the tables of a mapping file; `path` is its place in messages and its name.

    Raises `UserError` as `read_mapping` does.
    """
    table = dict(table)
    _check_keys(table, ("format", "file", "columns"), f"{path}: ")
    if table.get("format", 1) != 1:
        raise UserError(f"{path}: format = {table['format']!r} is unknown; this reads format 1")
    for key in ("file", "columns"):
        if not isinstance(table.setdefault(key, {}), dict):
            raise UserError(f"{path}: {key} must be a table, written [{key}]")
    file_keys = [field.name for field in dataclasses.fields(Mapping)]
    file_keys = [name for name in file_keys if name not in ("channels", "name", "constants")]
    _check_keys(table["file"], file_keys, f"{path}: [file] ")
    channels, constants = {}, {}
    for name, entry in table["columns"].items():
        where = f"{path}: [columns] {name}"
        if isinstance(entry, dict) and "constant" in entry:
            constants[name] = _constant(name, entry, where)
        else:
            channels[name] = _column(name, entry, where)
    settings = _file_settings(table["file"], f"{path}: [file]")
    _check_channels(channels, settings, path)
    if "wind_direction" in constants and settings.get("frame", "NED") != "NED":
        raise UserError(f"{path}: a constant wind_direction counts from north; leave frame out")
    return Mapping(channels=channels, name=path.name, constants=constants, **settings)


def _check_keys(table: dict[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise UserError(
                f"{where}unknown key {key!r}; known keys are {', '.join(known)}"
                + nearest(key, known)
            )


def _file_settings(settings: dict[str, Any], where: str) -> dict[str, Any]:
    """The checked keyword arguments of `Mapping` that stand under [file].

    Raises `UserError`, beginning with `where`, for a value of another type or out of range.
    """
    settings = dict(settings)
    step = settings.get("time_step")
    if step is not None:
        settings["time_step"] = _number(step, f"{where} time_step")
        if settings["time_step"] <= 0:
            raise UserError(f"{where} time_step must be above zero seconds, got {step}")
    for key in ("start", "end"):
        if key in settings:
            settings[key] = _number(settings[key], f"{where} {key}")
    check_span(settings.get("start"), settings.get("end"), where)
    lines = settings.get("header_lines")
    if lines is not None and not (type(lines) is int and 0 <= lines <= MOST_HEADER_LINES):
        raise UserError(
            f"{where} header_lines must be a whole number up to {MOST_HEADER_LINES}, got {lines!r}"
        )
    for key, what in _TEXTS.items():
        if key in settings and not (isinstance(settings[key], str) and settings[key]):
            raise UserError(f"{where} {key} must be {what}, got {settings[key]!r}")
    _check_separators(settings, where)
    for key, choices in _CHOICES.items():
        if settings.get(key, choices[0]) not in choices:
            raise UserError(
                f'{where} {key} must be "{choices[0]}" or "{choices[1]}", got {settings[key]!r}'
            )
    if "times" in settings:
        if not isinstance(settings["times"], dict):
            raise UserError(f'{where} times must be a table such as {{ gps = "stamp" }}')
        settings["times"] = {
            topic: _column("t", entry, f"{where} times.{topic}")
            for topic, entry in settings["times"].items()
        }
    if "columns" in settings:
        names = settings["columns"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise UserError(f"{where} columns must be a list of names")
        if repeated := [name for name, times in Counter(names).items() if times > 1]:
            raise UserError(f"{where} columns has the name {repeated[0]!r} twice")
        settings["columns"] = tuple(names)
    if "origin" in settings:
        place = settings["origin"]
        if not isinstance(place, list) or len(place) != 2:
            raise UserError(
                f"{where} origin must be [latitude, longitude] in degrees, got {place!r}"
            )
        latitude, longitude = (_number(item, f"{where} origin") for item in place)
        if abs(latitude) > 90 or abs(longitude) > 360:
            raise UserError(f"{where} origin {place} is no place; latitude comes first")
        settings["origin"] = math.radians(latitude), math.radians(longitude)
    return settings


def _check_separators(settings: dict[str, Any], where: str) -> None:
    """Raises `UserError` for a delimiter, decimal sign or encoding that parts no numbers."""
    delimiter, decimal = settings.get("delimiter", ","), settings.get("decimal", ".")
    if delimiter != "whitespace" and (set(delimiter) & set('\r\n\x00"') or len(delimiter) > 8):
        raise UserError(f'{where} delimiter must be a sign or "whitespace", got {delimiter!r}')
    if len(decimal) != 1 or decimal.isalnum() or decimal in '+-"\r\n\x00' or ord(decimal) > 127:
        raise UserError(f'{where} decimal must be one sign such as ",", got {decimal!r}')
    try:
        alike = string.printable.encode(settings.get("encoding", "utf-8")).endswith(_ASCII)
    except (LookupError, ValueError):  # unknown; or no encoding of text such as this
        alike = False
    if not alike:
        raise UserError(
            f"{where} encoding = {settings['encoding']!r} is not known as one that has ASCII in "
            "it; use for instance 'utf-8' or 'cp1252'"
        )


def check_span(start: float | None, end: float | None, where: str) -> None:
    """Raises `UserError`, beginning with `where`, unless the start (s) is before the end."""
    if start is not None and end is not None and not start < end:
        raise UserError(f"{where} start = {start:g} s must be before end = {end:g} s")


def _check_channels(channels: dict[str, Column], settings: dict[str, Any], path: Path) -> None:
    """Whether the channels go with one another and with what stands under [file]."""
    if "time_step" in settings and "t" in channels:
        raise UserError(f"{path}: give either time_step or a column for t, not both")
    in_log = any(":" in entry.column for entry in channels.values())
    if "time_step" not in settings and "t" not in channels and not in_log:
        raise UserError(
            f"{path}: no channel t; name the time column under [columns], or give "
            "[file] time_step in seconds"
        )
    if settings.get("velocity_axes") == "earth" and not {"psi", "u", "v"} <= set(channels):
        raise UserError(f"{path}: velocities in earth axes need the channels psi, u and v")
    velocities = [channels.get(name) for name in "uv"]
    ways = {one and (one.course and one.names, one.course_unit, one.unit) for one in velocities}
    if any(one and one.course for one in velocities):
        if len(ways) > 1 or settings.get("velocity_axes") != "earth":
            raise UserError(
                f"{path}: a speed with its course is a velocity over ground: give u and v the "
                'same column, unit and course, and [file] velocity_axes = "earth"'
            )
        if settings.get("frame", "NED") != "NED":
            raise UserError(f"{path}: a course is clockwise from north; leave [file] frame out")
    geodetic = set(_GEODETIC) & set(channels)
    if geodetic and geodetic != set(_GEODETIC):
        raise UserError(f"{path}: latitude and longitude belong together; map both of them")
    if geodetic and {"x", "y"} & set(channels):
        raise UserError(f"{path}: latitude and longitude become x and y; leave x and y out")


def _constant(channel: str, entry: dict[str, Any], where: str) -> float:
    """The value (SI) of a channel that never changed.

    Raises `UserError`, beginning with `where`, for a channel that has to be measured, a key that is
    none, or a unit of another dimension.
    """
    _check_keys(entry, ("constant", "unit"), f"{where}: ")
    unit = {"unit": entry["unit"]} if "unit" in entry else {}
    gain = _column(channel, {"column": "", **unit}, where).gain
    if not (channel.startswith(ACTUATOR_PREFIXES) or channel in MAY_BE_CONSTANT):
        raise UserError(f"{where}: only orders, actuation, wind and heel may be constant")
    return _number(entry["constant"], f"{where}: constant") * gain


def _column(channel: str, entry: object, where: str) -> Column:
    """The column that stands for a channel: its name, or a table.

    Raises `UserError`, beginning with `where`, for an unknown channel, key or unit, or a unit of
    another dimension.
    """
    if not (is_channel(channel) or channel in _GEODETIC):
        known = (*CHANNEL_DIMENSIONS, *_GEODETIC, "cmd_<actuator>", "exec_<actuator>")
        raise UserError(
            f"{where} is no channel; channels are {', '.join(known)}"
            + nearest(channel, CHANNEL_DIMENSIONS)
        )
    if isinstance(entry, str):
        return Column(entry)
    if not isinstance(entry, dict) or not isinstance(entry.get("column"), str):
        raise UserError(
            f"{where} must be a column's name or a table such as "
            '{ column = "yaw", unit = "deg" }'
        )
    _check_keys(entry, [field.name for field in dataclasses.fields(Column)], f"{where}: ")
    numbers = {
        key: _number(entry[key], f"{where}: {key}")
        for key in ("sign", "scale", "offset", "delay")
        if key in entry
    }
    if numbers.get("sign", 1.0) not in (1.0, -1.0):
        raise UserError(f"{where}: sign must be 1 or -1; use scale for other factors")
    if channel == "t" and "delay" in numbers:
        raise UserError(f"{where}: time itself cannot be delayed; use offset")
    unit, cosine = entry.get("unit"), entry.get("cosine")
    dimension = (CHANNEL_DIMENSIONS | _GEODETIC).get(channel)
    if cosine is not None and not (
        isinstance(cosine, str) and unit in (None, "rad") and dimension in (None, "angle")
    ):
        raise UserError(
            f"{where}: cosine is the name of a column beside that of the sine of an angle, in rad"
        )
    course, course_unit = entry.get("course"), entry.get("course_unit", "deg")
    if course is not None and not (isinstance(course, str) and channel in ("u", "v")):
        raise UserError(
            f"{where}: course is the name of a column in deg beside that of a speed, for u and v"
        )
    if course_unit not in ("deg", "rad") or ("course_unit" in entry and course is None):
        raise UserError(f'{where}: course_unit is that of a course, "deg" or "rad"')
    if unit is not None and (not isinstance(unit, str) or unit not in UNITS):
        raise UserError(
            f"{where}: unknown unit {unit!r}; known units are {', '.join(UNITS)}"
            + nearest(str(unit), UNITS)
        )
    if unit is not None and dimension not in (None, UNITS[unit][0]):
        fitting = ", ".join(name for name, (kind, _) in UNITS.items() if kind == dimension)
        raise UserError(f"{where}: {unit!r} is not a unit of {dimension}; use one of {fitting}")
    if unit is not None and dimension is None and UNITS[unit][0] == "time":
        raise UserError(
            f"{where}: {unit!r} would turn pulse widths into seconds; leave the unit out, and "
            'state unit = "us" in the vessel file'
        )
    return Column(
        entry["column"],
        unit=unit,
        cosine=cosine,
        course=course,
        course_unit=course_unit,
        **numbers,
    )


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"{where} must be a finite number, got {value!r}")
    return float(value)
