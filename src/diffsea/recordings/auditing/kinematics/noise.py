"""The noise of increments of a measured level, and how it is divided out.

The noise of an increment is a random walk from noise in the rate, and white noise of the
measured level, which two neighbouring increments share with opposite sign; slower noise of
the level lies between the two. All follow from S(h), the mean square by which the level
differs from itself a time h later: cov of the increments from a to b and from c to d is

    [S(b - c) + S(a - d) - S(b - d) - S(a - c)] / 2.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg, optimize


_MEMORIES = (1.0, 3.0, 10.0, 30.0, 100.0)  # s, of the kinds of noise that forget themselves
_TINY = 1e-12

Levels = Float[np.ndarray, "series knot"]


class NoiseKinds:
    """The kinds of noise that are looked for at these knots, and their covariances.

    White noise of the level, a random walk, and noise that forgets itself within 1 to 100 s
    (but twenty times within the run: whatever remembers longer counts as a random walk).
    `covariances` has the shape (kinds, increments, increments), for unit amounts.
    """

    def __init__(self, times: Float[np.ndarray, "knot"], linked: Bool[np.ndarray, "window"]):
        self.times, self.linked = times, linked
        self.duration = times[-1] - times[0]
        self.scales = np.array([scale for scale in _MEMORIES if scale < self.duration / 20])
        square = np.moveaxis(self.mean_squares(np.abs(times[:, None] - times[None, :])), -1, 0)
        between = square[:, 1:, :-1] + square[:, :-1, 1:] - square[:, 1:, 1:] - square[:, :-1, :-1]
        self.covariances = 0.5 * between[:, linked][:, :, linked]

    def mean_squares(self, lag: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any kind"]:
        """S(h) of each kind of noise, in unit amount, over a time `lag` (s)."""
        kinds = [(lag > 0).astype(float), lag]
        kinds += [1 - np.exp(-lag / scale) for scale in self.scales]
        return np.stack(kinds, axis=-1)

    def amounts(self, levels: Levels) -> Float[np.ndarray, "kind"]:
        """How much there is of each kind, by non-negative least squares of S(h).

        Up to a tenth of the run: longer lags say nothing that a cause could not also say.
        """
        times, linked = self.times, self.linked
        stretch = np.concatenate([[0], np.cumsum(~linked)])
        lags = np.unique(np.geomspace(1, max(2, linked.size // 10), 12).astype(int))
        spans, squares = [], []
        for lag in lags:
            same = stretch[lag:] == stretch[:-lag]
            if np.sum(same) < 5:
                continue
            jumps = np.abs(levels[:, lag:] - levels[:, :-lag])[:, same]
            # Outliers must not pass for noise, or nothing would ever be significant.
            limit = 5 * 1.4826 * np.median(jumps)
            squares.append(np.mean(np.minimum(jumps, limit) ** 2) if limit > 0 else 0.0)
            spans.append(np.mean((times[lag:] - times[:-lag])[same]))
        spans, squares = np.array(spans), np.array(squares)
        squares = squares + 1e-6 * np.max(squares) + 1e-30
        certainty = np.sqrt(self.duration / spans) / squares
        basis = self.mean_squares(spans)
        weights, _ = optimize.nnls(basis * certainty[:, None], squares * certainty)
        if not np.any(weights > 0):
            weights[0] = np.max(squares)
        return weights


class Whitener:
    """Divides out the covariance of increments, estimated from a residual of levels.

    The random walk is at least `walk` (levels squared per second), and it and the white noise
    amount to at least `least`: without any, the smallest inaccuracy of an integral would be
    significant. `variance` is that of what is called noise, near one; `log_determinant` that of
    the covariance, over all series.
    """

    def __init__(self, levels: Levels, kinds: NoiseKinds, least: float, walk: float):
        weights = kinds.amounts(levels)
        weights[0] += least**2
        weights[1] = max(weights[1], walk) + least**2 / kinds.duration
        self.linked = kinds.linked
        covariance = np.tensordot(weights, kinds.covariances, 1)
        covariance[np.diag_indices_from(covariance)] *= 1 + 1e-6
        self.factor = linalg.cholesky(covariance, lower=True, check_finite=False)
        rest = self(np.diff(levels, axis=-1))
        self.log_determinant = 2 * len(levels) * float(np.sum(np.log(np.diag(self.factor))))
        self.variance = float(np.mean(rest**2)) + _TINY

    def __call__(self, increments: Float[np.ndarray, "*any window"]) -> np.ndarray:
        """Whitened increments of the linked windows; the leading axes are kept."""
        used = increments[..., self.linked]
        flat = used.reshape(-1, used.shape[-1]).T
        white = linalg.solve_triangular(self.factor, flat, lower=True, check_finite=False)
        return white.T.reshape(used.shape)
