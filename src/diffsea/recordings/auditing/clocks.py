"""Time stamps: repeated, irregular, rounded, missing; rows and samples that are not there."""

import numpy as np

from diffsea.recordings.auditing.edits import Clock, Merge
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.readers import EMPTY_ROWS, REPEATED_TIMES
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_IRREGULAR = 0.2  # an interval this far (relative) from the usual one is irregular
_MANY = 0.02  # share of irregular intervals that is worth a finding
_GAP = 3.0  # times the usual interval
_LOST = 0.05  # share of single samples lost that is worth a finding


def clock_findings(trajectory: Trajectory) -> list[Finding]:
    """Repeated rows, irregular time steps, and gaps of the clock or of single channels."""
    valid = np.asarray(trajectory.valid, dtype=bool)
    time = np.asarray(trajectory.t, dtype=float)[valid]
    steps = np.diff(time)
    findings = _duplicates(trajectory, time) + _empty_rows(trajectory)
    ahead = steps[steps > 0]
    if ahead.size < 3:
        return findings
    usual = float(np.median(ahead))
    findings += _rounded(time) or _irregular(ahead, usual)
    findings += _gaps(time, steps, usual)
    return findings + _channel_gaps(trajectory, time, valid, usual)


def _empty_rows(trajectory: Trajectory) -> list[Finding]:
    """Rows without any value that were dropped while reading."""
    notes = [note for note in trajectory.provenance if note.startswith(EMPTY_ROWS)]
    if not notes:
        return []
    count = float(notes[0].removeprefix(f"{EMPTY_ROWS}:").split(",")[0])
    return [
        Finding(
            "gap",
            count,
            0.0,
            "1",
            f"{count:.0f} empty rows ({notes[0]})",
            "nothing to repair: they are left out; if samples were lost there, the time stamps of "
            "the other rows show it",
            ("t",),
        )
    ]


def _duplicates(trajectory: Trajectory, time: np.ndarray) -> list[Finding]:
    """Repeated time stamps, here or dropped while reading, and repeated rows."""
    notes = [note for note in trajectory.provenance if note.startswith(REPEATED_TIMES)]
    repeated = np.flatnonzero(np.diff(time) <= 0)
    findings = []
    if notes:
        count = int(notes[0].removeprefix(REPEATED_TIMES).split()[1])
        findings.append(_duplicate(count, "time stamps", notes[0]))
    elif repeated.size:
        where = f"first at t = {time[repeated[0] + 1]:g} s"
        findings.append(_duplicate(repeated.size, "time stamps", where))
    rows = _repeated_rows(trajectory)
    if rows.size and not _held(rows):
        where = f"first at t = {np.asarray(trajectory.t)[rows[0]]:g} s"
        findings.append(_duplicate(rows.size, "rows", where))
    return findings


def _duplicate(count: int, what: str, where: str) -> Finding:
    return Finding(
        "duplicate",
        float(count),
        0.0,
        "1",
        f"{count} {what} repeat the one before ({where})",
        "delete them, or give [file] time_step if the stamps were merely rounded",
        ("t",),
        edits=(Merge(REPEATED_TIMES),) * (what == "time stamps"),
    )


def _repeated_rows(trajectory: Trajectory) -> np.ndarray:
    """Rows in which every moving channel equals the row before while others change."""
    channels = [np.asarray(getattr(trajectory, name), dtype=float) for name in MOTION_CHANNELS]
    channels = [series for series in channels if np.sum(np.isfinite(series)) > 2]
    if len(channels) < 3:
        return np.zeros(0, dtype=int)
    table = np.stack(channels)
    moving = np.mean(np.diff(table, axis=1) != 0, axis=1) > 0.9
    if np.sum(moving) < 3:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.all(np.diff(table[moving], axis=1) == 0, axis=0)) + 1


def _held(rows: np.ndarray) -> bool:
    """Whether the repetitions are one long standstill, which is another finding."""
    return rows.size >= 10 and rows[-1] - rows[0] < 1.5 * rows.size


def _rounded(time: np.ndarray) -> list[Finding]:
    """Time stamps of an even clock, rounded to so few digits that the steps come out uneven.

    All stamps are multiples of one resolution, and half of that is as far as any of them is
    from a straight line: what jitters does not stay that near, what drifts neither.
    """
    if time.size < 30:
        return []
    resolution = _resolution(time)
    steps = np.diff(time)
    usual = (time[-1] - time[0]) / (time.size - 1)
    uneven = np.abs(steps / usual - 1) > _IRREGULAR
    if resolution <= 0 or np.mean(uneven) < _MANY:
        return []
    rows = np.arange(time.size)
    slope, start = np.polyfit(rows, time - time[0], 1)
    rest = time - time[0] - start - slope * rows
    if np.ptp(rest) > 1.2 * resolution:
        return []
    spread = float(np.std(steps))
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
            {"resolution": resolution, "time_step": float(slope)},
            edits=(Clock(float(slope)),),
        )
    ]


def _resolution(time: np.ndarray) -> float:
    """The largest step of which all time stamps are multiples; zero where there is none."""
    steps = np.diff(time)
    step = float(np.min(steps[steps > 0], initial=np.inf))
    for part in (1, 2, 3, 4, 5):
        multiples = (time - time[0]) / (step / part)
        if np.max(np.abs(multiples - np.round(multiples))) < 0.02:
            return step / part
    return 0.0


def _irregular(steps: np.ndarray, usual: float) -> list[Finding]:
    """Jitter: many intervals that are neither the usual one nor gaps."""
    short = steps[steps < _GAP * usual]
    off = np.abs(short / usual - 1) > _IRREGULAR
    if np.mean(off) < _MANY or np.sum(off) < 3:
        return []
    spread = float(np.std(short))
    return [
        Finding(
            "time-step",
            spread,
            spread / np.sqrt(2 * short.size),
            "s",
            f"{100 * np.mean(off):.2g} % of the time steps differ by more than "
            f"{100 * _IRREGULAR:.0f} % from the usual {usual:.4g} s (standard deviation "
            f"{spread:.3g} s)",
            "resample on a uniform clock; if the samples were really equally spaced, give "
            "[file] time_step in the mapping instead of the time column",
            ("t",),
        )
    ]


def _gaps(time: np.ndarray, steps: np.ndarray, usual: float) -> list[Finding]:
    wide = np.flatnonzero(steps > _GAP * usual)
    if not wide.size:
        return []
    longest = wide[np.argmax(steps[wide])]
    return [
        Finding(
            "gap",
            float(steps[longest]),
            usual,
            "s",
            f"{wide.size} gaps in the time stamps, {np.sum(steps[wide]):.4g} s in all; the "
            f"longest, {steps[longest]:.4g} s, begins at t = {time[longest]:.6g} s",
            "split the recording there, or leave the gap: nothing is interpolated across it",
            ("t",),
        )
    ]


def _channel_gaps(
    trajectory: Trajectory, time: np.ndarray, valid: np.ndarray, usual: float
) -> list[Finding]:
    """Stretches in which a channel that is otherwise measured has no sample."""
    longest: dict[str, tuple[float, float]] = {}
    lost: dict[str, int] = {}
    for channel in MOTION_CHANNELS:
        series = np.asarray(getattr(trajectory, channel), dtype=float)[valid]
        times = time[np.isfinite(series)]
        if times.size < 3 or times.size == time.size:
            continue
        steps = np.diff(np.concatenate([time[:1], times, time[-1:]]))
        own = float(np.median(np.diff(times)))
        at = int(np.argmax(steps))
        if steps[at] > max(5 * own, _GAP * usual, 1.0):
            longest[channel] = (float(steps[at]), float(np.concatenate([time[:1], times])[at]))
        # A slower sensor has a rhythm of its own; a sample is lost where that is broken.
        missing = np.round(np.diff(times) / own) - 1
        missing = np.sum(missing[(missing >= 1) & (missing < 5)])
        if missing > _LOST * times.size:
            lost[channel] = int(missing)
    return _long_gaps(longest, usual) + _lost_samples(lost, usual)


def _long_gaps(longest: dict[str, tuple[float, float]], usual: float) -> list[Finding]:
    if not longest:
        return []
    channel = max(longest, key=lambda name: longest[name][0])
    seconds, start = longest[channel]
    return [
        Finding(
            "gap",
            seconds,
            usual,
            "s",
            f"{', '.join(longest)} without samples; the longest stretch, {seconds:.4g} s of "
            f"{channel}, begins at t = {start:.6g} s",
            "nothing to repair: nothing is interpolated across the gap",
            tuple(longest),
        )
    ]


def _lost_samples(lost: dict[str, int], usual: float) -> list[Finding]:
    if not lost:
        return []
    counts = ", ".join(f"{count} of {channel}" for channel, count in lost.items())
    return [
        Finding(
            "gap",
            usual * max(lost.values()),
            usual,
            "s",
            f"single samples are lost all along the recording: {counts}",
            "nothing to repair: missing samples stay missing",
            tuple(lost),
        )
    ]
