"""From a mismatch to names: screen, refit a short list, decide, say what is left.

Screening by score tests only makes a short list. Each of it is refitted from the prior
and judged by evidence and by held-out data; accepted effects are added one at a time
until nothing is left to explain or nothing explains it, and each is then asked for again.
"""

import dataclasses

import numpy as np

from diffsea.diagnosis.bootstrap import NONE, Bootstrap, bootstrap
from diffsea.diagnosis.candidates import candidates
from diffsea.diagnosis.refit import Fitted, Progress, completed, ranked, refitted
from diffsea.diagnosis.remainder import Remainder, remainder
from diffsea.diagnosis.screening import Screening, locate, screen, short_list
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate
from diffsea.identification.holdout import Split, exchanged_gain, split
from diffsea.identification.problem import Problem, free_by_default, make_problem
from diffsea.identification.tape import Shape
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import catalogue_name


ALPHA = 0.01  # family-wise
EVIDENCE = 10.0  # twice the log of odds of 150 to 1
MOST_EFFECTS = 3
ROOM = 8  # coordinates that effects found together may have
BEYOND = 2.0  # times what its score promises: more than that an effect seldom gains
RESUMED = 2  # times at most that a fit is found to have stopped early


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
        inflation = self.fitted.estimate.inflation
        others = [
            one.support(inflation)
            for one in self.tried
            if one.possible and catalogue_name(one.effect) != catalogue_name(self.name)
        ]
        return self.fitted.support(inflation) - max([0.0, *others])


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Everything found."""

    verdict: str
    split: Split
    nominal: Estimate
    final: Estimate
    effects: tuple[Accepted, ...]
    refitted: tuple[Fitted, ...]  # the first short list
    before: Screening  # against the nominal model
    after: Screening  # against the final one
    where: Screening  # unnamed forces in the nominal model, measured by the final noise
    dropped: tuple[str, ...] = ()  # accepted first, found needless or doubtful later
    unnamed: Remainder | None = None  # a model of what is left, where that is significant
    bootstrap: Bootstrap = NONE

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the accepted effects."""
        return tuple(accepted.name for accepted in self.effects)

    @property
    def left(self) -> float:
        """Family-wise p-value of what the final model leaves."""
        return self.bootstrap.of_located(self.after.remainder)


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
    free = free_by_default(vessel) if free is None else free
    effects = candidates(vessel, [*recordings, *(test or [])])

    def problem_of(runs: list[Trajectory], least: Shape) -> Problem:
        return make_problem(vessel, runs, free, effects, per_run, ROOM, least=least)

    data = split(problem_of, recordings, test or [], per_run)
    progress("fitting the nominal model")
    nominal = estimate(data.train, free, progress=progress)
    progress("screening the catalogue")
    first = screen(data.train, nominal, data.recordings)
    drawn = bootstrap(data.train, nominal, data.recordings, draws, progress) if draws else NONE
    accepted: list[Accepted] = []
    shown: tuple[Fitted, ...] = ()
    current, screening, resumed = nominal, first, 0
    while len(accepted) < MOST_EFFECTS and drawn.of_strongest(screening.p_value) < ALPHA:
        tried = _tried(data, current, screening, progress)
        shown = tuple(tried) if not accepted else shown
        best = decide(data, current, tried, progress)
        if best is None:
            break
        better = stalled(data.train, current, best) if resumed < RESUMED else None
        if better is not None:
            progress(f"{best.effect}: its fit went on where the one without it had stopped")
            current, resumed = better, resumed + 1
            screening = screen(data.train, current, data.recordings)
            nominal, first = (nominal, first) if accepted else (current, screening)
            continue
        accepted.append(Accepted(best.effect, best, rivals(best, tried), tuple(tried)))
        progress(f"accepted: {catalogue_name(best.effect)}")
        current = best.estimate
        screening = screen(data.train, current, data.recordings)
    kept = revised(data, accepted, current, progress)
    if kept.changed:
        current = kept.estimate
        screening = screen(data.train, current, data.recordings)
    left, named = drawn.of_located(screening.remainder), kept.effects
    doubtful = [one.name for one in named if left < ALPHA and outdone(one, screening)]
    if doubtful:
        current = _without(data.train, current, doubtful)
        screening = screen(data.train, current, data.recordings)
        named = tuple(one for one in named if one.name not in doubtful)
        left = min(left, drawn.of_located(screening.remainder))
    if not named and nameless(data.train, shown):
        left = min(left, drawn.of_strongest(screening.p_value))
    verdict = _verdict(named, left)
    unnamed = None
    if verdict == "unexplained":
        progress("modelling what is left")
        unnamed = remainder(data, current)
    where = first
    if named:
        progress("locating the mismatch")
        where = locate(data.train, nominal, current)
    return Diagnosis(
        verdict, data, nominal, current, named, shown, first, screening, where,
        (*kept.dropped, *doubtful), unnamed, drawn,
    )  # fmt: skip


def outdone(one: Accepted, after: Screening) -> bool:
    """Whether what is left stands out more than an effect did: then both may have another cause."""
    strongest = max((cell.z**2 for cell in after.cells), default=0.0)
    return one.fitted.seen.score.statistic < strongest


def stalled(problem: Problem, current: Estimate, best: Fitted) -> Estimate | None:
    """A better fit without the effect, where the one so far had stopped early; else None.

    Sought from where the fit with the effect ended, if that gained more than scores promise: a
    name is not to be had for the progress of a fit.
    """
    promised = best.seen.score.statistic * best.seen.score.inflation
    if best.drop < BEYOND * promised:
        return None
    again = _without(problem, best.estimate, [best.effect])
    return again if current.deviance - again.deviance > 0.5 * best.drop else None


def _without(problem: Problem, current: Estimate, names: list[str]) -> Estimate:
    """The estimate without some of its effects."""
    free = tuple(name for name in current.free if name not in names)
    start = np.array(current.coordinates, float)
    start[problem.layout.indices(tuple(names))] = 0.0
    return estimate(problem, free, start, current.noise)


def _doubtful(problem: Problem, current: Estimate) -> set[str]:
    """Names that what is left over may only resemble.

    Where an effect came out larger than its law holds for, the error of that law is left over,
    and it looks like the effect's confusables.
    """
    names: set[str] = set()
    for effect in problem.layout.effects:
        if effect.name in current.free:
            place = problem.layout.indices((effect.name,))[0]
            if abs(current.coordinates[place]) > effect.valid:
                names |= set(effect.confusables)
    return names


def _tried(
    data: Split, current: Estimate, screening: Screening, progress: Progress
) -> list[Fitted]:
    """The short list refitted, as far as the compiled program has room for it."""
    problem = data.train
    room = problem.width - len(problem.layout.indices(current.free))
    declared = {effect.name: effect.confusables for effect in problem.layout.effects}
    names = [
        name
        for name in short_list(screening, declared)
        if len(problem.layout.indices((name,))) <= room
        and catalogue_name(name) not in _doubtful(problem, current)
    ]
    if not names:
        return []
    return refitted(data, current, screening.seen, names, progress)


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
    inflation = judged[0].estimate.inflation
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
            gain = gain.pooled(exchanged_gain(data, current, one.estimate))
        if gain.clear:
            return dataclasses.replace(one, gain=gain)
    return None


def _stands(problem: Problem, accepted: Fitted) -> bool:
    """Whether an effect that held-out data have spoken for once is still needed.

    Beside others they may leave it open; against it speaks a lack of evidence, or their loss.
    """
    gain, constant = accepted.gain, accepted.constancy
    if not accepted.possible or gain is None or constant is None or not constant.holds:
        return False
    enough = accepted.evidence(accepted.estimate.inflation) > needed(problem)
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
    return any(one.support(one.estimate.inflation) > needed(problem) for one in sound)


def rivals(best: Fitted, tried: list[Fitted]) -> tuple[str, ...]:
    """Names that the same data support nearly as well."""
    names: list[str] = []
    inflation = best.estimate.inflation
    for other in tried:
        name = catalogue_name(other.effect)
        same = name == catalogue_name(best.effect) or name in names
        judged = other.possible and other.gain is not None
        if judged and not same and best.support(inflation) - other.support(inflation) < EVIDENCE:
            names.append(name)
    return tuple(names)


@dataclasses.dataclass(frozen=True)
class Revision:
    """What was accepted, after each of it was asked for again."""

    effects: tuple[Accepted, ...]
    estimate: Estimate
    dropped: tuple[str, ...]
    changed: bool


def revised(
    data: Split, accepted: list[Accepted], current: Estimate, progress: Progress
) -> Revision:
    """Ask for every effect but the last again, now that the others are in the model.

    Without it, and with each of its near rivals instead: what was accepted first was judged
    while the others' effects were still in the data.
    """
    effects, dropped, changed = list(accepted), [], False
    for one in accepted[:-1]:
        progress(f"asking again for {one.name}")
        without = _without(data.train, current, [one.name])
        options = [one.fitted, *(t for t in one.tried if t.gain is not None and t.possible)]
        options = {t.effect: t for t in options if t.effect not in without.free}
        again = ranked([completed(data, without, t) for t in options.values()])
        best = decide(data, without, again, progress)
        mine = next((t for t in again if t.effect == one.name), None)
        if best is None and mine is not None and _stands(data.train, mine):
            continue
        if best is None:
            effects.remove(one)
            dropped.append(one.name)
            current, changed = without, True
        elif best.effect != one.name or rivals(best, again) != one.rivals:
            new = Accepted(best.effect, best, rivals(best, again), tuple(again))
            effects[effects.index(one)] = new
            changed = changed or best.effect != one.name
            current = best.estimate
    return Revision(tuple(effects), current, tuple(dropped), changed)


def _verdict(accepted: tuple[Accepted, ...], left: float) -> str:
    if left < ALPHA:
        return "unexplained"
    if not accepted:
        return "consistent"
    if any(one.rivals for one in accepted):
        return "ambiguous"
    return "explained"
