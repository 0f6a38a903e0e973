"""A log through a mapping: streams read, channels picked, put into SI and NED, and joined.

Topics have clocks of their own. They are put on one clock without inventing data.
"""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from diffsea.errors import UserError, nearest
from diffsea.recordings.geodesy import place_fixes
from diffsea.recordings.logs import (
    ardupilot,
    folder,
    matlab,
    mcap_json,
    px4,
    ros,
    tlog,
    tlog_csv,
)
from diffsea.recordings.logs.streams import LogFormat, Stream, list_fields, merge_repeated_times
from diffsea.recordings.mappings import Column, Mapping, is_held
from diffsea.series import BRIDGED_INTERVALS, between_samples, hold_at, median_interval, unwrap
from diffsea.trajectory import MOTION_CHANNELS, RowsLeftOut, Samples


_DATAFLASH = LogFormat(
    "ardupilot-bin",
    (".bin",),
    ardupilot.contents,
    ardupilot.streams,
    "ardupilot",
    parameters=ardupilot.parameters,
)
# Every format of log there is.
FORMATS = (
    _DATAFLASH,
    dataclasses.replace(
        _DATAFLASH, name="ardupilot-log", suffixes=(".log",), holds=ardupilot.is_log
    ),
    LogFormat(
        "mavlink-tlog",
        (".tlog",),
        tlog.LOG.contents,
        tlog.LOG.streams,
        "ardupilot",
        parameters=tlog.LOG.parameters,
    ),
    LogFormat(
        "mavlink-csv",
        (".csv",),
        tlog_csv.LOG.contents,
        tlog_csv.LOG.streams,
        holds=tlog_csv.is_log,
        parameters=tlog_csv.LOG.parameters,
    ),
    LogFormat("px4-ulg", (".ulg",), px4.contents, px4.streams, "px4"),
    LogFormat(
        "matlab",
        (".mat",),
        matlab.contents,
        matlab.streams,
        time_is_mapped=True,
        table=matlab.table,
    ),
    LogFormat(
        "mcap-json",
        (".mcap",),
        mcap_json.contents,
        mcap_json.streams,
        "mcap",
        holds=mcap_json.is_json,
        parameters=mcap_json.parameters,
    ),
    LogFormat(
        "ros-bag",
        (".bag", ".db3", ".mcap"),
        ros.contents,
        ros.streams,
        "ros",
        is_folder=ros.is_folder,
    ),
    LogFormat(
        "folder",
        (),
        folder.contents,
        folder.streams,
        time_is_mapped=True,
        is_folder=folder.is_folder,
        told="a folder of tables (where each is a run of its own, name them: {path}/*.csv); as one "
        "run it",
    ),
)
# What a field for the example may be called, by the channel; the first that a log has is shown.
_EXAMPLES = {
    "psi": ("yaw", "heading", "psi"),
    "latitude": ("latitude", "lat"),
    "r": ("yaw_rate", "yawrate", "angular_velocity_z", "angular_velocity.z"),
    "x": ("x", "north"),
}
_EXAMPLE_UNITS = {"psi": "rad", "latitude": "deg", "r": "rad/s", "x": "m"}
_ENDINGS = {"_deg": "deg", "_rad": "rad", "_deg_s": "deg/s", "_rad_s": "rad/s", "_m": "m"}
_ANGLES = ("psi", "phi", "wind_direction", "apparent_wind_angle")

Rows = Float[np.ndarray, "row"]  # the recording's, in s, or values in them


class LogChannels(NamedTuple):
    """The channels of a log on one clock, in SI units and NED axes.

    Attributes:
        values: by channel, with `t` in s.
        notes: what was done to them, in words.
        repeated_times: of every topic that had such.
        rates: samples per second, by channel.
        cut_off: that the file ends within a message, in words.
        epoch: s since 1970 at which `t` is zero; None where the log does not say.
    """

    values: dict[str, Samples]
    notes: list[str]
    repeated_times: tuple[RowsLeftOut, ...]
    rates: dict[str, float]
    cut_off: str = ""
    epoch: float | None = None


def is_log(path: Path) -> bool:
    """Whether a file is named like a log, or a folder is a ROS 2 bag or has tables of one run."""
    return format_of(path) is not None


def log_table(path: Path) -> dict[str, Samples] | None:
    """The fields of a log that is one table, by what a mapping calls them; None of any other file.

    Raises:
        UserError: it cannot be read.
    """
    form = format_of(path)
    return None if form is None or form.table is None else form.table(path)


def contents(path: Path) -> dict[str, list[str]]:
    """The topics of a log and their numeric fields.

    Raises:
        UserError: the file is no log, or an optional package is absent.
    """
    form = _checked_format(path)
    with form.packages(path):
        return form.contents(path)


def read_log(path: Path, mapping: Mapping | None) -> LogChannels:
    """Channels of a log in SI units and NED axes on one clock, with `t` in s.

    The mapping names its columns `topic:field`; a field may be named by the end of its name
    where that leaves no doubt. The rows are the samples of the topic with the most of them, or
    of that under [file] clock; `join_channels` says how the other topics meet them.

    Raises:
        UserError: the log cannot be read or lacks a topic or field, a stream has one sample or
            time that runs backwards, or clocks do not overlap.
    """
    form = _checked_format(path)
    if mapping is None:
        raise UserError(_how_to_map(path, form))
    columns = {name: column for name, column in mapping.ned_channels.items() if name != "t"}
    _check_columns(path, mapping, form, columns)
    if not any(name in columns for name in (*MOTION_CHANNELS, "latitude")):
        raise UserError(
            f"{mapping.name} has no motion channel ({', '.join(MOTION_CHANNELS)}, or latitude "
            f"and longitude); {path} needs one"
        )
    streams = _mapped_streams(path, mapping, form, columns)
    channels, notes = _pick_channels(path, mapping, columns, streams)
    if mapping.clock is not None and mapping.clock not in streams:
        raise UserError(
            f"{mapping.name}: [file] clock = {mapping.clock!r} is none of the topics mapped: "
            + ", ".join(streams)
            + nearest(mapping.clock, streams)
        )
    clock, why = max(streams.values(), key=lambda stream: stream.t.size), "the most samples"
    if mapping.clock is not None:
        clock, why = streams[mapping.clock], "[file] clock"
    notes.insert(0, f"rows are the {clock.t.size} samples of {clock.title} ({why})")
    values, lost = join_channels(channels, clock.t, mapping.velocity_axes == "earth", str(path))
    merged = [stream.repeated_times for stream in streams.values()]
    rates = {name: channel.rate for name, channel in channels.items()}
    repeated = tuple(one for one in merged if one)
    cut_off = next((one.cut_off for one in streams.values() if one.cut_off), "")
    channels_on_it = {"t": clock.t} | values
    return LogChannels(channels_on_it, [*notes, *lost], repeated, rates, cut_off, clock.epoch)


def _check_columns(
    path: Path, mapping: Mapping, form: LogFormat, columns: dict[str, Column]
) -> None:
    """Raises `UserError` for times and columns that a mapping of such a log has otherwise."""
    if not form.time_is_mapped:
        if "t" in mapping.channels or mapping.time_step is not None:
            raise UserError(
                f"{mapping.name}: {path} has clocks of its own, so leave t and [file] time_step "
                "out; [file] clock chooses the topic whose samples become the rows"
            )
        for name, column in columns.items():
            if not all(column.topic_and_field):
                raise UserError(
                    f"{mapping.name}: [columns] {name}: {column.column!r} must be written "
                    f"topic:field, for {path} is a log with several topics"
                )
    for name, column in columns.items():
        topics = {each.rpartition(":")[0] for each in column.names}
        if len(topics) > 1:
            raise UserError(
                f"{mapping.name}: [columns] {name}: its columns must come from one topic, not "
                + " and ".join(column.names)
            )


def format_of(path: Path) -> LogFormat | None:
    """The format of a log by its name, and where that does not tell by its content."""
    if path.is_dir():
        return next((form for form in FORMATS if form.is_folder and form.is_folder(path)), None)
    named = (form for form in FORMATS if path.suffix.lower() in form.suffixes)
    held = lambda form: form.holds is None or (path.is_file() and form.holds(path))
    return next(filter(held, named), None)


def _checked_format(path: Path) -> LogFormat:
    if not path.exists():
        siblings = [item.name for item in path.parent.glob("*")]
        raise UserError(f"there is no recording {path}{nearest(path.name, siblings)}")
    if path.is_file():
        try:
            with path.open("rb") as file:
                first = file.read(1)
        except OSError as error:
            raise UserError(f"cannot read {path}: {error.strerror}") from error
        if not first:
            raise UserError(f"{path} is empty; copy the log again")
    form = format_of(path)
    if form is None:
        suffixes = ", ".join(dict.fromkeys(end for form in FORMATS for end in form.suffixes))
        raise UserError(
            f"{path} is no log; logs are named {suffixes}, or are folders of bags or tables"
        )
    return form


def _how_to_map(path: Path, form: LogFormat) -> str:
    """What to say where there is no mapping: all there is, and how a mapping begins."""
    found = contents(path)
    fields = [(topic, field) for topic, names in found.items() for field in names]
    first, *others = found.values() if found else [[]]
    shared = [name for name in first if others and all(name in names for names in others)]
    example = next(filter(None, (_example_row(channel, fields) for channel in _EXAMPLES)), None)
    row = example or 'psi = { column = "topic:field", unit = "rad" }'
    clock = shared[0] if shared else "..."
    time = f'  t = {{ column = "{clock}", unit = "s" }}\n' if form.time_is_mapped else ""
    what = form.told.format(path=path)
    return (
        f"{path} is {what} needs a mapping that says which fields are which channels. "
        f"Topics and fields:\n{list_fields(found)}\nWrite, for instance in log.mapping.toml,\n"
        f"  [columns]\n{time}  {row}\n"
        "with a line per channel and its unit in the log, and name it with "
        "--mapping log.mapping.toml"
    )


def _example_row(channel: str, fields: list[tuple[str, str]]) -> str | None:
    """The row of a mapping for a channel that a field is called; None where none is."""
    for topic, field in fields:
        name, unit = field.lower(), ""
        ending = next((end for end in _ENDINGS if name.endswith(end)), "")
        if ending:
            name, unit = name.removesuffix(ending), _ENDINGS[ending]
        if not {name, name.rpartition(".")[2]} & set(_EXAMPLES[channel]):
            continue
        column = f"{topic}:{field}".removeprefix(":")
        asked = "" if unit else "  # or its unit in the log"
        unit = unit or _EXAMPLE_UNITS[channel]
        return f'{channel} = {{ column = "{column}", unit = "{unit}" }}{asked}'
    return None


def _mapped_streams(
    path: Path, mapping: Mapping, form: LogFormat, columns: dict[str, Column]
) -> dict[str, Stream]:
    """The streams that the mapping names, in its order, with strictly increasing time."""
    topics: dict[str, str] = {}  # and the first column of each
    for column in columns.values():
        topics.setdefault(column.topic_and_field[0], column.column)
    with form.packages(path):
        streams = form.streams(path, mapping, list(topics))
    for topic, column in topics.items():
        if topic not in streams:
            found = contents(path)
            known = [*found, *(name.partition("[")[0] for name in found)]
            raise UserError(
                f"{path} has no {topic!r}, which {mapping.name} maps to "
                + mapping.channel_of(column)
                + nearest(topic, known)
                + f". It has\n{list_fields(found)}"
            )
    sampled = {c.topic_and_field[0] for name, c in columns.items() if not is_held(name)}
    fewest = {topic: 2 if topic in sampled else 1 for topic in topics}
    return {t: merge_repeated_times(streams[t], path, fewest[t]) for t in topics}


@dataclasses.dataclass(frozen=True)
class LogChannel:
    """Samples of one channel, in SI units, with their own times (s, increasing)."""

    topic: str
    t: Samples
    values: Samples

    @property
    def rate(self) -> float:
        """Valid samples per second; NaN of fewer than two."""
        times = self.t[np.isfinite(self.values)]
        span = float(times[-1] - times[0]) if times.size > 1 else 0.0
        return (times.size - 1) / span if span > 0 else float("nan")


def _pick_channels(
    path: Path, mapping: Mapping, columns: dict[str, Column], streams: dict[str, Stream]
) -> tuple[dict[str, LogChannel], list[str]]:
    """The channels in SI units, each with its own clock, and notes on where they come from."""
    channels: dict[str, LogChannel] = {}
    sources: dict[str, list[str]] = {topic: [] for topic in streams}
    for name, column in columns.items():
        topic, field = column.topic_and_field
        written = mapping.channel_of(column.column)
        where = f"{path}, {mapping.name}, {written}"
        full, series = streams[topic].field(field, where)
        for other in column.names[1:]:
            beside, second = streams[topic].field(other.rpartition(":")[2], where)
            full, series = f"{full} and {beside}", column.made_of(name, (series, second))
        series = np.where(np.isfinite(series), series, np.nan) * column.gain + column.shift
        if not np.any(np.isfinite(series)):
            raise UserError(f"{path}: {column.column}, mapped to {written}, has no valid value")
        channels[name] = LogChannel(topic, streams[topic].t - column.delay, series)
        sources[topic].append(f"{name} from {full}")
    notes = [
        f"{topic or 'top level'}: {streams[topic].t.size} samples by {streams[topic].clock}; "
        + ", ".join(names)
        for topic, names in sources.items()
    ]
    damage = [(*one.notes, *filter(None, [one.cut_off])) for one in streams.values()]
    notes += dict.fromkeys(note for stream in damage for note in stream)
    late = {name: column.delay for name, column in columns.items() if column.delay}
    notes += [f"{name} shifted by {-delay:g} s" for name, delay in late.items()]
    if mapping.frame != "NED":
        notes.append(f"turned from {mapping.frame} into NED axes")
    if "latitude" not in channels:
        return channels, notes
    latitude, longitude = channels.pop("latitude"), channels.pop("longitude")
    if latitude.topic != longitude.topic or np.any(latitude.t != longitude.t):
        raise UserError(
            f"{mapping.name}: latitude and longitude must come from one topic, with one delay"
        )
    north, east, note = place_fixes(latitude.values, longitude.values, mapping.origin, str(path))
    position = {
        "x": dataclasses.replace(latitude, values=north),
        "y": dataclasses.replace(longitude, values=east),
    }
    return position | channels, [*notes, note]


def join_channels(
    channels: dict[str, LogChannel], rows: Rows, turn: bool, where: str
) -> tuple[dict[str, Rows], list[str]]:
    """Every channel in the rows of one clock (s, increasing), and notes on what that cost.

    Motion: a sample has its value in one row, the nearest, where it is moved to the row's
    instant along the straight line to its neighbour; other rows stay NaN. So a slow sensor
    counts as often as it measured. Across more than three of a channel's own intervals, and
    beyond its ends, there is no line, and a sample that only such rows surround is left out.
    Orders hold from the row nearest to their time stamp on: from the next row on they would be
    late by half an interval, and the vessel would seem to answer early. Executed actuation holds
    from its stamp on. With `turn`, u and v are velocities north and east and are turned into body
    axes by the heading, interpolated in the same way.

    Raises:
        UserError: a channel shares no time with the rows; the message begins with `where`.
    """
    values, notes = {}, []
    lines: dict[str, Rows] = {}
    for name, channel in channels.items():
        is_state = name == "armed"  # it is told where it changes, perhaps once, before all rows
        if not is_state and (channel.t[-1] < rows[0] or channel.t[0] > rows[-1]):
            raise UserError(
                f"{where}: the clocks do not overlap: the recording's runs from {rows[0]:.10g} s "
                f"to {rows[-1]:.10g} s, but {name} from {channel.topic} has samples from "
                f"{channel.t[0]:.10g} s to {channel.t[-1]:.10g} s; choose topics of one clock, in "
                'ROS bags perhaps with [file] stamps = "receive", or correct it by a delay'
            )
        finite = np.isfinite(channel.values)
        t, known = channel.t[finite], channel.values[finite]
        if is_held(name):
            ordered = name.startswith("cmd_")
            values[name] = hold_at(t, known, _until_halfway(rows) if ordered else rows)
            continue
        lines[name], there = np.full(rows.shape, np.nan), np.zeros(rows.shape, dtype=bool)
        if t.size > 1:
            longest = BRIDGED_INTERVALS * median_interval(t) * (1 + 1e-9)
            there = between_samples(t, rows, longest)
            continuous = unwrap(known) if name in _ANGLES else known
            lines[name] = np.where(there, np.interp(rows, t, continuous), np.nan)
        nearest_to_samples, lost = _nearest_rows(t, rows, there)
        values[name] = np.where(nearest_to_samples, lines[name], np.nan)
        if lost:
            notes.append(f"{name}: {lost} samples beside gaps of the clocks are left out")
    if "wind_direction" in values:
        values["wind_direction"] = values["wind_direction"] % (2 * np.pi)
    if turn:
        body = (values["u"] + 1j * values["v"]) * np.exp(-1j * lines["psi"])
        values |= {"u": body.real, "v": body.imag}
        notes.append("u and v turned from earth into body axes by the heading")
    return values, notes


def _until_halfway(rows: Rows) -> Rows:
    """The times (s) up to which a row is the nearest, looking ahead.

    A hole of the clock is no row: half a usual interval after the row before it.
    """
    step = np.diff(rows, append=np.inf)
    return rows + 0.5 * np.minimum(step, median_interval(rows) if rows.size > 1 else 0.0)


def _nearest_rows(
    t: Samples, rows: Rows, usable: Bool[np.ndarray, "row"]
) -> tuple[Bool[np.ndarray, "row"], int]:
    """The usable rows that are nearest to a sample on either side, and how many have none."""
    after = np.searchsorted(rows, t, side="left")
    before = np.searchsorted(rows, t, side="right") - 1

    def distance(index: np.ndarray) -> Samples:
        inside = index.clip(0, rows.size - 1)
        return np.where((index == inside) & usable[inside], np.abs(rows[inside] - t), np.inf)

    ahead, behind = distance(after), distance(before)
    reached = np.isfinite(np.minimum(ahead, behind))
    nearest = np.zeros(rows.shape, dtype=bool)
    nearest[np.where(ahead < behind, after, before)[reached]] = True
    within = (t >= rows[0]) & (t <= rows[-1])
    return nearest, int(np.sum(within & ~reached))
