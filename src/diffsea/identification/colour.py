"""Autocorrelation of innovations: how much less dependent values say than independent ones.

Where gusts have colour, whitened innovations stay correlated in time. The variance of a
score or of an estimate is then `E' C E` instead of `E' E`, with C the correlation of the
innovations (the long-run variance of Newey and West 1987, with correlations pooled over
time, so that an effect seen in a few bursts does not pass for noise).
"""

import numpy as np
from jaxtyping import Float, Int


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
    E = columns.reshape(-1, 6, columns.shape[1])
    total = np.einsum("kci,kcj->ij", E, E)
    for lag, weights in enumerate(correlation, start=1):
        product = np.einsum("kci,kcj,c->ij", E[lag:], E[:-lag], weights, optimize=True)
        total += product + product.T
    return total


def inflation(
    columns: Float[np.ndarray, "value coordinate"], correlation: Float[np.ndarray, "lag 6"]
) -> Float[np.ndarray, "coordinate"]:
    """Factor on the variance of each column's score, at least one."""
    E = columns.reshape(-1, 6, columns.shape[1])
    plain = (columns**2).sum(0)
    coloured = plain.copy()
    for lag, weights in enumerate(correlation, start=1):
        coloured += 2 * np.einsum("kci,kci,c->i", E[lag:], E[:-lag], weights)
    return np.maximum(coloured / np.maximum(plain, 1e-300), 1.0)
