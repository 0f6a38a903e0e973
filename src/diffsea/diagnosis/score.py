"""Efficient score tests, and what the strongest of many of them shows by chance.

With residual e, Jacobian J_n of the nuisances and J_a of a candidate, the efficient score is
`J_a' M e` with M the projection off J_n (Rao 1948, Neyman 1959). Its variance is taken with the
autocorrelation of the innovations, so that coloured gusts do not pass for physics.

The joint null distribution is that of data sets drawn from the fitted model on the same inputs,
nuisances refitted to each, both to first order: the scores of all candidates, windows and regimes
are then jointly normal with the Gram matrix of their efficient columns.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from diffsea.statistics import autocorrelation, long_run_covariance, variance_inflation


NULL_DRAWS = 1999  # of the joint null: its one per cent is then known to a fifth of itself
NULL_SEED = 7
COUNTABLE = 0.02  # share of the draws from which on they are counted: forty of them
NO_INFORMATION = 1e-12  # of a column, in squared standard deviations of the innovations


@dataclasses.dataclass(frozen=True)
class NullDistribution:
    """Distribution of the smallest p-value among all tests of a screening."""

    smallest: Float[np.ndarray, "draw"]  # ascending

    def family_wise(self, p_value: float) -> float:
        """Chance that any test shows `p_value` or less.

        Below what draws can show, as many independent tests as their lowest tenth behaves
        like (the correction of Sidak 1967 with an effective number).
        """
        share = float(np.searchsorted(self.smallest, p_value, side="right")) / len(self.smallest)
        if share >= COUNTABLE:
            return share
        low = float(np.quantile(self.smallest, 0.1))
        number = np.log(0.9) / np.log1p(-low) if low > 0 else 1.0
        return float(-np.expm1(number * np.log1p(-min(p_value, 1 - 1e-12))))

    @property
    def threshold(self) -> float:
        """The p-value of one test that is family-wise one per cent."""
        grid = np.logspace(-12, -1, 400)
        family_wise = np.array([self.family_wise(p) for p in grid])
        return float(grid[np.searchsorted(family_wise, 0.01).clip(0, len(grid) - 1)])


def joint_null(
    gram: Float[np.ndarray, "column column"], tests: list[slice], draws: int = NULL_DRAWS
) -> NullDistribution:
    """The null distribution of several tests, each of the columns of one slice of a Gram matrix."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(NULL_SEED).standard_normal((draws, len(gram))) @ root.T
    unit = gram / np.outer(scale, scale)
    strongest: dict[int, np.ndarray] = {}  # statistic among the tests of as many columns
    for columns in tests:
        size, scores = columns.stop - columns.start, z[:, columns]
        inverse = np.linalg.pinv(unit[columns, columns], rcond=1e-10, hermitian=True)
        statistic = ((scores @ inverse) * scores).sum(1)
        strongest[size] = np.maximum(strongest.get(size, 0.0), statistic)
    smallest = [np.ones(draws), *(stats.chi2.sf(most, k) for k, most in strongest.items())]
    return NullDistribution(np.sort(np.min(smallest, axis=0)))


class ScoreTest(NamedTuple):
    """Outcome of a score test of one candidate."""

    statistic: float  # chi-squared under the nominal model
    p_value: float
    step: Float[np.ndarray, "column"]  # one-step estimate of the candidate's coordinates
    inflation: float  # variance of the score over the Fisher information, at least one


class Projection:
    """The projection off the nuisances, and score tests of what it leaves of candidates.

    `residual` and columns have six values for each row of the data set, then the prior's rows.
    """

    def __init__(
        self,
        residual: Float[np.ndarray, "value"],
        nuisance: Float[np.ndarray, "value nuisance"],
        run: Int[np.ndarray, "row"],
        correlation: Float[np.ndarray, "lag 6"] | None = None,
    ):
        """Project the residual.

        Arguments:
            run: the number of the run that each row of the data set belongs to.
            correlation: of the innovations in time; estimated from them where None.
        """
        self.data_values = 6 * len(run)
        self.basis = np.linalg.qr(nuisance)[0]
        self.residual = self.efficient(residual[:, None])[:, 0]
        if correlation is None:
            correlation = autocorrelation(self.residual[: self.data_values].reshape(-1, 6), run)
        self.correlation = correlation

    def efficient(
        self, columns: Float[np.ndarray, "value column"]
    ) -> Float[np.ndarray, "value column"]:
        """Columns with the nuisances projected out."""
        return columns - self.basis @ (self.basis.T @ columns)

    def is_informative(self, E: Float[np.ndarray, "value column"]) -> Bool[np.ndarray, "column"]:
        """Which columns move an innovation: those of the spare runs of a data set move none."""
        return (E[: self.data_values] ** 2).sum(0) > NO_INFORMATION * (E**2).sum(0)

    def test(self, E: Float[np.ndarray, "value column"]) -> ScoreTest:
        """Test one candidate by its efficient columns."""
        step, informative = np.zeros(E.shape[1]), self.is_informative(E)
        k = int(informative.sum())
        if k == 0:
            return ScoreTest(0.0, 1.0, step, 1.0)
        E = E[:, informative]
        s = E.T @ self.residual
        inverse = np.linalg.pinv(E.T @ E, rcond=1e-10, hermitian=True)
        coloured = long_run_covariance(E[: self.data_values], self.correlation)
        ratio = max(1.0, float(np.trace(coloured @ inverse)) / k)
        statistic = float(s @ inverse @ s) / ratio
        step[informative] = -(inverse @ s)
        return ScoreTest(statistic, float(stats.chi2.sf(statistic, k)), step, ratio)

    def test_each(
        self, E: Float[np.ndarray, "value column"]
    ) -> tuple[
        Float[np.ndarray, "column"], Float[np.ndarray, "column"], Float[np.ndarray, "column"]
    ]:
        """Test every column as a candidate of its own: steps, standard errors, p-values.

        A column without information has a p-value of one and an infinite error.
        """
        information = (E**2).sum(0)
        informed = information > NO_INFORMATION
        V = np.where(informed, information, 1.0)
        ratio = variance_inflation(E[: self.data_values], self.correlation)
        step = -(E.T @ self.residual) / V
        std = np.where(informed, np.sqrt(ratio / V), np.inf)
        p = np.where(informed, stats.chi2.sf((step / std) ** 2, 1), 1.0)
        return step, std, p
