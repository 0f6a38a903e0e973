"""Actuation by itself: executed against ordered, impossible angles, actuators without effect.

What an actuator does to the vessel is `responses`' question; here its two records are compared
with each other, and it is asked whether it does anything at all.

Orders against response: does every actuator push the way its label says?

A rudder to starboard and more thrust to port than to starboard turn the vessel to starboard;
thrust ahead speeds it up. Yaw rate (or speed) is regressed on the actuation after a
first-order lag, the time constant being whatever fits best, and the sign must agree with
that of a regression of increments on actuation and on the motion itself: with feedback from
the motion to the actuator, the first alone could be cause and effect exchanged.
"""

import dataclasses

import numpy as np

from diffsea.recordings.auditing.edits import Affine, Swap
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.auditing.helm import MIRRORED, dead_rudder, dead_thruster, zigzag_findings
from diffsea.recordings.lags import NO_RESPONSE, LaggedResponse, response_to
from diffsea.recordings.motion import MeasuredMotion
from diffsea.trajectory import Series, Trajectory


_SETTLED = 4.0  # s for which an order must have stood before what was executed is compared
_NEAR = 0.05  # how close a ratio must be to that of two units
_DIFFERENT = 0.1  # a ratio this far from one is worth a finding
_STILL = 1e-3  # an executed channel that moves by less than this share of its orders stands still
_RUDDERS = ("rudder", "helm", "delta")  # angles that never go round
_RATIOS = {180 / np.pi: "deg", 60.0: "rpm", 100.0: "%", 1e3: "thousandths", 2 * np.pi: "rad/s"}


@dataclasses.dataclass(frozen=True)
class _Pair:
    """An actuator's orders and what was executed of them, in rows that have both."""

    name: str
    t: np.ndarray
    ordered: np.ndarray
    executed: np.ndarray


def actuation_findings(trajectory: Trajectory) -> list[Finding]:
    """Angles that are in degrees, and executed actuation that contradicts its orders.

    A limit at which what is executed stays while orders go beyond it is no fault, and no scale
    is read off there; where something is wrong the message names it.
    """
    findings = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        for name, series in group.items():
            findings += _degrees(prefix + name, np.asarray(series, dtype=float))
    accused = {name for finding in findings for name in finding.channels}
    for name in trajectory.executed:
        if name in trajectory.commanded and not {f"cmd_{name}", f"exec_{name}"} & accused:
            findings += _against_orders(_pair(trajectory, name))
    return findings


def _degrees(channel: str, series: np.ndarray) -> list[Finding]:
    """A rudder's angle beyond half a turn is in degrees."""
    series = series[np.isfinite(series)]
    if not any(word in channel.lower() for word in _RUDDERS) or series.size < 3:
        return []
    largest = float(np.max(np.abs(series)))
    if largest <= np.pi:
        return []
    return [
        Finding(
            "unit",
            180 / np.pi,
            0.0,
            "1",
            f"{channel} is in degrees, not in radians: it reaches {largest:.3g}",
            f'{channel} = {{ ..., unit = "deg" }} in the mapping',
            (channel,),
            edits=(Affine((channel,), np.pi / 180, unit="deg"),),
        )
    ]


def _pair(trajectory: Trajectory, name: str) -> _Pair:
    t = np.asarray(trajectory.t, dtype=float)
    ordered = np.asarray(trajectory.commanded[name], dtype=float)
    executed = np.asarray(trajectory.executed[name], dtype=float)
    rows = np.asarray(trajectory.valid, dtype=bool) & np.isfinite(ordered) & np.isfinite(executed)
    return _Pair(name, t[rows], ordered[rows], executed[rows])


def _against_orders(pair: _Pair) -> list[Finding]:
    if pair.t.size < 30 or np.ptp(pair.ordered) <= 0:
        return []
    if np.ptp(pair.executed) < _STILL * np.ptp(pair.ordered):
        return [_still(pair)]
    ratio, error = _settled_ratio(pair)
    size, sure = abs(ratio), abs(ratio) > 5 * error
    if not sure or (ratio > 0 and abs(ratio - 1) < max(_DIFFERENT, 5 * error)):
        return []
    kind, what = "scale", f"is {ratio:.4g} times"
    unit = [
        name for known, name in _RATIOS.items() if _close(size, known) or _close(size, 1 / known)
    ]
    if ratio < 0:
        kind, what = "sign", f"has the opposite sign of (ratio {ratio:.4g})"
    elif unit:
        kind, what = "unit", f"is {ratio:.4g} times (one of them may be in {unit[0]})"
    channels = (f"cmd_{pair.name}", f"exec_{pair.name}")
    return [
        Finding(
            kind,
            ratio,
            error,
            "1",
            f"where orders have stood for {_SETTLED:g} s, {channels[1]} {what} {channels[0]}"
            + _limit(pair),
            f"sign, unit or scale of {channels[0]} or of {channels[1]} in the mapping",
            channels,
            doubt="either the order or what was executed may be labelled wrongly",
        )
    ]


def _close(ratio: float, known: float) -> bool:
    return abs(np.log(ratio / known)) < _NEAR


def _still(pair: _Pair) -> Finding:
    seconds = float(pair.t[-1] - pair.t[0])
    return Finding(
        "stuck",
        seconds,
        float(np.median(np.diff(pair.t))),
        "s",
        f"exec_{pair.name} stays at {np.median(pair.executed):.4g} all the time while "
        f"cmd_{pair.name} moves by {np.ptp(pair.ordered):.4g}: actuator or sensor is dead",
        f"leave exec_{pair.name} out of the mapping, if the vessel obeyed its orders",
        (f"exec_{pair.name}",),
    )


def _settled_ratio(pair: _Pair) -> tuple[float, float]:
    """Executed per ordered where orders have stood and no limit is reached, and its error.

    One value for every order that stood long enough: within it samples say nothing new.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(pair.ordered) != 0) + 1, [pair.t.size]])
    pieces = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        late = slice(first + np.searchsorted(pair.t[first:last], pair.t[first] + _SETTLED), last)
        if late.start < late.stop:
            pieces.append((pair.ordered[first], np.median(pair.executed[late])))
    if len(pieces) < 4:
        return 1.0, np.inf
    ordered, executed = np.array(pieces).T
    free = np.abs(executed) < 0.95 * np.max(np.abs(pair.executed))
    free = free if np.sum(free) >= 4 and np.ptp(ordered[free]) > 0 else np.ones(free.shape, bool)
    ordered, executed = ordered[free], executed[free]
    if np.ptp(ordered) <= 0:
        return 1.0, np.inf
    matrix = np.stack([ordered, np.ones_like(ordered)], axis=-1)
    gains = np.linalg.lstsq(matrix, executed, rcond=None)[0]
    rest = executed - matrix @ gains
    spread = np.sum((ordered - ordered.mean()) ** 2)
    variance = np.sum(rest**2) / (ordered.size - 2) + (1e-3 * np.ptp(executed)) ** 2
    return float(gains[0]), float(np.sqrt(variance / spread))


def _limit(pair: _Pair) -> str:
    """Words on the level that what was executed does not pass while orders do."""
    level = float(np.max(np.abs(pair.executed)))
    at = np.abs(pair.executed) > 0.99 * level
    if np.mean(at) < 0.02 or np.max(np.abs(pair.ordered[at])) < 1.05 * level:
        return ""
    return f"; it never exceeds {level:.4g}, whatever is ordered"


_PORT = ("port", "left")
_STARBOARD = ("starboard", "stbd", "right")
_STEERING = ("rudder", "helm", "delta")
_PROPELLERS = ("propeller", "prop", "engine")
_ANGLES = ("angle", "azimuth")
_TURNING = "rad/s per unit of actuation"


def response_findings(trajectory: Trajectory, motion: MeasuredMotion) -> list[Finding]:
    """Actuators that push the wrong way or not at all, and port exchanged with starboard.

    `motion` is the trajectory's motion with its own faults already put right. Where yaw rate
    was not measured, heading is differentiated.
    """
    if motion.has("psi") and not motion.has("r"):
        rate = np.gradient(motion.values["psi"], motion.t)
        known = motion.known | {"r": motion.known["psi"]}
        motion = dataclasses.replace(motion.with_channels(r=rate), known=known)
    findings = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        series = {name: _on_clock(trajectory, motion, values) for name, values in group.items()}
        findings += _mirrored(_group(motion, prefix, series))
    return findings


def _group(motion: MeasuredMotion, prefix: str, series: dict[str, np.ndarray]) -> list[Finding]:
    """Findings on either the commanded or the executed actuators."""
    findings = []
    port = [name for name in series if _is(name, _PORT) and not _is(name, _STEERING)]
    starboard = [name for name in series if _is(name, _STARBOARD) and not _is(name, _STEERING)]
    for name, values in series.items():
        if _is(name, _STEERING):
            findings += _rudder(motion, prefix + name, values, alone=not port)
        elif _is(name, _ANGLES):
            continue
        elif _is(name, ("bow",)) or (_is(name, ("stern",)) and _is(name, ("tunnel", "thruster"))):
            findings += _tunnel(motion, prefix + name, values, -1 if _is(name, ("stern",)) else 1)
        elif _is(name, _PROPELLERS):
            findings += _propeller(motion, prefix + name, values)
    if len(port) == len(starboard) == 1:
        names = (prefix + port[0], prefix + starboard[0])
        findings += _pair_of_responses(motion, names, series[port[0]], series[starboard[0]])
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


def _on_clock(trajectory: Trajectory, motion: MeasuredMotion, series: Series) -> np.ndarray:
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


def _rudder(motion: MeasuredMotion, channel: str, angle: np.ndarray, alone: bool) -> list[Finding]:
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


def _tunnel(motion: MeasuredMotion, channel: str, force: np.ndarray, side: int) -> list[Finding]:
    """A tunnel thruster pushes to starboard: at the bow that turns the vessel to starboard."""
    if not motion.has("r") or np.ptp(force) <= 0:
        return []
    effect = response_to(motion, "r", force[None])
    if not effect.sound or effect.gains[0] * side > 0:
        return []
    way = "port" if side > 0 else "starboard"
    return [_sign(channel, effect, f"positive {channel} turns the vessel to {way}")]


def _propeller(motion: MeasuredMotion, channel: str, speed: np.ndarray) -> list[Finding]:
    if not motion.has("u") or np.ptp(speed) < 0.2 * np.max(np.abs(speed)):
        return []
    effect = response_to(motion, "u", speed[None])
    if not effect.sound or effect.gains[0] > 0:
        return []
    return [_sign(channel, effect, f"positive {channel} slows the vessel down")]


def _sign(channel: str, effect: LaggedResponse, message: str) -> Finding:
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


def _pair_of_responses(
    motion: MeasuredMotion, names: tuple[str, str], port: np.ndarray, starboard: np.ndarray
) -> list[Finding]:
    """Exchanged or reversed thrusters either side of the centreline."""
    if not motion.has("r"):
        return []
    half, mean = 0.5 * (port - starboard), 0.5 * (port + starboard)
    # What is small beside the other may be no more than an error of a thrust table.
    yaw = response_to(motion, "r", half[None]) if np.ptp(half) > 0.2 * np.ptp(mean) else NO_RESPONSE
    surge = NO_RESPONSE
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


def _swapped(names: tuple[str, str], yaw: LaggedResponse) -> list[Finding]:
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
    motion: MeasuredMotion,
    names: tuple[str, str],
    port: np.ndarray,
    starboard: np.ndarray,
    yaw: LaggedResponse,
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


def _share(effect: LaggedResponse) -> str:
    return f"it explains {100 * effect.explained:.0f} %"
