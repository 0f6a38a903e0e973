"""Profile likelihood: intervals that need not be symmetric.

The interval of a parameter holds the values at which the deviance, with all else fitted again,
is less than a chi-squared quantile above its minimum (Venzon and Moolgavkar 1988).
"""

import dataclasses

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from diffsea.identification.estimates import LEVEL, Estimate, Progress, no_progress
from diffsea.identification.objectives.base import AbstractObjective


FAR = 6.0  # standard errors at which the search gives up: open on that side
BENT = 0.25  # relative departure from a parabola from which a parameter is asymmetric
TOLERANCE = 0.02  # standard errors


@dataclasses.dataclass(frozen=True)
class Profile:
    """The interval of one parameter; infinite on a side that the data leave open."""

    name: str
    interval: tuple[float, float]


def asymmetric_parameters(objective: AbstractObjective, fitted: Estimate) -> tuple[str, ...]:
    """Parameters whose deviance is no parabola at the ends of their 90 % interval.

    Looked at along the line on which all others follow to first order, without fitting.
    """
    rise = chi2.ppf(LEVEL, 1)
    names = [p.name for p in objective.parameters]
    bent = []
    for n, k in enumerate(fitted.index):
        if k >= len(names):
            continue
        rises = [
            _cost(objective, fitted, _followed(fitted, n, sign * np.sqrt(rise))) - fitted.deviance
            for sign in (-1.0, 1.0)
        ]
        if any(not np.isfinite(r) or abs(r / _expected(fitted, n) - 1) > BENT for r in rises):
            bent.append(names[k])
    return tuple(bent)


def profile_interval(
    objective: AbstractObjective, fitted: Estimate, name: str, progress: Progress = no_progress
) -> Profile:
    """The 90 % profile interval of a parameter, its misfits' colour taken account of."""
    names = [p.name for p in objective.parameters]
    number = names.index(name)
    n = int(np.flatnonzero(fitted.index == number)[0])
    others = tuple(free for free in fitted.free if free != name)
    wanted = _expected(fitted, n)

    def excess(errors: float) -> float:
        start = _followed(fitted, n, errors)
        cost = (
            objective.refit(fitted, others, start).deviance
            if others
            else _cost(objective, fitted, start)
        )
        return (cost if np.isfinite(cost) else np.inf) - fitted.deviance - wanted

    ends = []
    for sign in (-1.0, 1.0):
        progress(f"profile of {name} {'above' if sign > 0 else 'below'} its estimate")
        ends.append(_crossing(excess, sign))
    parameter, std = objective.parameters[number], fitted.stds[n]
    found = [
        float(parameter.decode(fitted.coordinates[number] + end * std))
        if np.isfinite(end)
        else float(np.copysign(np.inf, end))
        for end in ends
    ]
    low, high = sorted(found)
    return Profile(name, (low, high))


def _crossing(excess, sign: float) -> float:
    """Where the excess changes sign, in standard errors; infinite where it does not."""
    near, far = 0.0, sign * 1.6
    while not excess(far) > 0:
        near, far = far, 1.5 * far
        if abs(far) > FAR:
            return sign * np.inf
    return float(brentq(lambda e: min(excess(e), 1e3), near, far, xtol=TOLERANCE, maxiter=8,
                        disp=False))  # fmt: skip


def _expected(fitted: Estimate, n: int) -> float:
    """Rise of the deviance at the interval's end, more where misfits are coloured."""
    plain = np.linalg.inv(fitted.precision)[n, n]
    return float(chi2.ppf(LEVEL, 1) * fitted.covariance[n, n] / plain)


def _followed(fitted: Estimate, n: int, errors: float) -> np.ndarray:
    """Coordinates with one so many standard errors off, the others following to first order."""
    coordinates = fitted.coordinates.copy()
    step = fitted.covariance[:, n] / np.sqrt(fitted.covariance[n, n])
    coordinates[fitted.index] += errors * step
    return coordinates


def _cost(objective: AbstractObjective, fitted: Estimate, coordinates: np.ndarray) -> float:
    return objective.cost(coordinates, fitted)
