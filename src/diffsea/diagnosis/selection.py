"""Stepwise selection of effects: forward, one after the other, and backward, asking for each again.

Screening by score tests only makes a short list. Each of it is refitted from the prior and judged
by evidence and by held-out data; accepted effects are added one at a time until nothing is left to
explain or nothing explains it. What was accepted early is asked for again beside what came later.
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
from diffsea.diagnosis.starts import start_beside, start_with_effects_of
from diffsea.identification.estimates import ONE_SIDED_95, Estimate
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
        best = _decide(data, now.final, tried, progress, effort.insists)
        if best is None and not effort.insists:
            break
        if best is None and (others := tried.left_behind()):
            progress("none of the likeliest causes holds; others are asked for")
            further = refit_candidates(data, now.final, now.final_screening, progress, others)
            best = _decide(data, now.final, further, progress)
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
        other = _decide(data, one.estimate, beside, progress)
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


def _decide(
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


def ask_again(
    data: Split, found: Search, asked: tuple[AcceptedEffect, ...], progress: Progress
) -> tuple[Search, bool]:
    """Ask for some of the effects again; and whether another model came of it.

    Without it, and with each of its near rivals instead: what was accepted was judged beside
    others, while the effects of later ones were still in the data.
    """
    current, effects, dropped, changed = found.final, list(found.effects), [], False
    for one in asked:
        if current_budget().skips(f"asking again for {spoken_name(one.name)}"):
            break
        progress(f"is {spoken_name(one.name)} needed beside the others?")
        bare = refit_without(data.train, current, [one.name], one.hypothesis.without)
        again = _refit_with_rivals(data, bare, current, one)
        tried = ShortList.of(data.train, again)
        best = _decide(data, bare, tried, progress)
        if current_budget().skips(f"asking again for {spoken_name(one.name)}"):
            break  # fits were cut short
        if best is None:
            same = next((option for option in again if option.effect == one.name), None)
            best = same if same is not None and same.still_stands(tried.needed) else None
            stays = best is not None
        else:
            stays = best.effect == one.name and AcceptedEffect(best, tried).rivals == one.rivals
        if best is None:
            effects.remove(one)
            dropped.append(one.name)
            current, changed = bare, True
        elif stays:
            # As it was accepted, with the constancy that its size has beside the others.
            hypothesis = replace(one.hypothesis, constancy=best.constancy)
            effects[effects.index(one)] = replace(one, hypothesis=hypothesis)
        else:
            effects[effects.index(one)] = AcceptedEffect(best, tried)
            changed = changed or best.effect != one.name
            current = best.estimate
    kept = replace(found, final=current, effects=tuple(effects), dropped=(*found.dropped, *dropped))
    return kept, changed


def _refit_with_rivals(
    data: Split, bare: Estimate, current: Estimate, accepted: AcceptedEffect
) -> list[Hypothesis]:
    """An accepted effect and its near rivals, each fitted beside what is left without it."""
    rivals = [accepted.hypothesis, *accepted.short_list.judged]
    options = {one.effect: one for one in rivals if one.effect not in bare.free}

    def refit(one: Hypothesis) -> Refit:
        if one.effect == accepted.name:
            return Refit(one.candidate, [Start.at(current)])
        beside = Start.beside(bare, start_beside(data.train, bare, one))
        free = (*bare.free, one.effect)
        as_it_was = start_with_effects_of(data.train, one.estimate, bare, free)
        return Refit(one.candidate, [beside, as_it_was])

    return refit_fully(data, bare, [refit(one) for one in options.values()])


def withdraw_outdone(data: Split, kept: Search, null: Bootstrap, progress: Progress) -> Search:
    """Withdraw names that stood out no more than what is left does: both may have another cause.

    A name stands out by its score or by what its fit gained, whichever is the more: a score at zero
    may say little of a fit. The other effects are asked for without them. Two statistics whose
    centre is far from zero differ by chance, as their variance of four times the centre says.
    """
    left = null.of_located(kept.final_screening.located_p_value)
    strongest = max((cell.z**2 for cell in kept.final_screening.cells), default=0.0)

    def is_outdone(statistic: float) -> bool:
        chance = 2 * ONE_SIDED_95 * math.sqrt(statistic + strongest)
        return statistic < strongest + chance

    outdone = [one.name for one in kept.searched if is_outdone(one.hypothesis.statistic)]
    if left >= ALPHA or not outdone:
        return kept
    if current_budget().skips("whether names stand out more than what is left"):
        return kept
    others = tuple(one for one in kept.effects if one.name not in outdone)
    known = next(one.hypothesis.without for one in kept.effects if one.name in outdone)
    bare = refit_without(data.train, kept.final, outdone, known)
    rest = replace(kept, final=bare, effects=others)
    rest, _ = ask_again(data, rest, rest.searched, progress)
    screening = screen(data.train, rest.final)
    return replace(rest, final_screening=screening, dropped=(*rest.dropped, *outdone))


def withdraw_worsening(data: Split, kept: Search, progress: Progress) -> Search:
    """Withdraw names, the last one first, until predictions are no worse than without any.

    Each predicted the motion no worse than those before it, beyond chance and noticeably: several
    that are each a little worse may be much worse together.
    """
    while kept.searched and not current_budget().skips("whether all names predict no worse"):
        progress("does the vessel with all that was found move as the recorded one?")
        if not motion_change(data, kept.nominal, kept.final).is_worse:
            break
        last = kept.searched[-1]
        bare = refit_without(data.train, kept.final, [last.name], last.hypothesis.without)
        kept = replace(
            kept,
            final=bare,
            final_screening=screen(data.train, bare),
            effects=tuple(one for one in kept.effects if one is not last),
            dropped=(*kept.dropped, last.name),
        )
    return kept
