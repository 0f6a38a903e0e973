"""Each accepted effect asked for again, beside those that came after it."""

import dataclasses

from diffsea.diagnosis.decision import Accepted, decide, rivals, stands
from diffsea.diagnosis.refit import Fitted, Progress, completed, has_room, ranked, without
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Split


@dataclasses.dataclass(frozen=True)
class Revision:
    """What was accepted, after each of it was asked for again."""

    effects: tuple[Accepted, ...]
    estimate: Estimate
    dropped: tuple[str, ...]
    changed: bool


def revised(
    data: Split,
    accepted: list[Accepted],
    asked: list[Accepted],
    current: Estimate,
    progress: Progress,
) -> Revision:
    """Ask for some of the effects again, with those that are in the model now.

    Without it, and with each of its near rivals instead: what was accepted was judged beside
    others, while the effects of later ones were still in the data.
    """
    effects, dropped, changed = list(accepted), [], False
    for one in asked:
        progress(f"asking again for {one.name}")
        bare = without(data.train, current, [one.name])
        options = [one.fitted, *(t for t in one.tried if t.gain is not None and t.possible)]
        options = {
            t.effect: t
            for t in options
            if t.effect not in bare.free and has_room(data.train, bare, t.effect)
        }
        again = ranked([
            completed(data, bare, t, current.coordinates if t.effect == one.name else None)
            for t in options.values()
        ])  # fmt: skip
        best = decide(data, bare, again, progress)
        mine = next((t for t in again if t.effect == one.name), None)
        if best is None and mine is not None and stands(data.train, mine):
            effects[effects.index(one)] = _beside_the_others(one, mine)
            continue
        if best is None:
            effects.remove(one)
            dropped.append(one.name)
            current, changed = bare, True
        elif best.effect != one.name or rivals(best, again) != one.rivals:
            new = Accepted(best.effect, best, rivals(best, again), tuple(again))
            effects[effects.index(one)] = new
            changed = changed or best.effect != one.name
            current = best.estimate
        else:
            effects[effects.index(one)] = _beside_the_others(one, best)
    return Revision(tuple(effects), current, tuple(dropped), changed)


def _beside_the_others(one: Accepted, again: Fitted) -> Accepted:
    """What was accepted, with the constancy that its size has now."""
    return dataclasses.replace(
        one, fitted=dataclasses.replace(one.fitted, constancy=again.constancy)
    )
