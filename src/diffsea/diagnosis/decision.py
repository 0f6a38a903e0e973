"""Which hypothesis to believe: evidence, held-out data, one size, and what else would do."""

import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.diagnosis.refit import EVIDENCE, Hypothesis
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
    needed: float  # twice the natural log of odds

    @property
    def judged(self) -> list[Hypothesis]:
        """Physical hypotheses that were judged on held-out data."""
        return [one for one in self.hypotheses if one.is_judged]

    @property
    def inflation(self) -> float:
        """How many dependent values count as one, by the best judged hypothesis."""
        return self.judged[0].inflation if self.judged else 1.0

    @property
    def has_something_nameless(self) -> bool:
        """Whether something is missing that no name could be given to, where none was.

        All data together speak for it, but what comes nearest does not predict held-out runs
        clearly, is not physical, or has not one size in all the data. What held-out runs contradict
        as strongly as the others support it is no sign of anything.
        """
        supported = (one for one in self.hypotheses if one.support(one.inflation) > self.needed)
        return any(np.isfinite(one.deviance_drop) for one in supported)

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
        return sorted(sound, key=lambda one: not one.has_one_size)


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
        gain = one.gain
        if gain is None or not one.has_one_size or one.evidence(inflation) <= short_list.needed:
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
    if one.gain is None or not one.is_judged or not one.has_one_size:
        return False
    return one.evidence(one.inflation) > needed and (one.gain.open or one.gain.clear)


@dataclasses.dataclass(frozen=True)
class AcceptedEffect:
    """An effect that was accepted, with what else could have been."""

    hypothesis: Hypothesis
    short_list: ShortList  # that it was chosen from

    @property
    def name(self) -> str:
        """The effect's name in the catalogue's registry."""
        return self.hypothesis.effect

    @property
    def rivals(self) -> tuple[str, ...]:
        """Catalogue names that the same data support nearly as well, the best first."""
        best, names = self.hypothesis, dict[str, None]()
        for other in self.short_list.judged:
            if best.support(best.inflation) - other.support(best.inflation) < EVIDENCE:
                names[catalogue_name(other.effect)] = None
        return tuple(name for name in names if name != catalogue_name(best.effect))

    @property
    def lead(self) -> float:
        """Twice the log of its odds against the next best name, or none; all data together."""
        best = self.hypothesis
        others = [
            one.support(best.inflation)
            for one in self.short_list.hypotheses
            if one.is_physical and catalogue_name(one.effect) != catalogue_name(best.effect)
        ]
        return best.support(best.inflation) - max([0.0, *others])
