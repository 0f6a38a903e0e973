"""Efficient score tests: is there a direction in which the model would fit better?

With residual e, Jacobian J_n of the nuisances and J_a of a candidate, the efficient score
is `J_a' M e` with M the projection off J_n (Rao 1948, Neyman 1959). Its variance is taken
as the larger of the Fisher information and the variance of its sums over blocks of time,
so that coloured gusts do not pass for physics.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from diffsea.identification.fit import block_sums


class Score(NamedTuple):
    """Outcome of a score test for one candidate."""

    statistic: float  # chi-squared under the nominal model
    p_value: float
    step: np.ndarray  # one-step estimate of the candidate's coordinates
    inflation: float  # variance of block sums over Fisher information, at least one


class Projection:
    """Residual and candidates with the nuisances projected out."""

    def __init__(self, residual: np.ndarray, nuisance: np.ndarray, rows: int, prior_rows: int):
        """`rows` measured values (six to a sample), followed by `prior_rows` of the prior."""
        self.rows, self.prior_rows = rows, prior_rows
        self.basis = np.linalg.qr(nuisance)[0]
        self.residual = self._projected(residual[:, None])[:, 0]
        self.blocks = max(8, (rows // 6) // 60)

    def _projected(self, columns: np.ndarray) -> np.ndarray:
        return columns - self.basis @ (self.basis.T @ columns)

    def efficient(self, columns: np.ndarray) -> np.ndarray:
        """A candidate's Jacobian with the nuisances projected out."""
        return self._projected(columns)

    def sums(self, efficient: np.ndarray) -> np.ndarray:
        """Efficient score summed over blocks of time."""
        weighted = efficient[: self.rows] * self.residual[: self.rows, None]
        return block_sums(weighted.reshape(-1, 6, efficient.shape[1]).sum(1), self.blocks)

    def score(self, columns: np.ndarray) -> Score:
        """Test one candidate."""
        E = self.efficient(columns)
        V = E.T @ E
        s = E.T @ self.residual
        blocks = self.sums(E)
        robust = blocks.T @ blocks
        inverse = np.linalg.pinv(V, rcond=1e-10, hermitian=True)
        k = columns.shape[1]
        inflation = max(1.0, float(np.trace(robust @ inverse)) / k)
        statistic = float(s @ inverse @ s) / inflation
        # Few blocks: the variance is itself estimated, hence F instead of chi-squared.
        used = int((np.abs(blocks).sum(1) > 0).sum())
        p = stats.f.sf(statistic / k, k, max(used - k, 1)) if used > k else 1.0
        return Score(statistic, float(p), -(inverse @ s), inflation)

    def mimicry(self, a: np.ndarray, b: np.ndarray) -> float:
        """Share of a's efficient information that b reproduces, 0 to 1."""
        A, B = self.efficient(a), self.efficient(b)
        VA, VB, VAB = A.T @ A, B.T @ B, A.T @ B
        inner = VAB @ np.linalg.pinv(VB, rcond=1e-10, hermitian=True) @ VAB.T
        return float(np.trace(np.linalg.pinv(VA, rcond=1e-10, hermitian=True) @ inner) / len(VA))
