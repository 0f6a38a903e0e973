"""Medians over draws of noise and their differences, with intervals by drawing the draws again."""

import dataclasses
from collections.abc import Sequence

import numpy as np


AGAIN = 4000  # samples of the bootstrap
LEVEL = 95.0  # per cent


@dataclasses.dataclass(frozen=True)
class Interval:
    """A median over draws, its interval, and the range of the draws themselves."""

    median: float
    low: float
    high: float
    least: float
    most: float

    @property
    def leaves_out_zero(self) -> bool:
        """Whether a difference with this interval is told apart from none."""
        return self.low > 0 or self.high < 0


def over_draws(values: Sequence[float]) -> Interval:
    """The median of values (draw), in their unit, and an interval of `LEVEL` for it.

    Percentiles of the medians of draws drawn again with replacement.
    """
    given = np.asarray(values, float)
    rows = np.random.default_rng(0).integers(0, len(given), (AGAIN, len(given)))
    tails = 50 - LEVEL / 2, 50 + LEVEL / 2
    low, high = np.percentile(np.median(given[rows], axis=1), tails)
    return Interval(
        float(np.median(given)), float(low), float(high), float(given.min()), float(given.max())
    )


def paired(values: dict[int, float], less: dict[int, float]) -> Interval:
    """The differences `values - less` draw by draw, over the draws (by seed) that both have."""
    both = sorted(values.keys() & less.keys())
    return over_draws([values[seed] - less[seed] for seed in both])
