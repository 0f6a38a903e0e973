"""Motion channels made ready for comparison: gaps bridged or marked, integrals, windows."""

import dataclasses

import numpy as np
from scipy import interpolate

from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_KNOTS = 400  # windows per comparison at most: enough for any standard error wanted here


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion channels on one clock, with short gaps bridged and long ones marked.

    `known[channel]` is false in samples that lie in a long gap.
    """

    t: np.ndarray
    values: dict[str, np.ndarray]
    known: dict[str, np.ndarray]

    @property
    def interval(self) -> float:
        """Median sampling interval, s."""
        return float(np.median(np.diff(self.t)))

    def has(self, *channels: str) -> bool:
        """Whether all these channels have enough samples to work with."""
        return all(np.sum(self.known[channel]) >= 20 for channel in channels)

    def replaced(self, **values: np.ndarray) -> "Motion":
        """The same motion with some channels changed."""
        return dataclasses.replace(self, values=self.values | values)


def bridged(t: np.ndarray, series: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """The series with gaps interpolated, and which samples lie in no gap above `longest` s."""
    finite = np.isfinite(series)
    if np.sum(finite) < 2:
        return np.zeros_like(t), np.zeros(t.shape, dtype=bool)
    times = t[finite]
    after = np.searchsorted(times, t, side="left").clip(0, times.size - 1)
    before = (np.searchsorted(times, t, side="right") - 1).clip(0, times.size - 1)
    near = (times[after] - times[before] <= longest) & (t >= times[0]) & (t <= times[-1])
    return np.interp(t, times, series[finite]), near


def knots(motion: Motion, channels: tuple[str, ...], margin: float) -> tuple[np.ndarray, ...]:
    """Indices of the knots, and which windows between them are wholly known."""
    t = motion.t
    window = max(2 * motion.interval, (t[-1] - t[0]) / _KNOTS)
    margin = min(margin, 0.05 * (t[-1] - t[0]))
    marks = np.arange(t[0] + margin, t[-1] - margin, window)
    index = np.unique(np.searchsorted(t, marks).clip(0, t.size - 1))
    unknown = ~np.all([motion.known[channel] for channel in channels], axis=0)
    lost = np.concatenate([[0], np.cumsum(unknown)])
    linked = lost[index[1:] + 1] == lost[index[:-1]]
    return index, linked


def integral(t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Cumulative trapezoidal integral along the last axis, starting at zero."""
    steps = 0.5 * (series[..., 1:] + series[..., :-1]) * np.diff(t)
    return np.concatenate([np.zeros((*series.shape[:-1], 1)), np.cumsum(steps, axis=-1)], -1)


def refined(motion: Motion, turn: float) -> Motion:
    """The motion on a finer clock, if need be, so that it turns by less than `turn` rad per step.

    Cubic between the samples: chords of a turn would pass for a lever arm, and cut corners
    for a late sensor.
    """
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
    return Motion(t, values, known)


def motion_of(trajectory: Trajectory) -> Motion:
    """The valid rows of a trajectory as motion, at strictly increasing times.

    A channel that repeats itself in a regular rhythm is sampled slower than the file: only
    its fresh values count. Gaps are bridged up to about three of a channel's own intervals.
    """
    rows = np.flatnonzero(np.asarray(trajectory.valid, dtype=bool))
    time = np.asarray(trajectory.t, dtype=float)[rows]
    ahead = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    time, rows = time[ahead], rows[ahead]
    values, known = {}, {}
    for channel in MOTION_CHANNELS:
        series = np.asarray(getattr(trajectory, channel), dtype=float)[rows]
        series = np.where(_fresh(series), series, np.nan)
        times = time[np.isfinite(series)]
        own = np.median(np.diff(times)) if times.size > 2 else 0.0
        longest = max(3.5 * own, 3.5 * np.median(np.diff(time)))
        values[channel], known[channel] = bridged(time, series, longest)
    return Motion(time, values, known)


def _fresh(series: np.ndarray) -> np.ndarray:
    """Which samples are new, where a slower sensor's value is repeated regularly."""
    everything = np.ones(series.shape, dtype=bool)
    steps = np.diff(series)
    new = np.concatenate([[True], steps != 0])
    lengths = np.diff(np.flatnonzero(new))
    changes = np.abs(steps[np.isfinite(steps) & (steps != 0)])
    if lengths.size < 20 or changes.size < 20:
        return everything
    # Steps of mostly one size are rounding: such a value is not held, it is just coarse.
    if np.median(changes) < 1.5 * np.min(changes):
        return everything
    usual = np.median(lengths)
    return everything if usual < 2 or np.percentile(lengths, 90) > 2 * usual else new


def windows(motion: Motion, channels: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Start and end indices of windows long enough for noise not to matter."""
    index, linked = knots(motion, channels, 0.0)
    stride = max(1, index.size // 60)
    kept = index[::stride]
    whole = np.array([np.all(linked[i : i + stride]) for i in range(0, linked.size, stride)])
    whole = whole[: kept.size - 1]
    return kept[:-1][whole], kept[1:][whole]
