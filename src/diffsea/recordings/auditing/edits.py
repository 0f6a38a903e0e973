"""Changes of a recording that put a fault right, in memory and, where one can say it, in a mapping.

Every edit has `apply`, which returns a changed recording, and `mapped`, which returns the mapping
that reads the same change from the file, or None where no mapping can say it.
"""

import dataclasses
from typing import Protocol

import numpy as np

from diffsea.recordings.mappings import UNITS, Mapping
from diffsea.trajectory import MOTION_CHANNELS, Series, Trajectory


class Edit(Protocol):
    """One change of a recording."""

    def apply(self, run: Trajectory) -> Trajectory:
        """The changed recording; the one given stays as it is."""
        ...

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """The mapping with the change in it; None where no mapping can say it."""
        ...


def channel(run: Trajectory, name: str) -> np.ndarray:
    """A channel by its native name: `t`, motion, `cmd_...`, `exec_...`, wind or roll."""
    if name == "t" or name in MOTION_CHANNELS:
        return np.asarray(getattr(run, name), dtype=float)
    for prefix, group in (("cmd_", run.commanded), ("exec_", run.executed)):
        if name.startswith(prefix):
            return np.asarray(group[name.removeprefix(prefix)], dtype=float)
    return np.asarray(run.extra[name], dtype=float)


def replaced(run: Trajectory, channels: dict[str, Series]) -> Trajectory:
    """The recording with other series for the channels of these native names."""
    plain = {name: s for name, s in channels.items() if name == "t" or name in MOTION_CHANNELS}

    def group(old: dict, prefix: str) -> dict:
        return {name: channels.get(prefix + name, series) for name, series in old.items()}

    return dataclasses.replace(
        run,
        **plain,
        commanded=group(run.commanded, "cmd_"),
        executed=group(run.executed, "exec_"),
        extra=group(run.extra, ""),
    )


def _with_columns(mapping: Mapping, **columns) -> Mapping:
    return dataclasses.replace(mapping, channels=mapping.channels | columns)


@dataclasses.dataclass(frozen=True)
class Affine:
    """channel -> gain * channel + offset, in SI; `unit` is the label that makes the gain exact."""

    channels: tuple[str, ...]
    gain: float = 1.0
    offset: float = 0.0
    unit: str = ""

    def apply(self, run: Trajectory) -> Trajectory:
        """Every channel rescaled."""
        return replaced(
            run, {name: self.gain * channel(run, name) + self.offset for name in self.channels}
        )

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """Unit, sign, scale and offset of the columns."""
        turned = mapping.velocity_axes == "earth"
        if turned and ("psi" in self.channels or len({"u", "v"} & set(self.channels)) == 1):
            return None
        delayed = any(column.delay for column in mapping.channels.values())
        if any(name not in mapping.channels for name in self.channels):
            return None
        if "t" in self.channels and delayed and self.gain != 1:
            return None
        return _with_columns(
            mapping, **{name: self._column(mapping.channels[name]) for name in self.channels}
        )

    def _column(self, column):
        if self.unit and (column.unit is None or UNITS[column.unit][1] == 1.0):
            return dataclasses.replace(column, unit=self.unit)
        factor = 1.0 if column.unit is None else UNITS[column.unit][1]
        gain, shift = self.gain * column.gain, self.gain * column.shift + self.offset
        sign = float(np.sign(gain))
        scale = abs(gain) / factor
        scale = 1.0 if abs(scale - 1) < 1e-12 else scale
        return dataclasses.replace(column, sign=sign, scale=scale, offset=shift / (sign * factor))


@dataclasses.dataclass(frozen=True)
class Swap:
    """Two channels exchange their series."""

    first: str
    second: str

    def apply(self, run: Trajectory) -> Trajectory:
        """The two exchanged."""
        first, second = channel(run, self.first), channel(run, self.second)
        return replaced(run, {self.first: second, self.second: first})

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """The two columns exchanged."""
        names = (self.first, self.second)
        if mapping.velocity_axes == "earth" and {"u", "v"} & set(names):
            return None
        if any(name not in mapping.channels for name in names):
            return None
        first, second = (mapping.channels[name] for name in names)
        return _with_columns(mapping, **{self.first: second, self.second: first})


@dataclasses.dataclass(frozen=True)
class Shift:
    """Channels that are late by `delay` + `rate` (t - `middle`) s go to where they belong.

    Samples beyond the ends of the recording become NaN.
    """

    channels: tuple[str, ...]
    delay: float
    rate: float = 0.0
    middle: float = 0.0

    def apply(self, run: Trajectory) -> Trajectory:
        """The channels read as much later as they are late."""
        t = np.asarray(run.t, dtype=float)
        late = t + self.delay + self.rate * (t - self.middle)
        return replaced(run, {n: _read_at(t, channel(run, n), late) for n in self.channels})

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """A delay of the columns; a growing delay cannot be said."""
        turned = mapping.velocity_axes == "earth"
        if self.rate or (turned and {"psi", "u", "v"} & set(self.channels)):
            return None
        if any(name not in mapping.channels for name in self.channels):
            return None
        old = {name: mapping.channels[name] for name in self.channels}
        return _with_columns(
            mapping,
            **{n: dataclasses.replace(c, delay=c.delay + self.delay) for n, c in old.items()},
        )


def _read_at(t: np.ndarray, series: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The series at other times, NaN where it is unknown or in a gap of its own."""
    finite = np.isfinite(series)
    if np.sum(finite) < 2:
        return series
    times = t[finite]
    values = np.interp(at, times, series[finite], left=np.nan, right=np.nan)
    after = np.searchsorted(times, at, side="left").clip(0, times.size - 1)
    before = (np.searchsorted(times, at, side="right") - 1).clip(0, times.size - 1)
    usual = float(np.median(np.diff(times)))
    return np.where(times[after] - times[before] <= 3.0 * usual, values, np.nan)


@dataclasses.dataclass(frozen=True)
class BodyAxes:
    """u and v are velocities north and east, to be turned into body axes by the heading."""

    def apply(self, run: Trajectory) -> Trajectory:
        """u and v in body axes."""
        body = (channel(run, "u") + 1j * channel(run, "v")) * np.exp(-1j * channel(run, "psi"))
        return replaced(run, {"u": body.real, "v": body.imag})

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """velocity_axes = "earth"."""
        if mapping.velocity_axes == "earth" or not {"psi", "u", "v"} <= set(mapping.channels):
            return None
        return dataclasses.replace(mapping, velocity_axes="earth")


@dataclasses.dataclass(frozen=True)
class Blank:
    """Samples of channels within spans of time (s, both ends included) become NaN."""

    channels: tuple[str, ...]
    spans: tuple[tuple[float, float], ...]

    def apply(self, run: Trajectory) -> Trajectory:
        """The cells emptied."""
        t = np.asarray(run.t, dtype=float)
        inside = np.any([(t >= start) & (t <= end) for start, end in self.spans], axis=0)
        return replaced(run, {n: np.where(inside, np.nan, channel(run, n)) for n in self.channels})

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """No mapping empties cells."""
        return None


@dataclasses.dataclass(frozen=True)
class Compass:
    """Heading less `sine` sin(heading) + `cosine` cos(heading) (rad).

    With `velocities`, u and v had been turned into body axes by the faulty heading and are
    turned by its error.
    """

    sine: float
    cosine: float
    velocities: bool = False

    def apply(self, run: Trajectory) -> Trajectory:
        """Heading, and velocities if need be, without the error."""
        psi = channel(run, "psi")
        error = self.sine * np.sin(psi) + self.cosine * np.cos(psi)
        new = {"psi": psi - error}
        if self.velocities:
            body = (channel(run, "u") + 1j * channel(run, "v")) * np.exp(1j * error)
            new |= {"u": body.real, "v": body.imag}
        return replaced(run, new)

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """No mapping has a compass curve."""
        return None


@dataclasses.dataclass(frozen=True)
class Lever:
    """Positions of a point `x` m forward and `y` m to starboard go to the reference point."""

    x: float
    y: float

    def apply(self, run: Trajectory) -> Trajectory:
        """Positions less the turned arm."""
        arm = (self.x + 1j * self.y) * np.exp(1j * channel(run, "psi"))
        new = {"x": channel(run, "x") - arm.real, "y": channel(run, "y") - arm.imag}
        return replaced(run, new)

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """No mapping moves positions by the heading."""
        return None


@dataclasses.dataclass(frozen=True)
class OverGround:
    """Velocities through water that flows `north` and `east` (m/s) become those over ground."""

    north: float
    east: float

    def apply(self, run: Trajectory) -> Trajectory:
        """u and v with the current added."""
        flow = (self.north + 1j * self.east) * np.exp(-1j * channel(run, "psi"))
        return replaced(
            run, {"u": channel(run, "u") + flow.real, "v": channel(run, "v") + flow.imag}
        )

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """No mapping adds a current."""
        return None


@dataclasses.dataclass(frozen=True)
class Order:
    """What is called executed is an order: exec_<actuator> becomes cmd_<actuator>.

    Where the order is there already, the other is left out.
    """

    actuator: str

    def apply(self, run: Trajectory) -> Trajectory:
        """The channel moved from executed to commanded."""
        executed = dict(run.executed)
        series = executed.pop(self.actuator)
        return dataclasses.replace(
            run, executed=executed, commanded={self.actuator: series} | run.commanded
        )

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """The column under another name."""
        columns = dict(mapping.channels)
        if f"exec_{self.actuator}" not in columns:
            return None
        column = columns.pop(f"exec_{self.actuator}")
        return dataclasses.replace(mapping, channels={f"cmd_{self.actuator}": column} | columns)


@dataclasses.dataclass(frozen=True)
class Clock:
    """Rows are `step` s apart, whatever their time stamps say; the first keeps its own."""

    step: float

    def apply(self, run: Trajectory) -> Trajectory:
        """The recording on the uniform clock."""
        t = np.asarray(run.t, dtype=float)
        return dataclasses.replace(run, t=t[0] + self.step * np.arange(t.size))

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """time_step in place of the time column; time then starts at zero."""
        if "t" not in mapping.channels:
            return None
        columns = {name: column for name, column in mapping.channels.items() if name != "t"}
        return dataclasses.replace(mapping, channels=columns, time_step=self.step)


@dataclasses.dataclass(frozen=True)
class Merge:
    """Rows whose time does not advance are left out; of one time stamp the last counts."""

    note: str  # the first words of the provenance's note on rows merged while reading

    def apply(self, run: Trajectory) -> Trajectory:
        """The rows left, and the provenance saying that their repetition is dealt with."""
        t = np.asarray(run.t, dtype=float)
        following = np.append(np.minimum.accumulate(t[::-1])[::-1][1:], np.inf)
        kept = t < following
        notes = tuple(
            f"repaired: {note}" if note.startswith(self.note) else note for note in run.provenance
        )
        names = [*MOTION_CHANNELS]

        def rows(group: dict) -> dict:
            return {name: np.asarray(series)[kept] for name, series in group.items()}

        return dataclasses.replace(
            run,
            t=t[kept],
            **rows({name: getattr(run, name) for name in names}),
            commanded=rows(run.commanded),
            executed=rows(run.executed),
            extra=rows(run.extra),
            valid=np.asarray(run.valid, dtype=bool)[kept],
            provenance=notes,
        )

    def mapped(self, mapping: Mapping) -> Mapping | None:
        """Reading merges rows of one time stamp in any case."""
        return mapping
