"""Several starts at once: is the optimum that was found the only one?"""

import dataclasses

import numpy as np
from scipy.stats import chi2

from diffsea.errors import UserError
from diffsea.identification.estimates import Estimate, Progress, silent
from diffsea.identification.objectives import Objective


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How many of several starts lead to the optimum, and the best rival where there is one."""

    starts: int
    agreeing: int
    rival: float | None  # deviance of the next best optimum above the best; None without one

    def as_dict(self) -> dict:
        """The record of fit.json."""
        return dataclasses.asdict(self)

    @property
    def sentence(self) -> str:
        """In words."""
        told = f"{self.agreeing} of {self.starts} starts lead to this optimum"
        if self.rival is not None:
            told += f"; the best other one is {self.rival:.1f} worse in -2 log posterior"
        return told


def multistart(
    objective: Objective,
    free: tuple[str, ...],
    count: int,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[Estimate, Agreement]:
    """The best fit of all parameters from the prior mean and `count` - 1 draws of the prior.

    All starts are explored together (`jax.vmap`) for a few steps; the best of them and the best
    one elsewhere are fitted to their ends. Starts agree where the exploration led them to one
    place, within the 99.9 % region of the fit.

    Raises:
        UserError: no start from which the model can be simulated.
    """
    parameters = objective.parameters
    spreads = np.array([p.spread for p in parameters])
    draws = np.random.default_rng(seed).normal(size=(count, len(parameters))) * spreads
    draws[0] = 0.0
    ends, costs = objective.explore(draws)
    finite = np.isfinite(costs)
    if not finite.any():
        raise UserError(
            "the model diverges from every start; look at the vessel file (drag and added mass "
            "are negative) and at the recordings' units"
        )
    order = [k for k in np.argsort(costs) if finite[k]]
    progress(f"{len(order)} of {count} starts explored; fitting from the best")
    lead = ends[order[0]]
    best = objective.fit(free, lead, progress)
    near = [k for k in order if _inside(best, ends[k] - lead)]
    apart = [k for k in order if k not in near]
    rival = None
    if apart:
        progress("fitting from the best start elsewhere")
        other = objective.fit(free, ends[apart[0]], progress)
        beside = [k for k in apart if _inside(best, ends[k] - ends[apart[0]])]
        if _inside(best, other.coordinates - best.coordinates):
            near += beside
        else:
            if other.deviance < best.deviance:
                best, other, near = other, best, beside
            rival = other.deviance - best.deviance
    return best, Agreement(count, len(near), rival)


def _inside(fitted: Estimate, difference: np.ndarray) -> bool:
    """Whether coordinates differ by less than the fit's 99.9 % region."""
    off = difference[fitted.index]
    distance = float(off @ np.linalg.solve(fitted.covariance, off))
    return distance < float(chi2.ppf(0.999, len(off)))
