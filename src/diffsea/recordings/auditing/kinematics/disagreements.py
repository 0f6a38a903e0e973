"""What the comparisons by kinematics mean: which sensor is wrong, by how much, in its own unit.

A misfit is explained by parameters, but a user wants to know what to write into the mapping.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from diffsea.recordings.auditing.edits import (
    Affine,
    Compass,
    Lever,
    OverGround,
    Shift,
    StepRemoval,
    Turned,
)
from diffsea.recordings.auditing.finding import CAUSES, Finding, finding_of
from diffsea.recordings.auditing.kinematics.motor_field import MotorField
from diffsea.recordings.auditing.kinematics.relations import DELAYS, IRON, OF_MOTORS
from diffsea.recordings.auditing.kinematics.selection import Explanation
from diffsea.trajectory import Samples, in_words


Channels = tuple[str, ...]

_SMALLEST_LATENCY = 0.1  # s; delays nearer to each other than this are one
_SAME = 3.0  # standard errors by which two numbers that are one may differ
_LARGE_ANGLE = np.radians(45.0)  # from which on axes are turned rather than a heading offset
TURNED = ("psi", "u", "v")  # by an error of the heading that turns velocities into body axes
_SENSOR_OF = ("x", "u", "psi", "r")  # one channel of each separate sensor


class HeadingSource(NamedTuple):
    """What is known of where the heading comes from."""

    t: Samples  # s, of the motion
    field: MotorField | None  # what the motors may do to it
    turned_velocities: bool  # whether u and v were turned into body axes by it


def disagreement_findings(
    heading: Explanation | None,
    velocity: Explanation | None,
    source: HeadingSource,
    jump: float | None = None,
) -> list[Finding]:
    """What the two comparisons found; None stands for one that could not be made.

    A compass error that the velocities show as well takes the place of a wrong scale of the
    yaw rate. Where velocities were turned into body axes by the heading recorded, an error that yaw
    rate reveals is in them too; `jump` (s) is when heading jumped.
    """
    found = _latencies(heading, velocity)
    velocity = None if velocity is None else _without_slow_clock(velocity)
    compass = velocity is not None and "iron" in velocity.causes
    velocity_faults: _Makers = _VELOCITY_FAULTS
    if jump is not None:
        velocity_faults = velocity_faults | {"step": functools.partial(_heading_step, jump)}
    heading_faults = _HEADING_FAULTS | {
        "iron": functools.partial(_hard_iron, source.turned_velocities),
        "motors": functools.partial(_motor_field, source),
    }
    for explanation, makers in ((heading, heading_faults), (velocity, velocity_faults)):
        if explanation is None:
            continue
        for cause in explanation.causes:
            if cause not in makers or (compass and explanation is heading and cause == "gain"):
                continue
            fault = makers[cause](explanation)
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


def _hard_iron(turned_velocities: bool, found: Explanation) -> Finding:
    sine, cosine = found.theta["sine"], found.theta["cosine"]
    size, std = _length(found, *IRON)
    by, words = _deviation(size, sine, cosine)
    edit = Compass(sine, cosine, turned_velocities)
    if turned_velocities:
        by |= {"time_constant": 0.0}
    channels = TURNED if turned_velocities else ("psi",)
    return finding_of("hard-iron", channels, size, std, words, edit, parameters=by)


def _motor_field(source: HeadingSource, found: Explanation) -> Finding:
    """A field of the motors: its size is that at the run's largest thrust, whatever is possible."""
    assert source.field is not None
    size, std = _length(found, *OF_MOTORS)
    sine, cosine = (found.theta[name] for name in OF_MOTORS)
    by, words = _deviation(size, sine, cosine)
    seconds = source.field.time_constant
    error = source.field.deviation(sine, cosine)
    edit = Turned(tuple(source.t), tuple(error), source.turned_velocities)
    channels = TURNED if source.turned_velocities else ("psi",)
    words |= {"seconds": seconds, "most": np.degrees(np.abs(error).max())}
    # The catalogue's amplitude is that at full thrust, which only the vessel knows.
    by["amplitude_at_largest_thrust"] = by.pop("amplitude")
    by["time_constant"] = seconds
    return finding_of("motor-field", channels, size, std, words, edit, parameters=by)


def _deviation(
    size: float, sine: float, cosine: float
) -> tuple[dict[str, float], dict[str, object]]:
    """Parameters and words of `size sin(heading - phase)`."""
    phase = float(np.arctan2(-cosine, sine))
    words = {"degrees": np.degrees(size), "phase": np.degrees(phase) % 360}
    return {"amplitude": size, "phase": phase}, words


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
    by, edit = {"time": jump, "angle": value}, StepRemoval("psi", value, jump)
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
}
_VELOCITY_FAULTS: _Makers = {
    "gain": functools.partial(_scale, ("u", "v"), "the change of position"),
    "angle": _heading_offset,
    "water": _through_water,
    "lever": _lever_arm,
    "p_rate": functools.partial(_clock_drift, ("x", "y"), ("u", "v", "psi"), "p_rate"),
    "nu_rate": functools.partial(_clock_drift, ("u", "v"), ("x", "y", "psi"), "nu_rate"),
    "psi_rate": functools.partial(_clock_drift, ("psi",), ("x", "y", "u", "v"), "psi_rate"),
    "iron": functools.partial(_hard_iron, False),
}
