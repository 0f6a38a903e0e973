"""Compares increments of a measured quantity with what other channels predict of them.

Heading is the integral of yaw rate, position that of velocity. Differentiating the noisy
left side would drown everything in noise, so both sides are integrated: between two
neighbouring knots (instants one window apart) the measured increment should be the
predicted one. What remains is explained by *causes* (a bias, a delay, a current ...), each
a few parameters that are zero in a sound recording, chosen one after another for as long
as they are both significant and large enough to matter.

The noise of an increment is a random walk from noise in the rate, and white noise of the
measured level, which two neighbouring increments share with opposite sign:

    cov(e_i, e_j) = (q h + 2 s^2) on the diagonal, -s^2 beside it.

Both parts are estimated from the residual and divided out; the covariance of the estimates
then allows for what correlation is left (Newey and West 1987).
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import linalg, optimize, stats


# One estimate in a million is wrong by chance if the residual is as assumed; it never
# quite is, hence the margin over the usual levels.
SIGNIFICANCE = 1e-7
_MAX_STEPS = 12
_TINY = 1e-12


@dataclasses.dataclass(frozen=True)
class Cause:
    """A way in which two sets of channels may disagree.

    `size` gives the magnitude that is compared with `negligible` from the cause's
    parameters; by default their norm. A `gain` multiplies the prediction: noise in the
    prediction biases it towards zero, so it is believed only if the reverse regression
    agrees. Causes that name each other in `excludes` are not combined.
    """

    name: str
    parameters: tuple[str, ...]
    negligible: float
    gain: bool = False
    excludes: tuple[frozenset[str], ...] = ()


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Measured levels, their prediction, and the causes that may part them.

    `times` (s) are the knots. `measured` and the value of `predict` have the shape (series, knots). `linked[i]` says
    whether the increment from knot i to i + 1 can be used. `steps` are the increments
    with which derivatives are taken, per parameter.
    """

    times: np.ndarray
    measured: np.ndarray
    predict: Callable[[dict[str, float]], np.ndarray]
    linked: np.ndarray
    causes: tuple[Cause, ...]
    steps: dict[str, float]
    bounds: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The causes found, with their parameters and covariance.

    `remainder` is the share of the first misfit's (whitened) square that is left.
    `precision` holds the standard error of every parameter that was not chosen, had it
    been fitted as well: infinite means that this recording cannot tell.
    """

    causes: tuple[str, ...]
    theta: dict[str, float]
    std: dict[str, float]
    alternatives: dict[str, tuple[str, ...]]


class Whitener:
    """Divides out the covariance of increments, estimated from a residual of levels.

    The mean square S(h) of residual differences over a time h is fitted, up to a tenth of
    the run, by non-negative amounts of white noise of the level, of noise that forgets
    itself within 1 to 100 s, and of a random walk. Longer lags say nothing that a cause
    could not also say.
    """

    def __init__(self, levels: np.ndarray, times: np.ndarray, linked: np.ndarray):
        self.linked = linked
        weights, scales = _structure(levels, times, linked)
        start, end = times[:-1][linked], times[1:][linked]

        def half(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            return 0.5 * _spread(np.abs(first[:, None] - second[None, :]), scales) @ weights

        covariance = half(end, start) + half(start, end) - half(end, end) - half(start, start)
        covariance[np.diag_indices_from(covariance)] *= 1 + 1e-6
        self.factor = linalg.cholesky(covariance, lower=True)

    def __call__(self, increments: np.ndarray) -> np.ndarray:
        """Whitened increments; the leading axes are kept, the last is the time."""
        used = increments[..., self.linked]
        flat = used.reshape(-1, used.shape[-1]).T
        white = linalg.solve_triangular(self.factor, flat, lower=True)
        return white.T.reshape(used.shape)


def _spread(lag: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Mean-square difference over `lag` s of each kind of noise, last axis by kind."""
    kinds = [(lag > 0).astype(float), lag]
    kinds += [1 - np.exp(-lag / scale) for scale in scales]
    return np.stack(kinds, axis=-1)


def _structure(levels: np.ndarray, times: np.ndarray, linked: np.ndarray):
    """Amounts of each kind of noise, and the memory times (s) of those that forget."""
    duration = times[-1] - times[0]
    scales = np.array([scale for scale in (1.0, 3.0, 10.0, 30.0, 100.0) if scale < duration / 5])
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
    basis = _spread(spans, scales)
    weights, _ = optimize.nnls(basis * certainty[:, None], squares * certainty)
    if not np.any(weights > 0):
        weights[0] = np.max(squares)
    return weights, scales


def explain(comparison: Comparison) -> Explanation:
    """Choose causes by forward steps, each confirmed with the others present."""
    theta = dict.fromkeys(comparison.steps, 0.0)
    chosen: list[Cause] = []
    rejected: set[str] = set()
    while len(chosen) < 6:
        ranked = _ranked(comparison, theta, chosen, rejected)
        if not ranked:
            break
        _, cause = ranked[0]
        trial = _refit(comparison, theta, [*chosen, cause])
        if _holds(comparison, trial, [*chosen, cause], cause):
            theta, chosen = trial, [*chosen, cause]
        else:
            rejected.add(cause.name)
    chosen, theta = _prune(comparison, theta, chosen)
    std = {} if not chosen else _std(comparison, theta, chosen)
    return Explanation(tuple(cause.name for cause in chosen), theta, std, {})


def _prune(comparison: Comparison, theta: dict, chosen: list[Cause]) -> tuple[list, dict]:
    """Drop what the causes found later have made superfluous."""
    for cause in list(chosen):
        if not _holds(comparison, theta, chosen, cause):
            chosen = [other for other in chosen if other is not cause]
            theta = {
                name: 0.0 if name in cause.parameters else value for name, value in theta.items()
            }
            theta = _refit(comparison, theta, chosen)
    return chosen, theta


def _levels(comparison: Comparison, theta: dict[str, float]) -> np.ndarray:
    return comparison.measured - comparison.predict(theta)


def _residual(comparison: Comparison, theta: dict[str, float]) -> np.ndarray:
    return np.diff(_levels(comparison, theta), axis=-1)


def _whitener(comparison: Comparison, theta: dict[str, float]) -> Whitener:
    """The noise that is left when every cause is allowed for at once.

    From the residual of the present model it would swallow what has not been found yet.
    """
    names = _names(list(comparison.causes))
    levels = _levels(comparison, theta)
    times, linked = comparison.times, comparison.linked
    for _ in range(2):
        white = Whitener(levels, times, linked)
        jacobian = _jacobian(comparison, theta, names)
        estimate, _ = _solve(white(jacobian), white(np.diff(levels, axis=-1)))
        fitted = np.tensordot(estimate, jacobian, 1)
        rest = np.cumsum(np.diff(levels, axis=-1) - fitted, axis=-1)
        levels = np.concatenate([np.zeros((len(rest), 1)), rest], axis=-1)
    return Whitener(levels, times, linked)


def _jacobian(comparison: Comparison, theta: dict, names: list[str]) -> np.ndarray:
    """d(predicted increments) / d(parameter), first axis by parameter."""
    columns = []
    for name in names:
        step = comparison.steps[name]
        ahead = comparison.predict(theta | {name: theta[name] + step})
        behind = comparison.predict(theta | {name: theta[name] - step})
        columns.append(np.diff(ahead - behind, axis=-1) / (2 * step))
    return np.array(columns)


def _names(causes: list[Cause]) -> list[str]:
    return [name for cause in causes for name in cause.parameters]


def _solve(columns: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of whitened columns, with a covariance robust to autocorrelation.

    A direction that the data say nothing about gets an estimate near zero and a very large
    variance.
    """
    count, series, length = columns.shape
    matrix = columns.reshape(count, -1)
    norms = np.linalg.norm(matrix, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    scaled = columns / norms[:, None, None]
    flat = scaled.reshape(count, -1)
    inverse = np.linalg.inv(flat @ flat.T + 1e-10 * np.eye(count))
    estimate = inverse @ (flat @ target.ravel())
    rest = target - np.tensordot(estimate, scaled, 1)
    freedom = series * length / max(series * length - count, 1)
    robust = inverse @ _long_run(np.einsum("pst,st->tp", scaled, rest)) @ inverse * freedom
    # The robust covariance of few samples is itself uncertain, mostly too small; the plain
    # one is its lower limit.
    plain = np.diag(inverse) * (np.mean(rest**2) * freedom + _TINY)
    grow = np.sqrt(np.maximum(1.0, plain / np.maximum(np.diag(robust), _TINY * plain)))
    cov = robust * np.outer(grow, grow)
    np.fill_diagonal(cov, np.maximum(np.diag(cov), plain) * (1 + _TINY))
    return estimate / norms, cov / np.outer(norms, norms)


def _long_run(scores: np.ndarray) -> np.ndarray:
    """Newey-West sum of autocovariances with 1.3 sqrt(n) lags."""
    length = scores.shape[0]
    lags = int(np.ceil(1.3 * np.sqrt(length)))
    total = scores.T @ scores
    for lag in range(1, min(lags, length - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total


def _ranked(
    comparison: Comparison, theta: dict, chosen: list[Cause], rejected: set[str]
) -> list[tuple[float, Cause]]:
    """Causes that would help significantly, by the misfit they take away, best first."""
    names = _names(chosen)
    rest = _residual(comparison, theta)
    white = _whitener(comparison, theta)
    target = white(rest)
    base = white(_jacobian(comparison, theta, names)) if names else None
    taken = {cause.name for cause in chosen} | rejected
    ranked = []
    for cause in comparison.causes:
        if cause.name in taken or any(group <= taken for group in cause.excludes):
            continue
        own = white(_jacobian(comparison, theta, list(cause.parameters)))
        columns = own if base is None else np.concatenate([base, own])
        estimate, cov = _solve(columns, target)
        count = len(cause.parameters)
        if not _significant(estimate[-count:], cov[-count:, -count:]):
            continue
        fitted = np.tensordot(estimate, columns, 1)
        drop = np.sum(target**2) - np.sum((target - fitted) ** 2)
        ranked.append((drop - count * np.log(target.size) * np.mean(target**2), cause))
    return sorted(ranked, key=lambda item: -item[0])


def _significant(estimate: np.ndarray, cov: np.ndarray) -> bool:
    wald = float(estimate @ np.linalg.solve(cov, estimate))
    return stats.chi2.sf(wald, estimate.size) < SIGNIFICANCE


def _refit(comparison: Comparison, theta: dict, causes: list[Cause]) -> dict[str, float]:
    """Gauss-Newton over the causes' parameters, with step halving."""
    names = _names(causes)
    if not names:
        return theta
    for _ in range(_MAX_STEPS):
        rest = _residual(comparison, theta)
        white = _whitener(comparison, theta)
        step, cov = _solve(white(_jacobian(comparison, theta, names)), white(rest))
        start = np.sum(white(rest) ** 2)
        for _ in range(6):
            trial = _moved(comparison, theta, names, step)
            if np.sum(white(_residual(comparison, trial)) ** 2) <= start:
                theta = trial
                break
            step = step / 2
        if np.all(np.abs(step) < 0.02 * np.sqrt(np.diag(cov))):
            break
    return theta


def _moved(comparison: Comparison, theta: dict, names: list[str], step: np.ndarray) -> dict:
    moved = dict(theta)
    for name, change in zip(names, step, strict=True):
        bound = comparison.bounds[name]
        moved[name] = float(np.clip(theta[name] + change, -bound, bound))
    return moved


def _joint(comparison: Comparison, theta: dict, causes: list[Cause]):
    names = _names(causes)
    rest = _residual(comparison, theta)
    white = _whitener(comparison, theta)
    columns = white(_jacobian(comparison, theta, names))
    _, cov = _solve(columns, white(rest))
    return names, columns, white(rest), cov


def _std(comparison: Comparison, theta: dict, causes: list[Cause]) -> dict[str, float]:
    names, _, _, cov = _joint(comparison, theta, causes)
    return dict(zip(names, np.sqrt(np.diag(cov)), strict=True))


def _holds(comparison: Comparison, theta: dict, causes: list[Cause], cause: Cause) -> bool:
    """Whether a fitted cause is significant beside the others, and large enough to matter."""
    names, columns, rest, cov = _joint(comparison, theta, causes)
    index = [names.index(name) for name in cause.parameters]
    values = np.array([theta[name] for name in cause.parameters])
    if np.linalg.norm(values) < cause.negligible:
        return False
    if not _significant(values, cov[np.ix_(index, index)]):
        return False
    return not cause.gain or _gain_holds(columns, rest, index[0], values[0], cause.negligible)


def _gain_holds(
    columns: np.ndarray, rest: np.ndarray, index: int, value: float, negligible: float
) -> bool:
    """Whether the reverse regression agrees that the gain is off in the same direction.

    With noise in the prediction the forward estimate of the gain is too small, with noise in
    the measurement the reverse one is too large: the truth lies between (Frisch 1934).
    """
    own = columns[index].ravel()
    measured = rest.ravel() + (1 + value) * own
    others = [column.ravel() for i, column in enumerate(columns) if i != index]
    regressors = np.stack([measured, *others], axis=-1)
    slope = np.linalg.lstsq(regressors, own, rcond=None)[0][0]
    if abs(slope) < 1e-12:
        return False
    reverse = 1 / slope - 1
    return np.sign(reverse) == np.sign(value) and abs(reverse) > negligible
