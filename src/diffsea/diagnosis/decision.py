"""Which hypothesis to believe: evidence, held-out data, one size, and what else would do."""

import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.diagnosis.refit import EVIDENCE, Hypothesis
from diffsea.diagnosis.screening import Screening
from diffsea.identification.holdout import Gain
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import catalogue_name


def needed_evidence(problem: Problem) -> float:
    """Evidence that a name needs: odds of 150 to 1 with one chance for the whole catalogue."""
    names = {catalogue_name(effect.name) for effect in problem.layout.effects}
    return EVIDENCE + 2 * float(np.log(len(names)))


@dataclasses.dataclass(frozen=True)
class ShortList:
    """Refitted hypotheses, best first, and the evidence that a name needs."""

    hypotheses: tuple[Hypothesis, ...]
    needed: float

    @property
    def judged(self) -> list[Hypothesis]:
        """Physical hypotheses that were judged on held-out data."""
        return [one for one in self.hypotheses if one.is_judged]

    @property
    def inflation(self) -> float:
        """How many dependent values count as one, by the best judged hypothesis."""
        return self.judged[0].inflation if self.judged else 1.0

    def rivals_of(self, best: Hypothesis) -> tuple[str, ...]:
        """Names that the same data support nearly as well."""
        names: list[str] = []
        for other in self.judged:
            name = catalogue_name(other.effect)
            if name == catalogue_name(best.effect) or name in names:
                continue
            if best.support(best.inflation) - other.support(best.inflation) < EVIDENCE:
                names.append(name)
        return tuple(names)

    def lead_of(self, best: Hypothesis) -> float:
        """Twice the log of its odds against the next best name, or none; all data together."""
        others = [
            one.support(best.inflation)
            for one in self.hypotheses
            if one.is_physical and catalogue_name(one.effect) != catalogue_name(best.effect)
        ]
        return best.support(best.inflation) - max([0.0, *others])

    @property
    def has_something_nameless(self) -> bool:
        """Whether something is missing that no name could be given to, where none was.

        All data together speak for it, but what comes nearest does not predict held-out runs
        clearly, is not physical, or has not one size in all the data. What held-out runs contradict
        as strongly as the others support it is no sign of anything.
        """
        return any(
            one.support(one.inflation) > self.needed
            for one in self.hypotheses
            if np.isfinite(one.deviance_drop)
        )

    def pair_candidates(self) -> list[Hypothesis]:
        """Hypotheses beside which another effect may be missing; those of one size come first.

        For a list of which `decide` accepted none. There are some only where the best lacks nothing
        but one size in all the data: what else is missing may come and go beside it, or it stands
        for two effects at once.
        """
        sound = [
            one
            for one in self.judged
            if one.evidence(self.inflation) > self.needed and one.gain and one.gain.clear
        ]
        if not sound or sound[0] is not self.judged[0]:
            return []
        return sorted(sound, key=lambda one: one.constancy is None or not one.constancy.holds)


def decide(
    short_list: ShortList, exchanged_gain: Callable[[Hypothesis], Gain] | None
) -> Hypothesis | None:
    """The best hypothesis for which evidence and held-out data both speak.

    It is the one that all data support most, or one that they support nearly as well. Where
    held-out data leave one open, they and the training data change places: `exchanged_gain` says
    what comes of it, None where they cannot.
    """
    inflation = short_list.inflation
    for one in short_list.judged:
        behind = short_list.judged[0].support(inflation) - one.support(inflation)
        if behind > EVIDENCE:
            return None
        gain, constancy = one.gain, one.constancy
        if gain is None or constancy is None or not constancy.holds:
            continue
        if one.evidence(inflation) <= short_list.needed:
            continue
        if gain.open and exchanged_gain is not None:
            # Not part of its support: the training data speak in the evidence already, and the
            # others are not asked.
            one = dataclasses.replace(one, exchanged=exchanged_gain(one))
            gain = one.pooled_gain
        if gain is not None and gain.clear:
            return one
    return None


def still_stands(one: Hypothesis, needed: float) -> bool:
    """Whether an effect that held-out data have spoken for once is still needed beside others.

    Then they may leave it open; against it speaks a lack of evidence, or their loss.
    """
    if not one.is_judged or one.constancy is None or not one.constancy.holds:
        return False
    enough = one.evidence(one.inflation) > needed
    return enough and one.gain is not None and (one.gain.open or one.gain.clear)


def explain_more_together(
    best: Hypothesis, first: Hypothesis, second: Hypothesis, needed: float
) -> bool:
    """Whether two effects explain what the best alone does, and the first stands beside the second.

    Arguments:
        best: the best hypothesis of one effect.
        first: one of the pair, fitted and judged beside the second.
        second: the hypothesis of both effects.
    """
    gained = best.estimate.deviance - second.estimate.deviance
    return gained > -EVIDENCE and still_stands(first, needed)


@dataclasses.dataclass(frozen=True)
class AcceptedEffect:
    """An effect that was accepted, with what else could have been."""

    name: str
    hypothesis: Hypothesis
    rivals: tuple[str, ...]  # names that the same data support nearly as well
    short_list: ShortList  # that it was chosen from

    @classmethod
    def of(cls, best: Hypothesis, short_list: ShortList) -> "AcceptedEffect":
        """The effect of the best hypothesis of a short list."""
        return cls(best.effect, best, short_list.rivals_of(best), short_list)

    @property
    def lead(self) -> float:
        """Twice the log of its odds against the next best name, or none; all data together."""
        return self.short_list.lead_of(self.hypothesis)

    def is_outdone_by(self, left: Screening) -> bool:
        """Whether what is left stands out more than the effect did: both may have another cause."""
        strongest = max((cell.z**2 for cell in left.cells), default=0.0)
        return self.hypothesis.candidate.score.statistic < strongest
