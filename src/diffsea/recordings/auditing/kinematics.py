"""Heading against yaw rate, and position against velocity: comparisons, and what their causes mean.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi
    p_m(t)   = (1 + k) int R(psi_m - a - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay. Every cause is
tested with the others present; which of them are there, `causes.select_causes` decides. A misfit is
then explained by parameters, but a user wants to know which sensor is wrong, by how much in its own
unit, and what to write into the mapping: `disagreement_findings` says so.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Inexact

from diffsea.recordings.auditing.causes import (
    Cause,
    Explanation,
    KinematicComparison,
    Levels,
    Parameters,
)
from diffsea.recordings.auditing.edits import Affine, Compass, Lever, OverGround, Shift
from diffsea.recordings.auditing.finding import Finding
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

_SMALLEST_LATENCY = 0.1  # s; delays nearer to each other than this are one
_LARGE_ANGLE = np.radians(45.0)  # from which on axes are turned rather than a heading offset
_SENSOR_OF = ("x", "u", "psi", "r")  # one channel of each separate sensor
_DELAYS = {"p_delay": ("x", "y"), "nu_delay": ("u", "v"), "psi_delay": ("psi",)}
_AS_CAUSE = {
    "gain": "a scale",
    "angle": "a heading offset",
    "water": "a velocity through the water",
    "lever": "a lever arm",
    "p_delay": "a late position",
    "nu_delay": "a late velocity",
    "psi_delay": "position and velocity late together",
    "p_rate": "a drifting clock of the position",
    "nu_rate": "a drifting clock of the velocity",
    "psi_rate": "a drifting clock of the heading",
    "iron": "a heading error periodic in heading",
    "bias": "a yaw-rate bias",
    "delay": "a late channel",
    "rate": "a drifting clock",
}


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
        Cause("gain", ("gain",), 0.03, gain=True),
        Cause("bias", ("bias",), 5e-4),
        Cause("delay", ("delay",), delay, starts=_STARTS),
        Cause("rate", ("rate",), drift, beside=("delay",)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.0)),)
    shift = max(0.25, motion.interval)
    steps = {"gain": 1e-3, "bias": 1e-4, "delay": shift, "rate": shift / motion.duration}
    bounds = {"gain": 0.9, "bias": 1.0, "delay": _LONGEST_DELAY, "rate": _FASTEST_DRIFT}
    unresolved = _unresolved(motion, fine, integrate(motion.t, motion.values["r"]), turned)
    return KinematicComparison(
        motion.t[index],
        motion.values["psi"][None, index],
        functools.partial(_predicted_heading, fine, course, motion.t[index]),
        linked,
        causes,
        steps | {"sine": 1e-3, "cosine": 1e-3},
        bounds | {"sine": _LARGEST_IRON, "cosine": _LARGEST_IRON},
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
    motion: MeasuredMotion, level: float, iron: bool = True, psi_late: bool = False
) -> KinematicComparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `iron` says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that. `psi_late` says whether heading was found late
    against yaw rate.

    Parameters: `gain` of the velocity, `angle` (rad) that heading reads too much, current `north`
    and `east` (m/s), arm `lever_x` and `lever_y` (m), heading error `sine` and `cosine` (rad), and
    `delay` (s) and its `rate` (s/s) of each of `p` (position), `nu` (velocity) and `psi`.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    rates = ("p_rate", "nu_rate", "psi_rate")
    shift = max(0.25, motion.interval)
    steps = dict.fromkeys(("gain", "angle", "north", "east", "sine", "cosine"), 1e-3)
    steps |= {"lever_x": 1e-2, "lever_y": 1e-2}
    steps |= dict.fromkeys(_DELAYS, shift) | dict.fromkeys(rates, shift / motion.duration)
    bounds = dict.fromkeys(steps, 1e3) | {"gain": 0.95, "angle": 3.2}
    bounds |= dict.fromkeys(_DELAYS, _LONGEST_DELAY) | dict.fromkeys(rates, _FASTEST_DRIFT)
    paths = (integrate(each.t, each.earth_velocity) for each in (motion, fine))
    return KinematicComparison(
        motion.t[index],
        np.stack([motion.values["x"], motion.values["y"]])[:, index],
        functools.partial(_predicted_position, fine, motion.t[index]),
        linked,
        _velocity_causes(motion, iron, psi_late),
        steps,
        bounds | {"sine": _LARGEST_IRON, "cosine": _LARGEST_IRON},
        doubt=0.01,
        floor=max(0.02, _unresolved(motion, fine, *paths)),
        walk=max(_random_walk(motion, "u"), _random_walk(motion, "v")),
        middle=float(fine.t.mean()),
        level=level,
    )


def _predicted_position(
    fine: MeasuredMotion, at: Float[np.ndarray, "knot"], theta: Parameters
) -> Levels:
    """Position (m) at the knots (s), north then east."""
    t, values = fine.t, fine.values
    past = t - t.mean()
    late = theta["nu_delay"] + theta["nu_rate"] * past
    flow = _advance(t, values["u"] + 1j * values["v"], late)
    psi = _advance(t, values["psi"], theta["psi_delay"] + theta["psi_rate"] * past)
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


def _velocity_causes(motion: MeasuredMotion, iron: bool, psi_late: bool) -> tuple[Cause, ...]:
    """Why position and velocity may part.

    Sensors are late, never early, and two of the three are as much as kinematics can tell.
    Heading that leads means that position and velocity are late together; heading is late
    alone only if it is so against the yaw rate too.
    """
    values = motion.values
    speed = float(np.sqrt(np.mean(values["u"] ** 2 + values["v"] ** 2)))
    turning = float(np.sqrt(np.mean(np.gradient(values["psi"], motion.t) ** 2))) + 1e-9
    causes = [
        Cause("gain", ("gain",), 0.02, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
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


def _moving_average(series: Samples, width: int) -> Samples:
    """Mean over about `width` samples, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first = (index - width // 2).clip(0)
    last = (index + width // 2 + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)


def _unresolved(
    motion: MeasuredMotion, fine: MeasuredMotion, coarse_sum: np.ndarray, fine_sum: np.ndarray
) -> float:
    """How far (root mean square) an integral on the two clocks parts.

    What happens between the samples is known no better than that.
    """
    return float(np.std(coarse_sum - np.interp(motion.t, fine.t, fine_sum)))


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
    heading: Explanation | None, velocity: Explanation | None, turned_velocities: bool = False
) -> list[Finding]:
    """What the two comparisons found; None stands for one that could not be made.

    A compass error that the velocities show as well takes the place of a wrong scale of the
    yaw rate. `turned_velocities` says that u and v were turned into body axes by the heading
    recorded, so that an error which yaw rate reveals is in them too.
    """
    found = _latencies(heading, velocity)
    compass = velocity is not None and "iron" in velocity.causes
    for explanation, makers in ((heading, _HEADING_FAULTS), (velocity, _VELOCITY_FAULTS)):
        for cause in explanation.causes if explanation else ():
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


def _rival_text(found: Explanation, cause: str) -> str:
    """Why the cause may be another one; empty where the data decide."""
    rivals = found.alternatives.get(cause, ())
    if not rivals:
        return ""
    return "this run cannot tell it from " + " or ".join(_AS_CAUSE[rival] for rival in rivals)


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
    channels, rest = ", ".join(late), ", ".join(others)
    text = f"{channels} lag {rest} by {delay:.3g} s"
    repair = f"delay = {delay:.3g} for {channels} in the mapping"
    doubt = unsure
    # Where most sensors are late, it may be the rest that is stamped too early.
    if len(set(_SENSOR_OF) & set(late)) > len(set(_SENSOR_OF) & set(others)):
        text += f", or {rest} are stamped that much too early"
        repair += f" (or delay = {-delay:.3g} for {rest})"
        doubt = f"{rest} may be stamped too early instead"
    text += f"; {unsure}" if unsure else ""
    repair += ", or estimate it as an effect"
    values, edits = {"delay": delay}, (Shift(late, delay),)
    return Finding(
        "sensor-latency", delay, std, "s", text, repair, late, values, edits=edits, doubt=doubt
    )


def _clock_drift(late: Channels, others: Channels, rate: str, found: Explanation) -> Finding:
    """A clock that falls behind by the parameter `rate`, and by the delay of the same sensor."""
    drift, delay, std = (
        found.theta[rate],
        found.theta[rate.replace("rate", "delay")],
        found.std[rate],
    )
    channels = ", ".join(late)
    text = (
        f"the clock of {channels} falls behind that of {', '.join(others)} by "
        f"{1e3 * drift:.3g} ms per second; half-way through the run it is {delay:.3g} s late"
    )
    repair = f"rescale the time of {channels} before merging the logs"
    values, edits = {"rate": drift, "offset": delay}, (Shift(late, delay, drift, found.middle),)
    return Finding("clock-drift", drift, std, "s/s", text, repair, late, values, edits=edits)


def _scale(channels: Channels, against: str, found: Explanation) -> Finding:
    """Channels that read too much or too little."""
    ratio = 1.0 / (1.0 + found.theta["gain"])
    std = found.std["gain"] * ratio**2
    names = " and ".join(channels)
    text = f"{names} read {ratio:.4g} times what {against} implies"
    repair = f"scale = {1 / ratio:.5g} for {names} in the mapping"
    values, edits = {"factor": ratio}, (Affine(channels, 1 / ratio),)
    return Finding("scale", ratio, std, "1", text, repair, channels, values, edits=edits)


def _length(found: Explanation, first: str, second: str) -> tuple[float, float]:
    """Length of a vector of two parameters, and its standard error."""
    a, b = found.theta[first], found.theta[second]
    length = float(np.hypot(a, b))
    return length, float(np.hypot(a * found.std[first], b * found.std[second]) / length)


def _hard_iron(found: Explanation) -> Finding:
    sine, cosine = found.theta["sine"], found.theta["cosine"]
    size, std = _length(found, "sine", "cosine")
    phase = float(np.arctan2(sine, cosine))
    text = (
        f"heading is in error by {np.degrees(size):.3g} deg times cos(heading - "
        f"{np.degrees(phase):.0f} deg)"
    )
    repair = "calibrate the compass; the error is an effect that can be estimated with the rest"
    values, edits = {"amplitude": size, "phase": phase}, (Compass(sine, cosine),)
    return Finding("hard-iron", size, std, "rad", text, repair, ("psi",), values, edits=edits)


def _gyro_bias(found: Explanation) -> Finding:
    value = -found.theta["bias"]  # of the sensor: what has to be added to heading, less that
    text = (
        f"yaw rate reads {value:.3g} rad/s ({np.degrees(value):.3g} deg/s) more than heading "
        "changes"
    )
    repair = f'r = {{ ..., unit = "rad/s", offset = {-value:.5g} }} in the mapping'
    std, edits = found.std["bias"], (Affine(("r",), 1.0, -value),)
    return Finding(
        "gyro-bias", value, std, "rad/s", text, repair, ("r",), {"bias": value}, edits=edits
    )


def _heading_offset(found: Explanation) -> Finding:
    value, std, channels = found.theta["angle"], found.std["angle"], ("psi",)
    kind, what, doubt = "heading-offset", "heading reads", ""
    if abs(value) > _LARGE_ANGLE:
        kind, what = "axes", "heading or the axes of the velocities are turned"
        doubt = "heading or velocity may be turned"
    text = (
        f"{what} {np.degrees(value):.3g} deg too far clockwise: position moves at that angle to "
        "the recorded velocity, on every heading"
    )
    repair = f'psi = {{ ..., unit = "rad", offset = {-value:.5g} }} in the mapping'
    by, edits = {"angle": value}, (Affine(channels, 1.0, -value),)
    return Finding(kind, value, std, "rad", text, repair, channels, by, edits=edits, doubt=doubt)


def _through_water(found: Explanation) -> Finding:
    north, east = found.theta["north"], found.theta["east"]
    speed, std = _length(found, "north", "east")
    towards = float(np.arctan2(east, north))
    text = (
        f"position moves {speed:.3g} m/s towards {np.degrees(towards) % 360:.0f} deg faster than "
        "u and v say, whatever the heading: they are velocities through the water, and this is "
        "the current"
    )
    repair = "take velocities over ground from the positions, or model a current"
    values, edits = {"speed": speed, "direction": towards}, (OverGround(north, east),)
    kind, channels = "through-water", ("u", "v")
    return Finding(kind, speed, std, "m/s", text, repair, channels, values, edits=edits)


def _lever_arm(found: Explanation) -> Finding:
    x, y = found.theta["lever_x"], found.theta["lever_y"]
    length, std = _length(found, "lever_x", "lever_y")
    text = (
        f"position belongs to a point {x:.3g} m forward and {y:.3g} m to starboard of the one "
        "that velocity belongs to"
    )
    repair = (
        "move one of them to the reference point, or name the lever arm in the vessel's sensors"
    )
    values, edits = {"x": x, "y": y}, (Lever(x, y),)
    return Finding("lever-arm", length, std, "m", text, repair, ("x", "y"), values, edits=edits)


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
