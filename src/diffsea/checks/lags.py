"""The first-order lag by which motion answers orders, and how well it is known.

Intervals are percentiles of a block bootstrap (Kunsch 1989): the time that was used is cut into
blocks, and whole blocks are drawn, so that what depends on its neighbours stays beside them.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import signal

from diffsea.checks.spans import DRAWS, IntervalEstimate, TimeScales
from diffsea.trajectory import Samples


_MOVED = 0.02  # of full order, standard deviation below which nothing was ordered
_EXPLAINED = 0.3  # of the variance, that an answer must have to be one
_FEWEST_CONSTANTS = 10  # time constants that a log must last to compare sides
_WELL_EXPLAINED = 0.8  # below it, what is left over is larger than what sides differ by


@dataclasses.dataclass(frozen=True)
class FirstOrderLag:
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


def lagged(order: Samples, delay: int, constant: float, interval: float) -> Samples:
    """The answer to an order that is late by some rows, after a first-order lag (s).

    What is ordered in a row acts from there on, and so shows from the next row on.
    """
    delay = min(delay + 1, order.size - 1)
    late = np.concatenate([np.full(delay, order[0]), order[: order.size - delay]])
    share = 1 - math.exp(-interval / constant)
    return order[0] + signal.lfilter([share], [1, share - 1], late - order[0])


def block_moments(
    columns: Float[np.ndarray, "p time"], answer: Samples, scales: TimeScales
) -> Float[np.ndarray, "block q q"]:
    """Sums of products of columns, a constant and the answer, by blocks of time."""
    known = np.isfinite(answer)
    everything = np.vstack([columns, np.ones_like(answer), np.where(known, answer, 0.0)])
    everything = everything * known
    length = max(1, round(scales.block / scales.interval))
    filled = np.pad(everything, ((0, 0), (0, -answer.size % length)))
    blocks = filled.reshape(len(filled), -1, length).swapaxes(0, 1)
    return blocks @ blocks.swapaxes(1, 2)


def _explained(moments: Float[np.ndarray, "*any q q"]) -> Float[np.ndarray, "*any"]:
    """Share of the answer's variance that one column explains, of sums of products."""
    count = np.maximum(moments[..., 1, 1], 1.0)
    xx = moments[..., 0, 0] - moments[..., 0, 1] ** 2 / count
    yy = moments[..., 2, 2] - moments[..., 2, 1] ** 2 / count
    xy = moments[..., 0, 2] - moments[..., 0, 1] * moments[..., 2, 1] / count
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((xx > 0) & (yy > 0), xy * np.abs(xy) / (xx * yy), 0.0)
    return share


def lag_of(
    parts: Sequence[tuple[Float[np.ndarray, "_"] | None, Float[np.ndarray, "_"]]],
    scales: TimeScales,
    rng: np.random.Generator,
) -> FirstOrderLag | None:
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
                    block_moments(
                        lagged(order, int(delay), constant, interval)[None],
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
    best, explained = _bestlag_of(sign * whole, delays, constants, interval)
    at_its_end = best[0] > delays[-2] * interval  # or of time constants: then it is neither
    if explained < _EXPLAINED or at_its_end or best[1] == constants[-1]:
        return None
    drawn = []
    blocks = moments.shape[1]
    for _ in range(DRAWS):
        times = np.bincount(rng.integers(blocks, size=blocks), minlength=blocks)
        shares = sign * _explained(np.tensordot(times, moments, (0, 1)))
        drawn.append(_bestlag_of(shares, delays, constants, interval)[0])
    # No finer than by half a step of the clock, and of the time constants looked for.
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    step, ratio = 0.5 * interval, math.sqrt(constants[1] / constants[0])
    low = np.minimum(low, [best[0] - step, best[1] / ratio])
    high = np.maximum(high, [best[0] + step, best[1] * ratio])
    delay, constant = (
        IntervalEstimate(float(best[k]), max(float(low[k]), 0.0), float(high[k]), "s")
        for k in (0, 1)
    )
    return FirstOrderLag(delay, constant, explained, sign < 0)


def _bestlag_of(
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


def is_known_well(lag: FirstOrderLag, rows: int, scales: TimeScales) -> bool:
    """Whether an answer was seen often enough, and well enough, to compare two sides of it."""
    often = rows * scales.interval > _FEWEST_CONSTANTS * lag.time_constant.value
    return often and lag.explained > _WELL_EXPLAINED
