"""Units: which are usual, which are stated, and what ratios of columns say of them."""

import math

import numpy as np

from diffsea.recordings.proposal.readings import Prior


_CAP = 14.0  # the most that a ratio which is that of no units costs
_RATIO = 0.04  # standard deviation of scale errors
_STATED = 0.97  # probability that a stated unit is right
UNIT_ODDS = {
    "x": {"m": 0.93, "km": 0.01, "ft": 0.02, "nmi": 0.01, "cm": 0.01, "mm": 0.02},
    "u": {"m/s": 0.8, "kn": 0.15, "km/h": 0.03, "ft/s": 0.02},
    "r": {"rad/s": 0.55, "deg/s": 0.4, "deg/min": 0.05},
}  # fmt: skip
UNIT_ODDS |= {"y": UNIT_ODDS["x"], "v": UNIT_ODDS["u"]}


def unit_odds(prior: Prior, channel: str, column: str) -> dict[str, float]:
    """Probability of every unit of a column, from what its header says."""
    odds = dict(UNIT_ODDS[channel])
    stated = prior.suggestions[column].unit
    if stated in odds:
        odds = {unit: (1 - _STATED) * value for unit, value in odds.items()}
        odds[stated] += _STATED
    total = sum(odds.values())
    return {unit: value / total for unit, value in odds.items()}


def ratio_cost(ratio: float, expected: float, error: float) -> float:
    """Cost (log odds) of a ratio that differs from that of two units; never above a cap.

    `error` is the relative standard error of the ratio. The tails are heavy (Student's t with
    four degrees of freedom): sensors have wrong scales, too.
    """
    if not ratio > 0 or not math.isfinite(error):
        return 0.0
    spread = math.hypot(_RATIO, min(error, 2.0))
    return min(2.5 * math.log1p(0.25 * (math.log(ratio / expected) / spread) ** 2), _CAP)


def period_odds(values: np.ndarray, stated: str) -> dict[float, float]:
    """Log odds of a column being an angle in degrees (period 360) or radians (2 pi)."""
    finite = values[np.isfinite(values)]
    largest = float(np.max(np.abs(finite)))
    jumps = np.abs(np.diff(finite))
    if np.any((jumps > 300) & (jumps <= 360)) and largest <= 360.5:
        return {360.0: 0.0, 2 * math.pi: -12.0}
    if largest <= 2 * math.pi + 0.05 and np.any((jumps > 5.5) & (jumps <= 2 * math.pi + 0.05)):
        return {2 * math.pi: 0.0, 360.0: -12.0}
    odds = {2 * math.pi: -0.2, 360.0: -1.7}
    if largest > 4 * math.pi:
        odds = {2 * math.pi: -4.0, 360.0: -0.02}
    for unit, period in (("deg", 360.0), ("rad", 2 * math.pi)):
        if stated == unit:
            odds[period] += 4.0
    return odds
