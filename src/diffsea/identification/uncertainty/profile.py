"""Profile likelihood: intervals that need not be symmetric.

The interval of a parameter holds the values at which the deviance, with all else fitted again,
is less than a chi-squared quantile above its minimum (Venzon and Moolgavkar 1988). Where misfits
are correlated in time, the quantile is larger by as much as the parameter's variance is.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.optimize import root_scalar
from scipy.stats import chi2

from diffsea.identification.estimates import INTERVAL_LEVEL, Estimate, Progress, no_progress
from diffsea.identification.objectives.base import AbstractObjective, Coordinates


SEARCH_LIMIT = 6.0  # standard errors at which the search gives up: open on that side
ASYMMETRY = 0.25  # relative departure from a parabola from which a parameter is asymmetric
END_TOLERANCE = 0.02  # standard errors: intervals are told to two digits


@dataclasses.dataclass(frozen=True)
class Profile:
    """The interval of one parameter; infinite on a side that the data leave open."""

    name: str
    interval: tuple[float, float]


def asymmetric_parameters(objective: AbstractObjective, fitted: Estimate) -> tuple[str, ...]:
    """Parameters whose deviance is no parabola at the ends of their 90 % interval.

    Looked at along the line on which all others follow to first order, without fitting.
    """
    errors = float(np.sqrt(chi2.ppf(INTERVAL_LEVEL, 1)))
    names = [p.name for p in objective.parameters]
    asymmetric = []
    for n, k in enumerate(fitted.index):
        if k >= len(names):
            continue
        for sign in (-1.0, 1.0):
            end = _coordinates_at(fitted, n, sign * errors)
            rise = objective.cost(end, fitted) - fitted.deviance
            if not np.isfinite(rise) or abs(rise / _rise_at_end(fitted, n) - 1) > ASYMMETRY:
                asymmetric.append(names[k])
                break
    return tuple(asymmetric)


def profile_interval(
    objective: AbstractObjective, fitted: Estimate, name: str, progress: Progress = no_progress
) -> Profile:
    """The 90 % profile interval of a parameter."""
    number = [p.name for p in objective.parameters].index(name)
    n = int(np.flatnonzero(fitted.index == number)[0])
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

    parameter, std = objective.parameters[number], fitted.stds[n]
    ends = []
    for sign in (-1.0, 1.0):
        progress(f"profile of {name} {'above' if sign > 0 else 'below'} its estimate")
        errors = _sign_change(excess, sign)
        at = fitted.coordinates[number] + errors * std
        ends.append(float(parameter.decode(at)) if np.isfinite(errors) else errors)
    low, high = sorted(ends)
    return Profile(name, (low, high))


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
