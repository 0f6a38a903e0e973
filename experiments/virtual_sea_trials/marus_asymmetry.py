"""What makes port differ from starboard: candidates refitted one at a time, and their odds.

The reasoning is the diagnosis's own: each candidate is refitted together with all the
derivatives, and its evidence is the fall of the deviance less the price of its room in the
prior (Laplace), both by the misfits that the best of them leaves.
"""

import dataclasses
from collections.abc import Callable

from experiments.virtual_sea_trials import marus_vessel

import jax
import numpy as np

from diffsea import Effect
from diffsea.diagnosis.decision import EVIDENCE
from diffsea.identification.estimates import Estimate
from diffsea.identification.objectives.trial_numbers import TrialNumbers


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One explanation, refitted."""

    name: str
    estimate: Estimate
    parameters: dict[str, float]  # SI units
    drop: float  # of the deviance against the even vessel
    evidence: float  # twice the log of the Bayes factor against the even vessel

    @property
    def log10_odds(self) -> float:
        """Decimal logarithm of the odds against the even vessel."""
        return self.evidence / (2 * np.log(10))


def tried(objective: TrialNumbers, even: Estimate, say: Callable[[str], None]) -> list[Candidate]:
    """Every candidate refitted from the even vessel, best first."""
    fits = {}
    for effect in objective.effects:
        start = np.array(even.coordinates, float)
        fits[effect.name] = objective.fit((*even.free, effect.name), start)
        drop = even.deviance - fits[effect.name].deviance
        say(f"{effect.name}: the deviance falls by {drop:.1f}")
        # Programs of one candidate serve no other, and a process can map only so many.
        jax.clear_caches()
    ratio = objective.inflation(min(fits.values(), key=lambda one: one.deviance))
    found = [
        _candidate(objective, even, fits[effect.name], effect, ratio)
        for effect in objective.effects
    ]
    return sorted(found, key=lambda one: -one.evidence)


def _candidate(
    objective: TrialNumbers, even: Estimate, fitted: Estimate, effect: Effect, ratio: float
) -> Candidate:
    places = [k for k, owner in enumerate(objective.owners) if owner == effect.name]
    sizes = np.array(objective.sizes[effect.name])
    said = effect.decode(marus_vessel.start(), fitted.coordinates[places] * sizes)
    parameters = {name: float(value) for name, value in said.items()}
    evidence = objective.evidence(fitted, even, effect, ratio)
    return Candidate(effect.name, fitted, parameters, even.deviance - fitted.deviance, evidence)


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
