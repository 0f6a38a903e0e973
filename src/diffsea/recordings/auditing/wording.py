"""Findings in words: what the causes that part two channels mean, and how to repair them."""

from collections.abc import Callable

import numpy as np

from diffsea.recordings.auditing.causes import Explanation
from diffsea.recordings.auditing.edits import Affine, Compass, Lever, OverGround, Shift
from diffsea.recordings.auditing.finding import Finding


_WORDS = {
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
    heading: Explanation | None, velocity: Explanation | None, swung: bool = False
) -> list[Finding]:
    """What the two comparisons found; None stands for one that could not be made.

    A compass error that the velocities show as well takes the place of a wrong scale of the
    yaw rate. `swung` says that u and v were turned into body axes by the heading recorded, so
    that an error which yaw rate reveals is in them too.
    """
    findings = _latencies(heading, velocity)
    if heading:
        compass = velocity is not None and "iron" in velocity.causes
        causes = [cause for cause in heading.causes if not (compass and cause == "gain")]
        named = {"iron": lambda found: _iron(found, swung)}
        named |= _HEADING
        findings += [named[cause](heading) for cause in causes if cause in named]
    if velocity:
        causes = [cause for cause in velocity.causes if cause in _VELOCITY]
        findings += [_VELOCITY[cause](velocity) for cause in causes]
    return findings


def _latencies(heading: Explanation | None, velocity: Explanation | None) -> list[Finding]:
    """One finding per group of channels that is late by the same time.

    Only differences can be seen; sensors are late, never early, so the earliest is on time.
    """
    late, std = _lateness(heading, velocity)
    earliest = min(late.values(), default=0.0)
    late = {channels: delay - earliest for channels, delay in late.items()}
    doubts = [
        _unsure(found, cause)
        for found in (heading, velocity)
        if found
        for cause in found.causes
        if cause.endswith("delay")
    ]
    unsure = " or ".join(filter(None, dict.fromkeys(doubts)))
    findings = []
    while behind := [c for c, delay in late.items() if delay > max(0.1, 3 * std)]:
        delay = late[behind[0]]
        group = [c for c in behind if abs(late[c] - delay) <= max(0.1, 3 * std)]
        others = [c for c in late if late[c] < delay and c not in group]
        findings.append(_latency(", ".join(group), ", ".join(others), delay, std, unsure))
        late = {c: lag for c, lag in late.items() if c not in group}
    return findings


def _lateness(
    heading: Explanation | None, velocity: Explanation | None
) -> tuple[dict[str, float], float]:
    """How late each group of channels is (s), from an arbitrary zero, and how certain."""
    late: dict[str, float] = {}
    stds = [0.0]
    if velocity:
        for channels, cause in (("x, y", "p_delay"), ("u, v", "nu_delay"), ("psi", "psi_delay")):
            late[channels] = velocity.theta[cause] if cause in velocity.causes else 0.0
            stds.append(velocity.std[cause] if cause in velocity.causes else 0.0)
    if heading:
        after = heading.theta["delay"] if "delay" in heading.causes else 0.0
        late["r"] = late.setdefault("psi", 0.0) + after
        stds.append(heading.std["delay"] if "delay" in heading.causes else 0.0)
    return late, max(stds)


def _latency(channels: str, others: str, delay: float, std: float, unsure: str) -> Finding:
    # Where most channels are late, it may be the rest that is stamped too early.
    early = _sensors(channels) > _sensors(others)
    either = f", or {others} are stamped that much too early" if early else ""
    doubt = f"{others} may be stamped too early instead" if early else unsure
    repair = f"delay = {delay:.3g} for {channels} in the mapping"
    repair += f" (or delay = {-delay:.3g} for {others})" * early
    return Finding(
        "sensor-latency",
        delay,
        std,
        "s",
        f"{channels} lag {others} by {delay:.3g} s{either}" + _but(unsure),
        repair + ", or estimate it as an effect",
        tuple(channels.split(", ")),
        {"delay": delay},
        edits=(Shift(tuple(channels.split(", ")), delay),),
        doubt=doubt,
    )


def _sensors(channels: str) -> int:
    """How many separate sensors these channels come from."""
    names = channels.split(", ")
    return sum(first in names for first in ("x", "u", "psi", "r"))


def _unsure(found: Explanation, cause: str) -> str:
    """Why the cause may be another one; empty where the data decide."""
    rivals = found.alternatives.get(cause, ())
    if not rivals:
        return ""
    return "this run cannot tell it from " + " or ".join(_WORDS[rival] for rival in rivals)


def _but(doubt: str) -> str:
    return f"; {doubt}" if doubt else ""


def _drift(found: Explanation, parameter: str, offset: str, channels: str, others: str) -> Finding:
    rate = found.theta[parameter]
    doubt = _unsure(found, parameter)
    late = tuple(channels.split(", "))
    return Finding(
        "clock-drift",
        rate,
        found.std[parameter],
        "s/s",
        f"the clock of {channels} falls behind that of {others} by {1e3 * rate:.3g} ms per "
        f"second; half-way through the run it is {found.theta[offset]:.3g} s late" + _but(doubt),
        f"rescale the time of {channels} before merging the logs",
        late,
        {"rate": rate, "offset": found.theta[offset]},
        edits=(Shift(late, found.theta[offset], rate, found.middle),),
        doubt=doubt,
    )


def _iron(found: Explanation, swung: bool = False) -> Finding:
    doubt = _unsure(found, "iron")
    sine, cosine = found.theta["sine"], found.theta["cosine"]
    amplitude = float(np.hypot(sine, cosine))
    std = float(np.hypot(sine * found.std["sine"], cosine * found.std["cosine"]) / amplitude)
    phase = float(np.arctan2(sine, cosine))
    return Finding(
        "hard-iron",
        amplitude,
        std,
        "rad",
        f"heading is in error by {np.degrees(amplitude):.3g} deg times cos(heading - "
        f"{np.degrees(phase):.0f} deg)" + _but(doubt),
        "calibrate the compass; the error is an effect that can be estimated with the rest",
        ("psi",),
        {"amplitude": amplitude, "phase": phase},
        edits=(Compass(sine, cosine, swung),),
        doubt=doubt,
    )


def _bias(found: Explanation) -> Finding:
    doubt = _unsure(found, "bias")
    value = -found.theta["bias"]  # of the sensor: what has to be added to heading, less that
    return Finding(
        "gyro-bias",
        value,
        found.std["bias"],
        "rad/s",
        f"yaw rate reads {value:.3g} rad/s ({np.degrees(value):.3g} deg/s) more than heading "
        "changes" + _but(doubt),
        f'r = {{ ..., unit = "rad/s", offset = {-value:.5g} }} in the mapping',
        ("r",),
        {"bias": value},
        edits=(Affine(("r",), 1.0, -value),),
        doubt=doubt,
    )


def _scale(found: Explanation, channels: tuple[str, ...], against: str) -> Finding:
    ratio = 1.0 / (1.0 + found.theta["gain"])
    doubt = _unsure(found, "gain")
    return Finding(
        "scale",
        ratio,
        found.std["gain"] * ratio**2,
        "1",
        f"{' and '.join(channels)} read {ratio:.4g} times what {against} implies" + _but(doubt),
        f"scale = {1 / ratio:.5g} for {' and '.join(channels)} in the mapping",
        channels,
        {"factor": ratio},
        edits=(Affine(channels, 1 / ratio),),
        doubt=doubt,
    )


def _angle(found: Explanation) -> Finding:
    value = found.theta["angle"]
    large = abs(value) > np.radians(45.0)
    doubt = _unsure(found, "angle")
    what = "heading or the axes of the velocities are turned" if large else "heading reads"
    return Finding(
        "axes" if large else "heading-offset",
        value,
        found.std["angle"],
        "rad",
        f"{what} {np.degrees(value):.3g} deg too far clockwise: position moves at that angle to "
        "the recorded velocity, on every heading" + _but(doubt),
        f'psi = {{ ..., unit = "rad", offset = {-value:.5g} }} in the mapping',
        ("psi",),
        {"angle": value},
        edits=(Affine(("psi",), 1.0, -value),),
        doubt="heading or velocity may be turned" if large else doubt,
    )


def _water(found: Explanation) -> Finding:
    north, east = found.theta["north"], found.theta["east"]
    speed, towards = float(np.hypot(north, east)), float(np.arctan2(east, north))
    std = float(np.hypot(north * found.std["north"], east * found.std["east"]) / speed)
    doubt = _unsure(found, "water")
    return Finding(
        "through-water",
        speed,
        std,
        "m/s",
        f"position moves {speed:.3g} m/s towards {np.degrees(towards) % 360:.0f} deg faster than "
        "u and v say, whatever the heading: they are velocities through the water, and this is "
        "the current" + _but(doubt),
        "take velocities over ground from the positions, or model a current",
        ("u", "v"),
        {"speed": speed, "direction": towards},
        edits=(OverGround(north, east),),
        doubt=doubt,
    )


def _lever(found: Explanation) -> Finding:
    x, y = found.theta["lever_x"], found.theta["lever_y"]
    length = float(np.hypot(x, y))
    doubt = _unsure(found, "lever")
    std = float(np.hypot(x * found.std["lever_x"], y * found.std["lever_y"]) / length)
    return Finding(
        "lever-arm",
        length,
        std,
        "m",
        f"position belongs to a point {x:.3g} m forward and {y:.3g} m to starboard of the one "
        "that velocity belongs to" + _but(doubt),
        "move one of them to the reference point, or name the lever arm in the vessel's sensors",
        ("x", "y"),
        {"x": x, "y": y},
        edits=(Lever(x, y),),
        doubt=doubt,
    )


_HEADING: dict[str, Callable[[Explanation], Finding]] = {
    "gain": lambda found: _scale(found, ("r",), "the change of heading"),
    "bias": _bias,
    "rate": lambda found: _drift(found, "rate", "delay", "r", "psi"),
}
_VELOCITY: dict[str, Callable[[Explanation], Finding]] = {
    "gain": lambda found: _scale(found, ("u", "v"), "the change of position"),
    "angle": _angle,
    "water": _water,
    "lever": _lever,
    "p_rate": lambda found: _drift(found, "p_rate", "p_delay", "x, y", "u, v, psi"),
    "nu_rate": lambda found: _drift(found, "nu_rate", "nu_delay", "u, v", "x, y, psi"),
    "psi_rate": lambda found: _drift(found, "psi_rate", "psi_delay", "psi", "x, y, u, v"),
    "iron": _iron,
}
