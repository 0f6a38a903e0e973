"""What the strongest of many tests shows by chance: the joint null distribution.

Data sets are drawn from the fitted model with its fitted gusts on the same inputs, and the
nuisances refitted to each, both to first order: the scores of all candidates, windows and
regimes are then jointly normal with the Gram matrix of their efficient columns. The smallest
p-value of each draw makes the family-wise distribution, with all correlations between tests.

Efficient score tests: is there a direction in which the model would fit better?

With residual e, Jacobian J_n of the nuisances and J_a of a candidate, the efficient score
is `J_a' M e` with M the projection off J_n (Rao 1948, Neyman 1959). Its variance is taken
with the autocorrelation of the innovations, so that coloured gusts do not pass for physics.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from diffsea.statistics import autocorrelation, long_run_covariance, variance_inflation


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


class Score(NamedTuple):
    """Outcome of a score test for one candidate."""

    statistic: float  # chi-squared under the nominal model
    p_value: float
    step: np.ndarray  # one-step estimate of the candidate's coordinates
    inflation: float  # variance of the score over the Fisher information, at least one


class Projection:
    """Residual and candidates with the nuisances projected out."""

    def __init__(
        self,
        residual: np.ndarray,
        nuisance: np.ndarray,
        run: np.ndarray,
        correlation: np.ndarray | None = None,
    ):
        """Six values to a row of `run`, followed by the rows of the prior.

        `correlation` is that of the innovations in time, estimated from them where None.
        """
        self.rows = 6 * len(run)
        self.prior_rows = len(residual) - self.rows
        self.basis = np.linalg.qr(nuisance)[0]
        self.residual = self.efficient(residual[:, None])[:, 0]
        if correlation is None:
            correlation = autocorrelation(self.residual[: self.rows].reshape(-1, 6), run)
        self.correlation = correlation

    def efficient(self, columns: np.ndarray) -> np.ndarray:
        """Columns with the nuisances projected out."""
        return columns - self.basis @ (self.basis.T @ columns)

    def told(self, E: np.ndarray) -> np.ndarray:
        """Which columns move any innovation: those of runs that a dataset has to spare do not."""
        return (E[: self.rows] ** 2).sum(0) > 1e-12 * (E**2).sum(0)

    def score(self, E: np.ndarray) -> Score:
        """Test one candidate by its efficient columns."""
        step, told = np.zeros(E.shape[1]), self.told(E)
        k = int(told.sum())
        if k == 0:
            return Score(0.0, 1.0, step, 1.0)
        E = E[:, told]
        s = E.T @ self.residual
        inverse = np.linalg.pinv(E.T @ E, rcond=1e-10, hermitian=True)
        coloured = long_run_covariance(E[: self.rows], self.correlation)
        ratio = max(1.0, float(np.trace(coloured @ inverse)) / k)
        statistic = float(s @ inverse @ s) / ratio
        step[told] = -(inverse @ s)
        return Score(statistic, float(stats.chi2.sf(statistic, k)), step, ratio)

    def singles(self, E: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Test many one-coordinate candidates at once: steps, standard errors, p-values.

        A candidate without information has a p-value of one and an infinite error.
        """
        information = (E**2).sum(0)
        informed = information > 1e-12
        V = np.where(informed, information, 1.0)
        ratio = variance_inflation(E[: self.rows], self.correlation)
        step = -(E.T @ self.residual) / V
        std = np.where(informed, np.sqrt(ratio / V), np.inf)
        p = np.where(informed, stats.chi2.sf((step / std) ** 2, 1), 1.0)
        return step, std, p
