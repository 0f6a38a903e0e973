"""Noise of increments: what white noise of a level and random walks make of its differences.

The noise of an increment is a random walk from noise in the rate, and white noise of the
measured level, which two neighbouring increments share with opposite sign; slower noise of
the level lies between the two. All follow from S(h), the mean square by which the level
differs from itself a time h later: cov of the increments from a to b and from c to d is

    [S(b - c) + S(a - d) - S(b - d) - S(a - c)] / 2.
"""

import numpy as np
from scipy import linalg, optimize


_TINY = 1e-12


class Kinds:
    """The kinds of noise that are looked for at these knots, and their covariances.

    White noise of the level, a random walk, and noise that forgets itself within 1 to 100 s
    (but twenty times within the run: whatever remembers longer counts as a random walk).
    `covariances` has the shape (kinds, increments, increments), for unit amounts.
    """

    def __init__(self, times: np.ndarray, linked: np.ndarray):
        duration = times[-1] - times[0]
        memories = (1.0, 3.0, 10.0, 30.0, 100.0)
        self.times, self.linked = times, linked
        self.scales = np.array([scale for scale in memories if scale < duration / 20])
        spread = _spread(np.abs(times[:, None] - times[None, :]), self.scales)
        spread = np.moveaxis(spread, -1, 0)
        between = spread[:, 1:, :-1] + spread[:, :-1, 1:] - spread[:, 1:, 1:] - spread[:, :-1, :-1]
        self.covariances = 0.5 * between[:, linked][:, :, linked]


class Whitener:
    """Divides out the covariance of increments, estimated from a residual of levels.

    The mean square S(h) of residual differences over a time h is fitted, up to a tenth of
    the run, by non-negative amounts of the `kinds` of noise. Longer lags say nothing that a
    cause could not also say.

    The random walk is at least `walk` (levels squared per second), and it and the white noise
    amount to at least `least`: without any, the smallest inaccuracy of an integral would be
    significant.
    """

    def __init__(self, levels: np.ndarray, kinds: Kinds, least: float, walk: float):
        weights = _amounts(levels, kinds)
        weights[0] += least**2
        weights[1] = max(weights[1], walk) + least**2 / (kinds.times[-1] - kinds.times[0])
        self.linked = kinds.linked
        covariance = np.tensordot(weights, kinds.covariances, 1)
        covariance[np.diag_indices_from(covariance)] *= 1 + 1e-6
        self.factor = linalg.cholesky(covariance, lower=True, check_finite=False)
        rest = self(np.diff(levels, axis=-1))
        self.size = 2 * len(levels) * float(np.sum(np.log(np.diag(self.factor))))
        self.variance = float(np.mean(rest**2)) + _TINY  # of what is called noise, near one

    def __call__(self, increments: np.ndarray) -> np.ndarray:
        """Whitened increments; the leading axes are kept, the last is the time."""
        used = increments[..., self.linked]
        flat = used.reshape(-1, used.shape[-1]).T
        white = linalg.solve_triangular(self.factor, flat, lower=True, check_finite=False)
        return white.T.reshape(used.shape)


def _spread(lag: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Mean-square difference over `lag` s of each kind of noise, last axis by kind."""
    kinds = [(lag > 0).astype(float), lag]
    kinds += [1 - np.exp(-lag / scale) for scale in scales]
    return np.stack(kinds, axis=-1)


def _amounts(levels: np.ndarray, kinds: Kinds) -> np.ndarray:
    """How much there is of each kind of noise."""
    times, linked = kinds.times, kinds.linked
    duration = times[-1] - times[0]
    segment = np.concatenate([[0], np.cumsum(~linked)])
    lags = np.unique(np.geomspace(1, max(2, linked.size // 10), 12).astype(int))
    spans, squares = [], []
    for lag in lags:
        same = segment[lag:] == segment[:-lag]
        if np.sum(same) < 5:
            continue
        jumps = np.abs(levels[:, lag:] - levels[:, :-lag])[:, same]
        # Outliers must not pass for noise, or nothing would ever be significant.
        limit = 5 * 1.4826 * np.median(jumps)
        squares.append(np.mean(np.minimum(jumps, limit) ** 2) if limit > 0 else 0.0)
        spans.append(np.mean((times[lag:] - times[:-lag])[same]))
    spans, squares = np.array(spans), np.array(squares)
    squares = squares + 1e-6 * np.max(squares) + 1e-30
    certainty = np.sqrt(duration / spans) / squares
    basis = _spread(spans, kinds.scales)
    weights, _ = optimize.nnls(basis * certainty[:, None], squares * certainty)
    if not np.any(weights > 0):
        weights[0] = np.max(squares)
    return weights
