"""How a vessel answered her orders: speed, turning rate, lag and sides, with intervals."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from diffsea.checks.lags import FirstOrderLag, is_known_well, lag_of
from diffsea.checks.shares import OrderShares
from diffsea.checks.sides import asymmetry_of
from diffsea.checks.spans import (
    DRAWS,
    STAYED,
    IntervalEstimate,
    TimeScales,
    time_scales,
    used_span,
)
from diffsea.recordings.conditioning import cut
from diffsea.trajectory import Samples, Trajectory


_BIN = 0.1  # of full order
_SAME = 0.05  # of full order, within which an order stands
_STRAIGHT = 0.12  # of full order of turning, up to which the speed is that of a straight course
_FEWEST_SECONDS = 6.0  # in a bin


@dataclasses.dataclass(frozen=True)
class SteadyPoint:
    """Mean answer while an order stood: share of full order, m/s or rad/s, its interval, s."""

    order: float
    answer: IntervalEstimate
    seconds: float

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return {"order": self.order, "seconds": self.seconds} | self.answer.as_dict()


@dataclasses.dataclass(frozen=True)
class Answers:
    """What a log shows of the answer to orders; None or empty where it does not tell.

    Attributes:
        speed: mean speed by the order ahead, on straight courses.
        turning: mean turning rate by the order to turn.
        lag_of_turning, lag_of_speed: from order to motion.
        asymmetry: `ratio` of the thrusts of port and starboard, (1 - ratio) : (1 + ratio); of a
            rudder, of the turning rates by orders to starboard and to port.
        paired: whether it is that of a pair of thrusters.
        stayed: s for which an order has stood before speed or rate count as steady.
        ahead, turn, speeds, rates: the samples behind these, on one clock of all used spans.
    """

    speed: tuple[SteadyPoint, ...] = ()
    turning: tuple[SteadyPoint, ...] = ()
    lag_of_turning: FirstOrderLag | None = None
    lag_of_speed: FirstOrderLag | None = None
    asymmetry: IntervalEstimate | None = None
    ahead: Samples = dataclasses.field(default_factory=lambda: np.empty(0))
    turn: Samples = dataclasses.field(default_factory=lambda: np.empty(0))
    speeds: Samples = dataclasses.field(default_factory=lambda: np.empty(0))
    rates: Samples = dataclasses.field(default_factory=lambda: np.empty(0))
    paired: bool = False
    stayed: float = STAYED

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json: all but the samples."""
        one = lambda found: None if found is None else found.as_dict()
        return {
            "speed_against_order": [point.as_dict() for point in self.speed],
            "turning_rate_against_order": [point.as_dict() for point in self.turning],
            "lag": {"turning": one(self.lag_of_turning), "speed": one(self.lag_of_speed)},
            "asymmetry": one(self.asymmetry),
        }


def answers_of(runs: Sequence[tuple[Trajectory, Sequence[tuple[float, float]]]]) -> Answers:
    """How a vessel answered in the used spans (s) of runs whose orders are shares."""
    scales = time_scales([run for run, _ in runs])
    parts = [cut(run, *span) for run, spans in runs for span in spans]
    pieces = [piece for part in parts if (piece := used_span(part, scales)) is not None]
    if not pieces:
        return Answers(stayed=scales.stayed)
    ahead = np.concatenate([piece.orders.ahead for piece in pieces])
    speeds = np.concatenate([piece.speed for piece in pieces])
    rates = np.concatenate([piece.rate for piece in pieces])
    turns = [piece.orders.turning for piece in pieces if piece.orders.turning is not None]
    turn = np.concatenate(turns) if turns else np.full(ahead.shape, np.nan)
    rng = np.random.default_rng(0)
    steady_ahead = np.concatenate([_stood(p.orders.ahead, scales) for p in pieces])
    straight = np.concatenate([_straight(p.orders, scales) for p in pieces])
    speed = _steady_points(ahead, speeds, steady_ahead & straight, scales, "m/s", rng)
    turning: tuple[SteadyPoint, ...] = ()
    lag_of_turning = asymmetry = None
    if turns:
        steady_turn = np.concatenate([_stood(p.orders.turning, scales) for p in pieces])
        turning = _steady_points(turn, rates, steady_turn, scales, "rad/s", rng)
        parts = [(p.orders.turning, p.rate) for p in pieces]
        lag_of_turning = lag_of(parts, scales, rng)
        if lag_of_turning is not None and is_known_well(lag_of_turning, ahead.size, scales):
            asymmetry = asymmetry_of(pieces, lag_of_turning, scales, rng)
    lag_of_speed = lag_of([(p.orders.ahead, p.speed) for p in pieces], scales, rng)
    return Answers(
        speed=speed,
        turning=turning,
        lag_of_turning=lag_of_turning,
        lag_of_speed=lag_of_speed,
        asymmetry=asymmetry,
        ahead=ahead,
        turn=turn,
        speeds=speeds,
        rates=rates,
        paired=any(piece.orders.sides is not None for piece in pieces),
        stayed=scales.stayed,
    )


def _stood(order: Samples | None, scales: TimeScales) -> np.ndarray:
    """Rows in which an order has stood for long enough."""
    assert order is not None
    return _throughout(order, scales, lambda windows: np.ptp(windows, axis=1) <= 2 * _SAME)


def _straight(orders: OrderShares, scales: TimeScales) -> np.ndarray:
    """Rows before which no turn was ordered for long enough: the speed lost in it is regained."""
    if orders.turning is None:
        return np.ones(orders.ahead.shape, dtype=bool)
    turns = np.abs(orders.turning)
    return _throughout(turns, scales, lambda windows: windows.max(axis=1) <= _STRAIGHT)


def _throughout(
    order: Samples, scales: TimeScales, holds: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Rows that end a time, as long as orders must have stood, in which something holds."""
    rows = max(1, round(scales.stayed / scales.interval))
    if order.size <= rows:
        return np.zeros(order.shape, dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(order, rows + 1)
    return np.concatenate([np.zeros(rows, dtype=bool), holds(windows)])


def _steady_points(
    order: Samples,
    answer: Samples,
    steady: np.ndarray,
    scales: TimeScales,
    unit: str,
    rng: np.random.Generator,
) -> tuple[SteadyPoint, ...]:
    """Mean answers by tenths of full order, with intervals by blocks of time."""
    found = []
    bins = np.round(order / _BIN)
    block = np.arange(order.size) // max(1, round(scales.block / scales.interval))
    for level in np.unique(bins[steady & np.isfinite(answer)]):
        rows = steady & np.isfinite(answer) & (bins == level)
        seconds = float(np.sum(rows)) * scales.interval
        if seconds < _FEWEST_SECONDS:
            continue
        mean = float(np.mean(answer[rows]))
        blocks = np.unique(block[rows])
        sums = np.array(
            [(np.sum(answer[rows & (block == b)]), np.sum(rows & (block == b))) for b in blocks]
        )
        if len(blocks) > 1:
            drawn = sums[rng.integers(len(blocks), size=(DRAWS, len(blocks)))].sum(1)
            low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.05, 0.95])
        else:
            # One block tells no scatter between blocks: its own spread is the interval.
            low, high = np.quantile(answer[rows], [0.05, 0.95])
        one = IntervalEstimate(mean, float(low), float(high), unit)
        found.append(SteadyPoint(float(np.mean(order[rows])), one, seconds))
    return tuple(found)
