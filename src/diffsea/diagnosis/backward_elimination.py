"""Backward elimination: effects that were accepted early are asked for again beside later ones."""

import math
from dataclasses import replace

from diffsea.budget import current_budget
from diffsea.diagnosis.bootstrap import Bootstrap
from diffsea.diagnosis.decision import AcceptedEffect, ShortList, decide
from diffsea.diagnosis.refits import has_room, refit_fully, refit_without, start_beside
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.search import ALPHA, Search, exchange_judge
from diffsea.identification.estimates import ONE_SIDED_95
from diffsea.identification.holdout import Split
from diffsea.progress import Progress


def ask_again(
    data: Split, found: Search, asked: tuple[AcceptedEffect, ...], progress: Progress
) -> tuple[Search, bool]:
    """Ask for some of the effects again; and whether another model came of it.

    Without it, and with each of its near rivals instead: what was accepted was judged beside
    others, while the effects of later ones were still in the data.
    """
    current, effects, dropped, changed = found.final, list(found.effects), [], False
    for one in asked:
        if current_budget().skips(f"asking again for {one.name}"):
            break
        progress(f"is {one.name} needed beside the others?")
        bare = refit_without(data.train, current, [one.name])
        options = {
            hypothesis.effect: hypothesis
            for hypothesis in (one.hypothesis, *one.short_list.judged)
            if hypothesis.effect not in bare.free and has_room(data.train, bare, hypothesis.effect)
        }
        again = [
            refit_fully(
                data,
                bare,
                option.candidate,
                current.coordinates if name == one.name else start_beside(data.train, bare, option),
            )
            for name, option in options.items()
        ]
        tried = ShortList.of(data.train, again)
        best = decide(tried, exchange_judge(data, bare, progress))
        if current_budget().skips(f"asking again for {one.name}"):
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


def withdraw_outdone(data: Split, kept: Search, null: Bootstrap, progress: Progress) -> Search:
    """Withdraw names that stood out no more than what is left does: both may have another cause.

    The other effects are asked for without them. Two statistics whose centre is far from zero
    differ by chance, as their variance of four times the centre says.
    """
    left = null.of_located(kept.final_screening.located_p_value)
    strongest = max((cell.z**2 for cell in kept.final_screening.cells), default=0.0)

    def is_outdone(statistic: float) -> bool:
        chance = 2 * ONE_SIDED_95 * math.sqrt(statistic + strongest)
        return statistic < strongest + chance

    outdone = [
        one.name for one in kept.searched if is_outdone(one.hypothesis.candidate.score.statistic)
    ]
    if left >= ALPHA or not outdone:
        return kept
    if current_budget().skips("whether names stand out more than what is left"):
        return kept
    others = tuple(one for one in kept.effects if one.name not in outdone)
    bare = refit_without(data.train, kept.final, outdone)
    rest = replace(kept, final=bare, effects=others)
    rest, _ = ask_again(data, rest, rest.searched, progress)
    screening = screen(data.train, rest.final)
    return replace(rest, final_screening=screening, dropped=(*rest.dropped, *outdone))
