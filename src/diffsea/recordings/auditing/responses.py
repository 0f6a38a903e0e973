"""Orders against response: does every actuator push the way its label says, or at all?

A rudder to starboard and more thrust to port than to starboard turn the vessel to starboard;
thrust ahead speeds it up. Yaw rate (or speed) is regressed on the actuation after a
first-order lag, the time constant being whatever fits best, and the sign must agree with
that of a regression of increments on actuation and on the motion itself: with feedback from
the motion to the actuator, the first alone could be cause and effect exchanged.

Where no response shows, a rudder that is reversed each time the heading has come round to a
limit is a zig-zag, and then it must go against the heading; an actuator that is moved a great
deal and explains nothing is dead.
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from diffsea.recordings.auditing.edits import Affine, Swap
from diffsea.recordings.auditing.finding import Finding, wrong_sign
from diffsea.recordings.motion import MeasuredMotion
from diffsea.recordings.response_lag import (
    NO_RESPONSE,
    LaggedResponse,
    largest_explained_share,
    response_to,
)
from diffsea.trajectory import Samples, Series, Trajectory


_PORT = ("port", "left")
_STARBOARD = ("starboard", "stbd", "right")
_STEERING = ("rudder", "helm", "delta")
_PROPELLERS = ("propeller", "prop", "engine")
_ANGLES = ("angle", "azimuth")

_CERTAIN = 4.0  # standard errors
_SPREAD_OF_REVERSALS = 0.35  # relative, of the headings at which a zig-zag's rudder is reversed
_DEAD_RUDDER = 0.02  # share of the yaw rate's variance below which a rudder does nothing
_DEAD_THRUSTER = 0.3  # effect of a thruster, relative to its partner's, below which it is dead
_SMALLEST_ANGLE = np.radians(4.0)  # range of a rudder whose response is looked for
_BUSY_RUDDER = np.radians(16.0)  # range of a rudder that would turn the vessel if it moved
_NOTABLE_SHARE = 0.2  # of thrust: less may be no more than an error of a thrust table

_MIRRORED = (
    "; or the whole record has its axes mirrored (x east, y north, heading counter-clockwise)"
)
_TURNS = "positive {channel} turns the vessel to {side}"
_SLOWS = "positive {channel} slows the vessel down"
_PUSHES_ASTERN = "positive {channel} pushes astern"
_UNITS = {"yaw": "rad/s per unit of actuation", "surge": "m/s per unit of actuation"}


def response_findings(trajectory: Trajectory, motion: MeasuredMotion) -> list[Finding]:
    """Actuators that push the wrong way or not at all, and port exchanged with starboard.

    `motion` is the trajectory's motion with its own faults already put right. Where yaw rate
    was not measured, heading is differentiated.
    """
    if motion.has("psi") and not motion.has("r"):
        rate = np.gradient(motion.values["psi"], motion.t)
        known = motion.known | {"r": motion.known["psi"]}
        motion = dataclasses.replace(motion.with_channels(r=rate), known=known)
    found = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        series = {
            prefix + name: _on_motion_clock(trajectory, motion, s) for name, s in group.items()
        }
        found += _blame_mirrored_axes(_group_findings(motion, series))
    return found


def _on_motion_clock(trajectory: Trajectory, motion: MeasuredMotion, series: Series) -> Samples:
    """The actuation at the motion's instants, held; what came before the first is the first."""
    counted = np.asarray(trajectory.valid, dtype=bool)
    values = np.asarray(series, dtype=float)
    rows = np.flatnonzero(counted & np.isfinite(values))
    if not rows.size:
        return np.zeros(motion.t.size)
    share = np.arange(motion.t.size) * (np.sum(counted) / motion.t.size)
    place = np.searchsorted(rows, np.round(share), side="right") - 1
    return values[rows][np.clip(place, 0, rows.size - 1)]


def _group_findings(motion: MeasuredMotion, series: dict[str, Samples]) -> list[Finding]:
    """Findings on either the commanded or the executed actuators, by their channels."""
    found = []
    port = [name for name in series if _has(name, _PORT) and not _has(name, _STEERING)]
    starboard = [name for name in series if _has(name, _STARBOARD) and not _has(name, _STEERING)]
    for name, values in series.items():
        if _has(name, _STEERING):
            found += _rudder(motion, name, values, alone=not port)
        elif _has(name, _ANGLES):
            continue
        elif _has(name, ("bow",)) or (
            _has(name, ("stern",)) and _has(name, ("tunnel", "thruster"))
        ):
            found += _tunnel_thruster(motion, name, values, -1 if _has(name, ("stern",)) else 1)
        elif _has(name, _PROPELLERS):
            found += _propeller(motion, name, values)
    if len(port) == len(starboard) == 1:
        names = (port[0], starboard[0])
        found += _thruster_pair(motion, names, series[port[0]], series[starboard[0]])
    return found


def _has(channel: str, words: tuple[str, ...]) -> bool:
    name = channel.removeprefix("cmd_").removeprefix("exec_").lower()
    return any(word in name for word in words)


def _blame_mirrored_axes(found: list[Finding]) -> list[Finding]:
    """Where rudder and thrust both turn the vessel the wrong way, the motion is mirrored."""
    turning = [finding for finding in found if finding.axis == "yaw"]
    if {finding.kind for finding in turning} != {"sign", "swapped-actuators"}:
        return found
    mirrored = Finding(
        "axes",
        turning[0].value,
        turning[0].std,
        turning[0].unit,
        "rudder and thrust both turn the vessel to the other side: y, heading, v and yaw rate "
        "are positive to port, or x is east and y north",
        "sign = -1 for y, psi, v and r in the mapping, or exchange x and y and turn psi by "
        "90 deg as well",
        ("y", "psi", "v", "r"),
        edits=(Affine(("y", "psi", "v", "r"), -1.0),),
    )
    return [finding for finding in found if finding not in turning] + [mirrored]


def _reversed_actuator(channel: str, response: LaggedResponse, axis: str, message: str) -> Finding:
    """An actuator that drives yaw or surge the wrong way; `value` is its gain."""
    gain = float(response.gains[0])
    std = abs(gain) / response.certainty
    return wrong_sign((channel,), message, gain, std, _UNITS[axis], axis=axis)


def _share_text(response: LaggedResponse) -> str:
    return f" (it explains {100 * response.explained:.0f} % of the yaw rate's variance)"


def _rudder(motion: MeasuredMotion, channel: str, angle: Samples, alone: bool) -> list[Finding]:
    """A rudder that turns the vessel the wrong way or, where nothing else steers, not at all."""
    if not motion.has("r") or np.ptp(angle) < _SMALLEST_ANGLE:
        return []
    response = response_to(motion, "r", angle[None])
    if response.sound and response.gains[0] < 0:
        text = _TURNS.format(channel=channel, side="port") + _share_text(response) + _MIRRORED
        return [_reversed_actuator(channel, response, "yaw", text)]
    if response.sound:
        return []
    return zigzag_findings(motion, channel, angle) or (
        _dead_rudder(motion, channel, angle) if alone else []
    )


def _tunnel_thruster(
    motion: MeasuredMotion, channel: str, force: Samples, side: int
) -> list[Finding]:
    """A tunnel thruster pushes to starboard: at the bow that turns the vessel to starboard."""
    if not motion.has("r") or np.ptp(force) <= 0:
        return []
    response = response_to(motion, "r", force[None])
    if not response.sound or response.gains[0] * side > 0:
        return []
    text = _TURNS.format(channel=channel, side="port" if side > 0 else "starboard")
    return [_reversed_actuator(channel, response, "yaw", text)]


def _propeller(motion: MeasuredMotion, channel: str, speed: Samples) -> list[Finding]:
    if not motion.has("u") or np.ptp(speed) < _NOTABLE_SHARE * np.max(np.abs(speed)):
        return []
    response = response_to(motion, "u", speed[None])
    if not response.sound or response.gains[0] > 0:
        return []
    return [_reversed_actuator(channel, response, "surge", _SLOWS.format(channel=channel))]


def _thruster_pair(
    motion: MeasuredMotion, names: tuple[str, str], port: Samples, starboard: Samples
) -> list[Finding]:
    """Exchanged, reversed or dead thrusters either side of the centreline."""
    if not motion.has("r"):
        return []
    half, mean = 0.5 * (port - starboard), 0.5 * (port + starboard)
    yaw = surge = NO_RESPONSE
    if np.ptp(half) > _NOTABLE_SHARE * np.ptp(mean):
        yaw = response_to(motion, "r", half[None])
    if motion.has("u") and np.ptp(mean) > _NOTABLE_SHARE * np.ptp(half):
        surge = response_to(motion, "u", mean[None])
    both = np.stack([port, starboard])
    one = _one_reversed_thruster(motion, names, both, yaw) or _dead_thruster(motion, names, both)
    if one:
        return one
    if surge.sound and surge.gains[0] < 0:
        found = [
            _reversed_actuator(name, surge, "surge", _SLOWS.format(channel=name)) for name in names
        ]
        # Thrusters that are both reversed turn the vessel the wrong way as well.
        exchanged = yaw.sound and yaw.gains[0] >= 0
        return [*found, _exchanged_thrusters(names, yaw)] if exchanged else found
    return [_exchanged_thrusters(names, yaw)] if yaw.sound and yaw.gains[0] < 0 else []


def _exchanged_thrusters(names: tuple[str, str], yaw: LaggedResponse) -> Finding:
    gain = float(yaw.gains[0])
    return Finding(
        "swapped-actuators",
        gain,
        abs(gain) / yaw.certainty,
        _UNITS["yaw"],
        f"more {names[0]} than {names[1]} turns the vessel to port{_share_text(yaw)}: the two are "
        f"exchanged{_MIRRORED}",
        f"exchange the columns of {names[0]} and {names[1]} in the mapping",
        names,
        edits=(Swap(*names),),
        axis="yaw",
    )


def _one_reversed_thruster(
    motion: MeasuredMotion,
    names: tuple[str, str],
    both: Float[np.ndarray, "2 time"],
    yaw: LaggedResponse,
) -> list[Finding]:
    """One of two thrusters reversed: the sum then turns and the difference speeds up."""
    if np.min(np.ptp(both, axis=1)) <= 0 or not motion.has("u"):
        return []
    if abs(np.corrcoef(both)[0, 1]) > 0.9:
        return []
    turn, surge = response_to(motion, "r", both), response_to(motion, "u", both)
    if not (turn.sound and surge.sound) or turn.explained < yaw.explained + 0.2:
        return []
    signs = tuple(np.sign(turn.gains)), tuple(np.sign(surge.gains))
    wrong = {((-1, -1), (-1, 1)): 0, ((1, 1), (1, -1)): 1}.get(signs)
    if wrong is None:
        return []
    text = _PUSHES_ASTERN.format(channel=names[wrong])
    return [_reversed_actuator(names[wrong], surge, "surge", text)]


def zigzag_findings(motion: MeasuredMotion, channel: str, angle: Samples) -> list[Finding]:
    """A zig-zag whose rudder angle (rad) goes with the heading instead of against it."""
    if not motion.has("psi"):
        return []
    at = _reversals(angle)
    at = at[motion.known["psi"][at]]
    if at.size < 4:
        return []
    # An odd one out would shift the middle to its own side.
    middle = np.mean(motion.values["psi"][at[: at.size - at.size % 2]])
    reached = (motion.values["psi"][at] - middle) * np.sign(angle[at])  # negative where against
    error = float(np.std(reached) / np.sqrt(at.size))
    alike = np.std(reached) < _SPREAD_OF_REVERSALS * np.mean(reached)
    if not alike or np.mean(reached) < _CERTAIN * error or np.min(reached) <= 0:
        return []
    size = float(np.mean(reached))
    text = (
        f"the {at.size} reversals of {channel} are those of a zig-zag of "
        f"{np.degrees(size):.3g} deg, but go with the heading, not against it{_MIRRORED}"
    )
    return [wrong_sign((channel,), text, size, error, "rad")]


def _reversals(angle: Samples) -> Int[np.ndarray, "reversal"]:
    """Rows in which a rudder goes over to the other side, from amplitude to amplitude."""
    side = np.where(np.abs(angle) > 0.5 * np.max(np.abs(angle)), np.sign(angle), 0.0)
    held = side[np.maximum.accumulate(np.where(side != 0, np.arange(side.size), 0))]
    return np.flatnonzero(held[1:] * held[:-1] < 0) + 1


def _dead_rudder(motion: MeasuredMotion, channel: str, angle: Samples) -> list[Finding]:
    """A rudder that is put over again and again under way and explains nothing."""
    if not motion.has("u") or np.ptp(angle) < _BUSY_RUDDER or _reversals(angle).size < 4:
        return []
    speed = np.abs(motion.values["u"])
    if np.median(speed) < 0.3 * np.max(speed):
        return []
    share = largest_explained_share(motion, "r", angle[None])
    if share > _DEAD_RUDDER:
        return []
    text = (
        f"{channel} moves by {np.degrees(np.ptp(angle)):.3g} deg and explains {100 * share:.2g} % "
        "of the yaw rate's variance: the rudder does not move, or this is another vessel's record"
    )
    repair = "nothing to repair: leave the channel out if it is not this vessel's"
    std = float(np.sqrt(share / motion.t.size))
    return [Finding("stuck", share, std, "1", text, repair, (channel,))]


def _dead_thruster(
    motion: MeasuredMotion, names: tuple[str, str], both: Float[np.ndarray, "2 time"]
) -> list[Finding]:
    """One of two thrusters without effect, while the other turns the vessel."""
    spans = np.ptp(both, axis=1)
    if not np.min(spans) > 0.3 * np.max(spans):
        return []
    if abs(np.corrcoef(both)[0, 1]) > 0.7:
        return []
    response = response_to(motion, "r", both, signs=False)
    if not response.sound:
        return []
    strong = int(np.argmax(np.abs(response.gains)))
    weak = 1 - strong
    # To port they turn the vessel one way, to starboard the other.
    share = -float(response.gains[weak] / response.gains[strong])
    error = float(response.errors[weak] / abs(response.gains[strong]))
    if abs(share) > 3 * error or abs(share) + 3 * error > _DEAD_THRUSTER:
        return []
    text = (
        f"{names[weak]} turns the vessel {share:.2g} +- {error:.2g} times as much as "
        f"{names[strong]}: the thruster is dead"
    )
    repair = "nothing to repair: leave the channel out"
    return [Finding("stuck", share, error, "1", text, repair, (names[weak],))]
