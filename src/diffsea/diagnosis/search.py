"""Where a search for what a model lacks stands, how far it may go, and when it ends."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from diffsea.budget import current_budget
from diffsea.diagnosis.decision import AcceptedEffect, ShortList
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.refits import judge_exchanged
from diffsea.diagnosis.screening import Screening
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Split, has_own_environment
from diffsea.progress import Progress


ALPHA = 0.01  # family-wise level of significance
MOST_EFFECTS = 3  # that are named together: more have not been tried on data with known causes


@dataclass(frozen=True)
class Deadline:
    """When no further step of a search is begun; one that was begun is ended."""

    seconds: float = math.inf  # from now on
    began: float = field(default_factory=time.monotonic)

    @property
    def is_over(self) -> bool:
        """Whether the time is over, or that of all the work."""
        return time.monotonic() - self.began > self.seconds or current_budget().is_over


NO_DEADLINE = Deadline()


@dataclass(frozen=True)
class Effort:
    """How far a search goes."""

    effects: int = MOST_EFFECTS  # that are named together at most
    insists: bool = True  # whether more is tried where the short list leaves something open


FULL_EFFORT = Effort()


@dataclass(frozen=True)
class Search:
    """Where the search for effects stands, or ended."""

    nominal: Estimate
    nominal_screening: Screening
    final: Estimate  # with the effects so far
    final_screening: Screening  # against that, or one with the same effects
    effects: tuple[AcceptedEffect, ...] = ()
    short_list: ShortList = ShortList((), 0.0)  # the first one
    dropped: tuple[str, ...] = ()  # accepted first, found needless or doubtful later
    audited: tuple[str, ...] = ()  # of the effects, those that the audit had found
    complete: bool = True  # False where the time was over before everything had been asked

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the accepted effects."""
        return tuple(accepted.name for accepted in self.effects)

    @property
    def searched(self) -> tuple[AcceptedEffect, ...]:
        """Effects that were not found by the audit, but by the search."""
        return tuple(one for one in self.effects if one.name not in self.audited)


def exchange_judge(
    data: Split, current: Estimate, progress: Progress
) -> Callable[[Hypothesis], Hypothesis]:
    """What judges a hypothesis with training and held-out data exchanged, where it is possible."""

    def judge(one: Hypothesis) -> Hypothesis:
        if has_own_environment(data, one.estimate):
            return one
        progress(f"{one.effect}: the test leaves it open; test and recordings change places")
        return judge_exchanged(data, current, one)

    return judge
