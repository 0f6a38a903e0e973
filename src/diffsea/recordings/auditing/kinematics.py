"""Heading against yaw rate, and position against velocity: comparisons, and what their causes mean.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi
    p_m(t)   = (1 + k) int R(psi_m - a - s - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay, and s a step. Every
cause is tested with the others present; which of them are there, `causes.select_causes` decides. A
misfit is then explained by parameters, but a user wants to know which sensor is wrong, by how much
in its own unit, and what to write into the mapping: `disagreement_findings` says so.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Inexact
from scipy import ndimage

from diffsea.recordings.auditing.causes import (
    Cause,
    Explanation,
    KinematicComparison,
    Levels,
    Parameters,
)
from diffsea.recordings.auditing.edits import Affine, Compass, Lever, OverGround, Shift, Step
from diffsea.recordings.auditing.finding import CAUSES, Finding, finding_of
from diffsea.recordings.motion import MeasuredMotion, knots, refine
from diffsea.series import integrate
from diffsea.trajectory import Samples


Channels = tuple[str, ...]

_LONGEST_DELAY = 6.0  # s, the longest latency looked for
_STARTS = tuple(sign * late for late in (0.7, 1.4, 2.8, 5.0) for sign in (1, -1))  # s
_FASTEST_DRIFT = 0.1  # s/s, of a clock
_TURN_PER_STEP = 0.03  # rad, of the clock that integrals are taken on
_FEWEST_WINDOWS = 15  # that a comparison needs
_MARGIN = 2.0  # s, at both ends, for delays to reach into
_MEMORY = 10.0  # s over which heading is averaged to lose its own noise
# A heading error periodic in heading is told from a scale of the yaw rate only over a wide
# range of headings (rad); velocities tell it from an offset sooner.
_IRON_RANGE = 2.0
_IRON_RANGE_BY_VELOCITY = 0.5
_LARGEST_IRON = 0.6  # rad

_NEIGHBOURS = 9  # changes of heading from row to row, among which a jump stands out
_JUMP = 6.0  # times the median change, beyond which heading may have jumped
_SMALLEST_JUMP = np.radians(1.0)

_SMALLEST_LATENCY = 0.1  # s; delays nearer to each other than this are one
_SAME = 3.0  # standard errors by which two numbers that are one may differ
_SMALLEST_SCALE = 0.005  # a sensor is hardly calibrated better
_LARGE_ANGLE = np.radians(45.0)  # from which on axes are turned rather than a heading offset
_SENSOR_OF = ("x", "u", "psi", "r")  # one channel of each separate sensor
_DELAYS = {"p_delay": ("x", "y"), "nu_delay": ("u", "v"), "psi_delay": ("psi",)}


def heading_comparison(motion: MeasuredMotion, level: float) -> KinematicComparison | None:
    """Measured heading against integrated yaw rate; None where too little is known.

    Parameters: `gain`, `bias` (rad/s), `delay` (s) and its `rate` (s/s) of the yaw rate, and the
    amplitudes `sine` and `cosine` (rad) of a heading error. `level` is how improbable by chance a
    cause must be.
    """
    index, linked = knots(motion, ("psi", "r"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    turned = integrate(fine.t, fine.values["r"])
    # A heading without its own noise, which must not stand on both sides of the comparison, or
    # a compass error would explain it.
    course = turned + _moving_average(fine.values["psi"] - turned, int(_MEMORY / fine.interval))
    delay, drift = _smallest_delay(motion)
    causes = (
        Cause("gain", ("gain",), _SMALLEST_SCALE, gain=True),
        Cause("bias", ("bias",), 5e-4),
        Cause("delay", ("delay",), delay, starts=_STARTS),
        Cause("rate", ("rate",), drift, beside=("delay",)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.0)),)
    ranges = {"gain": (1e-3, 0.9), "bias": (1e-4, 1.0)}
    ranges["delay"], ranges["rate"] = _delay_ranges(motion)
    coarse = integrate(motion.t, motion.values["r"])
    unresolved = float(np.std(coarse - np.interp(motion.t, fine.t, turned)))
    return KinematicComparison(
        motion.t[index],
        motion.values["psi"][None, index],
        functools.partial(_predicted_heading, fine, course, motion.t[index]),
        linked,
        causes,
        ranges | dict.fromkeys(("sine", "cosine"), (1e-3, _LARGEST_IRON)),
        doubt=0.02,
        floor=max(np.radians(0.1), unresolved),
        walk=_random_walk(motion, "r"),
        middle=float(fine.t.mean()),
        level=level,
    )


def _predicted_heading(
    fine: MeasuredMotion, course: Samples, at: Float[np.ndarray, "knot"], theta: Parameters
) -> Levels:
    """Heading (rad) at the knots (s) from yaw rate; `course` is one without noise of its own."""
    t = fine.t
    late = theta["delay"] + theta["rate"] * (t - t.mean())
    psi = (1 + theta["gain"]) * integrate(t, np.interp(t + late, t, fine.values["r"]))
    psi = psi + theta["bias"] * t
    psi = psi + theta["sine"] * np.sin(course) + theta["cosine"] * np.cos(course)
    return np.interp(at, t, psi)[None]


def velocity_comparison(
    motion: MeasuredMotion,
    level: float,
    iron: bool = True,
    psi_late: bool = False,
    jump: float | None = None,
) -> KinematicComparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `jump` is when (s) the heading may have been knocked or reset, None where it runs on. `iron`
    says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that. `psi_late` says whether heading was found late
    against yaw rate.

    Parameters: `gain` of the velocity, `angle` (rad) that heading reads too much, and `step` (rad)
    what it reads more since the jump, current `north`
    and `east` (m/s), arm `lever_x` and `lever_y` (m), heading error `sine` and `cosine` (rad), and
    `delay` (s) and its `rate` (s/s) of each of `p` (position), `nu` (velocity) and `psi`.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    ranges = {"gain": (1e-3, 0.95), "angle": (1e-3, 3.2), "step": (1e-3, 3.2)}
    ranges |= dict.fromkeys(("north", "east"), (1e-3, 1e3))
    ranges |= dict.fromkeys(("sine", "cosine"), (1e-3, _LARGEST_IRON))
    ranges |= dict.fromkeys(("lever_x", "lever_y"), (1e-2, 1e3))
    delay, rate = _delay_ranges(motion)
    ranges |= dict.fromkeys(_DELAYS, delay)
    ranges |= dict.fromkeys(("p_rate", "nu_rate", "psi_rate"), rate)
    coarse, path = (integrate(each.t, each.earth_velocity) for each in (motion, fine))
    unresolved = float(np.std(coarse - np.interp(motion.t, fine.t, path)))
    return KinematicComparison(
        motion.t[index],
        np.stack([motion.values["x"], motion.values["y"]])[:, index],
        functools.partial(_predicted_position, fine, motion.t[index], jump),
        linked,
        _velocity_causes(motion, iron, psi_late, jump is not None),
        ranges,
        doubt=0.01,
        floor=max(0.02, unresolved),
        walk=max(_random_walk(motion, "u"), _random_walk(motion, "v")),
        middle=float(fine.t.mean()),
        level=level,
    )


def _predicted_position(
    fine: MeasuredMotion, at: Float[np.ndarray, "knot"], jump: float | None, theta: Parameters
) -> Levels:
    """Position (m) at the knots (s), north then east."""
    t, values = fine.t, fine.values
    past = t - t.mean()
    late = theta["nu_delay"] + theta["nu_rate"] * past
    flow = _advance(t, values["u"] + 1j * values["v"], late)
    psi = _advance(t, values["psi"], theta["psi_delay"] + theta["psi_rate"] * past)
    psi = psi if jump is None else psi - theta["step"] * (t > jump)
    psi = psi - theta["sine"] * np.sin(psi) - theta["cosine"] * np.cos(psi) - theta["angle"]
    turn = np.exp(1j * psi)
    velocity = (1 + theta["gain"]) * flow * turn + theta["north"] + 1j * theta["east"]
    place = integrate(t, velocity) + (theta["lever_x"] + 1j * theta["lever_y"]) * turn
    seen = at - theta["p_delay"] - theta["p_rate"] * (at - t.mean())
    place = np.interp(seen, t, place)
    return np.stack([place.real, place.imag])


def _advance(t: Samples, series: Inexact[np.ndarray, "time"], late: Samples) -> np.ndarray:
    """What the series, real or north + i east, will be `late` s later."""
    return np.interp(t + late, t, series) if np.any(late) else series


def heading_jump(motion: MeasuredMotion) -> float | None:
    """The time (s) of the reading of heading before its largest jump; None where it runs on.

    A jump is what it changes more than yaw rate says, and than it does just before and after. That
    it stays is for the comparison with positions to say.
    """
    if not motion.has("psi"):
        return None
    t, psi = motion.t, motion.values["psi"]
    turned = integrate(t, motion.values["r"]) if motion.has("r") else np.zeros_like(psi)
    change = np.diff(psi - turned)
    change = np.abs(change - ndimage.median_filter(change, _NEIGHBOURS))
    known = motion.known["psi"][1:] & motion.known["psi"][:-1]
    change[~(known & (np.diff(t) < 1.5 * motion.interval))] = 0.0
    row = int(np.argmax(change))
    usual = np.median(change[change > 0]) if np.any(change > 0) else 0.0
    return float(t[row]) if change[row] > max(_JUMP * usual, _SMALLEST_JUMP) else None


def _velocity_causes(
    motion: MeasuredMotion, iron: bool, psi_late: bool, jumps: bool
) -> tuple[Cause, ...]:
    """Why position and velocity may part.

    Sensors are late, never early, and two of the three are as much as kinematics can tell.
    Heading that leads means that position and velocity are late together; heading is late
    alone only if it is so against the yaw rate too.
    """
    values = motion.values
    speed = float(np.sqrt(np.mean(values["u"] ** 2 + values["v"] ** 2)))
    turning = float(np.sqrt(np.mean(np.gradient(values["psi"], motion.t) ** 2))) + 1e-9
    causes = [
        Cause("gain", ("gain",), _SMALLEST_SCALE, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
        *([Cause("step", ("step",), _SMALLEST_JUMP)] if jumps else []),
        Cause("water", ("north", "east"), max(0.01, 0.02 * speed)),
        # Large ships turn slowly: what matters is the lever's velocity against the ship's.
        Cause("lever", ("lever_x", "lever_y"), max(0.15, 0.003 * speed / turning)),
    ]
    delay, drift = _smallest_delay(motion)
    likely = {"p": 1, "nu": 1, "psi": 1 if psi_late else -1}
    all_three = (frozenset(_DELAYS),)
    for name, sign in likely.items():
        late, rate = f"{name}_delay", f"{name}_rate"
        two_rates = tuple(frozenset({rate, f"{n}_rate"}) for n in likely if n != name)
        causes += [
            Cause(late, (late,), delay, likely=sign, excludes=all_three, starts=_STARTS),
            Cause(rate, (rate,), drift, beside=(late,), excludes=two_rates),
        ]
    if iron and np.ptp(values["psi"]) > _IRON_RANGE_BY_VELOCITY:
        causes.append(Cause("iron", ("sine", "cosine"), np.radians(1.5)))
    return tuple(causes)


def _smallest_delay(motion: MeasuredMotion) -> tuple[float, float]:
    """The delay (s) and drift (s/s) below which sampling and differencing do as much."""
    delay = max(0.1, 0.75 * motion.interval)
    return delay, max(1e-3, 2 * delay / motion.duration)


def _delay_ranges(motion: MeasuredMotion) -> tuple[tuple[float, float], tuple[float, float]]:
    """Step and bound of a delay (s), and of its rate (s/s)."""
    shift = max(0.25, motion.interval)
    return (shift, _LONGEST_DELAY), (shift / motion.duration, _FASTEST_DRIFT)


def _moving_average(series: Samples, width: int) -> Samples:
    """Mean over about `width` samples, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first = (index - width // 2).clip(0)
    last = (index + width // 2 + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)


def _random_walk(motion: MeasuredMotion, channel: str) -> float:
    """Variance per second of the integral of a channel's white noise.

    From the median square of its second differences, so that manoeuvres do not count: that of
    normal deviates is 0.455, and their variance is six times that of the noise.
    """
    known = motion.known[channel]
    bend = np.diff(motion.values[channel], 2)[known[1:-1]]
    variance = np.median(bend**2) / (0.455 * 6) if bend.size else 0.0
    return float(variance * motion.interval)


def disagreement_findings(
    heading: Explanation | None,
    velocity: Explanation | None,
    turned_velocities: bool = False,
    jump: float | None = None,
) -> list[Finding]:
    """What the two comparisons found; None stands for one that could not be made.

    A compass error that the velocities show as well takes the place of a wrong scale of the
    yaw rate. `turned_velocities` says that u and v were turned into body axes by the heading
    recorded, so that an error which yaw rate reveals is in them too; `jump` (s) is when heading
    jumped.
    """
    found = _latencies(heading, velocity)
    velocity = None if velocity is None else _without_slow_clock(velocity)
    compass = velocity is not None and "iron" in velocity.causes
    for explanation, makers in ((heading, _HEADING_FAULTS), (velocity, _VELOCITY_FAULTS)):
        if explanation is None:
            continue
        for cause in explanation.causes:
            if cause == "step" and jump is not None:
                found.append(_heading_step(explanation, jump))
            if cause not in makers or (compass and explanation is heading and cause == "gain"):
                continue
            fault = makers[cause](explanation)
            if explanation is heading and cause == "iron" and turned_velocities:
                theta = explanation.theta
                edits = (Compass(theta["sine"], theta["cosine"], True),)
                fault = dataclasses.replace(fault, edits=edits)
            unsure = _rival_text(explanation, cause)
            message = f"{fault.message}; {unsure}" if unsure else fault.message
            found.append(dataclasses.replace(fault, message=message, doubt=fault.doubt or unsure))
    return found


def _without_slow_clock(found: Explanation) -> Explanation:
    """Without a scale of the velocity that is the drift of the clock of positions and velocities.

    They share a clock that falls behind, or the others' gets ahead: by it the vessel covers the
    same way in less time.
    """
    theta, std = found.theta, found.std
    if not {"gain", "psi_rate"} <= set(found.causes):
        return found
    apart = abs(theta["gain"] - theta["psi_rate"])
    if apart > _SAME * float(np.hypot(std["gain"], std["psi_rate"])):
        return found
    return dataclasses.replace(found, causes=tuple(c for c in found.causes if c != "gain"))


def _rival_text(found: Explanation, cause: str) -> str:
    """Why the cause may be another one; empty where the data decide."""
    rivals = found.alternatives.get(cause, ())
    if not rivals:
        return ""
    return "this run cannot tell it from " + " or ".join(CAUSES[rival] for rival in rivals)


def _latencies(heading: Explanation | None, velocity: Explanation | None) -> list[Finding]:
    """One finding per group of channels that is late by the same time.

    Only differences can be seen; sensors are late, never early, so the earliest is on time.
    """
    late: dict[Channels, float] = {}
    stds = [0.0]
    if velocity:
        for cause, channels in _DELAYS.items():
            late[channels] = velocity.theta[cause] if cause in velocity.causes else 0.0
            stds.append(velocity.std[cause] if cause in velocity.causes else 0.0)
    if heading:
        after = heading.theta["delay"] if "delay" in heading.causes else 0.0
        late["r",] = late.setdefault(("psi",), 0.0) + after
        stds.append(heading.std["delay"] if "delay" in heading.causes else 0.0)
    std, earliest = max(stds), min(late.values(), default=0.0)
    late = {channels: delay - earliest for channels, delay in late.items()}
    doubts = [
        _rival_text(found, cause)
        for found in (heading, velocity)
        if found
        for cause in found.causes
        if cause in ("delay", *_DELAYS)
    ]
    unsure = " or ".join(filter(None, dict.fromkeys(doubts)))
    apart = max(_SMALLEST_LATENCY, 3 * std)
    findings = []
    while behind := [channels for channels, delay in late.items() if delay > apart]:
        delay = late[behind[0]]
        group = [channels for channels in behind if abs(late[channels] - delay) <= apart]
        others = [c for c in late if late[c] < delay and c not in group]
        findings.append(_latency(sum(group, ()), sum(others, ()), delay, std, unsure))
        late = {channels: lag for channels, lag in late.items() if channels not in group}
    return findings


def _latency(late: Channels, others: Channels, delay: float, std: float, unsure: str) -> Finding:
    rest, either, instead, doubt = ", ".join(others), "", "", unsure
    # Where most sensors are late, it may be the rest that is stamped too early.
    if len(set(_SENSOR_OF) & set(late)) > len(set(_SENSOR_OF) & set(others)):
        either = f", or {rest} are stamped that much too early"
        instead = f" (or delay = {-delay:.3g} for {rest})"
        doubt = f"{rest} may be stamped too early instead"
    either += f"; {unsure}" if unsure else ""
    words = {"rest": rest, "either": either, "instead": instead}
    by, edit = {"delay": delay}, Shift(late, delay)
    return finding_of("sensor-latency", late, delay, std, words, edit, parameters=by, doubt=doubt)


def _clock_drift(late: Channels, others: Channels, rate: str, found: Explanation) -> Finding:
    """A clock that falls behind by the parameter `rate`, and by the delay of the same sensor."""
    drift, std, delay = found.theta[rate], found.std[rate], found.theta[rate[:-4] + "delay"]
    by, edit = {"rate": drift, "offset": delay}, Shift(late, delay, drift, found.middle)
    words = {"rest": ", ".join(others), "milli": 1e3 * drift, "delay": delay}
    return finding_of("clock-drift", late, drift, std, words, edit, parameters=by)


def _scale(channels: Channels, against: str, found: Explanation) -> Finding:
    """Channels that read too much or too little."""
    ratio = 1.0 / (1.0 + found.theta["gain"])
    std = found.std["gain"] * ratio**2
    by, edit = {"factor": ratio}, Affine(channels, 1 / ratio)
    words = {"names": " and ".join(channels), "against": against, "factor": 1 / ratio}
    return finding_of("scale", channels, ratio, std, words, edit, parameters=by)


def _length(found: Explanation, first: str, second: str) -> tuple[float, float]:
    """Length of a vector of two parameters, and its standard error."""
    a, b = found.theta[first], found.theta[second]
    length = float(np.hypot(a, b))
    return length, float(np.hypot(a * found.std[first], b * found.std[second]) / length)


def _hard_iron(found: Explanation) -> Finding:
    sine, cosine = found.theta["sine"], found.theta["cosine"]
    size, std = _length(found, "sine", "cosine")
    phase = float(np.arctan2(sine, cosine))
    by, edit = {"amplitude": size, "phase": phase}, Compass(sine, cosine)
    words = {"degrees": np.degrees(size), "phase": np.degrees(phase)}
    return finding_of("hard-iron", ("psi",), size, std, words, edit, parameters=by)


def _gyro_bias(found: Explanation) -> Finding:
    value = -found.theta["bias"]  # of the sensor: what has to be added to heading, less that
    by, edit = {"bias": value}, Affine(("r",), 1.0, -value)
    words = {"degrees": np.degrees(value), "offset": -value}
    return finding_of("gyro-bias", ("r",), value, found.std["bias"], words, edit, parameters=by)


def _heading_offset(found: Explanation) -> Finding:
    value, std = found.theta["angle"], found.std["angle"]
    fault, doubt = "heading-offset", ""
    if abs(value) > _LARGE_ANGLE:
        fault, doubt = "turned-axes", "heading or velocity may be turned"
    by, edit = {"angle": value}, Affine(("psi",), 1.0, -value)
    words = {"degrees": np.degrees(value), "offset": -value}
    return finding_of(fault, ("psi",), value, std, words, edit, parameters=by, doubt=doubt)


def _heading_step(found: Explanation, jump: float) -> Finding:
    value, std = found.theta["step"], found.std["step"]
    by, edit = {"time": jump, "angle": value}, Step("psi", value, jump)
    words = {"degrees": np.degrees(value), "time": jump}
    doubt = _rival_text(found, "step")
    return finding_of("heading-step", ("psi",), value, std, words, edit, parameters=by, doubt=doubt)


def _through_water(found: Explanation) -> Finding:
    north, east = found.theta["north"], found.theta["east"]
    size = _length(found, "north", "east")
    towards = float(np.arctan2(east, north))
    by, edit = {"speed": size[0], "direction": towards}, OverGround(north, east)
    words = {"degrees": np.degrees(towards) % 360}
    return finding_of("through-water", ("u", "v"), *size, words, edit, parameters=by)


def _lever_arm(found: Explanation) -> Finding:
    x, y = found.theta["lever_x"], found.theta["lever_y"]
    size, by = _length(found, "lever_x", "lever_y"), {"x": x, "y": y}
    return finding_of("lever-arm", ("x", "y"), *size, by, Lever(x, y), parameters=by)


_Makers = dict[str, Callable[[Explanation], Finding]]
_HEADING_FAULTS: _Makers = {
    "gain": functools.partial(_scale, ("r",), "the change of heading"),
    "bias": _gyro_bias,
    "rate": functools.partial(_clock_drift, ("r",), ("psi",), "rate"),
    "iron": _hard_iron,
}
_VELOCITY_FAULTS: _Makers = {
    "gain": functools.partial(_scale, ("u", "v"), "the change of position"),
    "angle": _heading_offset,
    "water": _through_water,
    "lever": _lever_arm,
    "p_rate": functools.partial(_clock_drift, ("x", "y"), ("u", "v", "psi"), "p_rate"),
    "nu_rate": functools.partial(_clock_drift, ("u", "v"), ("x", "y", "psi"), "nu_rate"),
    "psi_rate": functools.partial(_clock_drift, ("psi",), ("x", "y", "u", "v"), "psi_rate"),
    "iron": _hard_iron,
}
