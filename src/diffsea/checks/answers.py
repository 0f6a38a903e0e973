"""How a vessel answered her orders: speed, turning rate, lag and sides, with intervals.

Intervals are percentiles of a block bootstrap (Kunsch 1989): the time that was used is cut into
blocks, and whole blocks are drawn, so that what depends on its neighbours stays beside them.
Blocks and other times follow from the vessel's own, as long as she takes to turn by 90 deg at the
fastest rate recorded, and are at least those of a small boat.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy import signal

from diffsea.checks.shares import OrderShares, orders_of
from diffsea.recordings.conditioning import cut, resample
from diffsea.recordings.motion import motion_of
from diffsea.segments.free_motion import quarter_turn_window
from diffsea.trajectory import Samples, Trajectory


DRAWS = 400
LEVEL = 0.9  # of the intervals
STAYED = 8.0  # s for which an order of a small boat has stood before she is steady
_FINEST = 0.05  # s, of the clock on which answers are compared
_CONSTANTS = 24  # time constants looked for
_BIN = 0.1  # of full order
_SAME = 0.05  # of full order, within which an order stands
_STRAIGHT = 0.12  # of full order of turning, up to which the speed is that of a straight course
_FEWEST_SECONDS = 6.0  # in a bin
_EXPLAINED = 0.3  # of the variance, that an answer must have to be one
_FEWEST_CONSTANTS = 10  # time constants that a log must last to compare sides
_WELL_EXPLAINED = 0.8  # below it, what is left over is larger than what sides differ by
_MOST_ALIKE = 1e5  # condition of the sums of two sides, beyond which they are one
_MOVED = 0.02  # of full order, standard deviation below which nothing was ordered


@dataclasses.dataclass(frozen=True)
class TimeScales:
    """Times (s) that suit a vessel.

    Attributes:
        interval: of the clock on which answers are compared.
        latest: the longest dead time looked for.
        slowest: the longest time constant looked for.
        stayed: for which an order has stood before speed or rate count as steady.
        block: of the bootstrap.
    """

    interval: float
    latest: float
    slowest: float
    stayed: float
    block: float

    @property
    def constants(self) -> Float[np.ndarray, "constant"]:
        """Time constants looked for."""
        return np.geomspace(2 * self.interval, self.slowest, _CONSTANTS)


def time_scales(runs: Sequence[Trajectory]) -> TimeScales:
    """The scales of runs of one vessel, by their fastest turning: the longest that any has."""
    each = [dataclasses.astuple(_time_scales_of(run)) for run in runs]
    return TimeScales(*map(max, zip(*each, strict=True)))


def _time_scales_of(run: Trajectory) -> TimeScales:
    motion, window = motion_of(run), 0.0
    if motion.has("r"):
        window = quarter_turn_window(motion.t, motion.values["r"])
    elif motion.has("psi"):
        window = quarter_turn_window(motion.t, np.gradient(motion.values["psi"], motion.t))
    return TimeScales(
        interval=max(motion.interval, _FINEST, window / 100),
        latest=max(4.0, 0.5 * window),
        slowest=max(20.0, 4 * window),
        stayed=max(STAYED, window),
        block=max(20.0, window),
    )


@dataclasses.dataclass(frozen=True)
class IntervalEstimate:
    """A number with its interval of `LEVEL`."""

    value: float
    low: float
    high: float
    unit: str

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return {"value": self.value, "interval": [self.low, self.high], "unit": self.unit}


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
class LagOfAnswer:
    """Dead time and time constant of the first-order answer that follows the motion best.

    `explained` is the share of the motion's variance; `opposite` tells that a positive order makes
    less, so that one to turn turns to port.
    """

    delay: IntervalEstimate
    time_constant: IntervalEstimate
    explained: float
    opposite: bool = False

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return {
            "delay": self.delay.as_dict(),
            "time_constant": self.time_constant.as_dict(),
            "explained": self.explained,
            "opposite": self.opposite,
        }


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
    lag_of_turning: LagOfAnswer | None = None
    lag_of_speed: LagOfAnswer | None = None
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


@dataclasses.dataclass(frozen=True)
class _UsedSpan:
    """Orders and motion of one used span on an even clock; NaN where motion is not known."""

    orders: OrderShares
    speed: Samples
    rate: Samples


def answers_of(runs: Sequence[tuple[Trajectory, Sequence[tuple[float, float]]]]) -> Answers:
    """How a vessel answered in the used spans (s) of runs whose orders are shares."""
    scales = time_scales([run for run, _ in runs])
    parts = [cut(run, *span) for run, spans in runs for span in spans]
    pieces = [piece for part in parts if (piece := _piece(part, scales)) is not None]
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
        lag_of_turning = _lag(parts, scales, rng)
        if lag_of_turning is not None and _is_known_well(lag_of_turning, ahead.size, scales):
            asymmetry = _asymmetry(pieces, lag_of_turning, scales, rng)
    lag_of_speed = _lag([(p.orders.ahead, p.speed) for p in pieces], scales, rng)
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


def _piece(run: Trajectory, scales: TimeScales) -> _UsedSpan | None:
    """A span on an even clock; None without orders, or where it is too short."""
    run = run.counted()
    if orders_of(run) is None or run.t[-1] - run.t[0] < 2 * scales.stayed:
        return None
    even = resample(run, scales.interval)
    orders, motion = orders_of(even), motion_of(even)
    assert orders is not None
    unknown = np.full(motion.t.shape, np.nan)
    speed = rate = unknown
    if motion.has("u"):
        sway = motion.values["v"] if motion.has("v") else 0.0
        ahead = np.where(motion.values["u"] < 0, -1.0, 1.0)
        speed = np.where(motion.known["u"], ahead * np.hypot(motion.values["u"], sway), np.nan)
    elif motion.has("x", "y"):
        width = max(1, round(1.0 / scales.interval))
        pace = [np.gradient(motion.values[axis], motion.t) for axis in "xy"]
        smooth = [np.convolve(part, np.ones(width) / width, "same") for part in pace]
        speed = np.where(motion.known["x"], np.hypot(*smooth), np.nan)
    if motion.has("r"):
        rate = np.where(motion.known["r"], motion.values["r"], np.nan)
    elif motion.has("psi"):
        rate = np.where(motion.known["psi"], np.gradient(motion.values["psi"], motion.t), np.nan)
    return _UsedSpan(orders, speed, rate)


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


def _lagged(order: Samples, delay: int, constant: float, interval: float) -> Samples:
    """The answer to an order that is late by some rows, after a first-order lag (s).

    What is ordered in a row acts from there on, and so shows from the next row on.
    """
    delay = min(delay + 1, order.size - 1)
    late = np.concatenate([np.full(delay, order[0]), order[: order.size - delay]])
    share = 1 - math.exp(-interval / constant)
    return order[0] + signal.lfilter([share], [1, share - 1], late - order[0])


def _block_moments(
    columns: Float[np.ndarray, "p time"], answer: Samples, scales: TimeScales
) -> Float[np.ndarray, "block q q"]:
    """Sums of products of columns, a constant and the answer, by blocks of time."""
    known = np.isfinite(answer)
    everything = np.vstack([columns, np.ones_like(answer), np.where(known, answer, 0.0)])
    everything = everything * known
    length = max(1, round(scales.block / scales.interval))
    starts = np.arange(0, answer.size, length)
    return np.stack(
        [everything[:, s : s + length] @ everything[:, s : s + length].T for s in starts]
    )


def _explained(moments: Float[np.ndarray, "*any q q"]) -> Float[np.ndarray, "*any"]:
    """Share of the answer's variance that one column explains, of sums of products."""
    count = np.maximum(moments[..., 1, 1], 1.0)
    xx = moments[..., 0, 0] - moments[..., 0, 1] ** 2 / count
    yy = moments[..., 2, 2] - moments[..., 2, 1] ** 2 / count
    xy = moments[..., 0, 2] - moments[..., 0, 1] * moments[..., 2, 1] / count
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((xx > 0) & (yy > 0), xy * np.abs(xy) / (xx * yy), 0.0)
    return share


def _lag(
    parts: Sequence[tuple[Float[np.ndarray, "_"] | None, Float[np.ndarray, "_"]]],
    scales: TimeScales,
    rng: np.random.Generator,
) -> LagOfAnswer | None:
    """The lag whose answer is correlated best with the motion; None where none explains it."""
    orders = [order for order, _ in parts if order is not None]
    answers = [answer for _, answer in parts]
    everything = np.concatenate(orders)
    if np.std(everything) < _MOVED or not np.any(np.isfinite(np.concatenate(answers))):
        return None
    interval, constants = scales.interval, scales.constants
    delays = np.arange(0, round(scales.latest / interval) + 1)
    moments = np.stack(
        [
            np.concatenate(
                [
                    _block_moments(
                        _lagged(order, int(delay), constant, interval)[None],
                        answer,
                        scales,
                    )
                    for order, answer in zip(orders, answers, strict=True)
                ]
            )
            for delay in delays
            for constant in constants
        ]
    )  # lag, block, 3, 3
    whole = _explained(moments.sum(1))
    sign = float(np.sign(whole[np.argmax(np.abs(whole))]))
    best, explained = _best_lag(sign * whole, delays, constants, interval)
    at_its_end = best[0] > delays[-2] * interval  # or of time constants: then it is neither
    if explained < _EXPLAINED or at_its_end or best[1] == constants[-1]:
        return None
    drawn = []
    blocks = moments.shape[1]
    for _ in range(DRAWS):
        times = np.bincount(rng.integers(blocks, size=blocks), minlength=blocks)
        shares = sign * _explained(np.tensordot(times, moments, (0, 1)))
        drawn.append(_best_lag(shares, delays, constants, interval)[0])
    # No finer than by half a step of the clock, and of the time constants looked for.
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    step, ratio = 0.5 * interval, math.sqrt(constants[1] / constants[0])
    low = np.minimum(low, [best[0] - step, best[1] / ratio])
    high = np.maximum(high, [best[0] + step, best[1] * ratio])
    delay, constant = (
        IntervalEstimate(float(best[k]), max(float(low[k]), 0.0), float(high[k]), "s")
        for k in (0, 1)
    )
    return LagOfAnswer(delay, constant, explained, sign < 0)


def _best_lag(
    shares: Float[np.ndarray, "lag"],
    delays: np.ndarray,
    constants: np.ndarray,
    interval: float,
) -> tuple[Float[np.ndarray, "2"], float]:
    """Delay and time constant (s) that explain most, the delay between rows by a parabola."""
    table = shares.reshape(len(delays), len(constants))
    row, column = np.unravel_index(int(np.argmax(table)), table.shape)
    offset = 0.0
    if 0 < row < len(delays) - 1:
        below, here, above = table[row - 1 : row + 2, column]
        bend = below - 2 * here + above
        offset = 0.5 * (below - above) / bend if bend < 0 else 0.0
    delay = (delays[row] + offset) * interval
    return np.array([delay, constants[column]]), float(table[row, column])


def _is_known_well(lag: LagOfAnswer, rows: int, scales: TimeScales) -> bool:
    """Whether an answer was seen often enough, and well enough, to compare two sides of it."""
    often = rows * scales.interval > _FEWEST_CONSTANTS * lag.time_constant.value
    return often and lag.explained > _WELL_EXPLAINED


def _asymmetry(
    pieces: Sequence[_UsedSpan], lag: LagOfAnswer, scales: TimeScales, rng: np.random.Generator
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
        [_block_moments(c, rate, scales) for c, rate in zip(columns, rates, strict=True)]
    ).sum(0)
    if np.linalg.cond(first[:2, :2]) > _MOST_ALIKE:
        return None
    gains = np.linalg.lstsq(first[:3, :3], first[:3, 3], rcond=None)[0]
    moments = []
    for both, speed, rate in zip(columns, speeds, rates, strict=True):
        made = gains[:2] @ both + gains[2]
        beside = [made * np.abs(made), made * (speed - 1.0)]
        moments.append(_block_moments(np.vstack([both, *beside]), rate, scales))
    blocks = np.concatenate(moments)
    value = _ratio(blocks.sum(0))
    times = rng.integers(len(blocks), size=(DRAWS, len(blocks)))
    drawn = np.array([_ratio(blocks[chosen].sum(0)) for chosen in times])
    drawn = drawn[np.isfinite(drawn)]
    if not math.isfinite(value) or abs(value) > 1 or drawn.size < DRAWS // 2:
        return None
    low, high = np.quantile(drawn, [0.05, 0.95])
    return IntervalEstimate(float(value), float(low), float(high), "1")


def _relative_speeds(pieces: Sequence[_UsedSpan]) -> list[Samples] | None:
    """Speeds over their mean size, NaN where not known; None where hardly any is."""
    everything = np.concatenate([piece.speed for piece in pieces])
    known = everything[np.isfinite(everything)]
    usual = float(np.mean(np.abs(known))) if known.size > 0.5 * everything.size else 0.0
    return [piece.speed / usual for piece in pieces] if usual > 0 else None


def _sides(piece: _UsedSpan, lag: LagOfAnswer, speed: Samples) -> tuple[Samples, Samples]:
    """What turns to starboard and to port: the thrusters' orders, or a rudder's times the speed."""
    if piece.orders.sides is not None:
        port, starboard = piece.orders.sides
        return (starboard, port) if lag.opposite else (port, starboard)
    turning = piece.orders.turning
    assert turning is not None
    turning = speed * (-turning if lag.opposite else turning)
    return np.maximum(turning, 0.0), np.maximum(-turning, 0.0)


def _late(order: Samples, lag: LagOfAnswer, interval: float) -> Samples:
    return _lagged(order, round(lag.delay.value / interval), lag.time_constant.value, interval)


def _ratio(moments: Float[np.ndarray, "q q"]) -> float:
    """How much more the second side does, as `thrust-asymmetry` counts it; NaN if unknown."""
    gains = np.linalg.lstsq(moments[:-1, :-1], moments[:-1, -1], rcond=None)[0]
    first, second = gains[0], -gains[1]
    return float((second - first) / (second + first)) if first + second > 0 else math.nan
