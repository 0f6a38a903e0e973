"""Findings from the causes that part two channels: what they mean, and how to repair them.

The comparisons explain a misfit by parameters; a user wants to know which sensor is wrong, by
how much in its own unit, and what to write into the mapping.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.recordings.auditing.causes import Explanation
from diffsea.recordings.auditing.edits import Affine, Compass, Lever, OverGround, Shift
from diffsea.recordings.auditing.finding import Finding


Channels = tuple[str, ...]

_SMALLEST_LATENCY = 0.1  # s; delays nearer to each other than this are one
_LARGE_ANGLE = np.radians(45.0)  # from which on axes are turned rather than a heading offset
_SENSOR_OF = ("x", "u", "psi", "r")  # one channel of each separate sensor
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
        if explanation is None:
            continue
        for cause in explanation.causes:
            if cause not in makers or (compass and explanation is heading and cause == "gain"):
                continue
            fault = makers[cause](explanation)
            if explanation is heading and cause == "iron":
                fault = dataclasses.replace(
                    fault, edits=_compass_edits(explanation, turned_velocities)
                )
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
    late, std = _lateness(heading, velocity)
    earliest = min(late.values(), default=0.0)
    late = {channels: delay - earliest for channels, delay in late.items()}
    doubts = [
        _rival_text(found, cause)
        for found in (heading, velocity)
        if found
        for cause in found.causes
        if cause in ("delay", "p_delay", "nu_delay", "psi_delay")
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


def _lateness(
    heading: Explanation | None, velocity: Explanation | None
) -> tuple[dict[Channels, float], float]:
    """How late each group of channels is (s), from an arbitrary zero, and how certain."""
    late: dict[Channels, float] = {}
    stds = [0.0]
    if velocity:
        sensors = ((("x", "y"), "p_delay"), (("u", "v"), "nu_delay"), (("psi",), "psi_delay"))
        for channels, cause in sensors:
            late[channels] = velocity.theta[cause] if cause in velocity.causes else 0.0
            stds.append(velocity.std[cause] if cause in velocity.causes else 0.0)
    if heading:
        after = heading.theta["delay"] if "delay" in heading.causes else 0.0
        late["r",] = late.setdefault(("psi",), 0.0) + after
        stds.append(heading.std["delay"] if "delay" in heading.causes else 0.0)
    return late, max(stds)


def _latency(late: Channels, others: Channels, delay: float, std: float, unsure: str) -> Finding:
    channels, rest = ", ".join(late), ", ".join(others)
    # Where most sensors are late, it may be the rest that is stamped too early.
    early = len(set(_SENSOR_OF) & set(late)) > len(set(_SENSOR_OF) & set(others))
    either = f", or {rest} are stamped that much too early" if early else ""
    repair = f"delay = {delay:.3g} for {channels} in the mapping"
    repair += f" (or delay = {-delay:.3g} for {rest})" if early else ""
    return Finding(
        "sensor-latency",
        delay,
        std,
        "s",
        f"{channels} lag {rest} by {delay:.3g} s{either}" + (f"; {unsure}" if unsure else ""),
        repair + ", or estimate it as an effect",
        late,
        {"delay": delay},
        edits=(Shift(late, delay),),
        doubt=f"{rest} may be stamped too early instead" if early else unsure,
    )


def _clock_drift(rate: str, offset: str, late: Channels, others: Channels):
    """The maker of findings on a clock that falls behind, by the names of its parameters."""

    def make(found: Explanation) -> Finding:
        drift, delay = found.theta[rate], found.theta[offset]
        channels = ", ".join(late)
        text = (
            f"the clock of {channels} falls behind that of {', '.join(others)} by "
            f"{1e3 * drift:.3g} ms per second; half-way through the run it is {delay:.3g} s late"
        )
        repair = f"rescale the time of {channels} before merging the logs"
        parameters = {"rate": drift, "offset": delay}
        edits = (Shift(late, delay, drift, found.middle),)
        std = found.std[rate]
        return Finding(
            "clock-drift", drift, std, "s/s", text, repair, late, parameters, edits=edits
        )

    return make


def _scale(channels: Channels, against: str):
    """The maker of findings on channels that read too much or too little."""

    def make(found: Explanation) -> Finding:
        ratio = 1.0 / (1.0 + found.theta["gain"])
        std = found.std["gain"] * ratio**2
        names = " and ".join(channels)
        text = f"{names} read {ratio:.4g} times what {against} implies"
        repair = f"scale = {1 / ratio:.5g} for {names} in the mapping"
        edits = (Affine(channels, 1 / ratio),)
        parameters = {"factor": ratio}
        return Finding("scale", ratio, std, "1", text, repair, channels, parameters, edits=edits)

    return make


def _length(found: Explanation, first: str, second: str) -> tuple[float, float]:
    """Length of a vector of two parameters, and its standard error."""
    a, b = found.theta[first], found.theta[second]
    length = float(np.hypot(a, b))
    return length, float(np.hypot(a * found.std[first], b * found.std[second]) / length)


def _hard_iron(found: Explanation) -> Finding:
    amplitude, std = _length(found, "sine", "cosine")
    phase = float(np.arctan2(found.theta["sine"], found.theta["cosine"]))
    return Finding(
        "hard-iron",
        amplitude,
        std,
        "rad",
        f"heading is in error by {np.degrees(amplitude):.3g} deg times cos(heading - "
        f"{np.degrees(phase):.0f} deg)",
        "calibrate the compass; the error is an effect that can be estimated with the rest",
        ("psi",),
        {"amplitude": amplitude, "phase": phase},
        edits=_compass_edits(found, False),
    )


def _compass_edits(found: Explanation, turned_velocities: bool) -> tuple[Compass]:
    return (Compass(found.theta["sine"], found.theta["cosine"], turned_velocities),)


def _gyro_bias(found: Explanation) -> Finding:
    value = -found.theta["bias"]  # of the sensor: what has to be added to heading, less that
    return Finding(
        "gyro-bias",
        value,
        found.std["bias"],
        "rad/s",
        f"yaw rate reads {value:.3g} rad/s ({np.degrees(value):.3g} deg/s) more than heading "
        "changes",
        f'r = {{ ..., unit = "rad/s", offset = {-value:.5g} }} in the mapping',
        ("r",),
        {"bias": value},
        edits=(Affine(("r",), 1.0, -value),),
    )


def _heading_offset(found: Explanation) -> Finding:
    value = found.theta["angle"]
    large = abs(value) > _LARGE_ANGLE
    what = "heading or the axes of the velocities are turned" if large else "heading reads"
    return Finding(
        "axes" if large else "heading-offset",
        value,
        found.std["angle"],
        "rad",
        f"{what} {np.degrees(value):.3g} deg too far clockwise: position moves at that angle to "
        "the recorded velocity, on every heading",
        f'psi = {{ ..., unit = "rad", offset = {-value:.5g} }} in the mapping',
        ("psi",),
        {"angle": value},
        edits=(Affine(("psi",), 1.0, -value),),
        doubt="heading or velocity may be turned" if large else "",
    )


def _through_water(found: Explanation) -> Finding:
    north, east = found.theta["north"], found.theta["east"]
    speed, std = _length(found, "north", "east")
    towards = float(np.arctan2(east, north))
    return Finding(
        "through-water",
        speed,
        std,
        "m/s",
        f"position moves {speed:.3g} m/s towards {np.degrees(towards) % 360:.0f} deg faster than "
        "u and v say, whatever the heading: they are velocities through the water, and this is "
        "the current",
        "take velocities over ground from the positions, or model a current",
        ("u", "v"),
        {"speed": speed, "direction": towards},
        edits=(OverGround(north, east),),
    )


def _lever_arm(found: Explanation) -> Finding:
    x, y = found.theta["lever_x"], found.theta["lever_y"]
    length, std = _length(found, "lever_x", "lever_y")
    return Finding(
        "lever-arm",
        length,
        std,
        "m",
        f"position belongs to a point {x:.3g} m forward and {y:.3g} m to starboard of the one "
        "that velocity belongs to",
        "move one of them to the reference point, or name the lever arm in the vessel's sensors",
        ("x", "y"),
        {"x": x, "y": y},
        edits=(Lever(x, y),),
    )


_HEADING_FAULTS: dict[str, Callable[[Explanation], Finding]] = {
    "gain": _scale(("r",), "the change of heading"),
    "bias": _gyro_bias,
    "rate": _clock_drift("rate", "delay", ("r",), ("psi",)),
    "iron": _hard_iron,
}
_VELOCITY_FAULTS: dict[str, Callable[[Explanation], Finding]] = {
    "gain": _scale(("u", "v"), "the change of position"),
    "angle": _heading_offset,
    "water": _through_water,
    "lever": _lever_arm,
    "p_rate": _clock_drift("p_rate", "p_delay", ("x", "y"), ("u", "v", "psi")),
    "nu_rate": _clock_drift("nu_rate", "nu_delay", ("u", "v"), ("x", "y", "psi")),
    "psi_rate": _clock_drift("psi_rate", "psi_delay", ("psi",), ("x", "y", "u", "v")),
    "iron": _hard_iron,
}
