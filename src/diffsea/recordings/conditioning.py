"""Preparing recordings: cutting them, thinning them, putting them on one uniform clock.

Nothing is invented: gaps stay gaps (NaN), commands hold, and what was done stands in the
provenance.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffsea.errors import UserError
from diffsea.recordings.mappings import is_held, native_channels, with_channels
from diffsea.series import between_samples, hold_at, median_interval
from diffsea.trajectory import Samples, Trajectory


HELD_STEP = 0.02  # of the range of actuation: less is no change
_WRAPPED = ("wind_direction", "apparent_wind_angle")  # so averaged on the circle
_BRIDGED_INTERVALS = 3.0  # of a channel's own: a straight line says little across more


def cut(trajectory: Trajectory, start: float, end: float) -> Trajectory:
    """The rows with start <= t <= end (s); time keeps its zero.

    Raises `UserError` where fewer than two rows are left.
    """
    t = np.asarray(trajectory.t, float)
    rows = (t >= start) & (t <= end)
    if np.sum(rows) < 2:
        raise UserError(
            f"{trajectory.name} has {np.sum(rows)} samples from {start:g} s to {end:g} s; it "
            f"runs from {t[0]:g} s to {t[-1]:g} s"
        )
    note = f"cut to t = {start:g} s ... {end:g} s"
    return dataclasses.replace(trajectory.rows(rows), provenance=(*trajectory.provenance, note))


def cut_between(trajectory: Trajectory, start: float | None, end: float | None) -> Trajectory:
    """The rows from `start` to `end` (s), where either is given; see `cut`."""
    if start is None and end is None:
        return trajectory
    t = np.asarray(trajectory.t, float)
    first, last = (float(t[0]), float(t[-1]))
    return cut(trajectory, first if start is None else start, last if end is None else end)


def share_a_calendar(recordings: Sequence[Trajectory]) -> bool:
    """Whether there are several recordings, and all say when they were made."""
    return len(recordings) > 1 and all(run.read.epoch is not None for run in recordings)


def on_one_clock(recordings: Sequence[Trajectory]) -> list[Trajectory]:
    """Recordings that say when they were made, on the clock of the earliest; others as they are."""
    epochs = [run.read.epoch for run in recordings if run.read.epoch is not None]
    if not epochs or len(epochs) < len(recordings):
        return list(recordings)
    return [_moved(run, own - min(epochs)) for run, own in zip(recordings, epochs, strict=True)]


def in_sequence(recordings: Sequence[Trajectory]) -> list[Trajectory]:
    """Recordings on one clock, each after the ones before it: what changed in one has changed.

    As they are, if each begins after the one before it has ended; else they begin at multiples of a
    power of ten (s) that is longer than any of them.
    """
    pairs = itertools.pairwise(recordings)
    if all(float(before.t[-1]) < float(after.t[0]) for before, after in pairs):
        return list(recordings)
    longest = max(float(run.t[-1] - run.t[0]) for run in recordings)
    room = 10.0 ** (math.floor(math.log10(max(longest, 1.0))) + 1)
    return [_moved(run, k * room - float(run.t[0])) for k, run in enumerate(recordings)]


def _moved(run: Trajectory, shift: float) -> Trajectory:
    """The same run later by so much (s) on its clock."""
    if shift == 0:
        return run
    epoch = None if run.read.epoch is None else run.read.epoch - shift
    note = f"moved by {shift:+.10g} s on the clock, which other recordings share"
    return dataclasses.replace(
        run,
        t=np.asarray(run.t, float) + shift,
        read=dataclasses.replace(run.read, epoch=epoch),
        provenance=(*run.provenance, note),
    )


def thin(trajectory: Trajectory, interval: float) -> Trajectory:
    """Some of the valid rows: `interval` s apart or more, and those at which actuation changes.

    Where sensors have rows of their own, so far apart are those that are kept of each. Rows stay as
    they were measured: nothing is smoothed, and no order is moved. Actuation changes where it is
    off by two per cent of its range from the row that was kept last; its noise is not told from
    orders, so that a run with measured actuation may keep all its rows.
    """
    run = trajectory.counted()
    held = [series for name, series in native_channels(run).items() if is_held(name)]
    steps = [HELD_STEP * (np.nanmax(one) - np.nanmin(one)) for one in held]
    given = np.isfinite(np.stack([*run.motion.values()], axis=1))
    kept, read = [0], np.where(given[0], run.t[0], -np.inf)  # when each channel was read last
    for row in range(1, len(run.t)):
        last = kept[-1]
        is_late = (given[row] & (run.t[row] - read >= interval * (1 - 1e-6))).any()
        changes = zip(held, steps, strict=True)
        if is_late or any(abs(one[row] - one[last]) > step for one, step in changes):
            kept.append(row)
            read[given[row]] = run.t[row]
    if len(kept) in (1, len(run.t)):
        return run
    note = f"rows less than {interval:.3g} s apart left out where no order changes"
    return dataclasses.replace(run.rows(np.array(kept)), provenance=(*trajectory.provenance, note))


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
    run = trajectory.counted()
    old = run.t
    # The last sample may fall short of a whole interval by rounding only.
    new = old[0] + interval * np.arange(int((old[-1] - old[0]) / interval + 1e-6) + 1)
    if new.size < 2:
        raise UserError(
            f"{run.name} lasts {old[-1] - old[0]:g} s, too short for an interval of {interval:g} s"
        )
    even = native_channels(run) | {"t": new}
    for name, series in even.items():
        if is_held(name):
            even[name] = hold_at(old, series, new + 1e-6 * interval)
        elif name in _WRAPPED:
            circle = _local_lines(old, np.exp(1j * series), new, interval, max_gap)
            even[name] = np.where(np.isfinite(circle), np.angle(circle) % (2 * np.pi), np.nan)
        elif name != "t":
            even[name] = _local_lines(old, series, new, interval, max_gap)
    note = f"resampled to {interval:g} s"
    return with_channels(
        run,
        even,
        valid=np.ones(new.shape, dtype=bool),
        provenance=(*trajectory.provenance, note),
    )


def _local_lines(
    old: Samples,
    values: np.ndarray,
    new: Float[np.ndarray, "new"],
    interval: float,
    max_gap: float | None,
) -> np.ndarray:
    """Values, perhaps complex, of lines through half an interval either side; NaN in gaps."""
    finite = np.isfinite(values)
    times, values = old[finite], values[finite]
    if times.size < 2:
        return np.full(new.shape, np.nan, dtype=values.dtype)
    longest = _BRIDGED_INTERVALS * median_interval(times) if max_gap is None else max_gap
    inside = between_samples(times, new, longest * (1 + 1e-9), tolerance=1e-9)
    between = np.where(inside, np.interp(new, times, values), np.nan)
    line = _local_line(times, values, new, 0.5 * interval)
    return np.where(np.isfinite(line) & np.isfinite(between), line, between)


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
