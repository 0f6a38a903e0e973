"""Which hypothesis to believe: the best by all data, if each kind of them speaks for it.

A name is given where evidence, held-out data and one size in all the data speak for it, together
with what else would do.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.screening import CONFUSABLE
from diffsea.identification.free_predictions import MotionChange
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import catalogue_name


EVIDENCE = 10.0  # twice the log of odds of 150 to 1


def rank_hypotheses(tried: list[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses by what all data say, those not judged on held-out data last."""
    judged = [one for one in tried if one.is_judged]
    best = max(judged, key=lambda one: np.nan_to_num(one.deviance_drop, nan=-np.inf), default=None)
    inflation = 1.0 if best is None else best.inflation
    return sorted(tried, key=lambda one: (one.gain is None, -one.support(inflation)))


@dataclasses.dataclass(frozen=True)
class ShortList:
    """Refitted hypotheses, best first, and the evidence that a name needs."""

    hypotheses: tuple[Hypothesis, ...]
    needed: float  # twice the natural log of odds

    @classmethod
    def of(cls, problem: Problem, tried: list[Hypothesis]) -> "ShortList":
        """Hypotheses ranked; a name needs odds of 150 to 1, with one chance for all the names."""
        names = {catalogue_name(effect.name) for effect in problem.layout.effects}
        return cls(tuple(rank_hypotheses(tried)), EVIDENCE + 2 * float(np.log(len(names))))

    @property
    def judged(self) -> list[Hypothesis]:
        """Physical hypotheses that were judged on held-out data."""
        return [one for one in self.hypotheses if one.is_judged]

    @property
    def plainest_first(self) -> list[Hypothesis]:
        """The judged ones, before each those that are plainer and supported nearly as well."""
        ordered = dict[str, Hypothesis]()
        for one in self.judged:
            enough = one.support(self.inflation) - EVIDENCE
            plainer = [other for other in self.judged if other.is_plainer_than(one)]
            near = [other for other in plainer if other.support(self.inflation) > enough]
            ordered |= {
                other.effect: other for other in (*near, one) if other.effect not in ordered
            }
        return list(ordered.values())

    def owed_beside(self, accepted: Hypothesis) -> tuple[str, ...]:
        """Effects that have the evidence for a name, beside one that was accepted of them.

        It may explain what they do, or part of it; in any case they are to be asked for beside it.
        """
        return tuple(
            one.effect
            for one in self.hypotheses
            if one.evidence(one.inflation) > self.needed and not one.is_akin_to(accepted)
        )

    def left_behind(self) -> tuple[str, ...]:
        """Effects with evidence of their own that better ones had left behind, for nothing.

        For a list of which `decide` accepted none. What was fitted to its end and failed may say
        that something is missing; an effect of which it mimics little is not concerned by that.
        """
        failed = [one for one in self.hypotheses if one.gain is not None]
        return tuple(
            one.effect
            for one in self.hypotheses
            if one.gain is None
            and one.is_physical
            and one.evidence(one.inflation) > self.needed
            and all(one.share_mimicked_by(other) < CONFUSABLE for other in failed)
        )

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
    short_list: ShortList,
    exchange: Callable[[Hypothesis], Hypothesis] | None = None,
    compare: Callable[[Hypothesis, Hypothesis], MotionChange] | None = None,
) -> Hypothesis | None:
    """The best hypothesis for which evidence and held-out data both speak.

    It is the one that all data support most, or one that they support nearly as well, the plainer
    one before the other. One that fails bars what is supported less and does much the same: of two
    effects that are both there, each spoils what runs held out say of the other. Where held-out
    data leave one undecided, they and the training data change places: `exchange` judges it there,
    too; None where they cannot. Of several that stand, the motion tells: `compare` says how free
    predictions change from one to the other.
    """
    inflation, failed = short_list.inflation, list[Hypothesis]()

    def is_barred(one: Hypothesis) -> bool:
        return any(
            other.support(inflation) - one.support(inflation) > EVIDENCE
            and one.share_mimicked_by(other) >= CONFUSABLE
            for other in failed
        )

    for one in short_list.plainest_first:
        if one.evidence(inflation) <= short_list.needed or is_barred(one):
            continue
        if one.is_undecided and exchange is not None:
            # Not part of its support: the training data speak in the evidence already, and the
            # others are not asked.
            one = exchange(one)
        if one.stands:
            return one if compare is None else _best_of_motion(one, short_list, compare)
        failed.append(one)
    return None


def _best_of_motion(
    chosen: Hypothesis,
    short_list: ShortList,
    compare: Callable[[Hypothesis, Hypothesis], MotionChange],
) -> Hypothesis:
    """The chosen one, or one supported nearly as well that predicts motion noticeably better.

    Single steps are predicted by noise as well as by a model, and free predictions by the model
    alone. One that is less plain is not asked.
    """
    inflation, first = short_list.inflation, chosen
    for other in short_list.judged:
        behind = first.support(inflation) - other.support(inflation)
        if behind > EVIDENCE or other.is_akin_to(first) or first.is_plainer_than(other):
            continue
        if other.evidence(inflation) > short_list.needed and other.stands:
            chosen = other if compare(chosen, other).is_noticeably_better else chosen
    return chosen


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
            is_near = abs(best.support(best.inflation) - other.support(best.inflation)) < EVIDENCE
            if is_near and not other.is_akin_to(best):
                names[catalogue_name(other.effect)] = None
        return tuple(names)

    @property
    def lead(self) -> float:
        """Twice the log of its odds against the next best name, or none; all data together."""
        best = self.hypothesis
        own = best.support(best.inflation)
        others = [
            one.support(best.inflation)
            for one in self.short_list.hypotheses
            if one.is_physical and not one.is_akin_to(best)
        ]
        # What is far ahead and was not accepted does something else.
        return own - max([0.0, *(other for other in others if other < own + EVIDENCE)])
