"""Least squares of whitened columns, with errors that allow for what correlation is left.

Autocorrelation of innovations: how much less dependent values say than independent ones.

Where gusts have colour, whitened innovations stay correlated in time. The variance of a
score or of an estimate is then `E' C E` instead of `E' E`, with C the correlation of the
innovations (the long-run variance of Newey and West 1987, with correlations pooled over
time, so that an effect seen in a few bursts does not pass for noise).
"""

import numpy as np
from jaxtyping import Float, Int
from scipy import stats


# One estimate in a hundred thousand is wrong by chance if the residual is as assumed; it never
# quite is, hence the margin over the usual levels. experiments/audit_power measures the rate of
# false alarms that comes of it.
SIGNIFICANCE = 1e-5
_TINY = 1e-12


def solve(
    columns: np.ndarray, target: np.ndarray, doubt: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of whitened columns, with a covariance robust to autocorrelation.

    With `doubt`, the first column is a nuisance known to be zero within that. A direction
    that the data say nothing about gets an estimate near zero and a very large variance.
    """
    count, series, length = columns.shape
    norms = np.linalg.norm(columns.reshape(count, -1), axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    scaled = columns / norms[:, None, None]
    flat = scaled.reshape(count, -1)
    known = np.full(count, 1e-10)
    if doubt is not None:
        known[0] += np.mean(target**2) / (doubt * norms[0]) ** 2
    inverse = np.linalg.inv(flat @ flat.T + np.diag(known))
    estimate = inverse @ (flat @ target.ravel())
    rest = target - np.tensordot(estimate, scaled, 1)
    freedom = series * length / max(series * length - count, 1)
    scores = _long_run(np.einsum("pst,st->tp", scaled, rest))
    if doubt is not None:
        scores[0, 0] += known[0] * np.mean(target**2)
    robust = inverse @ scores @ inverse * freedom
    # The robust covariance of few samples is itself uncertain, mostly too small; the plain
    # one is its lower limit.
    plain = np.diag(inverse) * (np.mean(rest**2) * freedom + _TINY)
    grow = np.sqrt(np.maximum(1.0, plain / np.maximum(np.diag(robust), _TINY * plain)))
    cov = robust * np.outer(grow, grow)
    np.fill_diagonal(cov, np.maximum(np.diag(cov), plain) * (1 + _TINY))
    return estimate / norms, cov / np.outer(norms, norms)


def significant(estimate: np.ndarray, cov: np.ndarray, freedom: float, level: float) -> bool:
    """Whether the estimate is beyond chance; short runs make for heavier tails."""
    wald = float(estimate @ np.linalg.solve(cov, estimate)) / estimate.size
    return bool(stats.f.sf(wald, estimate.size, freedom) < level)


def _long_run(scores: np.ndarray) -> np.ndarray:
    """Newey-West sum of autocovariances with 1.3 sqrt(n) lags."""
    length = scores.shape[0]
    lags = int(np.ceil(1.3 * np.sqrt(length)))
    total = scores.T @ scores
    for lag in range(1, min(lags, length - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total


LAGS = 40  # rows


def autocorrelation(
    white: Float[np.ndarray, "row 6"], run: Int[np.ndarray, "row"], lags: int = LAGS
) -> Float[np.ndarray, "lag 6"]:
    """Tapered correlation of each channel's innovations at lags 1, 2, ... within runs."""
    lags = min(lags, len(white) // 4)
    power = np.maximum((white**2).sum(0), 1e-300)
    out = np.zeros((lags, 6))
    for lag in range(1, lags + 1):
        same = (run[lag:] == run[:-lag])[:, None]
        products = (white[lag:] * white[:-lag] * same).sum(0)
        out[lag - 1] = products / power * (1 - lag / (lags + 1))
    return out


def long_run(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> Float[np.ndarray, "coordinate coordinate"]:
    """`E' C E` for columns with six values to a row."""
    E, CE = _coloured(columns, correlation)
    return sum(own @ other.T for own, other in zip(E, CE, strict=True))


def inflation(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> Float[np.ndarray, "coordinate"]:
    """Factor on the variance of each column's score, at least one."""
    E, CE = _coloured(columns, correlation)
    plain = (columns**2).sum(0)
    return np.maximum((E * CE).sum((0, 2)) / np.maximum(plain, 1e-300), 1.0)


def _coloured(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> tuple[Float[np.ndarray, "6 coordinate row"], Float[np.ndarray, "6 coordinate row"]]:
    """Columns `E` by channels, and `C E`: products with symmetric Toeplitz matrices by FFT."""
    E = np.ascontiguousarray(columns.reshape(-1, 6, columns.shape[1]).transpose(1, 2, 0))
    rows, lags = E.shape[-1], len(correlation)
    length = 1 << (rows + lags - 1).bit_length()
    kernel = np.zeros((6, 1, length))
    kernel[:, 0, 0] = 1.0
    kernel[:, 0, 1 : lags + 1] = correlation.T
    kernel[:, 0, length - lags :] = correlation.T[:, ::-1]
    CE = np.fft.irfft(np.fft.rfft(E, length) * np.fft.rfft(kernel), length)
    return E, CE[..., :rows]
