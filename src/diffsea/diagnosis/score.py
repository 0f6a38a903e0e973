"""Efficient score tests: is there a direction in which the model would fit better?

With residual e, Jacobian J_n of the nuisances and J_a of a candidate, the efficient score
is `J_a' M e` with M the projection off J_n (Rao 1948, Neyman 1959). Its variance is taken
with the autocorrelation of the innovations, so that coloured gusts do not pass for physics.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from diffsea.identification.colour import autocorrelation, inflation, long_run


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
        """Which columns move any innovation: those of runs that a tape has to spare do not."""
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
        coloured = long_run(E[: self.rows], self.correlation)
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
        ratio = inflation(E[: self.rows], self.correlation)
        step = -(E.T @ self.residual) / V
        std = np.where(informed, np.sqrt(ratio / V), np.inf)
        p = np.where(informed, stats.chi2.sf((step / std) ** 2, 1), 1.0)
        return step, std, p
