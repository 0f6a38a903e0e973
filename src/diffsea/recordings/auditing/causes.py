"""Why increments of a measured quantity are not those that other channels predict.

Heading is the integral of yaw rate, position that of velocity. Differentiating the noisy
left side would drown everything in noise, so both sides are integrated: between two
neighbouring knots (instants one window apart) the measured increment should be the
predicted one. What remains is explained by *causes* (a bias, a delay, a current ...), each
a few parameters that are zero in a sound recording, chosen one after another for as long
as they are both significant and large enough to matter.

The noise of an increment is a random walk from noise in the rate, and white noise of the
measured level, which two neighbouring increments share with opposite sign; slower noise of
the level lies between the two. All follow from S(h), the mean square by which the level
differs from itself a time h later: cov of the increments from a to b and from c to d is

    [S(b - c) + S(a - d) - S(b - d) - S(a - c)] / 2.

It is estimated from the residual and divided out, and the standard errors allow for what
correlation is left (`robust_regression`). What is stated of a cause is at least the error by the
scatter between parts of the run, for the causes of real disagreements hold only nearly.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg, optimize

from diffsea.statistics import is_significant, robust_regression


# One estimate in a hundred thousand is wrong by chance if the residual is as assumed; it never
# quite is, hence the margin over the usual levels. experiments/audit_power measures the rate of
# false alarms that comes of it.
SIGNIFICANCE = 1e-5

_MEMORIES = (1.0, 3.0, 10.0, 30.0, 100.0)  # s, of the kinds of noise that forget themselves
_MOST_STEPS = 12  # of Gauss and Newton, from one cause to the next
_MOST_HALVINGS = 6  # of a step that makes the misfit larger
_SMALL_STEP = 0.02  # standard errors: a smaller step ends the fit
_MOST_CAUSES = 8  # at once; real recordings have shown no more than four
_FIRST_CAUSES = 3  # from which the forward selection is started
_REFITTED_CAUSES = 5  # of those that look significant, by a step of least squares
_TIE = 15.0  # difference of misfit (noise variances) that does not decide between causes
_PRICE = 30.0  # what one more cause must gain before it beats a smaller set
_UNLIKELY = 25.0  # what a parameter of the wrong sign must gain over its rivals
_MUCH_BETTER = 0.3  # of the misfit at zero, that another start must leave to be preferred
_REVERSE_CERTAINTY = 6.0  # standard errors of the slope of the reverse regression
_TINY = 1e-12
_BLOCKS = 8  # parts of a run, left out in turn
_RESOLUTION = 0.05  # of what is negligible: no error is stated smaller

Parameters = dict[str, float]
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
class KinematicComparison:
    """Measured levels, their prediction, and the causes that may part them.

    `times` (s) are the knots. `linked[i]` says whether the increment from knot i to i + 1 can be
    used. `ranges` are, by parameter, the increment with which derivatives are taken and the largest
    magnitude. `doubt` is the standard deviation that the gain is allowed in every
    test of another cause: noise in the prediction shrinks it a little, and that must not pass
    for, say, a bias in a steady turn. A cause whose whole effect on the levels is below `floor`
    (root mean square) is not named. `walk` (levels squared per second) is the random walk that
    noise of the predicting channels makes of their integral. A delay that grows is counted from
    `middle` (s). `level` is how improbable by chance a cause must be to be believed.
    """

    times: Float[np.ndarray, "knot"]
    measured: Levels
    predict: Callable[[Parameters], Levels]
    linked: Bool[np.ndarray, "window"]
    causes: tuple[Cause, ...]
    ranges: dict[str, tuple[float, float]]
    doubt: float
    floor: float
    walk: float
    middle: float
    level: float

    @functools.cached_property
    def noise_kinds(self) -> NoiseKinds:
        """The kinds of noise at the knots."""
        return NoiseKinds(self.times, self.linked)

    def residual(self, theta: Parameters) -> Float[np.ndarray, "series window"]:
        """Measured less predicted increments."""
        return np.diff(self.measured - self.predict(theta), axis=-1)

    def jacobian(
        self, theta: Parameters, names: Sequence[str]
    ) -> Float[np.ndarray, "parameter series window"]:
        """d(predicted increments) / d(parameter), by central differences."""
        columns = []
        for name in names:
            step, _ = self.ranges[name]
            ahead = self.predict(theta | {name: theta[name] + step})
            behind = self.predict(theta | {name: theta[name] - step})
            columns.append(np.diff(ahead - behind, axis=-1) / (2 * step))
        return np.array(columns)

    def whitener(self, theta: Parameters) -> Whitener:
        """By the noise that is left when every cause is allowed for at once.

        From the residual of the present model it would swallow what has not been found yet. A
        gain that is not established stays out: it would take the noise of the prediction away.
        """
        allowed = [c for c in self.causes if not c.gain or theta[c.parameters[0]] != 0]
        names = _parameter_names(allowed)
        levels = self.measured - self.predict(theta)
        known = (self.noise_kinds, 0.3 * self.floor, self.walk)
        for _ in range(2):
            white = Whitener(levels, *known)
            jacobian = self.jacobian(theta, names)
            estimate, _ = robust_regression(white(jacobian), white(np.diff(levels, axis=-1)))
            fitted = np.tensordot(estimate, jacobian, 1)
            rest = np.cumsum(np.diff(levels, axis=-1) - fitted, axis=-1)
            levels = np.concatenate([np.zeros((len(rest), 1)), rest], axis=-1)
        return Whitener(levels, *known)

    def significant(self, estimate: Float[np.ndarray, "p"], cov: Float[np.ndarray, "p p"]) -> bool:
        """Whether it is beyond chance; no more than one window per two seconds is independent."""
        windows = int(np.sum(self.linked))
        duration = self.times[-1] - self.times[0]
        freedom = max(min(windows, 0.5 * duration) - 8.0, 4.0)
        return is_significant(estimate, cov, freedom, self.level)


def _parameter_names(causes: Sequence[Cause]) -> list[str]:
    """Parameters of these causes and of what is fitted beside them, each once."""
    names = [name for cause in causes for name in (*cause.beside, *cause.parameters)]
    return list(dict.fromkeys(names))


@dataclasses.dataclass(frozen=True)
class Explanation:
    """The causes found that are large enough to matter, strongest first.

    `theta` holds every fitted parameter and `std` its standard error; `alternatives` names,
    for each cause, those that would have explained the same misfit nearly as well.
    `deviance` is minus twice the log-likelihood of what is left, with a price on causes. A delay
    that grows is counted from `middle` (s).
    """

    causes: tuple[str, ...]
    theta: Parameters
    std: Parameters
    alternatives: dict[str, tuple[str, ...]]
    deviance: float
    middle: float


@dataclasses.dataclass(frozen=True)
class FittedCauses:
    """A set of causes, the one added last at the end, and all parameters; others' are zero."""

    causes: tuple[Cause, ...]
    theta: Parameters

    def without(self, cause: Cause) -> "FittedCauses":
        """The other causes with their parameters as they are."""
        others = tuple(other for other in self.causes if other is not cause)
        names = _parameter_names(others)
        theta = {name: value if name in names else 0.0 for name, value in self.theta.items()}
        return FittedCauses(others, theta)


def select_causes(comparison: KinematicComparison | None) -> Explanation | None:
    """Choose causes by forward selection, each confirmed with the others present.

    The first step is tried with several causes, and the set that leaves the least misfit
    wins: where two causes look alike, the first choice may be wrong. Those that later ones have
    made superfluous are eliminated. Causes too small to matter are kept in the model, lest a larger
    one stand in for them, but are not named. None where there is no comparison.
    """
    if comparison is None:
        return None
    fit = FittedCauses((), dict.fromkeys(comparison.ranges, 0.0))
    white = comparison.whitener(fit.theta)
    first = _candidates(comparison, white, fit)
    first = [each for each in first if _is_confirmed(comparison, each, each.causes[-1])]
    if first:
        ends = [_select_forward(comparison, start) for start in first[:_FIRST_CAUSES]]
        white = comparison.whitener(ends[0].theta)
        costs = [_criterion(comparison, white, end) for end in ends]
        fit = ends[costs.index(min(costs))]
        for cause in fit.causes:
            if not _is_confirmed(comparison, fit, cause):
                fit = fit.without(cause)
                fit = _fit_parameters(comparison, comparison.whitener(fit.theta), fit)
    std = _stated_errors(comparison, fit) if fit.causes else {}
    named = [cause for cause in fit.causes if _matters(comparison, fit.theta, cause)]
    final = comparison.whitener(fit.theta)
    return Explanation(
        tuple(cause.name for cause in named),
        fit.theta,
        std,
        {cause.name: _alternatives(comparison, white, fit, cause) for cause in named},
        _criterion(comparison, final, fit) + final.log_determinant,
        comparison.middle,
    )


def _candidates(
    comparison: KinematicComparison, white: Whitener, fit: FittedCauses
) -> list[FittedCauses]:
    """The present causes with one more, for each that would help significantly, best first."""
    theta = fit.theta
    target = white(comparison.residual(theta))
    present = {cause.name for cause in fit.causes}
    promising = []
    for cause in comparison.causes:
        if cause.name in present or any(
            complete <= present | {cause.name} for complete in cause.excludes
        ):
            continue
        start = _starting_point(comparison, white, theta, cause)
        rest = target if start is theta else white(comparison.residual(start))
        names, doubt = _tested_parameters(comparison, (*fit.causes, cause))
        columns = white(comparison.jacobian(start, names))
        estimate, cov = robust_regression(columns, rest, doubt)
        index = [names.index(name) for name in cause.parameters]
        value = estimate[index] + [start[name] - theta[name] for name in cause.parameters]
        if comparison.significant(value, cov[np.ix_(index, index)]):
            left = np.sum((rest - np.tensordot(estimate, columns, 1)) ** 2)
            promising.append((left, FittedCauses((*fit.causes, cause), start)))
    promising.sort(key=lambda item: item[0])
    best = [_fit_parameters(comparison, white, more) for _, more in promising[:_REFITTED_CAUSES]]
    return sorted(best, key=lambda more: _criterion(comparison, white, more))


def _starting_point(
    comparison: KinematicComparison, white: Whitener, theta: Parameters, cause: Cause
) -> Parameters:
    """Where to begin with a cause: where misfit is least, which is here unless much is gained."""

    def misfit(point: Parameters) -> float:
        return float(np.sum(white(comparison.residual(point)) ** 2))

    if not cause.starts:
        return theta
    points = [theta | {cause.parameters[0]: value} for value in cause.starts]
    best = min(points, key=misfit)
    return best if misfit(best) < _MUCH_BETTER * misfit(theta) else theta


def _tested_parameters(
    comparison: KinematicComparison, causes: tuple[Cause, ...]
) -> tuple[list[str], float | None]:
    """Parameters to fit in a test of these causes, and how far the first is in doubt."""
    names = _parameter_names(causes)
    if "gain" in names:
        return names, None
    return ["gain", *names], comparison.doubt


def _fit_parameters(
    comparison: KinematicComparison, white: Whitener, fit: FittedCauses
) -> FittedCauses:
    """Gauss-Newton over the causes' parameters, within their bounds, with step halving."""
    names, theta = _parameter_names(fit.causes), fit.theta
    bounds = np.array([comparison.ranges[name][1] for name in names])
    for _ in range(_MOST_STEPS if names else 0):
        rest = white(comparison.residual(theta))
        step, cov = robust_regression(white(comparison.jacobian(theta, names)), rest)
        present, cost = np.array([theta[name] for name in names]), np.sum(rest**2)
        for _ in range(_MOST_HALVINGS):
            moved = np.clip(present + step, -bounds, bounds)
            trial = theta | dict(zip(names, moved.tolist(), strict=True))
            if np.sum(white(comparison.residual(trial)) ** 2) <= cost:
                theta = trial
                break
            step = step / 2
        if np.all(np.abs(step) < _SMALL_STEP * np.sqrt(np.diag(cov))):
            break
    return FittedCauses(fit.causes, theta)


def _criterion(comparison: KinematicComparison, white: Whitener, fit: FittedCauses) -> float:
    """Misfit in units of the noise variance, with a price on causes and parameters."""
    rest = white(comparison.residual(fit.theta))
    unlikely = sum(cause.likely * fit.theta[cause.parameters[0]] < 0 for cause in fit.causes)
    price = len(_parameter_names(fit.causes)) * np.log(rest.size) + _PRICE * len(fit.causes)
    return float(np.sum(rest**2) / white.variance + price + _UNLIKELY * unlikely)


def _select_forward(comparison: KinematicComparison, fit: FittedCauses) -> FittedCauses:
    """The set after adding causes for as long as one more is significant."""
    while len(fit.causes) < _MOST_CAUSES:
        candidates = _candidates(comparison, comparison.whitener(fit.theta), fit)
        confirmed = (c for c in candidates if _is_confirmed(comparison, c, c.causes[-1]))
        added = next(confirmed, None)
        if added is None:
            break
        fit = added
    return fit


def _alternatives(
    comparison: KinematicComparison, white: Whitener, fit: FittedCauses, cause: Cause
) -> tuple[str, ...]:
    """Causes that could stand in the place of one, leaving nearly the same misfit."""
    own = _criterion(comparison, white, fit)
    return tuple(
        other.causes[-1].name
        for other in _candidates(comparison, white, fit.without(cause))
        if other.causes[-1] is not cause and _criterion(comparison, white, other) - own < _TIE
    )


def _matters(comparison: KinematicComparison, theta: Parameters, cause: Cause) -> bool:
    """Whether the cause is above what is negligible, and its effect above the floor."""
    if np.linalg.norm([theta[name] for name in cause.parameters]) < cause.negligible:
        return False
    without = theta | dict.fromkeys((*cause.parameters, *cause.beside), 0.0)
    effect = comparison.predict(theta) - comparison.predict(without)
    return float(np.sqrt(np.mean(np.var(effect, axis=-1)))) >= comparison.floor


def _tested_columns(
    comparison: KinematicComparison, fit: FittedCauses
) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Names, whitened columns and residual, and covariance at the fitted parameters."""
    names, doubt = _tested_parameters(comparison, fit.causes)
    white = comparison.whitener(fit.theta)
    rest = white(comparison.residual(fit.theta))
    columns = white(comparison.jacobian(fit.theta, names))
    _, cov = robust_regression(columns, rest, doubt)
    return names, columns, rest, cov


def _stated_errors(comparison: KinematicComparison, fit: FittedCauses) -> Parameters:
    """Standard errors: by the noise, or by the scatter between parts of the run if that is more.

    The second is the jackknife's, with one block left out at a time (Efron 1982). None is smaller
    than what sampling and rounding of channels leave uncertain.
    """
    names, columns, rest, cov = _tested_columns(comparison, fit)
    _, doubt = _tested_parameters(comparison, fit.causes)
    edges = np.linspace(0, rest.shape[-1], _BLOCKS + 1).astype(int)
    estimates = []
    for first, after in itertools.pairwise(edges):
        kept = np.r_[0:first, after : rest.shape[-1]]
        estimates.append(robust_regression(columns[..., kept], rest[..., kept], doubt)[0])
    scatter = np.sqrt((_BLOCKS - 1) * np.var(estimates, axis=0))
    errors = dict(zip(names, np.maximum(np.sqrt(np.diag(cov)), scatter).tolist(), strict=True))
    least = {name: _RESOLUTION * c.negligible for c in fit.causes for name in c.parameters}
    return {name: max(errors[name], least.get(name, 0.0)) for name in _parameter_names(fit.causes)}


def _is_confirmed(comparison: KinematicComparison, fit: FittedCauses, cause: Cause) -> bool:
    """Whether a cause is significant beside the others and can be believed."""
    names, columns, rest, cov = _tested_columns(comparison, fit)
    index = [names.index(name) for name in cause.parameters]
    values = np.array([fit.theta[name] for name in cause.parameters])
    if any(abs(fit.theta[name]) >= comparison.ranges[name][1] for name in cause.parameters):
        return False
    if not comparison.significant(values, cov[np.ix_(index, index)]):
        return False
    return not cause.gain or _reverse_regression_agrees(columns, rest, index[0], values[0])


def _reverse_regression_agrees(
    columns: np.ndarray, rest: np.ndarray, index: int, value: float
) -> bool:
    """Whether the reverse regression agrees that the gain is off in the same direction.

    With noise in the prediction the forward estimate of the gain is too small, with noise in
    the measurement the reverse one is too large: the truth lies between (Frisch 1934).
    """
    own = columns[index]
    others = [column for i, column in enumerate(columns) if i != index]
    regressors = np.stack([rest + (1 + value) * own, *others])
    slope, cov = robust_regression(regressors, own)
    if slope[0] < _REVERSE_CERTAINTY * np.sqrt(cov[0, 0]):
        return False
    reverse = 1 / slope[0] - 1
    return bool(np.sign(reverse) == np.sign(value) and abs(reverse) > 0.5 * abs(value))
