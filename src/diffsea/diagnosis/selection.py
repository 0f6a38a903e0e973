"""Forward selection of effects: one after the other, or two together.

Screening by score tests only makes a short list. Each of it is refitted from the prior and judged
by evidence and by held-out data; accepted effects are added one at a time until nothing is left to
explain or nothing explains it. `elimination` asks for them again.
"""

import math
import time
from dataclasses import dataclass, field, replace

from diffsea.budget import current_budget
from diffsea.diagnosis.bootstrap import Bootstrap
from diffsea.diagnosis.decision import EVIDENCE, AcceptedEffect, ShortList, decide
from diffsea.diagnosis.first_hypotheses import FirstHypothesis
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.onsets import with_likeliest_onset
from diffsea.diagnosis.refits import (
    Refit,
    judge_exchanged,
    refit_candidates,
    refit_fully,
    refit_without,
)
from diffsea.diagnosis.screening import Screening, screen
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import Start
from diffsea.identification.free_predictions import MotionChange, motion_change
from diffsea.identification.holdout import Split, has_own_environment
from diffsea.identification.problem import Problem
from diffsea.progress import Progress
from diffsea.vessel.effects import spoken_name


ALPHA = 0.01  # family-wise level of significance
MOST_EFFECTS = 3  # that are named together: more have not been tried on data with known causes
SELDOM_GAINED = 2.0  # times what its score promises: more than that an effect seldom gains
PAIRS_TRIED = 3  # effects beside which another is sought at most
MOST_RESUMPTIONS = 2  # times at most that a fit is found to have stopped early
OWED_TO_THE_FIT = 0.5  # share of a gain that the model without the effect has, too, if fitted on


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
    first: tuple[FirstHypothesis, ...] = ()  # of the effects, what recordings tell by themselves
    complete: bool = True  # False where the time was over before everything had been asked

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the accepted effects."""
        return tuple(accepted.name for accepted in self.effects)

    @property
    def audited(self) -> tuple[str, ...]:
        """Names of the effects that the audit had found."""
        return tuple(one.effect for one in self.first if one.is_audited)

    @property
    def searched(self) -> tuple[AcceptedEffect, ...]:
        """Effects that were not told by the recordings, but found by the search."""
        first = {one.effect for one in self.first}
        return tuple(one for one in self.effects if one.name not in first)


def forward_search(
    data: Split,
    begun: Search,
    null: Bootstrap,
    progress: Progress,
    deadline: Deadline = NO_DEADLINE,
    effort: Effort = FULL_EFFORT,
) -> Search:
    """Add one effect after the other until nothing is left to explain or nothing explains it.

    Where nothing stands out any more, those that had evidence of their own before the last one was
    accepted are still asked for beside it, if they promise anything: a score at zero may say little
    of what a refit says. A search that does not insist is not complete where anything is left that
    stands out.
    """
    now, resumed, owed = begun, 0, tuple[str, ...]()
    while len(now.searched) < effort.effects:
        stands_out = null.of_strongest(now.final_screening.p_value) < ALPHA
        seen = now.final_screening.candidates
        owed = tuple(name for name in owed if name in seen and seen[name].expected > 0)
        if not stands_out and not owed:
            break
        if deadline.is_over:
            progress("the time is over: what was found until now is reported")
            current_budget().note("the search for further effects")
            return replace(now, complete=False)
        among, owed = () if stands_out else owed, ()
        tried = refit_candidates(data, now.final, now.final_screening, progress, among)
        if not now.searched:
            now = replace(now, short_list=tried)
        best = choose(data, now.final, tried, progress, effort.insists)
        if best is None and not effort.insists:
            break
        if best is None and (others := tried.left_behind()):
            progress("none of the likeliest causes holds; others are asked for")
            further = refit_candidates(data, now.final, now.final_screening, progress, others)
            best = choose(data, now.final, further, progress)
            tried = tried if best is None else further
        if best is None:
            room = len(now.searched) < MOST_EFFECTS - 1
            added = find_pair(data, tried, null, progress) if room else ()
        else:
            added, better = (), None
            if resumed < MOST_RESUMPTIONS:
                better = resume_stalled_fit(data.train, now.final, best)
            if better is not None:
                progress(
                    f"{spoken_name(best.effect)} gained only what the fit without it still owed"
                )
                resumed += 1
                now = replace(now, final=better, final_screening=screen(data.train, better))
                if not now.effects:
                    now = replace(now, nominal=better, nominal_screening=now.final_screening)
                continue
            best = with_likeliest_onset(data, now.final, best, progress)
            added, owed = (AcceptedEffect(best, tried),), tried.owed_beside(best)
        if current_budget().skips("the search for further effects"):
            return replace(now, complete=False)  # fits that judge these were cut short
        if not added:
            break
        for one in added:
            progress(f"found: {spoken_name(one.name)}")
        final = added[-1].hypothesis.estimate
        screening = screen(data.train, final)
        now = replace(now, final=final, final_screening=screening, effects=(*now.effects, *added))
    open_still = null.of_strongest(now.final_screening.p_value) < ALPHA
    return now if effort.insists or not open_still else replace(now, complete=False)


def find_pair(
    data: Split, alone: ShortList, null: Bootstrap, progress: Progress
) -> tuple[AcceptedEffect, ...]:
    """Two effects that leave nothing, where one alone has not one size in all the data.

    Each must stand beside the other, and both together explain what the best `alone` does.
    """
    for one in alone.pair_candidates()[:PAIRS_TRIED]:
        named = spoken_name(one.effect)
        progress(f"no effect alone has one size in all the data; beside {named} another?")
        screening = screen(data.train, one.estimate)
        beside = refit_candidates(data, one.estimate, screening, progress)
        other = choose(data, one.estimate, beside, progress)
        if other is None:
            continue
        bare = refit_without(data.train, other.estimate, [one.effect], one.without)
        asked = Refit(one.candidate, [Start.at(other.estimate)])
        (again,) = refit_fully(data, bare, [asked])
        left = null.of_located(screen(data.train, other.estimate).located_p_value)
        gained = alone.hypotheses[0].estimate.deviance - other.estimate.deviance
        stands = again.has_one_size and again.still_stands(alone.needed)
        if gained > -EVIDENCE and stands and left > ALPHA:
            return AcceptedEffect(one, alone), AcceptedEffect(other, beside)
    return ()


def resume_stalled_fit(problem: Problem, current: Estimate, best: Hypothesis) -> Estimate | None:
    """A better fit without the effect, where the current one had stopped early; else None.

    Sought from where the fit with the effect ended, if that gained more than scores promise, or
    than its size there accounts for: a name is not to be had for the progress of a fit.
    """
    score = best.candidate.score
    promised = min(score.statistic * score.inflation, best.wald)
    if best.deviance_drop < SELDOM_GAINED * promised:
        return None
    again = refit_without(problem, best.estimate, [best.effect], current)
    gained = current.deviance - again.deviance
    return again if gained > OWED_TO_THE_FIT * best.deviance_drop else None


def choose(
    data: Split, current: Estimate, tried: ShortList, progress: Progress, insists: bool = True
) -> Hypothesis | None:
    """The hypothesis to believe of those tried beside a current model.

    Where it `insists`, what held-out data leave open is judged with training and held-out data
    exchanged, unless each run has an environment of its own.
    """

    def exchange(one: Hypothesis) -> Hypothesis:
        if not insists or has_own_environment(data, one.estimate):
            return one
        named = spoken_name(one.effect)
        progress(f"runs held out leave {named} open; they and those fitted change places")
        return judge_exchanged(data, current, one)

    def compare(one: Hypothesis, other: Hypothesis) -> MotionChange:
        named = f"{spoken_name(one.effect)} or {spoken_name(other.effect)}"
        progress(f"{named}: which predicts the motion better?")
        return motion_change(data, one.estimate, other.estimate)

    return decide(tried, exchange, compare)
