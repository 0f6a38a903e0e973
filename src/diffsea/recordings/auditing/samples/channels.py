"""Time stamps, and single channels: what is wrong with them shows without any other channel.

Derivatives, integrals and latencies all rest on the clock, so it is looked at first: repeated,
irregular or rounded stamps, rows and samples that are not there. A channel that is frozen,
coarsely rounded or has wild values would pass for a fault of another kind if it were still so when
channels are compared.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Float, Inexact

from diffsea.progress import counted
from diffsea.recordings.auditing.edits import Blank, Edit, MergeRows, UniformClock
from diffsea.recordings.auditing.finding import Finding, finding_of, words_and_names
from diffsea.recordings.motion import MeasuredMotion
from diffsea.series import integrate, median_interval, stretches
from diffsea.statistics import robust_scale
from diffsea.trajectory import CHANNEL_UNITS, MOTION_CHANNELS, Samples, Trajectory


_IRREGULAR = 0.2  # an interval this far (relative) from the usual one is irregular
_IRREGULAR_SHARE = 0.02  # of the intervals that is worth a finding
_CLOCK_GAP = 3.0  # times the usual interval
_CHANNEL_GAP = 5.0  # times a channel's own interval
_LOST_SHARE = 0.05  # of single samples that is worth a finding
_STANDSTILL_ROWS = 10  # repetitions, nearly without a break, that are a standstill

# Steps of rounding, in these units, below which it does no harm to anything.
_HARMLESS_STEP = {"x": 0.02, "y": 0.02, "psi": 0.004, "u": 0.01, "v": 0.01, "r": 0.002}
_FEWEST_SAMPLES = 30  # from which a channel's usual behaviour is judged
_WILD = 10.0  # times what a channel usually does
_LONGEST_WILD = 3  # samples: what lasts longer is a movement, or a fault of another kind
_FROZEN_SECONDS = 2.0  # and samples that a value must stay to count as frozen
_FROZEN_SAMPLES = 8
_CONTRADICTION = 6.0  # times the usual excursion of a kinematic misfit


def clock_findings(trajectory: Trajectory) -> list[Finding]:
    """Repeated rows, irregular time steps, and gaps of the clock or of single channels.

    Repeated time stamps and empty rows count whether reading has dealt with them already or not.
    """
    run = trajectory.counted()
    steps = np.diff(run.t)
    found = []
    repeated = np.flatnonzero(steps <= 0)
    if run.read.repeated_times:
        merged = run.read.repeated_times[0]
        found = [_duplicate("time stamps", merged.count, merged.note, MergeRows())]
    elif repeated.size:
        where = f"first at t = {run.t[repeated[0] + 1]:g} s"
        found = [_duplicate("time stamps", repeated.size, where, MergeRows())]
    found += _repeated_rows(trajectory)
    empty = run.read.empty_rows
    if empty is not None:
        words = dataclasses.asdict(empty)
        found.append(finding_of("empty-rows", ("t",), float(empty.count), 0.0, words))
    if run.read.cut_off:
        words = {"told": run.read.cut_off, "end": run.t[-1]}
        found.append(finding_of("cut-off", ("t",), math.nan, math.nan, words))
    ahead = steps[steps > 0]
    if ahead.size < 3:
        return found
    usual = float(np.median(ahead))
    found += _rounded_stamps(run.t) or _irregular_steps(ahead, usual)
    wide = np.flatnonzero(steps > _CLOCK_GAP * usual)
    if wide.size:
        longest = wide[np.argmax(steps[wide])]
        words = {"count": wide.size, "total": np.sum(steps[wide]), "start": run.t[longest]}
        found.append(finding_of("clock-gap", ("t",), float(steps[longest]), usual, words))
    return found + _channel_gaps(run, usual)


def _duplicate(what: str, count: int, where: str, *edits: Edit) -> Finding:
    words = {"count": count, "what": what, "where": where}
    return finding_of("duplicate", ("t",), float(count), 0.0, words, *edits)


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
    rows = np.flatnonzero(np.all(steps[moving] == 0, axis=0)) + 1
    if np.sum(moving) < 3 or not rows.size:
        return []
    if rows.size >= _STANDSTILL_ROWS and rows[-1] - rows[0] < 1.5 * rows.size:
        return []
    where = f"first at t = {np.asarray(trajectory.t)[rows[0]]:g} s"
    return [_duplicate("rows", rows.size, where)]


def _rounded_stamps(t: Samples) -> list[Finding]:
    """Time stamps of an even clock, rounded to so few digits that the steps come out uneven.

    All stamps are multiples of one resolution, and half of that is as far as any of them is
    from a straight line: what jitters does not stay that near, what drifts neither.
    """
    if t.size < 30:
        return []
    steps = np.diff(t)
    step = float(np.min(steps[steps > 0], initial=np.inf))
    resolution = 0.0
    for part in (1, 2, 3, 4, 5):
        multiples = (t - t[0]) / (step / part)
        if np.max(np.abs(multiples - np.round(multiples))) < 0.02:
            resolution = step / part
            break
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
    std = spread / np.sqrt(2 * steps.size)
    by, edit = {"resolution": resolution, "time_step": slope}, UniformClock(slope)
    words = {"resolution": resolution, "step": slope}
    return [finding_of("rounded-stamps", ("t",), spread, std, words, edit, parameters=by)]


def _irregular_steps(steps: Float[np.ndarray, "step"], usual: float) -> list[Finding]:
    """Jitter: many intervals that are neither the usual one nor gaps.

    `steps` and the `usual` one are in s; the size is the standard deviation of those below a gap.
    """
    short = steps[steps < _CLOCK_GAP * usual]
    off = np.abs(short / usual - 1) > _IRREGULAR
    if np.mean(off) < _IRREGULAR_SHARE or np.sum(off) < 3:
        return []
    spread = float(np.std(short))
    std = spread / np.sqrt(2 * short.size)
    words = {"share": 100 * np.mean(off), "limit": 100 * _IRREGULAR, "usual": usual}
    return [finding_of("irregular-stamps", ("t",), spread, std, words)]


def _channel_gaps(run: Trajectory, usual: float) -> list[Finding]:
    """Stretches in which a channel that is otherwise measured has no sample, and single samples.

    A stretch counts above five of the channel's own intervals, three of the file's, which is
    `usual` (s), and 1 s; single samples where more than a twentieth of them are lost.
    """
    longest: dict[str, tuple[float, float]] = {}
    lost: dict[str, int] = {}
    for channel, series in run.motion.items():
        times = run.t[np.isfinite(series)]
        if times.size < 3 or times.size == run.t.size:
            continue
        bounds = np.concatenate([run.t[:1], times, run.t[-1:]])
        steps = np.diff(bounds)
        own = median_interval(times)
        at = int(np.argmax(steps))
        if steps[at] > max(_CHANNEL_GAP * own, _CLOCK_GAP * usual, 1.0):
            longest[channel] = (float(steps[at]), float(bounds[at]))
        # A slower sensor has a rhythm of its own; a sample is lost where that is broken.
        missing = np.round(np.diff(times) / own) - 1
        missing = np.sum(missing[(missing >= 1) & (missing < 5)])
        if missing > _LOST_SHARE * times.size:
            lost[channel] = int(missing)
    found = []
    if longest:
        channel = max(longest, key=lambda name: longest[name][0])
        seconds, start = longest[channel]
        channels, at = tuple(longest), {"longest": (channel,), "start": start}
        found.append(finding_of("channel-gap", channels, seconds, usual, at))
    if lost:
        counts = ", ".join(
            f"{count} of {words_and_names(channel)}" for channel, count in lost.items()
        )
        size = usual * max(lost.values())
        found.append(finding_of("lost-samples", tuple(lost), size, usual, {"counts": counts}))
    return found


def rounding_findings(trajectory: Trajectory) -> list[Finding]:
    """Channels that are multiples of one step, coarse against how they move and jitter.

    The size of a finding is the step, in the channel's SI unit. Steps that do no harm to anything
    later, such as 2 cm of a position or 0.004 rad of heading, are let pass.
    """
    found = []
    for channel, series in trajectory.counted().motion.items():
        series = series[np.isfinite(series)]
        levels = np.unique(np.round(series, 12))
        if series.size < _FEWEST_SAMPLES or levels.size < 4:
            continue
        step = float(np.min(np.diff(levels)))
        if step < 1e-9 * np.ptp(levels) or step <= _HARMLESS_STEP[channel]:
            continue
        steps = (levels - levels[0]) / step
        common = np.max(np.abs(steps - np.round(steps))) < 0.02
        if not common or not _is_coarse(series, step):
            continue
        # How far the values are from multiples of the step says how well it is known.
        multiples = np.round((series - series.min()) / step)
        rest = series - series.min() - step * multiples
        error = np.std(rest) / max(np.sqrt(np.sum(multiples**2)), 1.0)
        std = float(max(error, 1e-9 * step))
        words = {"unit": CHANNEL_UNITS[channel], "levels": int(round(np.ptp(series) / step)) + 1}
        found.append(finding_of("quantised", (channel,), step, std, words))
    return found


def _is_coarse(series: Samples, step: float) -> bool:
    """Whether rounding is most of how the channel jitters, or it often does not change at all.

    Rounding alone makes second differences of 0.7 steps (root mean square). What advances by one
    step throughout is not rounded but even.
    """
    if np.unique(np.round(np.diff(series) / step)).size < 2:
        return False
    if np.ptp(series) <= 200 * step and np.mean(np.diff(series) == 0) >= 0.3:
        return True
    bends = np.sort(np.abs(np.diff(series, 2)))[: int(0.9 * series.size)]
    return bool(np.sqrt(np.mean(bends**2)) < step)


def bridge_outliers(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Wild values: motion without them, and a finding per channel that has any.

    A wild value departs from the median of its neighbours by ten times what the channel does
    there and elsewhere and by two hundredths of its range; within three samples it is over
    and the channel back where it was. The places are bridged.
    """
    found, values = [], dict(motion.values)
    for channel in MOTION_CHANNELS:
        wild = _wild_samples(motion.values[channel], motion.known[channel])
        if not np.any(wild):
            continue
        values[channel] = np.interp(motion.t, motion.t[~wild], values[channel][~wild])
        at = motion.t[wild].tolist()
        edit = Blank((channel,), tuple(zip(at, at, strict=True)))
        words = {"counted": counted(len(at), "wild value"), "start": at[0]}
        found.append(finding_of("outliers", (channel,), float(len(at)), 0.0, words, edit))
    return motion.with_channels(**values), found


def _wild_samples(series: Samples, known: Bool[np.ndarray, "time"]) -> Bool[np.ndarray, "time"]:
    """Which samples are wild, as `bridge_outliers` has it; none among few known ones."""
    if np.sum(known) < _FEWEST_SAMPLES:
        return np.zeros(series.shape, dtype=bool)
    departure = np.abs(series - np.median(_neighbourhoods(series, 4), axis=1))
    changes = np.abs(np.diff(series, append=series[-1]))
    lively = np.median(_neighbourhoods(changes, 12), axis=1)
    # The mean keeps a coarsely rounded channel, whose median change is zero, from looking calm.
    calm = np.sort(departure[known])[: int(0.97 * np.sum(known))]
    usual = max(robust_scale(calm), 1.5 * np.mean(calm))
    low, high = np.percentile(series[known], [1, 99])  # a wild value must not say what is small
    rounding = np.min(changes[changes > 1e-9 * (high - low)], initial=np.ptp(series))
    floor = max(_WILD * usual, 5 * rounding, 0.02 * float(high - low))
    limit = np.maximum(_WILD * lively, floor)
    wild = known & (departure > limit) & (limit > 0)
    for stretch in stretches(wild):
        start, end = stretch.start, stretch.stop
        if end - start > _LONGEST_WILD or start < 2 or end > series.size - 2:
            wild[stretch] = False
            continue
        sides = series[stretch, None] - series[[start - 1, end]]
        returns = np.ptp(sides, axis=1) < 0.3 * np.min(np.abs(sides), axis=1)
        wild[stretch] &= returns & (np.min(np.abs(sides), axis=1) > floor)
    return wild


def _neighbourhoods(series: Samples, half: int) -> Float[np.ndarray, "time neighbour"]:
    """Each sample with `half` ones either side; the first and the last are repeated."""
    padded = np.pad(series, half, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)


def drop_frozen(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Channels that stand still while their partners move: motion without those stretches.

    A value that does not change at all is suspicious if its sensor's noise is seen everywhere
    else, or if the kinematic partner (yaw rate for heading, velocity for position)
    contradicts it far more than elsewhere.
    """
    frozen: dict[tuple[int, int], list[str]] = {}
    for channel in filter(motion.has, MOTION_CHANNELS):
        same = (np.diff(motion.values[channel]) == 0) & motion.known[channel][1:]
        for stretch in stretches(same):
            start, end = stretch.start, stretch.stop
            seconds = motion.t[end] - motion.t[start]
            if end - start < _FROZEN_SAMPLES or seconds < _FROZEN_SECONDS:
                continue
            noiseless = _is_noisy_elsewhere(motion, channel, start, end)
            if noiseless or _is_contradicted(motion, channel, start, end):
                frozen.setdefault((start, end), []).append(channel)
    known = {name: mask.copy() for name, mask in motion.known.items()}
    found = []
    for (start, end), names in frozen.items():
        channels, begin, stop = tuple(names), float(motion.t[start]), float(motion.t[end])
        for channel in channels:
            known[channel][start : end + 1] = False
        words, edit = {"start": begin, "end": stop}, Blank(channels, ((begin, stop),))
        size = stop - begin, motion.interval
        found.append(finding_of("frozen", channels, *size, words, edit))
    return MeasuredMotion(motion.t, motion.values, known), found


def _is_noisy_elsewhere(motion: MeasuredMotion, channel: str, start: int, end: int) -> bool:
    """Whether the channel jitters outside the stretch, while others go on doing so in it.

    Zero is what many sensors say at rest.
    """
    if motion.values[channel][start] == 0:
        return False
    steps = {name: np.diff(motion.values[name]) for name in MOTION_CHANNELS if motion.has(name)}
    outside = np.delete(steps[channel], slice(max(0, start - 1), end + 1))
    if outside.size < _FEWEST_SAMPLES or np.mean(outside == 0) > 0.02:
        return False
    bends = np.median(np.abs(np.diff(outside)))  # 1.7 times the steps where all is noise
    others = [series[start:end] for name, series in steps.items() if name != channel]
    goes_on = any(np.mean(series == 0) < 0.5 for series in others)
    return bool(goes_on and bends > 0.7 * np.median(np.abs(outside)))


def _is_contradicted(motion: MeasuredMotion, channel: str, start: int, end: int) -> bool:
    """Whether integrated yaw rate or velocity leaves the stretch far more than elsewhere."""
    if channel in ("psi", "r"):
        if not motion.has("psi", "r"):
            return False
        moved = motion.values["psi"]
        misfit = moved - integrate(motion.t, motion.values["r"])
        least = np.radians(2.0)
    else:
        if not motion.has("x", "y", "psi", "u", "v"):
            return False
        misfit = motion.path_misfit
        moved = integrate(motion.t, np.abs(motion.earth_velocity))
        least = 0.1 + 0.02 * abs(moved[end] - moved[start])
    size = end - start
    marks = range(0, motion.t.size - size, max(1, size // 2))
    elsewhere = [_excursion(misfit, i, i + size) for i in marks if i + size < start or i > end]
    usual = float(np.median(elsewhere)) if elsewhere else 0.0
    # A stop between two samples is one step's worth of contradiction for a place or heading.
    steps = np.abs(np.diff(moved[start : end + 1]))
    step = float(np.max(steps)) if channel in ("x", "y", "psi") else 0.0
    return _excursion(misfit, start, end) > max(_CONTRADICTION * usual, step + least)


def _excursion(misfit: Inexact[np.ndarray, "time"], start: int, end: int) -> float:
    """How far a misfit, real or north + i east, gets from where it was at the start."""
    return float(np.max(np.abs(misfit[start : end + 1] - misfit[start])))
