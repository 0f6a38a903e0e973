"""Single channels: frozen, coarsely rounded, with wild values.

These faults need no second channel to be seen, and would pass for faults of another kind if
they were still there when channels are compared.
"""

import numpy as np
from jaxtyping import Bool, Float, Inexact

from diffsea.recordings.auditing.edits import Blank
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.motion import MeasuredMotion
from diffsea.series import integrate
from diffsea.statistics import robust_scale
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory


_UNITS = {"x": "m", "y": "m", "psi": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}
# Steps of rounding, in these units, below which it does no harm to anything.
_HARMLESS_STEP = {"x": 0.02, "y": 0.02, "psi": 0.004, "u": 0.01, "v": 0.01, "r": 0.002}
_FEWEST_SAMPLES = 30  # from which a channel's usual behaviour is judged
_WILD = 10.0  # times what a channel usually does
_LONGEST_WILD = 3  # samples: what lasts longer is a movement, or a fault of another kind
_FROZEN_SECONDS = 2.0  # and samples that a value must stay to count as frozen
_FROZEN_SAMPLES = 8
_CONTRADICTION = 6.0  # times the usual excursion of a kinematic misfit


def rounding_findings(trajectory: Trajectory) -> list[Finding]:
    """Channels that are multiples of one step, coarse against how they move and jitter."""
    found = []
    for channel, series in trajectory.counted().motion.items():
        series = series[np.isfinite(series)]
        step = _common_step(series)
        if step <= _HARMLESS_STEP[channel] or not _is_coarse(series, step):
            continue
        # How far the values are from multiples of the step says how well it is known.
        multiples = np.round((series - series.min()) / step)
        rest = series - series.min() - step * multiples
        error = np.std(rest) / max(np.sqrt(np.sum(multiples**2)), 1.0)
        unit = _UNITS[channel]
        text = (
            f"{channel} comes in steps of {step:.4g} {unit}, "
            f"{int(round(np.ptp(series) / step)) + 1} levels in all"
        )
        repair = "log it with more digits; until then its noise is at least the step / sqrt(12)"
        std = float(max(error, 1e-9 * step))
        found.append(Finding("quantised", step, std, unit, text, repair, (channel,)))
    return found


def _common_step(series: Samples) -> float:
    """The common step of all values, zero where there is none."""
    levels = np.unique(np.round(series, 12))
    if series.size < _FEWEST_SAMPLES or levels.size < 4:
        return 0.0
    step = float(np.min(np.diff(levels)))
    if step < 1e-9 * np.ptp(levels):
        return 0.0
    steps = (levels - levels[0]) / step
    return step if np.max(np.abs(steps - np.round(steps))) < 0.02 else 0.0


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
        text = f"{np.sum(wild)} wild values in {channel}, the first at t = {at[0]:.6g} s"
        repair = "empty these cells: missing samples do no harm, wild ones do"
        edits = (Blank((channel,), tuple(zip(at, at, strict=True))),)
        count = float(np.sum(wild))
        found.append(Finding("outliers", count, 0.0, "1", text, repair, (channel,), edits=edits))
    return motion.with_channels(**values), found


def _wild_samples(series: Samples, known: Bool[np.ndarray, "time"]) -> Bool[np.ndarray, "time"]:
    if np.sum(known) < _FEWEST_SAMPLES:
        return np.zeros(series.shape, dtype=bool)
    departure = np.abs(series - np.median(_neighbourhoods(series, 4), axis=1))
    changes = np.abs(np.diff(series, append=series[-1]))
    lively = np.median(_neighbourhoods(changes, 12), axis=1)
    # The mean keeps a coarsely rounded channel, whose median change is zero, from looking calm.
    calm = np.sort(departure[known])[: int(0.97 * np.sum(known))]
    usual = max(robust_scale(calm), 1.5 * np.mean(calm))
    rounding = np.min(changes[changes > 1e-9 * np.ptp(series)], initial=np.ptp(series))
    low, high = np.percentile(series[known], [1, 99])
    floor = max(_WILD * usual, 5 * rounding, 0.02 * float(high - low))
    limit = np.maximum(_WILD * lively, floor)
    wild = known & (departure > limit) & (limit > 0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wild.astype(int), [0]])))
    for start, end in edges.reshape(-1, 2):
        if end - start > _LONGEST_WILD or start < 2 or end > series.size - 2:
            wild[start:end] = False
            continue
        sides = series[start:end, None] - series[[start - 1, end]]
        returns = np.ptp(sides, axis=1) < 0.3 * np.min(np.abs(sides), axis=1)
        wild[start:end] &= returns & (np.min(np.abs(sides), axis=1) > floor)
    return wild


def _neighbourhoods(series: Samples, half: int) -> Float[np.ndarray, "time neighbour"]:
    padded = np.pad(series, half, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)


def drop_frozen(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Channels that stand still while their partners move: motion without those stretches.

    A value that does not change at all is suspicious if its sensor's noise is seen everywhere
    else, or if the kinematic partner (yaw rate for heading, velocity for position)
    contradicts it far more than elsewhere.
    """
    frozen: dict[tuple[int, int], list[str]] = {}
    for channel in MOTION_CHANNELS:
        if not motion.has(channel):
            continue
        for start, end in _standstills(motion, channel):
            noiseless = _is_noisy_elsewhere(motion, channel, start, end)
            if noiseless or _is_contradicted(motion, channel, start, end):
                frozen.setdefault((start, end), []).append(channel)
    known = {name: mask.copy() for name, mask in motion.known.items()}
    found = []
    for (start, end), channels in frozen.items():
        for channel in channels:
            known[channel][start : end + 1] = False
        begin, stop = float(motion.t[start]), float(motion.t[end])
        found.append(
            Finding(
                "stuck",
                stop - begin,
                motion.interval,
                "s",
                f"{', '.join(channels)} did not change from t = {begin:.6g} s to {stop:.6g} s "
                "while the other channels say that the vessel moved",
                "empty these cells, or cut the recording there",
                tuple(channels),
                edits=(Blank(tuple(channels), ((begin, stop),)),),
            )
        )
    return MeasuredMotion(motion.t, motion.values, known), found


def _standstills(motion: MeasuredMotion, channel: str) -> list[tuple[int, int]]:
    """First and last row of the long stretches without change."""
    same = (np.diff(motion.values[channel]) == 0) & motion.known[channel][1:]
    edges = np.diff(np.concatenate([[0], same.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return [
        (int(start), int(end))
        for start, end in zip(starts, ends, strict=True)
        if end - start >= _FROZEN_SAMPLES and motion.t[end] - motion.t[start] >= _FROZEN_SECONDS
    ]


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
    values = motion.values
    if channel in ("psi", "r"):
        if not motion.has("psi", "r"):
            return False
        misfit, moved = values["psi"] - integrate(motion.t, values["r"]), values["psi"]
        least = np.radians(2.0)
    else:
        if not motion.has("x", "y", "psi", "u", "v"):
            return False
        flow = (values["u"] + 1j * values["v"]) * np.exp(1j * values["psi"])
        misfit = values["x"] + 1j * values["y"] - integrate(motion.t, flow)
        moved = integrate(motion.t, np.abs(flow))
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
