"""Single channels: frozen, coarsely rounded, with wild values; orders in place of motion."""

import numpy as np

from diffsea.recordings.auditing.edits import Blank, Order
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.motion import MeasuredMotion
from diffsea.series import integrate
from diffsea.statistics import robust_scale
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


# Rounding of heading (rad) and yaw rate (rad/s), position (m), velocity (m/s) below which it
# does no harm to anything.
_FINE = {"x": 0.02, "y": 0.02, "psi": 0.004, "u": 0.01, "v": 0.01, "r": 0.002}
_PAIRS = {"psi": ("psi", "r"), "r": ("psi", "r")}
_ANGLES = ("rudder", "delta", "angle", "azimuth", "helm")


def rounding_findings(trajectory: Trajectory) -> list[Finding]:
    """Channels that are multiples of one step, coarse against how they move and jitter."""
    findings = []
    for channel in MOTION_CHANNELS:
        series = _finite(trajectory, channel)
        step = _step(series)
        if step <= _FINE[channel] or not _coarse(series, step):
            continue
        unit = {"psi": "rad", "r": "rad/s", "u": "m/s", "v": "m/s"}.get(channel, "m")
        findings.append(
            Finding(
                "quantised",
                step,
                _step_error(series, step),
                unit,
                f"{channel} comes in steps of {step:.4g} {unit}, "
                f"{int(round(np.ptp(series) / step)) + 1} levels in all",
                "log it with more digits; until then its noise is at least the step / sqrt(12)",
                (channel,),
            )
        )
    return findings


def _finite(trajectory: Trajectory, channel: str) -> np.ndarray:
    series = np.asarray(getattr(trajectory, channel), dtype=float)
    return series[np.asarray(trajectory.valid, dtype=bool) & np.isfinite(series)]


def _step(series: np.ndarray) -> float:
    """The common step of all values, zero where there is none."""
    levels = np.unique(np.round(series, 12))
    if series.size < 30 or levels.size < 4:
        return 0.0
    step = float(np.min(np.diff(levels)))
    if step < 1e-9 * np.ptp(levels):
        return 0.0
    steps = (levels - levels[0]) / step
    return step if np.max(np.abs(steps - np.round(steps))) < 0.02 else 0.0


def _coarse(series: np.ndarray, step: float) -> bool:
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


def _step_error(series: np.ndarray, step: float) -> float:
    """Standard error of a step, from how far the values are from its multiples."""
    multiples = np.round((series - series.min()) / step)
    rest = series - series.min() - step * multiples
    error = np.std(rest) / max(np.sqrt(np.sum(multiples**2)), 1.0)
    return float(max(error, 1e-9 * step))


def outliers(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Wild values: motion without them, and a finding per channel that has any.

    A wild value departs from the median of its neighbours by ten times what the channel does
    there and elsewhere and by two hundredths of its range; within three samples it is over
    and the channel back where it was. The places are bridged.
    """
    findings, values = [], dict(motion.values)
    for channel in MOTION_CHANNELS:
        wild = _wild(motion, channel)
        if not np.any(wild):
            continue
        values[channel] = np.interp(motion.t, motion.t[~wild], values[channel][~wild])
        first, at = motion.t[np.argmax(wild)], motion.t[wild]
        findings.append(
            Finding(
                "outliers",
                float(np.sum(wild)),
                0.0,
                "1",
                f"{np.sum(wild)} wild values in {channel}, the first at t = {first:.6g} s",
                "empty these cells: missing samples do no harm, wild ones do",
                (channel,),
                edits=(Blank((channel,), tuple(zip(at.tolist(), at.tolist(), strict=True))),),
            )
        )
    return motion.with_channels(**values), findings


def _wild(motion: MeasuredMotion, channel: str) -> np.ndarray:
    series, known = motion.values[channel], motion.known[channel]
    if np.sum(known) < 30:
        return np.zeros(series.shape, dtype=bool)
    around = _neighbourhood(series, 4)
    departure = np.abs(series - np.median(around, axis=1))
    changes = np.abs(np.diff(series, append=series[-1]))
    lively = np.median(_neighbourhood(changes, 12), axis=1)
    # The mean keeps a coarsely rounded channel, whose median change is zero, from looking calm.
    calm = np.sort(departure[known])[: int(0.97 * np.sum(known))]
    usual = max(robust_scale(calm), 1.5 * np.mean(calm))
    rounding = np.min(changes[changes > 1e-9 * np.ptp(series)], initial=np.ptp(series))
    floor = max(10 * usual, 5 * rounding, 0.02 * _range(series[known]))
    limit = np.maximum(10 * lively, floor)
    wild = known & (departure > limit) & (limit > 0)
    # Whatever lasts longer than three samples is a movement, or a fault of another kind.
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wild.astype(int), [0]])))
    for start, end in edges.reshape(-1, 2):
        if end - start > 3 or start < 2 or end > series.size - 2:
            wild[start:end] = False
            continue
        sides = series[start:end, None] - series[[start - 1, end]]
        returns = np.ptp(sides, axis=1) < 0.3 * np.min(np.abs(sides), axis=1)
        wild[start:end] &= returns & (np.min(np.abs(sides), axis=1) > floor)
    return wild


def _neighbourhood(series: np.ndarray, half: int) -> np.ndarray:
    padded = np.pad(series, half, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)


def _range(series: np.ndarray) -> float:
    low, high = np.percentile(series, [1, 99])
    return float(high - low)


def frozen(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Channels that stand still while their partners move: motion without those stretches.

    A value that does not change at all is suspicious if its sensor's noise is seen everywhere
    else, or if the kinematic partner (yaw rate for heading, velocity for position)
    contradicts it far more than elsewhere.
    """
    found: dict[tuple[int, int], list[str]] = {}
    for channel in MOTION_CHANNELS:
        if not motion.has(channel):
            continue
        for start, end in _standstills(motion, channel):
            noiseless = _noisy_elsewhere(motion, channel, start, end)
            if noiseless or _contradicted(motion, channel, start, end):
                found.setdefault((start, end), []).append(channel)
    findings = [_stuck(motion, span, channels) for span, channels in found.items()]
    known = {name: mask.copy() for name, mask in motion.known.items()}
    for (start, end), channels in found.items():
        for channel in channels:
            known[channel][start : end + 1] = False
    return MeasuredMotion(motion.t, motion.values, known), findings


def _stuck(motion: MeasuredMotion, span: tuple[int, int], channels: list[str]) -> Finding:
    start, end = motion.t[span[0]], motion.t[span[1]]
    return Finding(
        "stuck",
        float(end - start),
        motion.interval,
        "s",
        f"{', '.join(channels)} did not change from t = {start:.6g} s to {end:.6g} s while "
        "the other channels say that the vessel moved",
        "empty these cells, or cut the recording there",
        tuple(channels),
        edits=(Blank(tuple(channels), ((float(start), float(end)),)),),
    )


def _standstills(motion: MeasuredMotion, channel: str) -> list[tuple[int, int]]:
    """First and last index of the stretches of at least 2 s and 8 samples without change."""
    same = (np.diff(motion.values[channel]) == 0) & motion.known[channel][1:]
    edges = np.diff(np.concatenate([[0], same.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return [
        (int(start), int(end))
        for start, end in zip(starts, ends, strict=True)
        if end - start >= 8 and motion.t[end] - motion.t[start] >= 2.0
    ]


def _noisy_elsewhere(motion: MeasuredMotion, channel: str, start: int, end: int) -> bool:
    """Whether the channel jitters from sample to sample outside the stretch, while others go on
    doing so in it. Zero is what many sensors say at rest."""
    if motion.values[channel][start] == 0:
        return False
    steps = {name: np.diff(motion.values[name]) for name in MOTION_CHANNELS if motion.has(name)}
    outside = np.delete(steps[channel], slice(max(0, start - 1), end + 1))
    if outside.size < 30 or np.mean(outside == 0) > 0.02:
        return False
    bends = np.median(np.abs(np.diff(outside)))  # 1.7 times the steps where all is noise
    others = [series[start:end] for name, series in steps.items() if name != channel]
    goes_on = any(np.mean(series == 0) < 0.5 for series in others)
    return bool(goes_on and bends > 0.7 * np.median(np.abs(outside)))


def _contradicted(motion: MeasuredMotion, channel: str, start: int, end: int) -> bool:
    turning = channel in _PAIRS
    needed = ("psi", "r") if turning else ("x", "y", "psi", "u", "v")
    if not motion.has(*needed):
        return False
    misfit, moved = _disagreement(motion, turning)
    size = end - start
    inside = _excursion(misfit, start, end)
    marks = range(0, motion.t.size - size, max(1, size // 2))
    elsewhere = [_excursion(misfit, i, i + size) for i in marks if i + size < start or i > end]
    usual = float(np.median(elsewhere)) if elsewhere else 0.0
    # A stop between two samples is one step's worth of contradiction for a place or heading.
    steps = np.abs(np.diff(moved[start : end + 1]))
    step = float(np.max(steps)) if channel in ("x", "y", "psi") else 0.0
    way = 0.02 * abs(moved[end] - moved[start])
    floor = step + (np.radians(2.0) if turning else 0.1 + way)
    return inside > max(6 * usual, floor)


def _disagreement(motion: MeasuredMotion, turning: bool) -> tuple[np.ndarray, np.ndarray]:
    """Measured less integrated heading or position, and the way made good."""
    values = motion.values
    if turning:
        return values["psi"] - integrate(motion.t, values["r"]), values["psi"]
    flow = (values["u"] + 1j * values["v"]) * np.exp(1j * values["psi"])
    path = integrate(motion.t, flow)
    return values["x"] + 1j * values["y"] - path, integrate(motion.t, np.abs(flow))


def _excursion(misfit: np.ndarray, start: int, end: int) -> float:
    piece = misfit[start : end + 1] - misfit[start]
    return float(np.max(np.abs(piece)))


def order_findings(trajectory: Trajectory) -> list[Finding]:
    """Executed channels that jump as only orders do.

    A rudder that turns by a large part of its range, and faster than 35 deg/s, from one
    sample to the next, and does so for most of its travel, is a command; so is thrust that
    moves in jumps of a fifth of its range between samples at most half a second apart. Thrust
    that equals its command throughout is let pass: a simulated thruster may have no lag.
    """
    valid = np.asarray(trajectory.valid, dtype=bool)
    time = np.asarray(trajectory.t, dtype=float)[valid]
    findings = []
    for name, series in trajectory.executed.items():
        values = np.asarray(series, dtype=float)[valid]
        ordered = trajectory.commanded.get(name)
        if ordered is not None and not is_angle(name):
            if np.array_equal(np.asarray(ordered, dtype=float)[valid], values, equal_nan=True):
                continue
        finite = np.isfinite(values)
        jump = _typical_jump(name, time[finite], values[finite])
        if jump is None:
            continue
        findings.append(
            Finding(
                "order-not-motion",
                jump,
                0.0,
                "rad" if is_angle(name) else "1",
                f"exec_{name} moves in jumps of up to {_shown(name, jump)} within one sample: "
                "these are orders, not motion",
                f"map it to cmd_{name}; what was executed has to be reconstructed",
                (f"exec_{name}",),
                edits=(Order(name),),
            )
        )
    return findings


def is_angle(name: str) -> bool:
    """Whether an actuator's channel is an angle, by its name."""
    return any(word in name.lower() for word in _ANGLES)


def _shown(name: str, jump: float) -> str:
    return f"{np.degrees(jump):.3g} deg" if is_angle(name) else f"{jump:.4g}"


def _typical_jump(name: str, time: np.ndarray, values: np.ndarray) -> float | None:
    """The largest jump where jumps make up most of the travel, else None."""
    if values.size < 20 or np.ptp(values) == 0:
        return None
    change, step = np.abs(np.diff(values)), np.diff(time)
    large = change > 0.2 * np.ptp(values)
    if is_angle(name):
        large &= change > np.radians(35.0) * step
    else:
        large &= step <= 0.5
    if np.sum(large) < 2 or np.sum(change[large]) < 0.5 * np.sum(change):
        return None
    return float(np.max(change))
