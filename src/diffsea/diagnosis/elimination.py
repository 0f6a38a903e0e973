"""Backward elimination of effects that were accepted beside others.

What was accepted early is asked for again beside what came later, and when it began; what stands
out no more than what is left over, and what makes predictions worse together with the rest, is
withdrawn.
"""

import math
from dataclasses import replace

from diffsea.budget import current_budget
from diffsea.diagnosis.bootstrap import Bootstrap
from diffsea.diagnosis.decision import AcceptedEffect, ShortList
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.onsets import with_onset_beside_others
from diffsea.diagnosis.refits import Refit, refit_fully, refit_without
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.selection import ALPHA, Search, choose
from diffsea.diagnosis.starts import start_beside, start_with_effects_of
from diffsea.identification.estimates import ONE_SIDED_95, Estimate
from diffsea.identification.fit import Start
from diffsea.identification.free_predictions import motion_change
from diffsea.identification.holdout import Split
from diffsea.progress import Progress
from diffsea.vessel.effects import spoken_name


def ask_when_again(data: Split, found: Search, progress: Progress) -> Search:
    """Ask again when changes began, beside the effects that were found after them."""
    final, effects = found.final, list(found.effects)
    for one in found.searched[:-1]:
        final, hypothesis = with_onset_beside_others(data.train, final, one.hypothesis, progress)
        effects[effects.index(one)] = replace(one, hypothesis=hypothesis)
    if final is found.final:
        return found
    screening = screen(data.train, final)
    return replace(found, final=final, final_screening=screening, effects=tuple(effects))


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
        best = choose(data, bare, tried, progress)
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
    rivals = [*accepted.short_list.judged, accepted.hypothesis]  # as it is now
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
