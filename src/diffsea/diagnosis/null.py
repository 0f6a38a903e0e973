"""What the strongest of many tests shows by chance: the joint null distribution.

Data sets are drawn from the fitted model with its fitted gusts on the same inputs, and the
nuisances refitted to each, both to first order: the scores of all candidates, windows and
regimes are then jointly normal with the Gram matrix of their efficient columns. The smallest
p-value of each draw makes the family-wise distribution, with all correlations between tests.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy import stats


DRAWS = 1999
SEED = 7


@dataclasses.dataclass(frozen=True)
class Null:
    """Distribution of the smallest p-value among all tests of a screening."""

    smallest: Float[np.ndarray, "draw"]  # ascending

    def family_wise(self, p_value: float) -> float:
        """Chance that any test shows `p_value` or less.

        Below what draws can show, as many independent tests as their lowest tenth behaves
        like (the correction of Sidak 1967 with an effective number).
        """
        share = float(np.searchsorted(self.smallest, p_value, side="right")) / len(self.smallest)
        if share >= 0.02:
            return share
        low = float(np.quantile(self.smallest, 0.1))
        number = np.log(0.9) / np.log1p(-low) if low > 0 else 1.0
        return float(-np.expm1(number * np.log1p(-min(p_value, 1 - 1e-12))))

    @property
    def level(self) -> float:
        """The p-value of one test that is family-wise one per cent."""
        grid = np.logspace(-12, -1, 400)
        wise = np.array([self.family_wise(p) for p in grid])
        return float(grid[np.searchsorted(wise, 0.01).clip(0, len(grid) - 1)])


def joint_null(
    gram: Float[np.ndarray, "column column"], tests: list[slice], draws: int = DRAWS
) -> Null:
    """The null of several tests, each of the columns of one slice of the Gram matrix."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(SEED).standard_normal((draws, len(gram))) @ root.T
    unit = gram / np.outer(scale, scale)
    strongest: dict[int, np.ndarray] = {}  # statistic among the tests of as many columns
    for part in tests:
        size, seen = part.stop - part.start, z[:, part]
        inverse = np.linalg.pinv(unit[part, part], rcond=1e-10, hermitian=True)
        statistic = ((seen @ inverse) * seen).sum(1)
        strongest[size] = np.maximum(strongest.get(size, 0.0), statistic)
    smallest = [np.ones(draws), *(stats.chi2.sf(most, k) for k, most in strongest.items())]
    return Null(np.sort(np.min(smallest, axis=0)))
