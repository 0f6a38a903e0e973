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
from diffsea.vessel.effects import EFFECTS, Onset, spoken_name


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
    number = _onset_to_ask(found.effect)
    if number is None:
        return found
    progress("when did it begin?")
    place = int(data.train.layout.indices((found.effect,))[number])
    seen = found.candidate.point.at[number]
    times = seen + found.candidate.reach * np.linspace(-1.0, 1.0, TIMES + 2)[1:-1]
    fitted = likeliest_of(data.train, found.estimate, place, times)
    if fitted is found.estimate:
        return found
    better = judge_fitted(data, current, fitted, found.candidate)
    better = dataclasses.replace(better, exchanged=found.exchanged)
    return better if better.is_judged else found


def with_onset_beside_others(
    problem: Problem, final: Estimate, found: Hypothesis, progress: Progress
) -> tuple[Estimate, Hypothesis]:
    """A model in which a change began when that is likeliest beside the effects found after it.

    What these do was in the data still when it was found, and may have moved its time: all of the
    recordings are asked. With the hypothesis of the change, as seen then. Both as they are where
    nothing is likelier, or for an effect of all the time.

    Arguments:
        final: the model with the effects found after it.
    """
    number = _onset_to_ask(found.effect)
    if number is None:
        return final, found
    progress(f"when did it begin: {spoken_name(found.effect)}?")
    place = int(problem.layout.indices((found.effect,))[number])
    size = EFFECTS[found.effect].sizes(problem.base)[number]
    recorded = np.asarray(problem.dataset.run_time)[problem.dataset.recorded_rows]
    times = np.quantile(recorded, np.linspace(0.0, 1.0, 2 * TIMES + 2)[1:-1]) / size
    better = likeliest_of(problem, final, place, np.unique(times))
    if better is final:
        return final, found
    at = list(found.candidate.point.at)
    at[number] = float(better.coordinates[place])
    point = dataclasses.replace(found.candidate.point, at=tuple(at))
    candidate = dataclasses.replace(found.candidate, point=point)
    return better, dataclasses.replace(found, candidate=candidate)


def _onset_to_ask(effect: str) -> int | None:
    """Which coordinate of an effect is when it began; None without one, or without time to ask."""
    scanned = EFFECTS[effect].scanned
    if scanned is None or not isinstance(scanned[1], Onset):
        return None
    return None if current_budget().skips("a look for when a change began") else scanned[0]


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
