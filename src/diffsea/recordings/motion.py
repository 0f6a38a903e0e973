"""Measured motion made ready for comparison: gaps bridged or marked, and windows without gaps."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Complex, Int

from diffsea.series import bridge_gaps, integrate, median_interval, strictly_later
from diffsea.trajectory import Samples, Trajectory


_MOST_KNOTS = 400  # windows per comparison: enough for any standard error wanted here
_FEWEST_SAMPLES = 20  # of a channel that is to be worked with
_MEMORY = 10.0  # s over which heading is averaged to lose its own noise
_ONE_SIZE = 1.01  # steps that differ by less are alike
_BRIDGED_INTERVALS = 3.5  # of a channel's own or the file's: three, and some jitter of the clock


@dataclasses.dataclass(frozen=True)
class MeasuredMotion:
    """Motion channels on one clock, with short gaps bridged and long ones marked.

    `values` and `known` have a series for each of `MOTION_CHANNELS`; `known[channel]` is false in
    samples that lie in a long gap. Channels are in SI units and radians, but in the axes and with
    the signs that the recording has, which may be wrong.
    """

    t: Samples  # s, strictly increasing
    values: dict[str, Samples]
    known: dict[str, Bool[np.ndarray, "time"]]

    @property
    def interval(self) -> float:
        """Median sampling interval, s."""
        return median_interval(self.t)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t[-1] - self.t[0])

    @property
    def place(self) -> Complex[np.ndarray, "time"]:
        """Position, north + i east, m."""
        return self.values["x"] + 1j * self.values["y"]

    @property
    def earth_velocity(self) -> Complex[np.ndarray, "time"]:
        """Velocity turned into earth axes by the heading, north + i east, m/s."""
        body = self.values["u"] + 1j * self.values["v"]
        return body * np.exp(1j * self.values["psi"])

    @property
    def path_misfit(self) -> Complex[np.ndarray, "time"]:
        """Position less integrated velocity, north + i east, m; constant in sound motion."""
        return self.place - integrate(self.t, self.earth_velocity)

    @property
    def turned(self) -> Samples:
        """Integral of the yaw rate, rad."""
        return integrate(self.t, self.values["r"])

    @property
    def steady_heading(self) -> Samples:
        """Heading without noise of its own, rad: that of the yaw rate, led by it over ten seconds.

        Where what depends on the heading is compared with it, its noise must not stand on both
        sides: it would explain itself.
        """
        turned = self.turned
        return turned + _moving_average(self.values["psi"] - turned, int(_MEMORY / self.interval))

    def has(self, *channels: str) -> bool:
        """Whether all these channels have enough samples to work with."""
        return all(np.sum(self.known[channel]) >= _FEWEST_SAMPLES for channel in channels)

    def with_channels(self, **values: Samples) -> "MeasuredMotion":
        """The same motion with some channels changed."""
        return dataclasses.replace(self, values=self.values | values)

    def without(self, channels: Iterable[str]) -> "MeasuredMotion":
        """The motion as if these channels had not been measured."""
        lost = {name: np.zeros(self.t.shape, dtype=bool) for name in channels}
        return dataclasses.replace(self, known=self.known | lost)


def motion_of(trajectory: Trajectory) -> MeasuredMotion:
    """The rows of a trajectory that count as motion, at strictly increasing times.

    A channel that repeats itself in a regular rhythm is sampled slower than the file: only
    its fresh values count. Gaps are bridged up to about three of a channel's own intervals.
    """
    run = trajectory.counted()
    run = run.rows(strictly_later(run.t))
    values, known = {}, {}
    for channel, series in run.motion.items():
        series = np.where(fresh_samples(series), series, np.nan)
        times = run.t[np.isfinite(series)]
        own = median_interval(times) if times.size > 2 else 0.0
        longest = _BRIDGED_INTERVALS * max(own, median_interval(run.t))
        values[channel], known[channel] = bridge_gaps(run.t, series, longest)
    return MeasuredMotion(run.t, values, known)


def fresh_samples(*series: Samples) -> Bool[np.ndarray, "time"]:
    """Which samples are new, where a slower sensor's value is repeated regularly.

    Of several series of one sensor, those in which any of them is new.
    """
    everything = np.ones(series[0].shape, dtype=bool)
    steps = np.sum(np.abs(np.diff(series)), axis=0)
    new = np.concatenate([[True], steps != 0])
    lengths = np.diff(np.flatnonzero(new))
    changes = steps[np.isfinite(steps) & (steps != 0)]
    if lengths.size < 20 or changes.size < 20:
        return everything
    # Steps of mostly one size are rounding: such a value is not held, it is just coarse. Those of
    # a position at a steady speed are never quite alike.
    if np.median(changes) < _ONE_SIZE * np.min(changes):
        return everything
    usual = np.median(lengths)
    return everything if usual < 2 or np.percentile(lengths, 90) > 2 * usual else new


def refine(motion: MeasuredMotion, turn: float) -> MeasuredMotion:
    """The motion on a finer clock, if need be, so that it turns by less than `turn` rad per step.

    Cubic Hermite splines between the samples: chords of a turn would pass for a lever arm, and cut
    corners for a late sensor. A sampling interval is cut into ten parts at most.
    """
    from scipy import interpolate  # slow to import, and not for every audit

    turns = np.abs(np.diff(motion.values["psi"]))
    parts = int(np.clip(np.ceil(np.percentile(turns, 95) / turn), 1, 10))
    if parts == 1:
        return motion
    fractions = np.arange(parts) / parts
    fine = motion.t[:-1, None] + np.diff(motion.t)[:, None] * fractions
    t = np.append(fine.ravel(), motion.t[-1])
    values = {}
    for name, series in motion.values.items():
        slopes = np.gradient(series, motion.t)
        values[name] = interpolate.CubicHermiteSpline(motion.t, series, slopes)(t)
    known = {name: np.repeat(mask, parts)[: t.size] for name, mask in motion.known.items()}
    return MeasuredMotion(t, values, known)


def knots(
    motion: MeasuredMotion, channels: tuple[str, ...], margin: float
) -> tuple[Int[np.ndarray, "knot"], Bool[np.ndarray, "window"]]:
    """Rows evenly in time between which motion is compared, and which windows have no gap.

    `margin` (s) is left out at both ends. A window lies between two knots and counts where all
    of the `channels` are known throughout.
    """
    t = motion.t
    window = max(2 * motion.interval, (t[-1] - t[0]) / _MOST_KNOTS)
    margin = min(margin, 0.05 * (t[-1] - t[0]))
    marks = np.arange(t[0] + margin, t[-1] - margin, window)
    index = np.unique(np.searchsorted(t, marks).clip(0, t.size - 1))
    unknown = ~np.all([motion.known[channel] for channel in channels], axis=0)
    lost = np.concatenate([[0], np.cumsum(unknown)])
    linked = lost[index[1:] + 1] == lost[index[:-1]]
    return index, linked


def windows(
    motion: MeasuredMotion, channels: tuple[str, ...]
) -> tuple[Int[np.ndarray, "window"], Int[np.ndarray, "window"]]:
    """First and last rows of windows without gaps, so long that noise does not matter in them."""
    index, linked = knots(motion, channels, 0.0)
    stride = max(1, index.size // 60)
    ends = index[::stride]
    whole = np.array([np.all(linked[i : i + stride]) for i in range(0, linked.size, stride)])
    whole = whole[: ends.size - 1]
    return ends[:-1][whole], ends[1:][whole]


def _moving_average(series: Samples, width: int) -> Samples:
    """Mean over about `width` samples, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first = (index - width // 2).clip(0)
    last = (index + width // 2 + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)
