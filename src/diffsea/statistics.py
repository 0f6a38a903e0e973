"""Robust scales, sums over blocks, and variances that allow for correlation in time.

Where disturbances are slow, whitened residuals stay correlated. The variance of a score or of
an estimate is then `E' C E` instead of `E' E`, with C the correlation of the residuals: the
long-run variance of Newey and West (1987), either from the scores themselves (`newey_west`) or
with the correlation pooled over time (`long_run_covariance`), so that an effect seen in a few
bursts does not pass for noise.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from scipy import special


_QUARTILE = 0.6745  # upper quartile of the standard normal: the median of its magnitude
_LAGS = 40  # rows over which correlation is looked for
_TINY = 1e-12


def robust_scale(deviations: Float[np.ndarray, "..."]) -> float:
    """Standard deviation of normal deviations from zero by the median of their magnitude."""
    return float(1.4826 * np.median(np.abs(deviations)))


def noise_scale(values: Float[np.ndarray, "time"], differences: int = 3) -> float:
    """Standard deviation of white noise in a series that otherwise changes smoothly.

    From the median magnitude of its k-th differences, whose variance is (2k choose k) times that
    of the noise. Zero where the series is too short for them.
    """
    rest = np.abs(np.diff(values, differences))
    variance = math.comb(2 * differences, differences)
    return float(np.median(rest) / _QUARTILE / math.sqrt(variance)) if rest.size else 0.0


def block_sums(scores: Float[np.ndarray, "row score"], length: int) -> Float[np.ndarray, "b s"]:
    """Sums over consecutive blocks of `length` rows; the last block may be short."""
    spare = -len(scores) % length
    padded = np.concatenate([scores, np.zeros((spare, scores.shape[1]))])
    return padded.reshape(-1, length, scores.shape[1]).sum(1)


def moving_block_draws(
    values: Float[np.ndarray, "row"],
    run: Int[np.ndarray, "row"],
    length: int,
    draws: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "draw"]:
    """Means of values resampled in blocks of `length` that follow one another in one run.

    The moving-block bootstrap of Kunsch (1989): what depends on its neighbours stays beside them.
    A run shorter than a block is a block.
    """
    sums, counts = [], []
    for number in np.unique(run):
        own = values[run == number]
        size = min(length, len(own))
        total = np.concatenate([[0.0], np.cumsum(own)])
        sums.append(total[size:] - total[:-size])
        counts.append(np.full(len(own) - size + 1, size))
    blocks = max(1, math.ceil(len(values) / length))
    chosen = rng.integers(sum(map(len, sums)), size=(draws, blocks))
    return np.concatenate(sums)[chosen].sum(1) / np.concatenate(counts)[chosen].sum(1)


def robust_regression(
    columns: Float[np.ndarray, "p series time"],
    target: Float[np.ndarray, "series time"],
    doubt: float | None = None,
) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]:
    """Least squares of whitened columns, with a covariance robust to autocorrelation.

    With `doubt`, the first column is a nuisance known to be zero within that deviation. A
    direction that the data say nothing about gets an estimate near zero, of very large variance.
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
    scores = newey_west(np.einsum("pst,st->tp", scaled, rest))
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


def is_significant(
    estimate: Float[np.ndarray, "p"], cov: Float[np.ndarray, "p p"], freedom: float, level: float
) -> bool:
    """Whether the F test rejects zero at a level; few degrees of freedom make heavier tails."""
    wald = float(estimate @ np.linalg.solve(cov, estimate)) / estimate.size
    return bool(special.fdtrc(estimate.size, freedom, wald) < level)


def newey_west(scores: Float[np.ndarray, "time p"]) -> Float[np.ndarray, "p p"]:
    """Covariance of the sum of scores: autocovariances, tapered over 1.3 sqrt(n) lags."""
    length = len(scores)
    lags = int(np.ceil(1.3 * np.sqrt(length)))
    total = scores.T @ scores
    for lag in range(1, min(lags, length - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total


def autocorrelation(
    white: Float[np.ndarray, "row 6"], run: Int[np.ndarray, "row"], lags: int = _LAGS
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


def long_run_covariance(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> Float[np.ndarray, "coordinate coordinate"]:
    """`E' C E` for columns with six values to a row."""
    E, CE = _with_correlated(columns, correlation)
    products = (own @ other.T for own, other in zip(E, CE, strict=True))
    return sum(products, np.zeros(()))


def variance_inflation(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> Float[np.ndarray, "coordinate"]:
    """Factor on the variance of each column's score, `E' C E` over `E' E`, at least one."""
    E, CE = _with_correlated(columns, correlation)
    plain = (columns**2).sum(0)
    return np.maximum((E * CE).sum((0, 2)) / np.maximum(plain, 1e-300), 1.0)


def _with_correlated(
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
