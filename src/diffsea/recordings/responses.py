"""Orders against response: does every actuator push the way its label says?

A rudder to starboard and more thrust to port than to starboard turn the vessel to starboard;
thrust ahead speeds it up. Yaw rate (or speed) is regressed on the actuation after a
first-order lag, the time constant being whatever fits best, and the sign must agree with
that of a regression of increments on actuation and on the motion itself: with feedback from
the motion to the actuator, the first alone could be cause and effect exchanged.
"""

import dataclasses

import numpy as np

from diffsea.recordings.edits import Affine, Swap
from diffsea.recordings.finding import Finding
from diffsea.recordings.helm import MIRRORED, dead_rudder, dead_thruster, zigzag_findings
from diffsea.recordings.lags import NONE, Effect, response_to
from diffsea.recordings.motion import Motion
from diffsea.types import Series, Trajectory


_PORT = ("port", "left")
_STARBOARD = ("starboard", "stbd", "right")
_RUDDERS = ("rudder", "helm", "delta")
_PROPELLERS = ("propeller", "prop", "engine")
_ANGLES = ("angle", "azimuth")
_TURNING = "rad/s per unit of actuation"


def response_findings(trajectory: Trajectory, motion: Motion) -> list[Finding]:
    """Actuators that push the wrong way or not at all, and port exchanged with starboard.

    `motion` is the trajectory's motion with its own faults already put right. Where yaw rate
    was not measured, heading is differentiated.
    """
    if motion.has("psi") and not motion.has("r"):
        rate = np.gradient(motion.values["psi"], motion.t)
        known = motion.known | {"r": motion.known["psi"]}
        motion = dataclasses.replace(motion.replaced(r=rate), known=known)
    findings = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        series = {name: _on_clock(trajectory, motion, values) for name, values in group.items()}
        findings += _mirrored(_group(motion, prefix, series))
    return findings


def _group(motion: Motion, prefix: str, series: dict[str, np.ndarray]) -> list[Finding]:
    """Findings on either the commanded or the executed actuators."""
    findings = []
    port = [name for name in series if _is(name, _PORT) and not _is(name, _RUDDERS)]
    starboard = [name for name in series if _is(name, _STARBOARD) and not _is(name, _RUDDERS)]
    for name, values in series.items():
        if _is(name, _RUDDERS):
            findings += _rudder(motion, prefix + name, values, alone=not port)
        elif _is(name, _ANGLES):
            continue
        elif _is(name, ("bow",)) or (_is(name, ("stern",)) and _is(name, ("tunnel", "thruster"))):
            findings += _tunnel(motion, prefix + name, values, -1 if _is(name, ("stern",)) else 1)
        elif _is(name, _PROPELLERS):
            findings += _propeller(motion, prefix + name, values)
    if len(port) == len(starboard) == 1:
        names = (prefix + port[0], prefix + starboard[0])
        findings += _pair(motion, names, series[port[0]], series[starboard[0]])
    return findings


def _mirrored(findings: list[Finding]) -> list[Finding]:
    """Where rudder and thrust both turn the vessel the wrong way, the motion is mirrored."""
    turned = [f for f in findings if f.kind == "swapped-actuators" or f.unit == _TURNING]
    kinds = {finding.kind for finding in turned}
    if kinds != {"sign", "swapped-actuators"}:
        return findings
    return [f for f in findings if f not in turned] + [
        Finding(
            "axes",
            turned[0].value,
            turned[0].std,
            turned[0].unit,
            "rudder and thrust both turn the vessel to the other side: y, heading, v and yaw rate "
            "are positive to port, or x is east and y north",
            "sign = -1 for y, psi, v and r in the mapping, or exchange x and y and turn psi by "
            "90 deg as well",
            ("y", "psi", "v", "r"),
            edits=(Affine(("y", "psi", "v", "r"), -1.0),),
        )
    ]


def _is(name: str, words: tuple[str, ...]) -> bool:
    return any(word in name.lower() for word in words)


def _on_clock(trajectory: Trajectory, motion: Motion, series: Series) -> np.ndarray:
    """The actuation at the motion's instants, held; what came before the first is the first."""
    valid = np.asarray(trajectory.valid, dtype=bool) & np.isfinite(np.asarray(series, dtype=float))
    count = np.asarray(trajectory.t)[np.asarray(trajectory.valid, dtype=bool)].size
    if not np.any(valid):
        return np.zeros(motion.t.size)
    values = np.asarray(series, dtype=float)[valid]
    share = np.arange(motion.t.size) * (count / motion.t.size)
    rows = np.flatnonzero(valid)
    place = np.searchsorted(rows, np.round(share), side="right") - 1
    return values[np.clip(place, 0, values.size - 1)]


def _rudder(motion: Motion, channel: str, angle: np.ndarray, alone: bool) -> list[Finding]:
    if not motion.has("r") or np.ptp(angle) < np.radians(4.0):
        return []
    effect = response_to(motion, "r", angle[None])
    if effect.sound and effect.gains[0] < 0:
        share = f" ({_share(effect)} of the yaw rate's variance)"
        message = f"positive {channel} turns the vessel to port{share}{MIRRORED}"
        return [_sign(channel, effect, message)]
    if effect.sound:
        return []
    return zigzag_findings(motion, channel, angle) or (
        dead_rudder(motion, channel, angle) if alone else []
    )


def _tunnel(motion: Motion, channel: str, force: np.ndarray, side: int) -> list[Finding]:
    """A tunnel thruster pushes to starboard: at the bow that turns the vessel to starboard."""
    if not motion.has("r") or np.ptp(force) <= 0:
        return []
    effect = response_to(motion, "r", force[None])
    if not effect.sound or effect.gains[0] * side > 0:
        return []
    way = "port" if side > 0 else "starboard"
    return [_sign(channel, effect, f"positive {channel} turns the vessel to {way}")]


def _propeller(motion: Motion, channel: str, speed: np.ndarray) -> list[Finding]:
    if not motion.has("u") or np.ptp(speed) < 0.2 * np.max(np.abs(speed)):
        return []
    effect = response_to(motion, "u", speed[None])
    if not effect.sound or effect.gains[0] > 0:
        return []
    return [_sign(channel, effect, f"positive {channel} slows the vessel down")]


def _sign(channel: str, effect: Effect, message: str) -> Finding:
    gain = float(effect.gains[0])
    return Finding(
        "sign",
        gain,
        abs(gain) / effect.certainty,
        _TURNING if "turns" in message else "m/s per unit of actuation",
        message,
        f"{channel} = {{ ..., sign = -1 }} in the mapping",
        (channel,),
        edits=(Affine((channel,), -1.0),),
    )


def _pair(
    motion: Motion, names: tuple[str, str], port: np.ndarray, starboard: np.ndarray
) -> list[Finding]:
    """Exchanged or reversed thrusters either side of the centreline."""
    if not motion.has("r"):
        return []
    half, mean = 0.5 * (port - starboard), 0.5 * (port + starboard)
    # What is small beside the other may be no more than an error of a thrust table.
    yaw = response_to(motion, "r", half[None]) if np.ptp(half) > 0.2 * np.ptp(mean) else NONE
    surge = NONE
    if motion.has("u") and np.ptp(mean) > 0.2 * np.ptp(half):
        surge = response_to(motion, "u", mean[None])
    one = _reversed_one(motion, names, port, starboard, yaw) or dead_thruster(
        motion, names, port, starboard
    )
    if one:
        return one
    if surge.sound and surge.gains[0] < 0:
        findings = [_sign(name, surge, f"positive {name} slows the vessel down") for name in names]
        return findings if yaw.gains[0] < 0 or not yaw.sound else findings + _swapped(names, yaw)
    return _swapped(names, yaw) if yaw.sound and yaw.gains[0] < 0 else []


def _swapped(names: tuple[str, str], yaw: Effect) -> list[Finding]:
    gain = float(yaw.gains[0])
    return [
        Finding(
            "swapped-actuators",
            gain,
            abs(gain) / yaw.certainty,
            _TURNING,
            f"more {names[0]} than {names[1]} turns the vessel to port ({_share(yaw)} of the "
            f"yaw rate's variance): the two are exchanged{MIRRORED}",
            f"exchange the columns of {names[0]} and {names[1]} in the mapping",
            names,
            edits=(Swap(*names),),
        )
    ]


def _reversed_one(
    motion: Motion,
    names: tuple[str, str],
    port: np.ndarray,
    starboard: np.ndarray,
    yaw: Effect,
) -> list[Finding]:
    """One of two thrusters reversed: the sum then turns and the difference speeds up."""
    both = np.stack([port, starboard])
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
    return [_sign(names[wrong], surge, f"positive {names[wrong]} pushes astern")]


def _share(effect: Effect) -> str:
    return f"it explains {100 * effect.explained:.0f} %"
