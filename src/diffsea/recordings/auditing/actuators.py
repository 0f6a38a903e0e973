"""Actuation by itself: impossible angles, orders in place of motion, executed against ordered.

What an actuator does to the vessel is the question of `responses`; here its two records are
compared with each other, and it is asked whether they can be what they are called.
"""

import numpy as np
from jaxtyping import Float

from diffsea.channels import is_rudder, steers
from diffsea.recordings.auditing.edits import ExecutedToCommanded
from diffsea.recordings.auditing.finding import (
    Finding,
    finding_of,
    in_degrees,
    words_and_names,
)
from diffsea.series import hold_at, median_interval
from diffsea.trajectory import Samples, Trajectory


_STANDING = 4.0  # s for which an order must have stood before what was executed is compared
_NEAR_UNIT = 0.05  # logarithm: how close a ratio must be to that of two units
_OTHER_UNIT = 3.0  # times what was ordered is given by no actuator: it is counted in another unit
_DIFFERENT = 0.1  # a ratio this far from one is worth a finding
_CERTAIN = 5.0  # standard errors
_NOTABLE_OFFSET = 0.02  # of the orders' range: servos are set up to about a hundredth
_CLEAR = np.log(1e5)  # log likelihood ratio beyond chance
_MOST_EARLY = 3.0  # s looked for
_SMALLEST_EARLY = 0.1  # s; less is the stamping of two channels in turn
_LAGS = (0.0, 0.3, 1.0, 3.0)  # s, of servos from small to large
_MOTIONLESS = 1e-3  # an executed channel that moves by less of its orders' range stands still
_AT_LIMIT = 0.95  # of the largest executed value, from which on a limit may have been reached
_FASTEST_RUDDER = np.radians(35.0)  # rad/s; what turns faster from sample to sample is no rudder
_JUMP = 0.2  # of a channel's range within one sample
_JUMP_SECONDS = 0.5  # within which thrust may jump and be an order
_MOVES = 0.01  # of an order's usual range: less from row to row is no move
_STANDS = 0.8  # share of rows at which a reading stays, from which on it may be stale
_SELDOM = 1 / 3  # of the rows at which the order moves, those at which a stale reading does
_LEAST_READINGS = 8  # from which on it is said how old readings are

_Settled = Float[np.ndarray, "order"]

_ANGLES = ("angle", "azimuth")
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
            if not is_rudder(name) or angles.size < 3:  # one that never goes round
                continue
            largest = float(np.max(np.abs(angles)))
            if largest > np.pi:
                told = words_and_names(channel)
                text = f"{told} is in degrees, not in radians: it reaches {largest:.3g}"
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
        words = {"level": np.median(executed), "order": (order,), "travel": np.ptp(ordered)}
        fault = "dead-actuator" if np.ptp(executed) > 0 else "constant-actuator"
        return [finding_of(fault, (answer,), *size, words)]
    early = _early_execution(name, t, ordered, executed)
    settled = _settled(t, ordered, executed)
    ratio, error = _settled_ratio(*settled)
    like_order = ratio > 0 and abs(ratio - 1) < max(_DIFFERENT, _CERTAIN * error)
    if like_order:
        return early + _settled_offset(name, *settled)
    if abs(ratio) <= _CERTAIN * error:
        return early
    # The level that what was executed does not pass while orders do.
    level, limit = float(np.max(np.abs(executed))), ""
    at = np.abs(executed) > 0.99 * level
    if np.mean(at) >= 0.02 and np.max(np.abs(ordered[at])) >= 1.05 * level:
        limit = f"; it never exceeds {level:.4g}, whatever is ordered"
    doubt = "either the order or what was executed may be labelled wrongly"
    units = [
        unit
        for known, unit in _RATIOS.items()
        if any(abs(np.log(abs(ratio) / value)) < _NEAR_UNIT for value in (known, 1 / known))
    ]
    if ratio > 0 and not units and 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        words = {"order": (order,), "answer": (answer,), "standing": _STANDING, "limit": limit}
        by, fault = {"scale": ratio}, "feedback-scale"
        doubt = "an actuator that gives more or less than was ordered looks the same"
        size = ratio, error
        return [*early, finding_of(fault, channels, *size, words, parameters=by, doubt=doubt)]
    told = [words_and_names(channel) for channel in (answer, order)]
    which = f"one of them may be in {units[0]}" if units else "it counts in another unit"
    kind, what = "unit", f"is {ratio:.4g} times ({which})"
    if ratio < 0:
        kind, what = "sign", f"has the opposite sign of (ratio {ratio:.4g})"
    text = f"where orders have stood for {_STANDING:g} s, {told[0]} {what} {told[1]}{limit}"
    repair = f"sign, unit or scale of {order} or of {answer} in the mapping"
    return [*early, Finding(kind, ratio, error, "1", text, repair, channels, doubt=doubt)]


def _settled(t: Samples, ordered: Samples, executed: Samples) -> tuple[_Settled, _Settled]:
    """Orders that have stood, and what was executed of them then, where no limit is reached.

    One value for every order that stood long enough: within it samples say nothing new. Empty
    where they are too few.
    """
    starts = np.flatnonzero(np.diff(ordered) != 0) + 1
    starts = np.concatenate([[0], starts, [t.size]])
    pieces = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        stood = np.searchsorted(t[first:last], t[first] + _STANDING)
        if first + stood < last:
            pieces.append((ordered[first], np.median(executed[first + stood : last])))
    if len(pieces) < 4:
        return np.empty(0), np.empty(0)
    limit = _AT_LIMIT * np.max(np.abs(executed))
    ordered, executed = np.array(pieces).T
    free = np.abs(executed) < limit
    free = free if np.sum(free) >= 4 and np.ptp(ordered[free]) > 0 else np.ones(free.shape, bool)
    return ordered[free], executed[free]


def _settled_ratio(ordered: _Settled, executed: _Settled) -> tuple[float, float]:
    """Executed per ordered, and its error; one of no certainty where nothing tells."""
    if not ordered.size or np.ptp(ordered) <= 0:
        return 1.0, np.inf
    matrix = np.stack([ordered, np.ones_like(ordered)], axis=-1)
    gains = np.linalg.lstsq(matrix, executed, rcond=None)[0]
    rest = executed - matrix @ gains
    spread = np.sum((ordered - ordered.mean()) ** 2)
    variance = np.sum(rest**2) / (ordered.size - 2) + (1e-3 * np.ptp(executed)) ** 2
    return float(gains[0]), float(np.sqrt(variance / spread))


def _settled_offset(name: str, ordered: _Settled, executed: _Settled) -> list[Finding]:
    """What is executed is off by the same amount whatever is ordered.

    A servo stops within its dead band on the side it comes from, which averages out over orders.
    """
    if ordered.size < 4:
        return []
    channels = order, answer = f"cmd_{name}", f"exec_{name}"
    off = executed - ordered
    size = float(np.mean(off))
    std = float(np.hypot(np.std(off, ddof=1), 1e-3 * np.ptp(executed)) / np.sqrt(off.size))
    if abs(size) < max(_CERTAIN * std, _NOTABLE_OFFSET * np.ptp(ordered)):
        return []
    said = f"{size:.4g} rad ({np.degrees(size):.3g} deg)" if steers(name) else f"{size:.4g}"
    words = {"order": (order,), "answer": (answer,), "standing": _STANDING, "back": -size}
    words |= {"size": said, "unit": "rad" if steers(name) else "1"}
    doubt = "an actuator whose neutral point is off looks the same"
    by, fault = {"offset": size}, "feedback-offset"
    return [finding_of(fault, channels, size, std, words, parameters=by, doubt=doubt)]


def _early_execution(name: str, t: Samples, ordered: Samples, executed: Samples) -> list[Finding]:
    """What is executed before it is ordered: one of the clocks is off.

    Orders behind a first-order lag, shifted either way, are fitted to what was executed; a shift
    to earlier must leave so little of what none leaves that chance does not explain it,
    correlation counted.
    """
    step = median_interval(t)
    shifts = step * np.arange(int(np.ceil(-_MOST_EARLY / step)), int(_MOST_EARLY / step) + 1)
    shifts = shifts[:: max(1, shifts.size // 80)]
    rests = [(_lagged_rest(t, ordered, executed, shift), float(shift)) for shift in shifts]
    powers = np.array([np.sum(rest**2) for rest, _ in rests])
    best = int(np.argmin(powers))
    rest, shift = rests[best]
    causal = float(np.min(powers[shifts >= -0.5 * step]))
    if shift > -max(1.5 * step, _SMALLEST_EARLY) or not powers[best] > 0:
        return []
    rho = min(max(float(np.sum(rest[1:] * rest[:-1]) / powers[best]), 0.0), 0.99)
    number = t.size * (1 - rho) / (1 + rho)
    if 0.5 * number * np.log(causal / powers[best]) < _CLEAR:
        return []
    channels = order, answer = f"cmd_{name}", f"exec_{name}"
    std = max(0.5 * step, float(np.diff(shifts)[0]))
    words, by = {"order": (order,), "answer": (answer,), "early": -shift}, {"delay": shift}
    doubt = "either of the two clocks may be off"
    fault = "feedback-early"
    return [finding_of(fault, channels, shift, std, words, parameters=by, doubt=doubt)]


def _lagged_rest(t: Samples, ordered: Samples, executed: Samples, shift: float) -> Samples:
    """What is left of what was executed by lagged orders of `shift` s before, at best."""
    held = hold_at(t, ordered, t - shift)
    held = np.where(np.isfinite(held), held, ordered[0])
    rests = []
    for constant in _LAGS:
        lagged = held if constant == 0 else _first_order(t, held, constant)
        matrix = np.stack([lagged, np.ones_like(lagged)], axis=-1)
        rests.append(executed - matrix @ np.linalg.lstsq(matrix, executed, rcond=None)[0])
    return min(rests, key=lambda rest: float(np.sum(rest**2)))


def _first_order(t: Samples, held: Samples, constant: float) -> Samples:
    """Held orders behind a first-order lag (s), from their steps; rows evenly in time."""
    memory = np.exp(-np.arange(0.0, 8 * constant, median_interval(t)) / constant)
    padded = np.concatenate([np.full(memory.size, held[0]), held])
    return np.convolve(padded, memory / memory.sum())[memory.size : memory.size + held.size]


def order_findings(trajectory: Trajectory) -> list[Finding]:
    """Executed channels that jump as only orders do.

    A rudder that turns by a large part of its range, and faster than 35 deg/s, from one
    sample to the next, and does so for most of its travel, is a command; so is thrust that
    moves in jumps of a fifth of its range between samples at most half a second apart. Thrust
    that equals its command throughout is let pass: a simulated thruster may have no lag. What jumps
    because it is read too seldom is told as that.
    """
    run, stale = trajectory.counted(), stale_feedback(trajectory)
    found = []
    for name, values in run.executed.items():
        angle = is_rudder(name) or any(word in name.lower() for word in _ANGLES)
        ordered, channels = run.commanded.get(name), (f"exec_{name}",)
        edit = ExecutedToCommanded(name)
        if name in stale:
            words = {"order": (f"cmd_{name}",)}
            size = stale[name], median_interval(run.t)
            found.append(finding_of("stale-feedback", channels, *size, words, edit))
            continue
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
        found.append(finding_of("order-not-motion", channels, jump, 0.0, words, edit))
    return found


def stale_feedback(run: Trajectory) -> dict[str, float]:
    """Actuators whose feedback is read too seldom: for how long a reading stays (s, median).

    It stays for many rows while its order goes on, and then jumps. An actuator that rests, or
    follows late, moves at as many rows as its orders; one with a dead band or a play does not jump.
    """
    counted = run.counted()
    ages = {
        name: _reading_age(counted.t, counted.commanded[name], values)
        for name, values in counted.executed.items()
        if name in counted.commanded
    }
    return {name: age for name, age in ages.items() if age > 0}


def _reading_age(t: Samples, ordered: Samples, executed: Samples) -> float:
    """How long a reading stays while its order moves on, s, median; zero if it does not."""
    both = np.isfinite(ordered) & np.isfinite(executed)
    t, ordered, executed = t[both], ordered[both], executed[both]
    low, high = np.quantile(ordered, [0.05, 0.95]) if t.size else (0.0, 0.0)
    if t.size < 30 or low == high:
        return 0.0
    least = _MOVES * float(high - low)
    moves = np.abs(np.diff(ordered)) > least
    reads = np.flatnonzero(np.diff(executed) != 0)
    seldom = min((1 - _STANDS) * (t.size - 1), _SELDOM * float(moves.sum()))
    if not _LEAST_READINGS <= reads.size <= seldom:
        return 0.0
    # Readings between which the order moved: an actuator at rest is read in vain.
    moved = np.diff(np.append(0, np.cumsum(moves))[reads]) > 0
    apart = np.diff(t[reads])[moved]
    jumps = np.abs(np.diff(executed))[reads[1:]][moved]
    if apart.size < _LEAST_READINGS or np.median(jumps) < least:
        return 0.0
    return float(np.median(apart))
