"""How unlike the two sides of a vessel are, by the turning rate's answer to each of them."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffsea.checks.lags import FirstOrderLag, block_moments, lagged
from diffsea.checks.spans import DRAWS, IntervalEstimate, TimeScales, UsedSpan
from diffsea.trajectory import Samples


_MOST_ALIKE = 1e5  # condition of the sums of two sides, beyond which they are one


def asymmetry_of(
    pieces: Sequence[UsedSpan], lag: FirstOrderLag, scales: TimeScales, rng: np.random.Generator
) -> IntervalEstimate | None:
    """How unlike port and starboard are, by the turning rate's answer to each of them.

    Turning is damped by more than in proportion, and by speed, so that a second regression has the
    rate that the first one makes of the orders, times its magnitude and times the speed, as
    columns beside them. A rudder turns in proportion to the speed that it is ordered at: the turns
    to one side may all be slower. None of one whose speed is not known.
    """
    speeds = _relative_speeds(pieces)
    if speeds is None and pieces[0].orders.sides is None:
        return None
    speeds = [np.ones_like(piece.rate) for piece in pieces] if speeds is None else speeds
    rates = [np.where(np.isfinite(s), p.rate, np.nan) for p, s in zip(pieces, speeds, strict=True)]
    speeds = [np.where(np.isfinite(speed), speed, 1.0) for speed in speeds]
    late = lambda order: _late(order, lag, scales.interval)
    columns = [
        np.stack([late(side) for side in _sides(piece, lag, speed)])
        for piece, speed in zip(pieces, speeds, strict=True)
    ]
    first = np.concatenate(
        [block_moments(c, rate, scales) for c, rate in zip(columns, rates, strict=True)]
    ).sum(0)
    if np.linalg.cond(first[:2, :2]) > _MOST_ALIKE:
        return None
    gains = np.linalg.lstsq(first[:3, :3], first[:3, 3], rcond=None)[0]
    moments = []
    for both, speed, rate in zip(columns, speeds, rates, strict=True):
        made = gains[:2] @ both + gains[2]
        beside = [made * np.abs(made), made * (speed - 1.0)]
        moments.append(block_moments(np.vstack([both, *beside]), rate, scales))
    blocks = np.concatenate(moments)
    value = _ratio(blocks.sum(0))
    times = rng.integers(len(blocks), size=(DRAWS, len(blocks)))
    drawn = np.array([_ratio(blocks[chosen].sum(0)) for chosen in times])
    drawn = drawn[np.isfinite(drawn)]
    if not math.isfinite(value) or abs(value) > 1 or drawn.size < DRAWS // 2:
        return None
    low, high = np.quantile(drawn, [0.05, 0.95])
    return IntervalEstimate(float(value), float(low), float(high), "1")


def _relative_speeds(pieces: Sequence[UsedSpan]) -> list[Samples] | None:
    """Speeds over their mean size, NaN where not known; None where hardly any is."""
    everything = np.concatenate([piece.speed for piece in pieces])
    known = everything[np.isfinite(everything)]
    usual = float(np.mean(np.abs(known))) if known.size > 0.5 * everything.size else 0.0
    return [piece.speed / usual for piece in pieces] if usual > 0 else None


def _sides(piece: UsedSpan, lag: FirstOrderLag, speed: Samples) -> tuple[Samples, Samples]:
    """What turns to starboard and to port: the thrusters' orders, or a rudder's times the speed."""
    if piece.orders.sides is not None:
        port, starboard = piece.orders.sides
        return (starboard, port) if lag.opposite else (port, starboard)
    turning = piece.orders.turning
    assert turning is not None
    turning = speed * (-turning if lag.opposite else turning)
    return np.maximum(turning, 0.0), np.maximum(-turning, 0.0)


def _late(order: Samples, lag: FirstOrderLag, interval: float) -> Samples:
    return lagged(order, round(lag.delay.value / interval), lag.time_constant.value, interval)


def _ratio(moments: Float[np.ndarray, "q q"]) -> float:
    """How much more the second side does, as `thrust-asymmetry` counts it; NaN if unknown."""
    gains = np.linalg.lstsq(moments[:-1, :-1], moments[:-1, -1], rcond=None)[0]
    first, second = gains[0], -gains[1]
    return float((second - first) / (second + first)) if first + second > 0 else math.nan
