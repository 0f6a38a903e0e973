"""What the data determine, what only the prior does, and intervals that need not be symmetric.

The profile interval of a parameter holds the values at which the deviance, with all else fitted
again, is less than a chi-squared quantile above its minimum (Venzon and Moolgavkar 1988). Where
misfits are correlated in time, the quantile is larger by as much as the parameter's variance is.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import root_scalar
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from diffsea.identification.estimates import INTERVAL_LEVEL, Estimate
from diffsea.identification.objectives.base import AbstractObjective, Coordinates
from diffsea.parameters import Parameter
from diffsea.progress import Progress, no_progress


STRONG_CORRELATION = 0.9  # correlation from which two parameters are known only together
LEAST_DETERMINED = 0.5  # share of a direction that the data must determine
LEAST_WEIGHT = 0.25  # of a direction's largest weight: parameters with less are not named
SEARCH_LIMIT = 6.0  # standard errors at which the search gives up: open on that side
ASYMMETRY = 0.25  # relative departure from a parabola from which a parameter is asymmetric
END_TOLERANCE = 0.02  # standard errors: intervals are told to two digits


@dataclasses.dataclass(frozen=True)
class Direction:
    """A combination of parameters, in units of their priors' standard deviations."""

    weights: dict[str, float]  # unit vector, small entries left out
    determined: float  # share of its variance that the data remove, 0 to 1

    @property
    def sentence(self) -> str:
        """The direction in words."""
        terms = [f"{w:+.2f} {name}" for name, w in self.weights.items()]
        combination = " ".join(terms).lstrip("+")
        return f"{combination} (the data determine {100 * self.determined:.0f} % of it)"


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Directions that the data leave to the prior, and groups that are known only together."""

    undetermined: tuple[Direction, ...]  # the worst first
    groups: tuple[tuple[str, ...], ...]
    condition: float  # ratio of the best to the worst determined direction's precision

    @property
    def sentences(self) -> list[str]:
        """What a user should know, in words; empty where all is well."""
        told = [f"not determined: {direction.sentence}" for direction in self.undetermined]
        for group in self.groups:
            told.append(
                f"known only together: {', '.join(group)} (correlated beyond "
                f"{STRONG_CORRELATION:g}; one may be far off if another is)"
            )
        return told

    def as_dict(self) -> dict:
        """The record of fit.json."""
        return {
            "undetermined": [dataclasses.asdict(d) for d in self.undetermined],
            "correlated_groups": [list(group) for group in self.groups],
            "condition": self.condition,
            "messages": self.sentences,
        }


def identifiability(parameters: Sequence[Parameter], fitted: Estimate) -> Identifiability:
    """Judge an estimate's vessel parameters, effects and environments left aside.

    The information of the data, with all else estimated too and deflated by the misfits' colour,
    is compared with that of the prior in each of its principal directions: with eigenvalue l in
    units of the priors', the data determine l / (1 + l) of a direction.
    """
    free = fitted.of_vessel(parameters)
    if not free:
        return Identifiability((), (), 1.0)
    names, spreads = [p.name for p in free.values()], np.array([p.spread for p in free.values()])
    chosen, others = list(free), [n for n in range(len(fitted.index)) if n not in free]
    mixed = fitted.information[np.ix_(chosen, others)]
    inverse = np.linalg.pinv(fitted.information[np.ix_(others, others)])
    information = fitted.information[np.ix_(chosen, chosen)] - mixed @ inverse @ mixed.T
    scaled = spreads[:, None] * (information / fitted.inflation) * spreads
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 0.0)
    weak = []
    for value, vector in zip(values, vectors.T, strict=True):
        largest = vector[np.argmax(np.abs(vector))]
        vector, order = vector * np.sign(largest), np.argsort(-np.abs(vector))
        named = [k for k in order if abs(vector[k]) > LEAST_WEIGHT * abs(largest)]
        if value / (1 + value) < LEAST_DETERMINED:
            weights = {names[k]: float(vector[k]) for k in named}
            weak.append(Direction(weights, float(value / (1 + value))))
    covariance = fitted.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(covariance))
    strong = np.abs(covariance / np.outer(std, std)) > STRONG_CORRELATION
    count, component = connected_components(strong, directed=False)
    members = (np.flatnonzero(component == number) for number in range(count))
    groups = sorted(tuple(names[k] for k in group) for group in members if len(group) > 1)
    condition = float((1 + values[-1]) / (1 + values[0]))
    return Identifiability(tuple(weak), tuple(groups), condition)


def asymmetric_parameters(objective: AbstractObjective, fitted: Estimate) -> tuple[str, ...]:
    """Parameters whose deviance is no parabola at the ends of their 90 % interval.

    Looked at along the line on which all others follow to first order, without fitting.
    """
    errors = float(np.sqrt(chi2.ppf(INTERVAL_LEVEL, 1)))
    asymmetric = []
    for n, parameter in fitted.of_vessel(objective.parameters).items():
        for sign in (-1.0, 1.0):
            end = _coordinates_at(fitted, n, sign * errors)
            rise = objective.cost(end, fitted) - fitted.deviance
            if not np.isfinite(rise) or abs(rise / _rise_at_end(fitted, n) - 1) > ASYMMETRY:
                asymmetric.append(parameter.name)
                break
    return tuple(asymmetric)


def profile_interval(
    objective: AbstractObjective, fitted: Estimate, name: str, progress: Progress = no_progress
) -> tuple[float, float]:
    """The 90 % profile interval of a parameter, in its unit.

    Infinite on a side where the deviance does not rise enough within `SEARCH_LIMIT`.
    """
    free = fitted.of_vessel(objective.parameters)
    n, parameter = next((n, p) for n, p in free.items() if p.name == name)
    others = tuple(free for free in fitted.free if free != name)
    rise = _rise_at_end(fitted, n)

    def excess(errors: float) -> float:
        """Deviance above that of the interval's end, so many standard errors off."""
        start = _coordinates_at(fitted, n, errors)
        if others:
            cost = objective.refit(fitted, others, start).deviance
        else:
            cost = objective.cost(start, fitted)
        return (cost if np.isfinite(cost) else np.inf) - fitted.deviance - rise

    ends = []
    for sign in (-1.0, 1.0):
        progress(f"how {'large' if sign > 0 else 'small'} {name} can be")
        errors = _sign_change(excess, sign)
        at = fitted.coordinates[fitted.index[n]] + errors * fitted.stds[n]
        ends.append(float(parameter.decode(at)) if np.isfinite(errors) else errors)
    low, high = sorted(ends)
    return low, high


def _sign_change(excess: Callable[[float], float], sign: float) -> float:
    """Where the excess changes sign, in standard errors; infinite where it does not."""
    near, far = 0.0, sign * 1.6
    while not excess(far) > 0:
        near, far = far, 1.5 * far
        if abs(far) > SEARCH_LIMIT:
            return sign * np.inf
    bounded = lambda errors: min(excess(errors), 1e3)
    found = root_scalar(
        bounded, method="brentq", bracket=(near, far), xtol=END_TOLERANCE, maxiter=8
    )
    return float(found.root)


def _rise_at_end(fitted: Estimate, n: int) -> float:
    """Rise of the deviance at the interval's end, more where misfits are correlated."""
    plain = np.linalg.inv(fitted.precision)[n, n]
    return float(chi2.ppf(INTERVAL_LEVEL, 1) * fitted.covariance[n, n] / plain)


def _coordinates_at(fitted: Estimate, n: int, errors: float) -> Coordinates:
    """Coordinates with one so many standard errors off, the others following to first order."""
    coordinates = fitted.coordinates.copy()
    step = fitted.covariance[:, n] / np.sqrt(fitted.covariance[n, n])
    coordinates[fitted.index] += errors * step
    return coordinates
