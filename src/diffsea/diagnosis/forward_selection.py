"""Forward selection: one effect after the other, until nothing is left or nothing explains it.

Screening by score tests only makes a short list. Each of it is refitted from the prior and judged
by evidence and by held-out data.
"""

from dataclasses import replace

from diffsea.budget import current_budget
from diffsea.diagnosis.bootstrap import Bootstrap
from diffsea.diagnosis.decision import EVIDENCE, AcceptedEffect, ShortList, decide
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.refits import refit_candidates, refit_fully, refit_without
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.search import (
    ALPHA,
    FULL_EFFORT,
    MOST_EFFECTS,
    NO_DEADLINE,
    Deadline,
    Effort,
    Search,
    exchange_judge,
)
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Split
from diffsea.identification.problem import Problem
from diffsea.progress import Progress
from diffsea.vessel.effects import catalogue_name


SELDOM_GAINED = 2.0  # times what its score promises: more than that an effect seldom gains
PAIRS_TRIED = 3  # effects beside which another is sought at most
MOST_RESUMPTIONS = 2  # times at most that a fit is found to have stopped early
OWED_TO_THE_FIT = 0.5  # share of a gain that the model without the effect has, too, if fitted on


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
        exchange = exchange_judge(data, now.final, progress) if effort.insists else lambda one: one
        best = decide(tried, exchange)
        if best is None and not effort.insists:
            break
        if best is None and (others := tried.left_behind()):
            progress("none of the likeliest causes holds; others are asked for")
            further = refit_candidates(data, now.final, now.final_screening, progress, others)
            best = decide(further, exchange_judge(data, now.final, progress))
            tried = tried if best is None else further
        if best is None:
            room = len(now.searched) < MOST_EFFECTS - 1
            added = find_pair(data, tried, null, progress) if room else ()
        else:
            added, better = (), None
            if resumed < MOST_RESUMPTIONS:
                better = resume_stalled_fit(data.train, now.final, best)
            if better is not None:
                progress(f"{best.effect} gained only what the fit without it still owed")
                resumed += 1
                now = replace(now, final=better, final_screening=screen(data.train, better))
                if not now.effects:
                    now = replace(now, nominal=better, nominal_screening=now.final_screening)
                continue
            added, owed = (AcceptedEffect(best, tried),), tried.owed_beside(best)
        if current_budget().skips("the search for further effects"):
            return replace(now, complete=False)  # fits that judge these were cut short
        if not added:
            break
        for one in added:
            progress(f"found: {catalogue_name(one.name)}")
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
        progress(f"no effect alone has one size in all the data; beside {one.effect} another?")
        screening = screen(data.train, one.estimate)
        beside = refit_candidates(data, one.estimate, screening, progress)
        other = decide(beside, exchange_judge(data, one.estimate, progress))
        if other is None:
            continue
        bare = refit_without(data.train, other.estimate, [one.effect])
        again = refit_fully(data, bare, one.candidate, other.estimate.coordinates)
        left = null.of_located(screen(data.train, other.estimate).located_p_value)
        gained = alone.hypotheses[0].estimate.deviance - other.estimate.deviance
        if gained > -EVIDENCE and again.still_stands(alone.needed) and left > ALPHA:
            return AcceptedEffect(one, alone), AcceptedEffect(other, beside)
    return ()


def resume_stalled_fit(problem: Problem, current: Estimate, best: Hypothesis) -> Estimate | None:
    """A better fit without the effect, where the current one had stopped early; else None.

    Sought from where the fit with the effect ended, if that gained more than scores promise: a
    name is not to be had for the progress of a fit.
    """
    score = best.candidate.score
    if best.deviance_drop < SELDOM_GAINED * score.statistic * score.inflation:
        return None
    again = refit_without(problem, best.estimate, [best.effect])
    gained = current.deviance - again.deviance
    return again if gained > OWED_TO_THE_FIT * best.deviance_drop else None
