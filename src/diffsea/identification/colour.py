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
