"""Preparing recordings: cutting, splitting and putting them on one uniform clock.

Nothing is invented: gaps stay gaps (NaN), commands hold, and what was done stands in the
provenance.
"""

import dataclasses

import numpy as np

from diffsea.errors import UserError
from diffsea.trajectory import MOTION_CHANNELS, Series, Trajectory


_ANGLES = ("wind_direction",)  # wrapped in recordings, so averaged on the circle


def typical_interval(t: np.ndarray) -> float:
    """Median time step (s) of increasing time stamps; repeated stamps do not count."""
    steps = np.diff(np.asarray(t, dtype=float))
    steps = steps[steps > 0]
    if not steps.size:
        raise UserError("a recording needs at least two different time stamps")
    return float(np.median(steps))


def cut(trajectory: Trajectory, start: float, end: float) -> Trajectory:
    """The rows with start <= t <= end (s); time keeps its zero.

    Raises `UserError` where fewer than two rows are left.
    """
    t = np.asarray(trajectory.t, dtype=float)
    rows = (t >= start) & (t <= end)
    if np.sum(rows) < 2:
        raise UserError(
            f"{trajectory.name} has {np.sum(rows)} samples from {start:g} s to {end:g} s; it "
            f"runs from {t[0]:g} s to {t[-1]:g} s"
        )
    note = f"cut to t = {start:g} s ... {end:g} s"
    return _rows(trajectory, rows, note)


def split(trajectory: Trajectory, times: list[float]) -> list[Trajectory]:
    """The pieces between the given times (s); a sample at a time begins the later piece."""
    t = np.asarray(trajectory.t, dtype=float)
    edges = [-np.inf, *sorted(times), np.inf]
    pieces = []
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        rows = (t >= start) & (t < end)
        if np.sum(rows) < 2:
            raise UserError(
                f"{trajectory.name} has {np.sum(rows)} samples between the split times "
                f"{start:g} s and {end:g} s; it runs from {t[0]:g} s to {t[-1]:g} s"
            )
        pieces.append(_rows(trajectory, rows, f"split at {start:g} s and {end:g} s"))
    return pieces


def _rows(trajectory: Trajectory, rows: np.ndarray, note: str) -> Trajectory:
    def kept(group: dict) -> dict:
        return {name: np.asarray(series)[rows] for name, series in group.items()}

    return dataclasses.replace(
        trajectory,
        t=np.asarray(trajectory.t)[rows],
        **kept({name: getattr(trajectory, name) for name in MOTION_CHANNELS}),
        commanded=kept(trajectory.commanded),
        executed=kept(trajectory.executed),
        extra=kept(trajectory.extra),
        valid=np.asarray(trajectory.valid, dtype=bool)[rows],
        provenance=(*trajectory.provenance, note),
    )


def resample(trajectory: Trajectory, interval: float, max_gap: float | None = None) -> Trajectory:
    """The valid rows on a uniform clock of `interval` s that starts at the first of them.

    Motion and wind: each new sample is the value of a straight line through the old samples
    within half an interval either side, which is their average where they lie evenly, so
    that coarsening lowers the noise instead of folding it; movements faster than twice the
    interval are smoothed away. Where none are that near, it is interpolated between the
    neighbours if these are no further apart than `max_gap` (s; by default three of the
    channel's own intervals), else it is NaN. Actuation holds: a new sample takes the value
    in force at its instant, so a step moves by up to one interval.

    Raises `UserError` for an interval that is not above zero or leaves fewer than two
    samples.
    """
    if not np.isfinite(interval) or interval <= 0:
        raise UserError(f"the interval must be above zero seconds, got {interval:g}")
    valid = np.asarray(trajectory.valid, dtype=bool)
    old = np.asarray(trajectory.t, dtype=float)[valid]
    # The last sample may fall short of a whole interval by rounding only.
    new = old[0] + interval * np.arange(int((old[-1] - old[0]) / interval + 1e-6) + 1)
    if new.size < 2:
        raise UserError(
            f"{trajectory.name} lasts {old[-1] - old[0]:g} s, too short for an interval of "
            f"{interval:g} s"
        )

    def motion(name: str, series: Series) -> np.ndarray:
        values = np.asarray(series, dtype=float)[valid]
        if name in _ANGLES:
            circle = _resampled(old, np.exp(1j * values), new, interval, max_gap)
            return np.where(np.isfinite(circle), np.angle(circle) % (2 * np.pi), np.nan)
        return _resampled(old, values, new, interval, max_gap)

    def held(series: Series) -> np.ndarray:
        row = np.searchsorted(old, new + 1e-6 * interval, side="right") - 1
        return np.asarray(series, dtype=float)[valid][row.clip(0)]

    channels = {name: getattr(trajectory, name) for name in MOTION_CHANNELS}
    return dataclasses.replace(
        trajectory,
        t=new,
        **{name: motion(name, series) for name, series in channels.items()},
        commanded={name: held(series) for name, series in trajectory.commanded.items()},
        executed={name: held(series) for name, series in trajectory.executed.items()},
        extra={name: motion(name, series) for name, series in trajectory.extra.items()},
        valid=np.ones(new.shape, dtype=bool),
        provenance=(*trajectory.provenance, f"resampled to {interval:g} s"),
    )


def _resampled(
    old: np.ndarray, values: np.ndarray, new: np.ndarray, interval: float, max_gap: float | None
) -> np.ndarray:
    finite = np.isfinite(values)
    times, values = old[finite], values[finite]
    if times.size < 2:
        return np.full(new.shape, np.nan, dtype=values.dtype)
    longest = 3.0 * float(np.median(np.diff(times))) if max_gap is None else max_gap
    between = _interpolated(times, values, new, longest)
    line = _local_line(times, values, new, 0.5 * interval)
    return np.where(np.isfinite(line) & np.isfinite(between), line, between)


def _interpolated(
    times: np.ndarray, values: np.ndarray, new: np.ndarray, longest: float
) -> np.ndarray:
    """Linear interpolation between neighbours at most `longest` s apart, else NaN."""
    after = np.searchsorted(times, new - 1e-9, side="left").clip(0, times.size - 1)
    before = (np.searchsorted(times, new + 1e-9, side="right") - 1).clip(0, times.size - 1)
    inside = (new >= times[0] - 1e-9) & (new <= times[-1] + 1e-9)
    near = inside & (times[after] - times[before] <= longest * (1 + 1e-9))
    return np.where(near, np.interp(new, times, values), np.nan)


def _local_line(times: np.ndarray, values: np.ndarray, new: np.ndarray, half: float) -> np.ndarray:
    """At each new time, the straight line through the samples within `half` s; NaN below three.

    The samples at the very edge of the span belong to both neighbours.
    """
    first = np.searchsorted(times, new - half * (1 + 1e-9), side="left")
    last = np.searchsorted(times, new + half * (1 + 1e-9), side="right")
    count = last - first

    def total(series: np.ndarray) -> np.ndarray:
        sums = np.concatenate([[0.0], np.cumsum(series)])
        return sums[last] - sums[first]

    zero = times[0]  # keeps the sums of squares exact for clocks that count from 1970
    past, here = times - zero, new - zero
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_t, mean_v = total(past) / count, total(values) / count
        spread = total(past**2) / count - mean_t**2
        slope = (total(past * values) / count - mean_t * mean_v) / spread
        line = mean_v + slope * (here - mean_t)
    return np.where(count >= 3, line, np.nan)
