"""What the comparisons by kinematics mean: which sensor is wrong, by how much, in its own unit.

A misfit is explained by parameters, but a user wants to know what to write into the mapping.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from diffsea.recordings.auditing.causes import Explanation
from diffsea.recordings.auditing.edits import Affine, Compass, Lever, OverGround, Shift, Step
from diffsea.recordings.auditing.finding import CAUSES, Finding, finding_of
from diffsea.recordings.auditing.kinematics import DELAYS
from diffsea.trajectory import in_words


Channels = tuple[str, ...]

_SMALLEST_LATENCY = 0.1  # s; delays nearer to each other than this are one
_SAME = 3.0  # standard errors by which two numbers that are one may differ
_LARGE_ANGLE = np.radians(45.0)  # from which on axes are turned rather than a heading offset
_SENSOR_OF = ("x", "u", "psi", "r")  # one channel of each separate sensor


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
    velocity_faults: _Makers = _VELOCITY_FAULTS
    if jump is not None:
        velocity_faults = velocity_faults | {"step": functools.partial(_heading_step, jump)}
    for explanation, makers in ((heading, _HEADING_FAULTS), (velocity, velocity_faults)):
        if explanation is None:
            continue
        for cause in explanation.causes:
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
        for cause, channels in DELAYS.items():
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
        if cause in ("delay", *DELAYS)
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
    rest, either, instead, doubt = ", ".join(in_words(others)), "", "", unsure
    # Where most sensors are late, it may be the rest that is stamped too early.
    if len(set(_SENSOR_OF) & set(late)) > len(set(_SENSOR_OF) & set(others)):
        either = f", or {rest} stamped that much too early"
        instead = f" (or delay = {-delay:.3g} for {', '.join(others)})"
        doubt = f"{rest} may be stamped too early instead"
    either += f"; {unsure}" if unsure else ""
    words = {"rest": others, "either": either, "instead": instead}
    by, edit = {"delay": delay}, Shift(late, delay)
    return finding_of("sensor-latency", late, delay, std, words, edit, parameters=by, doubt=doubt)


def _clock_drift(late: Channels, others: Channels, rate: str, found: Explanation) -> Finding:
    """A clock that falls behind by the parameter `rate`, and by the delay of the same sensor."""
    drift, std, delay = found.theta[rate], found.std[rate], found.theta[rate[:-4] + "delay"]
    by, edit = {"rate": drift, "offset": delay}, Shift(late, delay, drift, found.middle)
    words = {"rest": others, "milli": 1e3 * drift, "delay": delay}
    return finding_of("clock-drift", late, drift, std, words, edit, parameters=by)


def _scale(channels: Channels, against: str, found: Explanation) -> Finding:
    """Channels that read too much or too little."""
    ratio = 1.0 / (1.0 + found.theta["gain"])
    std = found.std["gain"] * ratio**2
    by, edit = {"factor": ratio}, Affine(channels, 1 / ratio)
    words = {"against": against, "factor": 1 / ratio}
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


def _heading_step(jump: float, found: Explanation) -> Finding:
    value, std = found.theta["step"], found.std["step"]
    by, edit = {"time": jump, "angle": value}, Step("psi", value, jump)
    words = {"degrees": np.degrees(value), "time": jump}
    return finding_of("heading-step", ("psi",), value, std, words, edit, parameters=by)


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
