"""Time stamps: repeated, irregular, rounded, missing; rows and samples that are not there.

Derivatives, integrals and latencies all rest on the clock, so it is looked at before anything
else is.
"""

import numpy as np
from jaxtyping import Float

from diffsea.recordings.auditing.edits import Edit, MergeRows, UniformClock
from diffsea.recordings.auditing.finding import Finding
from diffsea.series import median_interval
from diffsea.trajectory import Samples, Trajectory


_IRREGULAR = 0.2  # an interval this far (relative) from the usual one is irregular
_IRREGULAR_SHARE = 0.02  # of the intervals that is worth a finding
_CLOCK_GAP = 3.0  # times the usual interval
_CHANNEL_GAP = 5.0  # times a channel's own interval
_LOST_SHARE = 0.05  # of single samples that is worth a finding
_STANDSTILL_ROWS = 10  # repetitions, nearly without a break, that are a standstill


def clock_findings(trajectory: Trajectory) -> list[Finding]:
    """Repeated rows, irregular time steps, and gaps of the clock or of single channels."""
    run = trajectory.counted()
    steps = np.diff(run.t)
    found = _repeated_stamps(run) + _repeated_rows(trajectory) + _empty_rows(run)
    ahead = steps[steps > 0]
    if ahead.size < 3:
        return found
    usual = float(np.median(ahead))
    found += _rounded_stamps(run.t) or _irregular_steps(ahead, usual)
    return found + _clock_gaps(run.t, steps, usual) + _channel_gaps(run, usual)


def _repeated_stamps(run: Trajectory) -> list[Finding]:
    """Repeated time stamps, merged while reading or still there."""
    if run.read.repeated_times:
        merged = run.read.repeated_times[0]
        return [_duplicate(f"{merged.count} time stamps", merged.count, merged.note, MergeRows())]
    repeated = np.flatnonzero(np.diff(run.t) <= 0)
    if not repeated.size:
        return []
    where = f"first at t = {run.t[repeated[0] + 1]:g} s"
    return [_duplicate(f"{repeated.size} time stamps", repeated.size, where, MergeRows())]


def _duplicate(what: str, count: int, where: str, *edits: Edit) -> Finding:
    text = f"{what} repeat the one before ({where})"
    repair = "delete them, or give [file] time_step if the stamps were merely rounded"
    return Finding("duplicate", float(count), 0.0, "1", text, repair, ("t",), edits=edits)


def _repeated_rows(trajectory: Trajectory) -> list[Finding]:
    """Rows in which every moving channel equals the row before while others change.

    One long standstill is another finding.
    """
    channels = [np.asarray(series, dtype=float) for series in trajectory.motion.values()]
    channels = [series for series in channels if np.sum(np.isfinite(series)) > 2]
    if len(channels) < 3:
        return []
    steps = np.diff(np.stack(channels), axis=1)
    moving = np.mean(steps != 0, axis=1) > 0.9
    if np.sum(moving) < 3:
        return []
    rows = np.flatnonzero(np.all(steps[moving] == 0, axis=0)) + 1
    if not rows.size:
        return []
    if rows.size >= _STANDSTILL_ROWS and rows[-1] - rows[0] < 1.5 * rows.size:
        return []
    where = f"first at t = {np.asarray(trajectory.t)[rows[0]]:g} s"
    return [_duplicate(f"{rows.size} rows", rows.size, where)]


def _empty_rows(run: Trajectory) -> list[Finding]:
    """Rows without any value that were dropped while reading."""
    rows = run.read.empty_rows
    if rows is None:
        return []
    text = f"{rows.count} empty rows ({rows.note})"
    repair = (
        "nothing to repair: they are left out; if samples were lost there, the time stamps of "
        "the other rows show it"
    )
    return [Finding("gap", float(rows.count), 0.0, "1", text, repair, ("t",))]


def _rounded_stamps(t: Samples) -> list[Finding]:
    """Time stamps of an even clock, rounded to so few digits that the steps come out uneven.

    All stamps are multiples of one resolution, and half of that is as far as any of them is
    from a straight line: what jitters does not stay that near, what drifts neither.
    """
    if t.size < 30:
        return []
    resolution = _resolution(t)
    steps = np.diff(t)
    usual = (t[-1] - t[0]) / (t.size - 1)
    uneven = np.abs(steps / usual - 1) > _IRREGULAR
    if resolution <= 0 or np.mean(uneven) < _IRREGULAR_SHARE:
        return []
    rows = np.arange(t.size)
    slope, start = np.polyfit(rows, t - t[0], 1)
    rest = t - t[0] - start - slope * rows
    if np.ptp(rest) > 1.2 * resolution:
        return []
    spread, slope = float(np.std(steps)), float(slope)
    return [
        Finding(
            "time-step",
            spread,
            spread / np.sqrt(2 * steps.size),
            "s",
            f"time stamps are rounded to {resolution:.4g} s: the rows are {slope:.6g} s apart "
            f"throughout, the stamps unevenly (standard deviation {spread:.3g} s)",
            f"[file] time_step = {slope:.6g} in the mapping instead of the time column",
            ("t",),
            {"resolution": resolution, "time_step": slope},
            edits=(UniformClock(slope),),
        )
    ]


def _resolution(t: Samples) -> float:
    """The largest step of which all time stamps are multiples; zero where there is none."""
    steps = np.diff(t)
    step = float(np.min(steps[steps > 0], initial=np.inf))
    for part in (1, 2, 3, 4, 5):
        multiples = (t - t[0]) / (step / part)
        if np.max(np.abs(multiples - np.round(multiples))) < 0.02:
            return step / part
    return 0.0


def _irregular_steps(steps: Float[np.ndarray, "step"], usual: float) -> list[Finding]:
    """Jitter: many intervals that are neither the usual one nor gaps."""
    short = steps[steps < _CLOCK_GAP * usual]
    off = np.abs(short / usual - 1) > _IRREGULAR
    if np.mean(off) < _IRREGULAR_SHARE or np.sum(off) < 3:
        return []
    spread = float(np.std(short))
    text = (
        f"{100 * np.mean(off):.2g} % of the time steps differ by more than "
        f"{100 * _IRREGULAR:.0f} % from the usual {usual:.4g} s (standard deviation {spread:.3g} s)"
    )
    repair = (
        "resample on a uniform clock; if the samples were really equally spaced, give "
        "[file] time_step in the mapping instead of the time column"
    )
    std = spread / np.sqrt(2 * short.size)
    return [Finding("time-step", spread, std, "s", text, repair, ("t",))]


def _clock_gaps(t: Samples, steps: Float[np.ndarray, "step"], usual: float) -> list[Finding]:
    wide = np.flatnonzero(steps > _CLOCK_GAP * usual)
    if not wide.size:
        return []
    longest = wide[np.argmax(steps[wide])]
    text = (
        f"{wide.size} gaps in the time stamps, {np.sum(steps[wide]):.4g} s in all; the "
        f"longest, {steps[longest]:.4g} s, begins at t = {t[longest]:.6g} s"
    )
    repair = "split the recording there, or leave the gap: nothing is interpolated across it"
    return [Finding("gap", float(steps[longest]), usual, "s", text, repair, ("t",))]


def _channel_gaps(run: Trajectory, usual: float) -> list[Finding]:
    """Stretches in which a channel that is otherwise measured has no sample, and single samples."""
    longest: dict[str, tuple[float, float]] = {}
    lost: dict[str, int] = {}
    for channel, series in run.motion.items():
        times = run.t[np.isfinite(series)]
        if times.size < 3 or times.size == run.t.size:
            continue
        steps = np.diff(np.concatenate([run.t[:1], times, run.t[-1:]]))
        own = median_interval(times)
        at = int(np.argmax(steps))
        if steps[at] > max(_CHANNEL_GAP * own, _CLOCK_GAP * usual, 1.0):
            start = float(np.concatenate([run.t[:1], times])[at])
            longest[channel] = (float(steps[at]), start)
        # A slower sensor has a rhythm of its own; a sample is lost where that is broken.
        missing = np.round(np.diff(times) / own) - 1
        missing = np.sum(missing[(missing >= 1) & (missing < 5)])
        if missing > _LOST_SHARE * times.size:
            lost[channel] = int(missing)
    found = []
    if longest:
        channel = max(longest, key=lambda name: longest[name][0])
        seconds, start = longest[channel]
        text = (
            f"{', '.join(longest)} without samples; the longest stretch, {seconds:.4g} s of "
            f"{channel}, begins at t = {start:.6g} s"
        )
        repair = "nothing to repair: nothing is interpolated across the gap"
        found.append(Finding("gap", seconds, usual, "s", text, repair, tuple(longest)))
    if lost:
        counts = ", ".join(f"{count} of {channel}" for channel, count in lost.items())
        text = f"single samples are lost all along the recording: {counts}"
        repair = "nothing to repair: missing samples stay missing"
        size = usual * max(lost.values())
        found.append(Finding("gap", size, usual, "s", text, repair, tuple(lost)))
    return found
