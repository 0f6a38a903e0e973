"""Noise of increments: what white noise of a level and random walks make of its differences.

The noise of an increment is a random walk from noise in the rate, and white noise of the
measured level, which two neighbouring increments share with opposite sign; slower noise of
the level lies between the two. All follow from S(h), the mean square by which the level
differs from itself a time h later: cov of the increments from a to b and from c to d is

    [S(b - c) + S(a - d) - S(b - d) - S(a - c)] / 2.

Compares increments of a measured quantity with what other channels predict of them.

Heading is the integral of yaw rate, position that of velocity. Differentiating the noisy
left side would drown everything in noise, so both sides are integrated: between two
neighbouring knots (instants one window apart) the measured increment should be the
predicted one. What remains is explained by *causes* (a bias, a delay, a current ...), each
a few parameters that are zero in a sound recording, chosen one after another for as long
as they are both significant and large enough to matter.

The noise of the increments is estimated from the residual and divided out (`noise`), and the
standard errors allow for what correlation is left (`regression`).
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from scipy import linalg, optimize

from diffsea.statistics import is_significant, robust_regression


# One estimate in a hundred thousand is wrong by chance if the residual is as assumed; it never
# quite is, hence the margin over the usual levels. experiments/audit_power measures the rate of
# false alarms that comes of it.
SIGNIFICANCE = 1e-5
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


_MAX_STEPS = 12
_MAX_CAUSES = 8
_STARTS = 3
_SMALL = 1e-12
_TIE = 15.0  # difference of misfit (noise variances) that does not decide between causes
_PRICE = 30.0  # what one more cause must gain before it beats a smaller set
_UNLIKELY = 25.0  # what a parameter of the wrong sign must gain over its rivals


@dataclasses.dataclass(frozen=True)
class Cause:
    """A way in which two sets of channels may disagree.

    The norm of its parameters is compared with `negligible`; parameters named in `beside`
    are fitted with them and not judged. A `gain` multiplies the prediction: noise in the
    prediction biases it towards zero, so it is believed only if the reverse regression
    agrees. `likely` is the sign that physics gives the parameter, if it does: the other is
    believed where nothing else will do. A cause is not added to complete any set in
    `excludes`. `starts` are values of its first parameter from which to begin besides zero: a
    latency of half a turn is not seen from there.
    """

    name: str
    parameters: tuple[str, ...]
    negligible: float
    gain: bool = False
    likely: int = 0
    beside: tuple[str, ...] = ()
    excludes: tuple[frozenset[str], ...] = ()
    starts: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Measured levels, their prediction, and the causes that may part them.

    `times` (s) are the knots. `measured` and the value of `predict` have the shape (series,
    knots). `linked[i]` says whether the increment from knot i to i + 1 can be used. `steps`
    are the increments with which derivatives are taken and `bounds` the largest magnitudes,
    by parameter. `doubt` is the standard deviation that the gain is allowed in every test of
    another cause: noise in the prediction shrinks it a little, and that must not pass for,
    say, a bias in a steady turn. A cause whose whole effect on the levels is below `floor`
    (root mean square) is not named. `walk` (levels squared per second) is the random walk that
    noise of the predicting channels makes of their integral.
    """

    times: np.ndarray
    measured: np.ndarray
    predict: Callable[[dict[str, float]], np.ndarray]
    linked: np.ndarray
    causes: tuple[Cause, ...]
    steps: dict[str, float]
    bounds: dict[str, float]
    doubt: float
    floor: float
    walk: float
    middle: float  # s, from where a growing delay is counted
    level: float  # how improbable by chance a cause must be to be believed

    @functools.cached_property
    def kinds(self) -> Kinds:
        """The kinds of noise at the knots."""
        return Kinds(self.times, self.linked)


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The causes found that are large enough to matter, strongest first.

    `theta` holds every fitted parameter and `std` its standard error; `alternatives` names,
    for each cause, those that would have explained the same misfit nearly as well.
    `deviance` is minus twice the log-likelihood of what is left, with a price on causes. A delay
    that grows is counted from `middle` (s).
    """

    causes: tuple[str, ...]
    theta: dict[str, float]
    std: dict[str, float]
    alternatives: dict[str, tuple[str, ...]]
    deviance: float
    middle: float


@dataclasses.dataclass(frozen=True)
class _Trial:
    """A set of causes, fitted, and what misfit it leaves (with a price on parameters)."""

    added: Cause
    causes: tuple[Cause, ...]
    theta: dict[str, float]
    cost: float


def explain(comparison: Comparison) -> Explanation:
    """Choose causes by forward steps, each confirmed with the others present.

    The first step is tried with several causes, and the set that leaves the least misfit
    wins: where two causes look alike, the first choice may be wrong. Causes too small to
    matter are kept in the model, lest a larger one stand in for them, but are not named.
    """
    theta = dict.fromkeys(comparison.steps, 0.0)
    white = _whitener(comparison, theta)
    trials = _believable(comparison, _trials(comparison, white, theta, ()))
    if not trials:
        return Explanation((), theta, {}, {}, _deviance(comparison, (), theta), comparison.middle)
    ends = [_continued(comparison, trial) for trial in trials[:_STARTS]]
    white = _whitener(comparison, ends[0].theta)
    best = min(ends, key=lambda end: _cost(comparison, white, end.causes, end.theta))
    chosen, theta = _pruned(comparison, best.theta, best.causes)
    named = tuple(cause for cause in chosen if _matters(comparison, theta, cause))
    rivals = {cause.name: _rivals(comparison, white, theta, chosen, cause) for cause in named}
    std = _std(comparison, theta, chosen) if chosen else {}
    names = tuple(cause.name for cause in named)
    deviance = _deviance(comparison, chosen, theta)
    return Explanation(names, theta, std, rivals, deviance, comparison.middle)


def _deviance(comparison: Comparison, causes: tuple[Cause, ...], theta: dict[str, float]) -> float:
    white = _whitener(comparison, theta)
    return _cost(comparison, white, causes, theta) + white.size


def _continued(comparison: Comparison, trial: _Trial) -> _Trial:
    """The set after adding causes for as long as one more is significant."""
    while len(trial.causes) < _MAX_CAUSES:
        white = _whitener(comparison, trial.theta)
        trials = _trials(comparison, white, trial.theta, trial.causes)
        added = next((more for more in trials if _holds(comparison, more)), None)
        if added is None:
            break
        trial = added
    return trial


def _believable(comparison: Comparison, trials: list[_Trial]) -> list[_Trial]:
    return [trial for trial in trials if _holds(comparison, trial)]


def _rivals(
    comparison: Comparison,
    white: Whitener,
    theta: dict[str, float],
    chosen: tuple[Cause, ...],
    cause: Cause,
) -> tuple[str, ...]:
    """Causes that could stand in the place of one, leaving nearly the same misfit."""
    others = tuple(other for other in chosen if other is not cause)
    kept = set(_names(others))
    reduced = {name: value if name in kept else 0.0 for name, value in theta.items()}
    own = _cost(comparison, white, chosen, theta)
    return tuple(
        trial.added.name
        for trial in _trials(comparison, white, reduced, others)
        if trial.added is not cause and trial.cost - own < _TIE
    )


def _matters(comparison: Comparison, theta: dict[str, float], cause: Cause) -> bool:
    if np.linalg.norm([theta[name] for name in cause.parameters]) < cause.negligible:
        return False
    without = theta | dict.fromkeys((*cause.parameters, *cause.beside), 0.0)
    effect = comparison.predict(theta) - comparison.predict(without)
    return float(np.sqrt(np.mean(np.var(effect, axis=-1)))) >= comparison.floor


def _pruned(
    comparison: Comparison, theta: dict[str, float], chosen: tuple[Cause, ...]
) -> tuple[tuple[Cause, ...], dict[str, float]]:
    """Drop what the causes found later have made superfluous."""
    for cause in chosen:
        if _holds(comparison, _Trial(cause, chosen, theta, 0.0)):
            continue
        chosen = tuple(other for other in chosen if other is not cause)
        kept = set(_names(chosen))
        theta = {name: value if name in kept else 0.0 for name, value in theta.items()}
        theta = _refit(comparison, _whitener(comparison, theta), theta, chosen)
    return chosen, theta


def _levels(comparison: Comparison, theta: dict[str, float]) -> np.ndarray:
    return comparison.measured - comparison.predict(theta)


def _residual(comparison: Comparison, theta: dict[str, float]) -> np.ndarray:
    return np.diff(_levels(comparison, theta), axis=-1)


def _whitener(comparison: Comparison, theta: dict[str, float]) -> Whitener:
    """The noise that is left when every cause is allowed for at once.

    From the residual of the present model it would swallow what has not been found yet. A
    gain that is not established stays out: it would take the noise of the prediction away.
    """
    allowed = [c for c in comparison.causes if not c.gain or theta[c.parameters[0]] != 0]
    names = _names(tuple(allowed))
    levels = _levels(comparison, theta)
    known = (comparison.kinds, 0.3 * comparison.floor, comparison.walk)
    for _ in range(2):
        white = Whitener(levels, *known)
        jacobian = _jacobian(comparison, theta, names)
        estimate, _ = robust_regression(white(jacobian), white(np.diff(levels, axis=-1)))
        fitted = np.tensordot(estimate, jacobian, 1)
        rest = np.cumsum(np.diff(levels, axis=-1) - fitted, axis=-1)
        levels = np.concatenate([np.zeros((len(rest), 1)), rest], axis=-1)
    return Whitener(levels, *known)


def _jacobian(comparison: Comparison, theta: dict, names: list[str]) -> np.ndarray:
    """d(predicted increments) / d(parameter), first axis by parameter."""
    columns = []
    for name in names:
        step = comparison.steps[name]
        ahead = comparison.predict(theta | {name: theta[name] + step})
        behind = comparison.predict(theta | {name: theta[name] - step})
        columns.append(np.diff(ahead - behind, axis=-1) / (2 * step))
    return np.array(columns)


def _names(causes: tuple[Cause, ...]) -> list[str]:
    """Parameters of these causes and of what is fitted beside them, each once."""
    names = [name for cause in causes for name in (*cause.beside, *cause.parameters)]
    return list(dict.fromkeys(names))


def _trials(
    comparison: Comparison, white: Whitener, theta: dict, chosen: tuple[Cause, ...]
) -> list[_Trial]:
    """The present causes with one more, for each that would help significantly, best first."""
    target = white(_residual(comparison, theta))
    taken = {cause.name for cause in chosen}
    promising = []
    for cause in comparison.causes:
        if cause.name in taken or any(group <= taken | {cause.name} for group in cause.excludes):
            continue
        start = _started(comparison, white, theta, cause)
        rest = target if start is theta else white(_residual(comparison, start))
        names, doubt = _tested(comparison, (*chosen, cause))
        columns = white(_jacobian(comparison, start, names))
        estimate, cov = robust_regression(columns, rest, doubt)
        index = [names.index(name) for name in cause.parameters]
        value = estimate[index] + [start[name] - theta[name] for name in cause.parameters]
        if _significant(comparison, value, cov[np.ix_(index, index)]):
            left = np.sum((rest - np.tensordot(estimate, columns, 1)) ** 2)
            promising.append((left, cause, start))
    promising.sort(key=lambda item: item[0])
    trials = [_trial(comparison, white, start, chosen, cause) for _, cause, start in promising[:5]]
    return sorted(trials, key=lambda trial: trial.cost)


def _started(
    comparison: Comparison, white: Whitener, theta: dict[str, float], cause: Cause
) -> dict[str, float]:
    """Where to begin with a cause: where misfit is least, which is here unless much is gained."""

    def misfit(point: dict[str, float]) -> float:
        return float(np.sum(white(_residual(comparison, point)) ** 2))

    if not cause.starts:
        return theta
    points = [theta | {cause.parameters[0]: value} for value in cause.starts]
    best = min(points, key=misfit)
    return best if misfit(best) < 0.3 * misfit(theta) else theta


def _trial(
    comparison: Comparison,
    white: Whitener,
    theta: dict[str, float],
    chosen: tuple[Cause, ...],
    cause: Cause,
) -> _Trial:
    """Fit with the additional cause."""
    causes = (*chosen, cause)
    fitted = _refit(comparison, white, theta, causes)
    return _Trial(cause, causes, fitted, _cost(comparison, white, causes, fitted))


def _cost(
    comparison: Comparison, white: Whitener, causes: tuple[Cause, ...], theta: dict[str, float]
) -> float:
    """Misfit in units of the noise variance, with a price on causes and parameters."""
    rest = white(_residual(comparison, theta))
    unlikely = sum(cause.likely * theta[cause.parameters[0]] < 0 for cause in causes)
    price = len(_names(causes)) * np.log(rest.size) + _PRICE * len(causes)
    return float(np.sum(rest**2) / white.variance + price + _UNLIKELY * unlikely)


def _tested(comparison: Comparison, causes: tuple[Cause, ...]) -> tuple[list[str], float | None]:
    """Parameters to fit in a test of these causes, and how far the first is in doubt."""
    names = _names(causes)
    if "gain" in names:
        return names, None
    return ["gain", *names], comparison.doubt


def _significant(comparison: Comparison, estimate: np.ndarray, cov: np.ndarray) -> bool:
    """Whether it is beyond chance; no more than one window per two seconds is independent."""
    windows = int(np.sum(comparison.linked))
    duration = comparison.times[-1] - comparison.times[0]
    freedom = max(min(windows, 0.5 * duration) - 8.0, 4.0)
    return is_significant(estimate, cov, freedom, comparison.level)


def _refit(
    comparison: Comparison, white: Whitener, theta: dict, causes: tuple[Cause, ...]
) -> dict[str, float]:
    """Gauss-Newton over the causes' parameters, with step halving."""
    names = _names(causes)
    for _ in range(_MAX_STEPS if names else 0):
        rest = white(_residual(comparison, theta))
        step, cov = robust_regression(white(_jacobian(comparison, theta, names)), rest)
        start = np.sum(rest**2)
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


def _joint(comparison: Comparison, theta: dict, causes: tuple[Cause, ...]):
    """Names, whitened columns and residual, and covariance at the fitted parameters."""
    names, doubt = _tested(comparison, causes)
    white = _whitener(comparison, theta)
    rest = white(_residual(comparison, theta))
    columns = white(_jacobian(comparison, theta, names))
    _, cov = robust_regression(columns, rest, doubt)
    return names, columns, rest, cov


def _std(comparison: Comparison, theta: dict, causes: tuple[Cause, ...]) -> dict[str, float]:
    names, _, _, cov = _joint(comparison, theta, causes)
    std = dict(zip(names, np.sqrt(np.diag(cov)), strict=True))
    return {name: float(std[name]) for name in _names(causes)}


def _holds(comparison: Comparison, trial: _Trial) -> bool:
    """Whether the added cause is significant beside the others and can be believed."""
    cause, theta = trial.added, trial.theta
    names, columns, rest, cov = _joint(comparison, theta, trial.causes)
    index = [names.index(name) for name in cause.parameters]
    values = np.array([theta[name] for name in cause.parameters])
    if any(abs(theta[name]) >= comparison.bounds[name] for name in cause.parameters):
        return False
    if not _significant(comparison, values, cov[np.ix_(index, index)]):
        return False
    return not cause.gain or _gain_holds(columns, rest, index[0], values[0])


def _gain_holds(columns: np.ndarray, rest: np.ndarray, index: int, value: float) -> bool:
    """Whether the reverse regression agrees that the gain is off in the same direction.

    With noise in the prediction the forward estimate of the gain is too small, with noise in
    the measurement the reverse one is too large: the truth lies between (Frisch 1934).
    """
    own = columns[index]
    others = [column for i, column in enumerate(columns) if i != index]
    regressors = np.stack([rest + (1 + value) * own, *others])
    slope, cov = robust_regression(regressors, own)
    if slope[0] < 6 * np.sqrt(cov[0, 0]):
        return False
    reverse = 1 / slope[0] - 1
    return bool(np.sign(reverse) == np.sign(value) and abs(reverse) > 0.5 * abs(value))
