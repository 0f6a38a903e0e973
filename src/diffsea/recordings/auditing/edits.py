"""Changes of a recording that put a fault right, in memory and, where one can say it, in a mapping.

A repair must be the same whether it is made in the recording or read through the mapping, so both
are methods of one record.
"""

import abc
import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.recordings.mappings import Column, Mapping
from diffsea.recordings.vocabulary import UNITS
from diffsea.series import between_samples, median_interval
from diffsea.trajectory import MOTION_CHANNELS, Samples, Series, Trajectory


Reader = Callable[[str], Samples]  # the series of a channel by its native name


class Edit(abc.ABC):
    """One change of a recording."""

    @abc.abstractmethod
    def apply(self, run: Trajectory) -> Trajectory:
        """The changed recording; the one given stays as it is."""

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """The mapping that reads the change from the file; None where no mapping can say it."""
        return None


class ChannelEdit(Edit):
    """A change of some channels, row by row, that leaves the rows themselves alone."""

    @abc.abstractmethod
    def new_series(self, read: Reader) -> dict[str, Samples]:
        """The changed channels by their native names, from all channels as they are."""

    def apply(self, run: Trajectory) -> Trajectory:
        """The recording with the changed channels."""
        return with_channels(run, self.new_series(lambda name: read_channel(run, name)))


def read_channel(run: Trajectory, name: str) -> Samples:
    """A channel by its native name: `t`, motion, `cmd_...`, `exec_...`, wind or roll."""
    if name == "t" or name in MOTION_CHANNELS:
        return np.asarray(getattr(run, name), dtype=float)
    for prefix, group in (("cmd_", run.commanded), ("exec_", run.executed)):
        if name.startswith(prefix):
            return np.asarray(group[name.removeprefix(prefix)], dtype=float)
    return np.asarray(run.extra[name], dtype=float)


def with_channels(run: Trajectory, channels: dict[str, Samples]) -> Trajectory:
    """The recording with other series for the channels of these native names."""
    plain = {name: s for name, s in channels.items() if name == "t" or name in MOTION_CHANNELS}

    def changed_group(old: dict[str, Series], prefix: str) -> dict[str, Series]:
        return {name: channels.get(prefix + name, series) for name, series in old.items()}

    return dataclasses.replace(
        run,
        **plain,
        commanded=changed_group(run.commanded, "cmd_"),
        executed=changed_group(run.executed, "exec_"),
        extra=changed_group(run.extra, ""),
    )


def _with_columns(
    mapping: Mapping, names: tuple[str, ...], change: Callable[[Column], Column]
) -> Mapping | None:
    """The mapping with the columns of some channels changed; None where one has no column."""
    if any(name not in mapping.channels for name in names):
        return None
    columns = {name: change(mapping.channels[name]) for name in names}
    return dataclasses.replace(mapping, channels=mapping.channels | columns)


@dataclasses.dataclass(frozen=True)
class Affine(ChannelEdit):
    """channel -> gain * channel + offset, in SI; `unit` is the label that makes the gain exact."""

    channels: tuple[str, ...]
    gain: float = 1.0
    offset: float = 0.0
    unit: str = ""

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """Every channel rescaled."""
        return {name: self.gain * read(name) + self.offset for name in self.channels}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """Unit, sign, scale and offset of the columns."""
        turned = mapping.velocity_axes == "earth"
        if turned and ("psi" in self.channels or len({"u", "v"} & set(self.channels)) == 1):
            return None
        delayed = any(column.delay for column in mapping.channels.values())
        if "t" in self.channels and delayed and self.gain != 1:
            return None
        return _with_columns(mapping, self.channels, self._rescaled_column)

    def _rescaled_column(self, column: Column) -> Column:
        if self.unit and (column.unit is None or UNITS[column.unit][1] == 1.0):
            return dataclasses.replace(column, unit=self.unit)
        factor = 1.0 if column.unit is None else UNITS[column.unit][1]
        gain, shift = self.gain * column.gain, self.gain * column.shift + self.offset
        sign = float(np.sign(gain))
        scale = abs(gain) / factor
        scale = 1.0 if abs(scale - 1) < 1e-12 else scale
        return dataclasses.replace(column, sign=sign, scale=scale, offset=shift / (sign * factor))


@dataclasses.dataclass(frozen=True)
class Swap(ChannelEdit):
    """Two channels exchange their series."""

    first: str
    second: str

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """The two exchanged."""
        return {self.first: read(self.second), self.second: read(self.first)}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """The two columns exchanged."""
        old, names = mapping.channels, {self.first, self.second}
        turned = mapping.velocity_axes == "earth" and {"u", "v"} & names
        if turned or not names <= set(old):
            return None
        new = {self.first: old[self.second], self.second: old[self.first]}
        return dataclasses.replace(mapping, channels=old | new)


@dataclasses.dataclass(frozen=True)
class Shift(ChannelEdit):
    """Channels that are late by `delay` + `rate` (t - `middle`) s go to where they belong.

    Samples beyond the ends of the recording become NaN.
    """

    channels: tuple[str, ...]
    delay: float
    rate: float = 0.0
    middle: float = 0.0

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """The channels read as much later as they are late."""
        t = read("t")
        late = t + self.delay + self.rate * (t - self.middle)
        return {name: _interpolate_within_gaps(t, read(name), late) for name in self.channels}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """A delay of the columns; a growing delay cannot be said."""
        turned = mapping.velocity_axes == "earth"
        if self.rate or (turned and {"psi", "u", "v"} & set(self.channels)):
            return None
        return _with_columns(
            mapping, self.channels, lambda c: dataclasses.replace(c, delay=c.delay + self.delay)
        )


def _interpolate_within_gaps(t: Samples, series: Samples, at: Samples) -> Samples:
    """The series at other times, NaN where it is unknown or in a gap of its own."""
    finite = np.isfinite(series)
    if np.sum(finite) < 2:
        return series
    times = t[finite]
    values = np.interp(at, times, series[finite], left=np.nan, right=np.nan)
    return np.where(between_samples(times, at, 3.0 * median_interval(times)), values, np.nan)


@dataclasses.dataclass(frozen=True)
class BodyAxes(ChannelEdit):
    """u and v are velocities north and east, to be turned into body axes by the heading."""

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """u and v in body axes."""
        body = (read("u") + 1j * read("v")) * np.exp(-1j * read("psi"))
        return {"u": body.real, "v": body.imag}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """velocity_axes = "earth"."""
        if mapping.velocity_axes == "earth" or not {"psi", "u", "v"} <= set(mapping.channels):
            return None
        return dataclasses.replace(mapping, velocity_axes="earth")


@dataclasses.dataclass(frozen=True)
class Blank(ChannelEdit):
    """Samples of channels within spans of time (s, both ends included) become NaN."""

    channels: tuple[str, ...]
    spans: tuple[tuple[float, float], ...]

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """The cells emptied."""
        t = read("t")
        inside = np.any([(t >= start) & (t <= end) for start, end in self.spans], axis=0)
        return {name: np.where(inside, np.nan, read(name)) for name in self.channels}


@dataclasses.dataclass(frozen=True)
class Compass(ChannelEdit):
    """Heading less `sine` sin(heading) + `cosine` cos(heading) (rad).

    With `velocities`, u and v had been turned into body axes by the faulty heading and are
    turned by its error.
    """

    sine: float
    cosine: float
    velocities: bool = False

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """Heading, and velocities if need be, without the error."""
        psi = read("psi")
        error = self.sine * np.sin(psi) + self.cosine * np.cos(psi)
        new = {"psi": psi - error}
        if self.velocities:
            body = (read("u") + 1j * read("v")) * np.exp(1j * error)
            new |= {"u": body.real, "v": body.imag}
        return new


@dataclasses.dataclass(frozen=True)
class Lever(ChannelEdit):
    """Positions of a point `x` m forward and `y` m to starboard go to the reference point."""

    x: float
    y: float

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """Positions less the turned arm."""
        arm = (self.x + 1j * self.y) * np.exp(1j * read("psi"))
        return {"x": read("x") - arm.real, "y": read("y") - arm.imag}


@dataclasses.dataclass(frozen=True)
class OverGround(ChannelEdit):
    """Velocities through water that flows `north` and `east` (m/s) become those over ground."""

    north: float
    east: float

    def new_series(self, read: Reader) -> dict[str, Samples]:
        """u and v with the current added."""
        flow = (self.north + 1j * self.east) * np.exp(-1j * read("psi"))
        return {"u": read("u") + flow.real, "v": read("v") + flow.imag}


@dataclasses.dataclass(frozen=True)
class ExecutedToCommanded(Edit):
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

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """The column under another name."""
        columns = dict(mapping.channels)
        column = columns.pop(f"exec_{self.actuator}", None)
        if column is None:
            return None
        return dataclasses.replace(mapping, channels={f"cmd_{self.actuator}": column} | columns)


@dataclasses.dataclass(frozen=True)
class UniformClock(Edit):
    """Rows are `step` s apart, whatever their time stamps say; the first keeps its own."""

    step: float

    def apply(self, run: Trajectory) -> Trajectory:
        """The recording on the uniform clock."""
        t = np.asarray(run.t, dtype=float)
        return dataclasses.replace(run, t=t[0] + self.step * np.arange(t.size))

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """time_step in place of the time column; time then starts at zero."""
        if "t" not in mapping.channels:
            return None
        columns = {name: column for name, column in mapping.channels.items() if name != "t"}
        return dataclasses.replace(mapping, channels=columns, time_step=self.step)


@dataclasses.dataclass(frozen=True)
class MergeRows(Edit):
    """Rows whose time does not advance are left out; of one time stamp the last counts."""

    def apply(self, run: Trajectory) -> Trajectory:
        """The rows left; what reading merged is dealt with, too, and the provenance says so."""
        t = np.asarray(run.t, dtype=float)
        following = np.append(np.minimum.accumulate(t[::-1])[::-1][1:], np.inf)
        merged = {rows.note for rows in run.read.repeated_times}
        return dataclasses.replace(
            run.rows(t < following),
            provenance=tuple(f"repaired: {n}" if n in merged else n for n in run.provenance),
            read=dataclasses.replace(run.read, repeated_times=()),
        )

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """Reading merges rows of one time stamp in any case."""
        return mapping
