"""Which hypothesis to believe: evidence, held-out data, one size, and what else would do."""

import dataclasses

import numpy as np

from diffsea.diagnosis.refit import EVIDENCE, Fitted, Progress
from diffsea.diagnosis.screening import Screening
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Split, exchanged_gain
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import catalogue_name


@dataclasses.dataclass(frozen=True)
class Accepted:
    """An effect that was accepted, with what else could have been."""

    name: str
    fitted: Fitted
    rivals: tuple[str, ...]
    tried: tuple[Fitted, ...] = ()  # the short list it was chosen from, best first

    @property
    def ahead(self) -> float:
        """Twice the log of the odds against the next best name, or none; all data together."""
        inflation = self.fitted.inflation
        others = [
            one.support(inflation)
            for one in self.tried
            if one.possible and catalogue_name(one.effect) != catalogue_name(self.name)
        ]
        return self.fitted.support(inflation) - max([0.0, *others])


def decide(
    data: Split, current: Estimate, tried: list[Fitted], progress: Progress
) -> Fitted | None:
    """The best hypothesis for which evidence and held-out data both speak.

    It is the one that all data support most, or one that they support nearly as well. Where
    held-out data leave one open, they and the training data change places.
    """
    judged = [one for one in tried if one.possible and one.gain is not None]
    if not judged:
        return None
    inflation = judged[0].inflation
    enough = needed(data.train)
    for one in judged:
        if judged[0].support(inflation) - one.support(inflation) > EVIDENCE:
            return None
        gain, constant = one.gain, one.constancy
        if gain is None or constant is None or one.evidence(inflation) <= enough:
            continue
        if not constant.holds:
            continue
        if gain.open and data.head is None:
            progress(f"{one.effect}: held-out data leave it open; exchanging them with the others")
            # Not part of its support: the training data speak in the evidence already, and the
            # others are not asked.
            exchanged = exchanged_gain(data, current, one.estimate)
            one = dataclasses.replace(one, exchanged=exchanged)
            gain = gain.pooled(exchanged)
        if gain.clear:
            return one
    return None


def footholds(data: Split, tried: list[Fitted]) -> list[Fitted]:
    """What may be there beside another effect, where the best lacks only one size in all the data.

    What else is missing may come and go beside the best; or the best stands for two at once. Asked
    where `decide` found nothing: a best that is sound but for that can only lack one size. Effects
    that have one come first.
    """
    judged = [one for one in tried if one.possible and one.gain is not None]
    inflation = judged[0].inflation if judged else 1.0
    sound = [
        one
        for one in judged
        if one.evidence(inflation) > needed(data.train) and one.gain is not None and one.gain.clear
    ]
    if not sound or sound[0] is not judged[0]:
        return []
    return sorted(sound, key=lambda one: one.constancy is None or not one.constancy.holds)


def stands(problem: Problem, accepted: Fitted) -> bool:
    """Whether an effect that held-out data have spoken for once is still needed.

    Beside others they may leave it open; against it speaks a lack of evidence, or their loss.
    """
    gain, constant = accepted.gain, accepted.constancy
    if not accepted.possible or gain is None or constant is None or not constant.holds:
        return False
    enough = accepted.evidence(accepted.inflation) > needed(problem)
    return enough and (gain.open or gain.clear)


def needed(problem: Problem) -> float:
    """Evidence that a name needs: odds of 150 to 1 with one chance for the whole catalogue."""
    names = {catalogue_name(effect.name) for effect in problem.layout.effects}
    return EVIDENCE + 2 * float(np.log(len(names)))


def nameless(problem: Problem, tried: tuple[Fitted, ...]) -> bool:
    """Whether something was left out that no name could be given to.

    All data together speak for it, but what comes nearest does not predict held-out runs clearly,
    is not physical, or has not one size in all the data. What held-out runs contradict as
    strongly as the others support it is no sign of anything.
    """
    sound = [one for one in tried if np.isfinite(one.drop)]
    return any(one.support(one.inflation) > needed(problem) for one in sound)


def rivals(best: Fitted, tried: list[Fitted]) -> tuple[str, ...]:
    """Names that the same data support nearly as well."""
    names: list[str] = []
    inflation = best.inflation
    for other in tried:
        name = catalogue_name(other.effect)
        same = name == catalogue_name(best.effect) or name in names
        judged = other.possible and other.gain is not None
        if judged and not same and best.support(inflation) - other.support(inflation) < EVIDENCE:
            names.append(name)
    return tuple(names)


def outdone(one: Accepted, after: Screening) -> bool:
    """Whether what is left stands out more than an effect did: then both may have another cause."""
    strongest = max((cell.z**2 for cell in after.cells), default=0.0)
    return one.fitted.seen.score.statistic < strongest
