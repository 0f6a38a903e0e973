"""What recordings and trial numbers each contribute to a fit of both, and what each leaves open.

At the estimate the information of the data is a sum, J = J_r + J_n, of recordings and numbers. What
a source would determine by itself is judged as the whole is: with J_s in place of J, the prior
being the same, and the rest of the model where the fit of both has it.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from diffsea.identification.estimates import Estimate, posterior_estimate
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.uncertainty.identifiability import (
    LEAST_DETERMINED,
    Identifiability,
    identifiability,
)


@dataclasses.dataclass(frozen=True)
class Source:
    """One kind of data in a fit of several.

    Attributes:
        cost: sum of its squared misfits over their standard deviations, at the estimate.
        values: how many there are.
        determined: share of each parameter's estimate that it would determine alone, 0 to 1.
        identifiability: directions that it alone leaves to the prior.
    """

    cost: float
    values: int
    determined: dict[str, float]
    identifiability: Identifiability

    def as_dict(self) -> dict[str, Any]:
        """The record of fit.json."""
        return {
            "cost": self.cost,
            "values": self.values,
            "determined": self.determined,
            "identifiability": self.identifiability.as_dict(),
        }


@dataclasses.dataclass(frozen=True)
class Sources:
    """Recordings and trial numbers in one fit.

    Attributes:
        prior_cost: sum of squared strains of the prior at the estimate.
        together: share of each parameter's estimate that both determine, 0 to 1.
        p_value: chance that numbers with the errors that are stated lie so far off.
    """

    recordings: Source
    trial_numbers: Source
    prior_cost: float
    together: dict[str, float]
    p_value: float

    @property
    def rows(self) -> list[tuple[str, float, float, float]]:
        """Of each parameter the shares by the recordings, by the numbers, and by both."""
        own, other = self.recordings.determined, self.trial_numbers.determined
        return [(name, own[name], other[name], both) for name, both in self.together.items()]

    @property
    def sentences(self) -> list[str]:
        """What a user should know, in words."""
        groups: dict[str, list[str]] = {}
        for name, own, other, both in self.rows:
            by = own >= LEAST_DETERMINED, other >= LEAST_DETERMINED
            who = _WHO[by] if any(by) or both < LEAST_DETERMINED else _ONLY_TOGETHER
            groups.setdefault(who, []).append(name)
        told = [f"{who}: {', '.join(names)}" for who, names in groups.items()]
        parts = (("recordings", self.recordings), ("trial numbers", self.trial_numbers))
        for name, source in parts:
            worst = source.identifiability.undetermined[:1]
            told += [f"least determined by the {name} alone: {one.sentence}" for one in worst]
        return told

    def as_dict(self) -> dict[str, Any]:
        """The record of fit.json."""
        return {
            "recordings": self.recordings.as_dict(),
            "trial_numbers": self.trial_numbers.as_dict() | {"p_value": self.p_value},
            "prior": {"cost": self.prior_cost},
            "messages": self.sentences,
        }


# By whether the recordings and the numbers determine most of a parameter.
_WHO = {
    (True, False): "determined by the recordings alone, not by the trial numbers",
    (False, True): "determined by the trial numbers alone, not by the recordings",
    (True, True): "determined by either alone",
    (False, False): "determined by neither, nor by both together",
}
_ONLY_TOGETHER = "determined only by both together"


def sources(objective: AbstractObjective, fitted: Estimate) -> Sources | None:
    """Judge the sources of a fit; None where only one kind of data was fitted."""
    problem = objective.problem
    if problem is None or problem.further is None:
        return None
    numbers = problem.linear_rows(fitted.coordinates, fitted.index)
    layout, cost = problem.layout, float(numbers.misfit @ numbers.misfit)
    strains = np.asarray(layout.strains(fitted.coordinates, layout.spreads()))
    spreads = layout.local_spreads(fitted.coordinates)

    def alone(information: Float[np.ndarray, "free free"], inflation: float) -> Estimate:
        found = posterior_estimate(
            fitted.free, fitted.coordinates, fitted.deviance, fitted.index, spreads, information
        )
        return dataclasses.replace(found, inflation=inflation)

    def shares(found: Estimate) -> dict[str, float]:
        chosen = found.of_vessel(objective.parameters)
        return {one.name: float(found.shrinkage[n]) for n, one in chosen.items()}

    own = alone(fitted.information - numbers.information, fitted.inflation)
    other = alone(numbers.information, 1.0)
    squares, values = objective.squares(fitted)
    return Sources(
        Source(squares, values, shares(own), identifiability(objective.parameters, own)),
        Source(
            cost, len(numbers.misfit), shares(other), identifiability(objective.parameters, other)
        ),
        float(strains @ strains),
        shares(fitted),
        float(chi2.sf(cost, len(numbers.misfit))),
    )
