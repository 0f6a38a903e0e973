"""Actuation by itself: impossible angles, orders in place of motion, executed against ordered.

What an actuator does to the vessel is the question of `responses`; here its two records are
compared with each other, and it is asked whether they can be what they are called.
"""

import numpy as np

from diffsea.recordings.auditing.edits import ExecutedToCommanded
from diffsea.recordings.auditing.finding import Finding, finding_of, in_degrees
from diffsea.series import median_interval
from diffsea.trajectory import Samples, Trajectory


_STANDING = 4.0  # s for which an order must have stood before what was executed is compared
_NEAR_UNIT = 0.05  # logarithm: how close a ratio must be to that of two units
_DIFFERENT = 0.1  # a ratio this far from one is worth a finding
_CERTAIN = 5.0  # standard errors
_MOTIONLESS = 1e-3  # an executed channel that moves by less of its orders' range stands still
_AT_LIMIT = 0.95  # of the largest executed value, from which on a limit may have been reached
_FASTEST_RUDDER = np.radians(35.0)  # rad/s; what turns faster from sample to sample is no rudder
_JUMP = 0.2  # of a channel's range within one sample
_JUMP_SECONDS = 0.5  # within which thrust may jump and be an order

_RUDDERS = ("rudder", "helm", "delta")  # angles that never go round
_ANGLES = ("rudder", "delta", "angle", "azimuth", "helm")
_RATIOS = {180 / np.pi: "deg", 60.0: "rpm", 100.0: "%", 1e3: "thousandths", 2 * np.pi: "rad/s"}


def actuation_findings(trajectory: Trajectory) -> list[Finding]:
    """Angles that are in degrees, and executed actuation that contradicts its orders.

    The angle of a rudder beyond half a turn is in degrees. A limit at which what is executed stays
    while orders go beyond it is no fault, and no scale is read off there; where something is wrong
    the message names it.
    """
    found = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        for name, series in group.items():
            channel, angles = prefix + name, np.asarray(series, dtype=float)
            angles = angles[np.isfinite(angles)]
            if not any(word in channel.lower() for word in _RUDDERS) or angles.size < 3:
                continue
            largest = float(np.max(np.abs(angles)))
            if largest > np.pi:
                text = f"{channel} is in degrees, not in radians: it reaches {largest:.3g}"
                found.append(in_degrees(channel, text))
    accused = {name for finding in found for name in finding.channels}
    counted = trajectory.counted()
    for name, executed in counted.executed.items():
        ordered = counted.commanded.get(name)
        if ordered is not None and not {f"cmd_{name}", f"exec_{name}"} & accused:
            both = np.isfinite(ordered) & np.isfinite(executed)
            rows = counted.t[both], ordered[both], executed[both]
            found += _executed_against_ordered(name, *rows)
    return found


def _executed_against_ordered(
    name: str, t: Samples, ordered: Samples, executed: Samples
) -> list[Finding]:
    """What is executed of orders that have stood: nothing, the reverse, or another multiple.

    The three series are those of the rows (t in s) that have both.
    """
    if t.size < 30 or np.ptp(ordered) <= 0:
        return []
    channels = order, answer = f"cmd_{name}", f"exec_{name}"
    if np.ptp(executed) < _MOTIONLESS * np.ptp(ordered):
        size = float(t[-1] - t[0]), median_interval(t)
        words = {"level": np.median(executed), "order": order, "travel": np.ptp(ordered)}
        return [finding_of("dead-actuator", (answer,), *size, words)]
    ratio, error = _settled_ratio(t, ordered, executed)
    like_order = ratio > 0 and abs(ratio - 1) < max(_DIFFERENT, _CERTAIN * error)
    if like_order or abs(ratio) <= _CERTAIN * error:
        return []
    kind, what = "scale", f"is {ratio:.4g} times"
    units = [
        unit
        for known, unit in _RATIOS.items()
        if any(abs(np.log(abs(ratio) / value)) < _NEAR_UNIT for value in (known, 1 / known))
    ]
    if ratio < 0:
        kind, what = "sign", f"has the opposite sign of (ratio {ratio:.4g})"
    elif units:
        kind, what = "unit", f"is {ratio:.4g} times (one of them may be in {units[0]})"
    text = f"where orders have stood for {_STANDING:g} s, {answer} {what} {order}"
    # The level that what was executed does not pass while orders do.
    level = float(np.max(np.abs(executed)))
    at = np.abs(executed) > 0.99 * level
    if np.mean(at) >= 0.02 and np.max(np.abs(ordered[at])) >= 1.05 * level:
        text += f"; it never exceeds {level:.4g}, whatever is ordered"
    repair = f"sign, unit or scale of {order} or of {answer} in the mapping"
    doubt = "either the order or what was executed may be labelled wrongly"
    return [Finding(kind, ratio, error, "1", text, repair, channels, doubt=doubt)]


def _settled_ratio(t: Samples, ordered: Samples, executed: Samples) -> tuple[float, float]:
    """Executed per ordered where orders have stood and no limit is reached, and its error.

    One value for every order that stood long enough: within it samples say nothing new.
    """
    starts = np.flatnonzero(np.diff(ordered) != 0) + 1
    starts = np.concatenate([[0], starts, [t.size]])
    pieces = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        stood = np.searchsorted(t[first:last], t[first] + _STANDING)
        if first + stood < last:
            pieces.append((ordered[first], np.median(executed[first + stood : last])))
    if len(pieces) < 4:
        return 1.0, np.inf
    limit = _AT_LIMIT * np.max(np.abs(executed))
    ordered, executed = np.array(pieces).T
    free = np.abs(executed) < limit
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


def order_findings(trajectory: Trajectory) -> list[Finding]:
    """Executed channels that jump as only orders do.

    A rudder that turns by a large part of its range, and faster than 35 deg/s, from one
    sample to the next, and does so for most of its travel, is a command; so is thrust that
    moves in jumps of a fifth of its range between samples at most half a second apart. Thrust
    that equals its command throughout is let pass: a simulated thruster may have no lag.
    """
    run = trajectory.counted()
    found = []
    for name, values in run.executed.items():
        angle = any(word in name.lower() for word in _ANGLES)
        ordered = run.commanded.get(name)
        if ordered is not None and not angle and np.array_equal(ordered, values, equal_nan=True):
            continue
        finite = np.isfinite(values)
        series, change = values[finite], np.abs(np.diff(values[finite]))
        step = np.diff(run.t[finite])
        if series.size < 20 or np.ptp(series) == 0:
            continue
        large = change > _JUMP * np.ptp(series)
        large &= change > _FASTEST_RUDDER * step if angle else step <= _JUMP_SECONDS
        if np.sum(large) < 2 or np.sum(change[large]) < 0.5 * np.sum(change):
            continue
        jump = float(np.max(change))
        words = {"name": name, "unit": "rad" if angle else "1"}
        words["jump"] = f"{np.degrees(jump):.3g} deg" if angle else f"{jump:.4g}"
        edit, channels = ExecutedToCommanded(name), (f"exec_{name}",)
        found.append(finding_of("order-not-motion", channels, jump, 0.0, words, edit))
    return found
