"""Each accepted effect asked for again, beside those that came after it.

From a mismatch to names: screen, refit a short list, decide, say what is left.

Screening by score tests only makes a short list. Each of it is refitted from the prior
and judged by evidence and by held-out data; accepted effects are added one at a time
until nothing is left to explain or nothing explains it, and each is then asked for again.
"""

import dataclasses

from diffsea.diagnosis.bootstrap import NONE, Bootstrap, bootstrap, check
from diffsea.diagnosis.decision import (
    Accepted,
    decide,
    footholds,
    nameless,
    outdone,
    rivals,
    stands,
)  # fmt: skip
from diffsea.diagnosis.refit import (
    EVIDENCE,
    Fitted,
    Progress,
    completed,
    has_room,
    ranked,
    refitted,
    without,
)
from diffsea.diagnosis.screening import Screening, candidates, locate, screen, short_list
from diffsea.diagnosis.unexplained import Remainder, remainder
from diffsea.identification.data.dataset import DatasetShape
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate
from diffsea.identification.holdout import Split, split_data
from diffsea.identification.problem import Problem, free_by_default, make_problem
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import catalogue_name


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


ALPHA = 0.01  # family-wise
MOST_EFFECTS = 3
ROOM = 9  # coordinates that effects found together may have: waves and a wind, say
BEYOND = 2.0  # times what its score promises: more than that an effect seldom gains
FOOTHOLDS = 3  # effects beside which another is sought at most
RESUMED = 2  # times at most that a fit is found to have stopped early


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Everything found."""

    verdict: str
    split_data: Split
    nominal: Estimate
    final: Estimate
    effects: tuple[Accepted, ...]
    refitted: tuple[Fitted, ...]  # the first short list
    before: Screening  # against the nominal model
    after: Screening  # against the final one
    where: Screening  # unnamed forces in the nominal model, measured by the final noise
    left: float  # family-wise p-value of what no accepted effect explains
    dropped: tuple[str, ...] = ()  # accepted first, found needless or doubtful later
    unnamed: Remainder | None = None  # a model of what is left, where that is significant
    bootstrap: Bootstrap = NONE

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the accepted effects."""
        return tuple(accepted.name for accepted in self.effects)


@one_blas_thread
def diagnose(
    vessel: Vessel,
    recordings: list[Trajectory],
    test: list[Trajectory] | None = None,
    per_run: bool = False,
    free: tuple[str, ...] | None = None,
    progress: Progress = lambda message: None,
    draws: int = 0,
) -> Diagnosis:
    """Find, name and model what the vessel's model lacks.

    Arguments:
        vessel: the nominal model.
        recordings: what to explain.
        test: held-out recordings; the last part of each recording where there are none.
        per_run: whether wind and current differ from run to run.
        free: parameters that may move; `free_by_default` if None.
        draws: data sets to simulate and refit for the chance of what is seen; 0: to first order.

    Raises:
        UserError: recordings that do not fit the vessel; too few draws.
    """
    if draws:
        check(draws)
    free = free_by_default(vessel) if free is None else free
    effects = candidates(vessel, [*recordings, *(test or [])], per_run)

    def problem_of(runs: list[Trajectory], least: DatasetShape) -> Problem:
        return make_problem(vessel, runs, free, effects, per_run, ROOM, least=least)

    data = split_data(problem_of, recordings, test or [], per_run)
    progress("fitting the nominal model")
    nominal = estimate(data.train, free, progress=progress)
    progress("screening the catalogue")
    first = screen(data.train, nominal)
    drawn = bootstrap(data.train, nominal, draws, progress) if draws else NONE
    found = forward(data, nominal, first, drawn, progress)
    return concluded(data, found, drawn, progress)


@dataclasses.dataclass(frozen=True)
class Forward:
    """Where the forward search ended."""

    nominal: Estimate
    first: Screening  # against it
    current: Estimate
    screening: Screening  # against that
    accepted: tuple[Accepted, ...]
    shown: tuple[Fitted, ...]  # the first short list


def forward(
    data: Split, nominal: Estimate, first: Screening, drawn: Bootstrap, progress: Progress
) -> Forward:
    """Add one effect after the other until nothing is left to explain or nothing explains it."""
    accepted: list[Accepted] = []
    shown: tuple[Fitted, ...] = ()
    current, screening, resumed = nominal, first, 0
    while len(accepted) < MOST_EFFECTS and drawn.of_strongest(screening.p_value) < ALPHA:
        tried = _tried(data, current, screening, progress)
        shown = tuple(tried) if not accepted else shown
        best = decide(data, current, tried, progress)
        if best is None:
            room = len(accepted) < MOST_EFFECTS - 1
            both = together(data, current, tried, drawn, progress) if room else ()
            if not both:
                break
            accepted += both
            current = both[-1].fitted.estimate
            screening = screen(data.train, current)
            continue
        better = stalled(data.train, current, best) if resumed < RESUMED else None
        if better is not None:
            progress(f"{best.effect}: its fit went on where the one without it had stopped")
            current, resumed = better, resumed + 1
            screening = screen(data.train, current)
            nominal, first = (nominal, first) if accepted else (current, screening)
            continue
        accepted.append(Accepted(best.effect, best, rivals(best, tried), tuple(tried)))
        progress(f"accepted: {catalogue_name(best.effect)}")
        current = best.estimate
        screening = screen(data.train, current)
    return Forward(nominal, first, current, screening, tuple(accepted), shown)


def together(
    data: Split, current: Estimate, tried: list[Fitted], drawn: Bootstrap, progress: Progress
) -> tuple[Accepted, ...]:
    """Two effects that leave nothing, where one alone has not one size in all the data.

    Each must stand beside the other, and both together explain what the best alone does.
    """
    for one in footholds(data, tried)[:FOOTHOLDS]:
        progress(f"no effect alone has one size in all the data; beside {one.effect} another?")
        screening = screen(data.train, one.estimate)
        more = _tried(data, one.estimate, screening, progress)
        other = decide(data, one.estimate, more, progress)
        if other is None:
            continue
        bare = without(data.train, other.estimate, [one.effect])
        again = completed(data, bare, one, other.estimate.coordinates)
        left = screen(data.train, other.estimate)
        enough = tried[0].estimate.deviance - other.estimate.deviance > -EVIDENCE
        if enough and stands(data.train, again) and drawn.of_located(left.remainder) > ALPHA:
            return (
                Accepted(one.effect, one, rivals(one, tried), tuple(tried)),
                Accepted(other.effect, other, rivals(other, more), tuple(more)),
            )
    return ()


def concluded(data: Split, found: Forward, drawn: Bootstrap, progress: Progress) -> Diagnosis:
    """Ask for every name again, withdraw what more than it is left beside, and say what is left."""
    accepted = list(found.accepted)
    kept = revised(data, accepted, accepted[:-1], found.current, progress)
    screening = screen(data.train, kept.estimate) if kept.changed else found.screening
    left = drawn.of_located(screening.remainder)
    dropped = list(kept.dropped)
    doubtful = [one.name for one in kept.effects if left < ALPHA and outdone(one, screening)]
    if doubtful:
        # What was found beside them is asked for without them.
        rest = [one for one in kept.effects if one.name not in doubtful]
        bare = without(data.train, kept.estimate, doubtful)
        kept = revised(data, rest, rest, bare, progress)
        screening = screen(data.train, kept.estimate)
        left = min(left, drawn.of_located(screening.remainder))
        dropped += [*kept.dropped, *doubtful]
    current, named = kept.estimate, kept.effects
    if not named and nameless(data.train, found.shown):
        left = min(left, drawn.of_strongest(screening.p_value))
    verdict = _verdict(named, left)
    unnamed = None
    if verdict == "unexplained":
        progress("modelling what is left")
        unnamed = remainder(data, current)
    where = found.first
    if named:
        progress("locating the mismatch")
        where = locate(data.train, found.nominal, current)
    return Diagnosis(
        verdict, data, found.nominal, current, named, found.shown, found.first, screening, where,
        left, tuple(dropped), unnamed, drawn,
    )  # fmt: skip


def stalled(problem: Problem, current: Estimate, best: Fitted) -> Estimate | None:
    """A better fit without the effect, where the one so far had stopped early; else None.

    Sought from where the fit with the effect ended, if that gained more than scores promise: a
    name is not to be had for the progress of a fit.
    """
    promised = best.seen.score.statistic * best.seen.score.inflation
    if best.drop < BEYOND * promised:
        return None
    again = without(problem, best.estimate, [best.effect])
    return again if current.deviance - again.deviance > 0.5 * best.drop else None


def _doubtful(problem: Problem, current: Estimate) -> set[str]:
    """Names that what is left over may only resemble.

    Where an effect came out larger than its law holds for, the error of that law is left over,
    and it looks like the effect's confusables.
    """
    names: set[str] = set()
    for effect in problem.layout.effects:
        if effect.name in current.free:
            place = problem.layout.indices((effect.name,))[0]
            if abs(current.coordinates[place]) > effect.leading.valid_to:
                names |= set(effect.confusables)
    return names


def _tried(
    data: Split, current: Estimate, screening: Screening, progress: Progress
) -> list[Fitted]:
    """The short list refitted, as far as the compiled program has room for it."""
    problem = data.train
    declared = {effect.name: effect.confusables for effect in problem.layout.effects}
    names = [
        name
        for name in short_list(screening, declared)
        if has_room(problem, current, name)
        and catalogue_name(name) not in _doubtful(problem, current)
    ]
    if not names:
        return []
    return refitted(data, current, screening.seen, names, progress)


def _verdict(accepted: tuple[Accepted, ...], left: float) -> str:
    if left < ALPHA:
        return "unexplained"
    if not accepted:
        return "consistent"
    if any(one.rivals for one in accepted):
        return "ambiguous"
    return "explained"
