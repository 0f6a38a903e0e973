"""Actuation by itself: executed against ordered, impossible angles, actuators without effect.

What an actuator does to the vessel is `responses`' question; here its two records are compared
with each other, and it is asked whether it does anything at all.
"""

import dataclasses

import numpy as np

from diffsea.recordings.edits import Affine
from diffsea.recordings.finding import Finding
from diffsea.types import Trajectory


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
