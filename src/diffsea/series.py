"""Time series of recordings: held, interpolated, integrated, and their clocks and angles.

Measured series have missing samples (NaN), gaps and repeated stamps, and motion and actuation
mean different things between two stamps: motion goes on in between, an order holds until the
next. These functions say once what is done about it. They take plain NumPy arrays of the rows
that count, see `Trajectory.counted`.
"""

import numpy as np
from jaxtyping import Bool, Float, Inexact

from diffsea.trajectory import Samples


BRIDGED_INTERVALS = 3.0  # of a channel's own: a straight line says little across more
CALENDAR = 1e8  # s: a clock that has run for three years counts from a calendar's epoch


def median_interval(t: Samples) -> float:
    """Median time step (s) of time stamps, repeated ones included."""
    return float(np.median(np.diff(t)))


def strictly_later(t: Samples) -> Bool[np.ndarray, "time"]:
    """The rows whose time stamp (s) is later than all before: what is left increases strictly."""
    later = np.ones(t.shape, dtype=bool)
    later[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
    return later


def stretches(chosen: Bool[np.ndarray, "time"]) -> list[slice]:
    """The rows that are chosen, one slice for each stretch without a break."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).tolist()
    return [slice(first, stop) for first, stop in zip(edges[::2], edges[1::2], strict=True)]


def hold_last(values: Samples, leading: str = "first") -> Samples:
    """Missing values (NaN) as the last one before.

    Those before the first value are as that one, or, where `leading` is "missing", stay NaN.
    All are NaN where no value is known.
    """
    finite = np.isfinite(values)
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values)), -1))
    if leading == "missing":
        return np.where(last < 0, np.nan, values[last])
    return values[np.where(last < 0, np.argmax(finite), last)]


def hold_at(
    t: Samples, values: Samples, times: Float[np.ndarray, "new"]
) -> Float[np.ndarray, "new"]:
    """At other times (s), the value whose stamp is the last until then; NaN before the first."""
    if not t.size:
        return np.full(times.shape, np.nan)
    last = np.searchsorted(t, times, side="right") - 1
    return np.where(last < 0, np.nan, values[last.clip(0)])


def interpolate_missing(t: Samples, values: Samples) -> Samples:
    """Missing values (NaN) on straight lines between neighbours, however far; beyond, as the end.

    All are NaN where no value is known.
    """
    finite = np.isfinite(values)
    return np.interp(t, t[finite], values[finite]) if finite.any() else values


def between_samples(
    t: Samples, times: Float[np.ndarray, "new"], longest: float, tolerance: float = 0.0
) -> Bool[np.ndarray, "new"]:
    """Which times (s) are stamps, or lie between two that are at most `longest` s apart.

    `t` increases and is not empty. A time within `tolerance` (s) of a stamp counts as being there.
    """
    after = np.searchsorted(t, times - tolerance, side="left").clip(0, t.size - 1)
    before = (np.searchsorted(t, times + tolerance, side="right") - 1).clip(0, t.size - 1)
    inside = (times >= t[0] - tolerance) & (times <= t[-1] + tolerance)
    return inside & (t[after] - t[before] <= longest)


def bridge_gaps(
    t: Samples, values: Samples, longest: float
) -> tuple[Samples, Bool[np.ndarray, "time"]]:
    """The values with all gaps interpolated, and which lie in no gap above `longest` s.

    Fewer than two known values give zeros, all of them unknown.
    """
    finite = np.isfinite(values)
    if np.sum(finite) < 2:
        return np.zeros_like(t), np.zeros(t.shape, dtype=bool)
    known = between_samples(t[finite], t, longest)
    return np.interp(t, t[finite], values[finite]), known


def integrate(
    t: Samples, values: Inexact[np.ndarray, "*any time"]
) -> Inexact[np.ndarray, "*any time"]:
    """Cumulative trapezoidal integral over time along the last axis, zero in the first row."""
    steps = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(t)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(steps, axis=-1)], -1)


def unwrap(angle: Samples) -> Samples:
    """The angle (rad) without jumps of a turn, continued through missing samples.

    An angle that is really in degrees is unwrapped as such: by turns of 2 pi it would be
    garbled beyond repair, and the audit would no longer see what is wrong with it.
    """
    finite = np.isfinite(angle)
    continuous = np.array(angle, dtype=float)
    known = continuous[finite]
    jumps, period = np.abs(np.diff(known)), 2 * np.pi
    if known.size >= 2 and np.max(np.abs(known)) > 4 * np.pi:
        if np.any(jumps > 300):
            period = 360.0
        elif not np.any(np.abs(jumps - 2 * np.pi) < 1):
            return continuous  # it is not wrapped
    continuous[finite] = np.unwrap(known, period=period)
    return continuous
