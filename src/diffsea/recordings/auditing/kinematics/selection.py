"""Which causes part a measured quantity from what other channels predict.

They are chosen one after another for as long as they are both significant and large enough to
matter, beside a noise that is estimated from the residual and divided out; the standard errors
allow for what correlation is left (`robust_regression`). What is stated of a cause is at least the
error by the scatter between parts of the run: the causes of real disagreements hold only nearly.
"""

import dataclasses
import itertools

import numpy as np

from diffsea.recordings.auditing.kinematics.comparison import (
    Cause,
    KinematicComparison,
    Parameters,
    parameter_names,
)
from diffsea.recordings.auditing.kinematics.noise import Whitener
from diffsea.statistics import robust_regression


# One estimate in a hundred thousand is wrong by chance if the residual is as assumed; it never
# quite is, hence the margin over the usual levels. experiments/audit_power measures the rate of
# false alarms that comes of it.
SIGNIFICANCE = 1e-5

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
_BLOCKS = 8  # parts of a run, left out in turn
_RESOLUTION = 0.05  # of what is negligible: no error is stated smaller


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
        names = parameter_names(others)
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
    names = parameter_names(causes)
    if "gain" in names:
        return names, None
    return ["gain", *names], comparison.doubt


def _fit_parameters(
    comparison: KinematicComparison, white: Whitener, fit: FittedCauses
) -> FittedCauses:
    """Gauss-Newton over the causes' parameters, within their bounds, with step halving."""
    names, theta = parameter_names(fit.causes), fit.theta
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
    price = len(parameter_names(fit.causes)) * np.log(rest.size) + _PRICE * len(fit.causes)
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
    effect = comparison.predicted(theta) - comparison.predicted(without)
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
    return {name: max(errors[name], least.get(name, 0.0)) for name in parameter_names(fit.causes)}


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
