"""Changes of a recording that put a fault right, in memory and, where one can say it, in a mapping.

A repair must be the same whether it is made in the recording or read through the mapping, so both
are methods of one record.
"""

import abc
import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool

from diffsea.recordings.mappings import UNITS, Column, Mapping, native_channels, with_channels
from diffsea.series import between_samples, median_interval, unwrap
from diffsea.trajectory import Samples, Trajectory


Channels = dict[str, Samples]  # by native name, SI units
Spans = tuple[tuple[float, float], ...]  # s, both ends included


class Edit(abc.ABC):
    """One change of a recording."""

    @abc.abstractmethod
    def apply(self, run: Trajectory) -> Trajectory:
        """The changed recording; the one given stays as it is."""

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        """The mapping that reads the change from the file; None where no mapping can say it."""
        return None

    @property
    def changed_spans(self) -> Spans:
        """Where it changes anything; empty for the whole recording."""
        return ()


class ChannelEdit(Edit):
    """A change of some channels, row by row, that leaves the rows themselves alone.

    The audit applies it to the motion alone, a repair to the whole recording.
    """

    @abc.abstractmethod
    def new_series(self, old: Channels) -> Channels:
        """The changed channels, from all channels as they are."""

    def apply(self, run: Trajectory) -> Trajectory:
        return with_channels(run, self.new_series(native_channels(run)))


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
    """channel -> gain * channel + offset, in SI; `unit` is the label that makes the gain exact.

    A mapping says it by unit, sign, scale and offset of the columns, but not of what is turned from
    earth into body axes, nor of a clock on which delays are counted.
    """

    channels: tuple[str, ...]
    gain: float = 1.0
    offset: float = 0.0
    unit: str = ""

    def new_series(self, old: Channels) -> Channels:
        return {name: self.gain * old[name] + self.offset for name in self.channels}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        turned = mapping.velocity_axes == "earth"
        if turned and ("psi" in self.channels or len({"u", "v"} & set(self.channels)) == 1):
            return None
        delayed = any(column.delay for column in mapping.channels.values())
        if "t" in self.channels and delayed and self.gain != 1:
            return None
        return _with_columns(mapping, self.channels, self._rescaled_column)

    def _rescaled_column(self, column: Column) -> Column:
        factor = 1.0 if column.unit is None else UNITS[column.unit][1]
        if self.unit and factor == 1.0:
            return dataclasses.replace(column, unit=self.unit)
        gain, shift = self.gain * column.gain, self.gain * column.shift + self.offset
        sign = float(np.sign(gain))
        scale = abs(gain) / factor
        scale = 1.0 if abs(scale - 1) < 1e-12 else scale
        return dataclasses.replace(column, sign=sign, scale=scale, offset=shift / (sign * factor))


@dataclasses.dataclass(frozen=True)
class Swap(ChannelEdit):
    """Two channels exchange their series, or their columns in the mapping."""

    first: str
    second: str

    def new_series(self, old: Channels) -> Channels:
        return {self.first: old[self.second], self.second: old[self.first]}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        old, names = mapping.channels, {self.first, self.second}
        turned = mapping.velocity_axes == "earth" and {"u", "v"} & names
        if turned or not names <= set(old):
            return None
        new = {self.first: old[self.second], self.second: old[self.first]}
        return dataclasses.replace(mapping, channels=old | new)


@dataclasses.dataclass(frozen=True)
class Shift(ChannelEdit):
    """Channels that are late by `delay` + `rate` (t - `middle`) s go to where they belong.

    Samples beyond the ends of the recording, or within a gap of three of a channel's own sampling
    intervals or more, become NaN. A mapping can say a delay, but not one that grows.
    """

    channels: tuple[str, ...]
    delay: float
    rate: float = 0.0
    middle: float = 0.0

    def new_series(self, old: Channels) -> Channels:
        t = old["t"]
        late = t + self.delay + self.rate * (t - self.middle)
        new = {}
        for name in self.channels:
            finite = np.isfinite(old[name])
            if np.sum(finite) < 2:
                continue
            times = t[finite]
            values = np.interp(late, times, old[name][finite], left=np.nan, right=np.nan)
            known = between_samples(times, late, 3.0 * median_interval(times))
            new[name] = np.where(known, values, np.nan)
        return new

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        turned = mapping.velocity_axes == "earth"
        if self.rate or (turned and {"psi", "u", "v"} & set(self.channels)):
            return None
        return _with_columns(
            mapping, self.channels, lambda c: dataclasses.replace(c, delay=c.delay + self.delay)
        )


@dataclasses.dataclass(frozen=True)
class BodyAxes(ChannelEdit):
    """u and v are velocities north and east, to be turned into body axes by the heading.

    In a mapping that is velocity_axes = "earth".
    """

    def new_series(self, old: Channels) -> Channels:
        body = (old["u"] + 1j * old["v"]) * np.exp(-1j * old["psi"])
        return {"u": body.real, "v": body.imag}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        if mapping.velocity_axes == "earth" or not {"psi", "u", "v"} <= set(mapping.channels):
            return None
        return dataclasses.replace(mapping, velocity_axes="earth")


@dataclasses.dataclass(frozen=True)
class Blank(ChannelEdit):
    """Samples of channels within spans of time (s, both ends included) become NaN."""

    channels: tuple[str, ...]
    spans: Spans

    @property
    def changed_spans(self) -> Spans:
        return self.spans

    def new_series(self, old: Channels) -> Channels:
        inside = within_spans(old["t"], self.spans)
        return {name: np.where(inside, np.nan, old[name]) for name in self.channels}


def within_spans(t: Samples, spans: Spans) -> Bool[np.ndarray, "time"]:
    """Which instants (s) lie in one of the spans, both ends included."""
    starts, ends = np.array(spans, dtype=float).reshape(-1, 2).T
    edges = np.zeros(t.size + 1, dtype=int)
    np.add.at(edges, np.searchsorted(t, starts, side="left"), 1)
    np.add.at(edges, np.searchsorted(t, ends, side="right"), -1)
    return np.cumsum(edges[:-1]) > 0


@dataclasses.dataclass(frozen=True)
class Rewrap(ChannelEdit):
    """A heading whose values within spans of time (s) become NaN, unwrapped without them.

    The first value that stays keeps its turn.
    """

    channel: str
    spans: Spans

    @property
    def changed_spans(self) -> Spans:
        return self.spans

    def new_series(self, old: Channels) -> Channels:
        turn = 2 * np.pi
        kept = np.where(within_spans(old["t"], self.spans), np.nan, old[self.channel])
        whole = unwrap(np.mod(kept, turn))
        first = np.argmax(np.isfinite(kept))
        return {self.channel: whole + turn * np.round((kept[first] - whole[first]) / turn)}


@dataclasses.dataclass(frozen=True)
class Compass(ChannelEdit):
    """Heading less `sine` sin(heading) + `cosine` cos(heading) (rad).

    With `velocities`, u and v had been turned into body axes by the faulty heading and are
    turned by its error.
    """

    sine: float
    cosine: float
    velocities: bool = False

    def new_series(self, old: Channels) -> Channels:
        psi = old["psi"]
        error = self.sine * np.sin(psi) + self.cosine * np.cos(psi)
        return _turned_back(old, error, self.velocities)


@dataclasses.dataclass(frozen=True)
class Turned(ChannelEdit):
    """Heading less an error (rad) that is known at some times (s), straight lines between them.

    With `velocities`, u and v are turned by it, as those of a `Compass`.
    """

    times: tuple[float, ...]
    error: tuple[float, ...]
    velocities: bool = False

    def new_series(self, old: Channels) -> Channels:
        error = np.interp(old["t"], self.times, self.error)
        return _turned_back(old, error, self.velocities)


def _turned_back(old: Channels, error: Samples, velocities: bool) -> Channels:
    """Heading less an error (rad), and velocities turned by it where they had been turned."""
    if not velocities:
        return {"psi": old["psi"] - error}
    body = (old["u"] + 1j * old["v"]) * np.exp(1j * error)
    return {"psi": old["psi"] - error, "u": body.real, "v": body.imag}


@dataclasses.dataclass(frozen=True)
class StepRemoval(ChannelEdit):
    """A channel less `size` after an instant (s)."""

    channel: str
    size: float
    time: float

    @property
    def changed_spans(self) -> Spans:
        return ((self.time, np.inf),)

    def new_series(self, old: Channels) -> Channels:
        return {self.channel: old[self.channel] - self.size * (old["t"] > self.time)}


@dataclasses.dataclass(frozen=True)
class Reheading(ChannelEdit):
    """Heading `sense` times as recorded plus `offset` (rad), velocities in its body axes.

    u and v had been turned into body axes by the heading as recorded, and the yaw rate agreed with
    it. A mapping says it where velocities are read in earth axes.
    """

    sense: float
    offset: float

    def new_series(self, old: Channels) -> Channels:
        psi = self.sense * old["psi"] + self.offset
        body = (old["u"] + 1j * old["v"]) * np.exp(1j * (old["psi"] - psi))
        return {"psi": psi, "u": body.real, "v": body.imag, "r": self.sense * old["r"]}

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        if mapping.velocity_axes != "earth":
            return None
        amended: Mapping | None = dataclasses.replace(mapping, velocity_axes="body")
        changes = [Affine(("psi",), self.sense, self.offset), Affine(("r",), self.sense)]
        for change in changes if "r" in mapping.channels else changes[:1]:
            amended = None if amended is None else change.amend_mapping(amended)
        return None if amended is None else dataclasses.replace(amended, velocity_axes="earth")


@dataclasses.dataclass(frozen=True)
class Lever(ChannelEdit):
    """Positions of a point `x` m forward and `y` m to starboard go to the reference point."""

    x: float
    y: float

    def new_series(self, old: Channels) -> Channels:
        arm = (self.x + 1j * self.y) * np.exp(1j * old["psi"])
        return {"x": old["x"] - arm.real, "y": old["y"] - arm.imag}


@dataclasses.dataclass(frozen=True)
class OverGround(ChannelEdit):
    """Velocities through water that flows `north` and `east` (m/s) become those over ground."""

    north: float
    east: float

    def new_series(self, old: Channels) -> Channels:
        flow = (self.north + 1j * self.east) * np.exp(-1j * old["psi"])
        return {"u": old["u"] + flow.real, "v": old["v"] + flow.imag}


@dataclasses.dataclass(frozen=True)
class ExecutedToCommanded(Edit):
    """What is called executed is an order: exec_<actuator> becomes cmd_<actuator>.

    Where the order is there already, the other is left out.
    """

    actuator: str

    def apply(self, run: Trajectory) -> Trajectory:
        executed = dict(run.executed)
        commanded = {self.actuator: executed.pop(self.actuator)} | run.commanded
        return dataclasses.replace(run, executed=executed, commanded=commanded)

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        columns = dict(mapping.channels)
        column = columns.pop(f"exec_{self.actuator}", None)
        if column is None:
            return None
        order = f"cmd_{self.actuator}"
        there = {} if order in mapping.constants else {order: column}
        return dataclasses.replace(mapping, channels=there | columns)


@dataclasses.dataclass(frozen=True)
class UniformClock(Edit):
    """Rows are `step` s apart, whatever their time stamps say; the first keeps its own.

    A mapping says it by time_step in place of the time column; time then starts at zero.
    """

    step: float

    def apply(self, run: Trajectory) -> Trajectory:
        t = np.asarray(run.t, dtype=float)
        return dataclasses.replace(run, t=t[0] + self.step * np.arange(t.size))

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        if "t" not in mapping.channels:
            return None
        columns = {name: column for name, column in mapping.channels.items() if name != "t"}
        return dataclasses.replace(mapping, channels=columns, time_step=self.step)


@dataclasses.dataclass(frozen=True)
class MergeRows(Edit):
    """Rows whose time does not advance are left out; of one time stamp the last counts.

    What reading merged is dealt with, too, and the provenance says so. No mapping need say it:
    reading merges such rows in any case.
    """

    def apply(self, run: Trajectory) -> Trajectory:
        t = np.asarray(run.t, dtype=float)
        following = np.append(np.minimum.accumulate(t[::-1])[::-1][1:], np.inf)
        merged = {rows.note for rows in run.read.repeated_times}
        return dataclasses.replace(
            run.rows(t < following),
            provenance=tuple(f"repaired: {n}" if n in merged else n for n in run.provenance),
            read=dataclasses.replace(run.read, repeated_times=()),
        )

    def amend_mapping(self, mapping: Mapping) -> Mapping | None:
        return mapping
