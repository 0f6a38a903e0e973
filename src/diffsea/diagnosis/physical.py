"""Whether a fitted effect is one that a vessel can have."""

import numpy as np

from diffsea.diagnosis.screening import Seen
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import Effect


ABSENT = 2.0  # standard errors by which a size may come out beyond its bounds, or zero in a run


def possible(problem: Problem, effect: Effect, fitted: Estimate, seen: Seen) -> bool:
    """Whether its sizes are physical, and a change lies where it was seen, within the recordings.

    Sizes count as physical as far as their standard errors tell.
    """
    values, stds = _sizes(problem, effect, fitted)
    if effect.positive and not _positive(values[:, 0], stds[:, 0]):
        return False
    if effect.bounds is not None:
        least, most = np.array(effect.bounds(problem.base)).T / effect.sizes(problem.base)
        if not ((values > least - ABSENT * stds) & (values < most + ABSENT * stds)).all():
            return False
    if effect.shape is None:
        return True
    shape = float(values[0, effect.shape])
    near = abs(shape - seen.look.at[effect.shape]) < seen.reach
    return near and (effect.periodic or _while_recorded(problem, effect, shape))


def _sizes(problem: Problem, effect: Effect, fitted: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Its coordinates in prior sizes and their standard errors, a row for each recorded copy."""
    places = np.array(problem.layout.indices((effect.name,)))
    places = places.reshape(problem.layout.copies(effect), -1)[recorded_copies(problem, effect)]
    order = [list(fitted.index).index(k) for k in places.ravel()]
    stds = np.sqrt(np.diag(np.linalg.inv(fitted.precision))[order])
    return fitted.coordinates[places], stds.reshape(places.shape)


def _positive(amounts: np.ndarray, stds: np.ndarray) -> bool:
    """Whether an effect that cannot be negative is not; of several copies some may be absent."""
    if len(amounts) == 1:
        return bool(amounts[0] > 0)
    return bool((amounts > -ABSENT * stds).all() and (amounts > 0).any())


def _while_recorded(problem: Problem, effect: Effect, shape: float) -> bool:
    """Whether a change happens between the first and the last row: else nothing changes."""
    size = problem.layout.sizes[problem.layout.effects.index(effect)][effect.shape]
    times = np.asarray(problem.tape.run_time)[np.asarray(problem.tape.known).any(1)]
    return bool(times.min() < shape * size < times.max())


def recorded_copies(problem: Problem, effect: Effect) -> list[int]:
    """Copies of an effect's coordinates that belong to recorded runs: a tape has spare ones."""
    if problem.layout.copies(effect) == 1:
        return [0]
    return np.unique(np.asarray(problem.tape.run)[np.asarray(problem.tape.known).any(1)]).tolist()
