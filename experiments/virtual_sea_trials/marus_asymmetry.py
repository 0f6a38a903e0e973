"""What makes port differ from starboard: candidates refitted one at a time, and their odds.

The reasoning is the diagnosis's own: each candidate is refitted together with all the
derivatives, and its evidence is the fall of the deviance less the price of its room in the
prior (Laplace), with the misfits' scales of the best model for all.
"""

import dataclasses
from collections.abc import Callable

import marus_vessel
import numpy as np

from diffsea.diagnosis.select import EVIDENCE
from diffsea.identification.estimates import Estimate
from diffsea.identification.trial_numbers import TrialNumbers


SIDES = 1.0  # sizes in which an effect is begun, to either side: it is not begun at nothing


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One explanation, refitted."""

    name: str
    estimate: Estimate
    parameters: dict[str, float]  # SI units
    drop: float  # of the deviance against the even vessel
    occam: float  # twice the log of prior over posterior volume

    @property
    def evidence(self) -> float:
        """Twice the log of the Bayes factor against the even vessel."""
        return self.drop - max(self.occam, 0.0)

    @property
    def log10_odds(self) -> float:
        """Decimal logarithm of the odds against the even vessel."""
        return self.evidence / (2 * np.log(10))


def tried(objective: TrialNumbers, even: Estimate, say: Callable[[str], None]) -> list[Candidate]:
    """Every candidate refitted from the even vessel, best first."""
    found = [_refitted(objective, even, effect) for effect in objective.effects]
    for one in found:
        say(f"{one.name}: log10 odds {one.log10_odds:.1f}")
    return sorted(found, key=lambda one: -one.evidence)


def _refitted(objective: TrialNumbers, even: Estimate, effect) -> Candidate:
    places = [k for k, owner in enumerate(objective.owners) if owner == effect.name]
    free = (*even.free, effect.name)
    fits = []
    for side in (-SIDES, SIDES):
        begin = np.array(even.coordinates, float)
        begin[places] = side
        fits.append(objective.fit(free, begin))
    best = min(fits, key=lambda fit: fit.deviance)
    volume = np.linalg.slogdet(best.precision)[1] - np.linalg.slogdet(even.precision)[1]
    occam = float(volume + 2 * np.log(objective.spreads[places]).sum())
    sizes = np.array(objective.sizes[effect.name])
    said = effect.parameters(marus_vessel.start(), best.coordinates[places] * sizes)
    parameters = {name: float(value) for name, value in said.items()}
    return Candidate(effect.name, best, parameters, even.deviance - best.deviance, occam)


def rivals(candidates: list[Candidate]) -> list[str]:
    """Those that the figures support nearly as well as the best, as the diagnosis counts."""
    best = candidates[0]
    return [one.name for one in candidates[1:] if best.evidence - one.evidence < EVIDENCE]


def shares(candidates: list[Candidate]) -> dict[str, float]:
    """Probability of each and of an even vessel, were these all there is and alike beforehand."""
    evidence = np.array([0.0, *(one.evidence for one in candidates)])
    weight = np.exp(0.5 * (evidence - evidence.max()))
    names = ["even", *(one.name for one in candidates)]
    return dict(zip(names, map(float, weight / weight.sum()), strict=True))
