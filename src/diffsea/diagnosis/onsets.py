"""When a change that was found began: likelihoods have many optima by its time.

A descent by the time of a change ends in the next valley, between two moments at which what
changed was moved; a change a little earlier or later may do far better.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from diffsea.budget import current_budget, on_every_core
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.refits import judge_fitted
from diffsea.identification.descent import filter_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import STALLED_GAIN, Start, estimate, estimate_surely
from diffsea.identification.holdout import Split
from diffsea.identification.problem import Problem
from diffsea.progress import Progress
from diffsea.vessel.effects import EFFECTS, Onset


TIMES = 64  # within reach of where a change was seen
VALLEYS = 4  # of the likelihood by the time, that are fitted
ROUNDS = 4  # of a first fit in each, with the noise held


def with_likeliest_onset(
    data: Split, current: Estimate, found: Hypothesis, progress: Progress
) -> Hypothesis:
    """A hypothesis with the likeliest time of its change, as far as it was seen; else itself.

    Arguments:
        current: the model without its effect.
    """
    scanned = EFFECTS[found.effect].scanned
    if scanned is None or not isinstance(scanned[1], Onset):
        return found
    if current_budget().skips("a look for when a change began"):
        return found
    progress("when did it begin?")
    place = int(data.train.layout.indices((found.effect,))[scanned[0]])
    seen = found.candidate.point.at[scanned[0]]
    times = seen + found.candidate.reach * np.linspace(-1.0, 1.0, TIMES + 2)[1:-1]
    fitted = likeliest_of(data.train, found.estimate, place, times)
    if fitted is found.estimate:
        return found
    better = judge_fitted(data, current, fitted, found.candidate)
    better = dataclasses.replace(better, exchanged=found.exchanged)
    return better if better.is_judged else found


def likeliest_of(
    problem: Problem, fitted: Estimate, place: int, values: Float[np.ndarray, "value"]
) -> Estimate:
    """The best fit that begins with one coordinate at some values, or the fit as it is.

    Arguments:
        place: of the coordinate.
        values: in its units, in order.
    """

    def moved(value: float) -> Start:
        coordinates = np.array(fitted.coordinates, float)
        coordinates[place] = value
        return Start.beside(fitted, coordinates)

    def cost(value: float) -> float:
        return filter_at(problem, moved(value).coordinates, fitted.noise).deviance

    def first_fit(value: float) -> Estimate:
        return estimate(problem, fitted.free, moved(value), rounds=ROUNDS, fixed_noise=True)

    costs = np.nan_to_num(np.array(on_every_core(cost, values)), nan=np.inf)
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    valleys = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]) & np.isfinite(costs))
    chosen = values[valleys[np.argsort(costs[valleys])][:VALLEYS]]
    first = on_every_core(first_fit, chosen)
    best = min(first, key=lambda one: np.nan_to_num(one.deviance, nan=np.inf), default=fitted)
    if not best.deviance < fitted.deviance - STALLED_GAIN:
        return fitted
    better = estimate_surely(problem, fitted.free, Start.at(best))
    return better if better.deviance < fitted.deviance - STALLED_GAIN else fitted
