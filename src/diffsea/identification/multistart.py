"""Several starts at once: is the optimum that was found the only one?"""

import dataclasses

import numpy as np
from jaxtyping import Bool
from scipy.stats import chi2

from diffsea.budget import current_budget
from diffsea.errors import UserError
from diffsea.identification.coordinates import expansion_points, negative_effects
from diffsea.identification.estimates import Estimate
from diffsea.identification.objectives.base import AbstractObjective, Starts
from diffsea.identification.problem import Problem
from diffsea.progress import Progress, no_progress


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How many of several starts lead to the optimum, and the best rival where there is one."""

    starts: int
    agreeing: int
    rival: float | None  # deviance of the next best optimum above the best; None without one

    @property
    def sentence(self) -> str:
        """In words."""
        told = f"{self.agreeing} of {self.starts} starts lead to this optimum"
        if self.rival is not None:
            told += f"; the best other one is {self.rival:.1f} worse in -2 log posterior"
        return told


def effect_starts(problem: Problem) -> Starts:
    """Coordinates without any effect, then those with each at places where it may show itself.

    Where they are absent some effects have no derivative, and others one that leads away from what
    can be. What changes at some time begins at several.
    """
    layout, spans = problem.layout, problem.dataset.spans
    rows = [np.zeros(layout.size)]
    for effect in layout.effects:
        places = [point.at for point in expansion_points(effect, problem.base, spans)]
        if effect.leading.positive and not effect.leading.secants:
            places.append((1.0, *[0.0] * (len(effect.coordinates) - 1)))
        for place in filter(any, places):
            row = np.zeros(layout.size)
            row[layout.indices((effect.name,))] = np.tile(place, layout.instances(effect))
            rows.append(row)
    return np.array(rows)


def multistart(
    objective: AbstractObjective,
    free: tuple[str, ...],
    count: int,
    seed: int = 0,
    progress: Progress = no_progress,
    besides: Starts | None = None,
    known: Estimate | None = None,
) -> tuple[Estimate, Agreement | None]:
    """The best fit of all that is free from the prior mean and `count` - 1 draws of the prior.

    With `besides`, starts that hold more than parameters, draws hold nothing of that. Where only
    those and the prior mean are asked for, nothing is said of agreement.

    All starts are explored for a few steps; the best of them and the best one elsewhere are fitted
    to their ends, those that lead to what cannot be only where all do. Starts agree where the
    exploration led them to one place, within the 99.9 % region of the fit.

    A fit that is `known` counts as one start more: only the best one elsewhere is fitted then. A
    fit that frees its noise at once may take for gusts what the noise expected beforehand, by
    which starts are explored, leaves to the parameters.

    Raises:
        UserError: no start from which the model can be simulated.
    """
    spreads = np.array([p.spread for p in objective.parameters])
    if besides is None:
        layout = None if objective.problem is None else objective.problem.layout
        besides = np.zeros((1, len(spreads) if layout is None else layout.size))
    draws = np.zeros((count - 1, besides.shape[1]))
    drawn = np.random.default_rng(seed).normal(size=(count, len(spreads))) * spreads
    draws[:, : len(spreads)] = drawn[1:]
    starts = np.concatenate([besides, draws])
    ends, costs = objective.explore(starts, free)
    finite = np.isfinite(costs)
    if not finite.any():
        raise UserError(
            "the model diverges from every start; look at the vessel file (drag and added mass "
            "are negative) and at the recordings' units"
        )
    order = [k for k in np.lexsort((costs, _impossible(objective.problem, ends))) if finite[k]]
    told = f"{len(order)} of {len(starts)} starts explored"
    if known is None:
        progress(f"{told}; fitting from the best")
        lead = ends[order[0]]
        best = objective.fit(free, lead, progress)
        if count == 1:
            return best, None
    else:
        progress(told)
        best, lead = known, known.coordinates
    near = [k for k in order if _same_optimum(best, ends[k] - lead)]
    apart = [k for k in order if k not in near]
    near_known, rival = int(known is not None), None
    if apart and not current_budget().skips("a fit from the best start elsewhere"):
        progress("fitting from the best start elsewhere")
        data = objective.problem
        other = objective.fit(free, ends[apart[0]], progress)
        beside = [k for k in apart if _same_optimum(other, ends[k] - ends[apart[0]])]
        if _same_optimum(best, other.coordinates - best.coordinates):
            near += beside
        else:
            if objective.problem is not data:  # it left out samples that the first one has
                best = objective.fit(free, best.coordinates, progress)
            rival = abs(other.deviance - best.deviance)
            if other.deviance < best.deviance:
                best, near, near_known = other, beside, 0
    count = len(starts) + int(known is not None)
    return best, Agreement(count, len(near) + near_known, rival)


def _impossible(problem: Problem | None, ends: Starts) -> Bool[np.ndarray, "start"]:
    """Whether an effect that cannot be negative is, at each of some coordinates."""
    if problem is None:
        return np.zeros(len(ends), bool)
    return np.array([bool(negative_effects(problem.layout, end)) for end in ends])


def _same_optimum(fitted: Estimate, difference: np.ndarray) -> bool:
    """Whether coordinates differ by less than the fit's 99.9 % region."""
    off = difference[fitted.index]
    distance = float(off @ np.linalg.solve(fitted.covariance, off))
    return distance < float(chi2.ppf(0.999, len(off)))
