"""From a mismatch to a name: screen, refit a short list, decide, say what is left.

Screening by score tests only makes a short list. Each of it is refitted from the prior
and judged by evidence and by held-out data; accepted effects are added one at a time
until nothing is left to explain or nothing explains it.
"""

import dataclasses
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np

from diffsea.diagnosis.candidates import candidates
from diffsea.diagnosis.locate import Cell, locate, regimes, time_windows
from diffsea.diagnosis.score import Projection, Score
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate
from diffsea.identification.found_effects import catalogue_name
from diffsea.identification.holdout import Gain, Split, exchanged_gain, gain, split
from diffsea.identification.problem import Problem, free_by_default, jacobian, make_problem, traced
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import AbstractEffect


Progress = Callable[[str], None]

ALPHA = 0.01  # family-wise level of the screening
EVIDENCE = 10.0  # difference of BIC that decides
SHORT_LIST = 6
MOST_EFFECTS = 3
CONFUSABLE = 0.5  # share of information mimicked from which a rival is always refitted


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A refitted hypothesis: the effects added so far and one more."""

    effect: str
    estimate: Estimate
    drop: float  # of the deviance against the hypothesis without it
    size: int  # coordinates it adds
    count: float  # measured values
    gain: Gain  # on held-out data
    score: Score
    possible: bool  # inside physical bounds

    def bic(self, inflation: float) -> float:
        """Difference of BIC to the hypothesis without it; positive where better.

        `inflation` says how many dependent values count as one (of the best hypothesis:
        under a wrong one the dependence is the effect itself).
        """
        return self.drop / inflation - self.size * float(np.log(self.count / inflation))


@dataclasses.dataclass(frozen=True)
class Accepted:
    """An effect that was accepted, with what else could have been."""

    name: str
    fitted: Fitted
    rivals: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Everything found."""

    verdict: str
    split: Split
    nominal: Estimate
    final: Estimate
    effects: tuple[Accepted, ...]
    screened: dict[str, Score]  # against the nominal model
    refitted: tuple[Fitted, ...]  # the first short list
    before: tuple[Cell, ...]  # where, against the nominal model
    after: tuple[Cell, ...]  # where, against the final one
    remainder: float  # family-wise p-value of structure left

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the accepted effects."""
        return tuple(accepted.name for accepted in self.effects)


@dataclasses.dataclass(frozen=True)
class Screening:
    """Scores of all candidates against one estimate, and where the mismatch is."""

    scores: dict[str, Score]
    columns: dict[str, np.ndarray]
    projection: Projection
    cells: tuple[Cell, ...]


def diagnose(
    vessel: Vessel,
    recordings: list[Trajectory],
    test: list[Trajectory] | None = None,
    per_run: bool = False,
    free: tuple[str, ...] | None = None,
    progress: Progress = lambda message: None,
) -> Diagnosis:
    """Find, name and model what the vessel's model lacks.

    Arguments:
        vessel: the nominal model.
        recordings: what to explain.
        test: held-out recordings; the last part of each recording where there are none.
        per_run: whether wind and current differ from run to run.
        free: parameters that may move; `free_by_default` if None.

    Raises:
        UserError: recordings that do not fit the vessel.
    """
    free = free_by_default(vessel) if free is None else free
    effects = candidates(vessel)

    def problem_of(runs: list[Trajectory]) -> Problem:
        return make_problem(vessel, runs, free, effects, per_run, 2 * MOST_EFFECTS)

    data = split(problem_of, recordings, test or [], per_run)
    progress("fitting the nominal model")
    nominal = estimate(data.train, free, progress=progress)
    progress("screening the catalogue")
    first = screen(data.train, nominal)
    accepted: list[Accepted] = []
    shown: tuple[Fitted, ...] = ()
    current, screening = nominal, first
    for _ in range(MOST_EFFECTS):
        if not suspicious(screening):
            break
        tried = refit_short_list(data, current, screening, progress)
        shown = shown or tuple(tried)
        best = decide(data, current, tried, progress)
        if best is None:
            break
        rivals = ambiguous_with(best, tried)
        accepted.append(Accepted(best.effect, best, rivals))
        progress(f"accepted: {catalogue_name(best.effect)}")
        current = best.estimate
        screening = screen(data.train, current)
    left = remainder(screening.cells)
    verdict = _verdict(accepted, left)
    return Diagnosis(
        verdict, data, nominal, current, tuple(accepted), first.scores, shown, first.cells,
        screening.cells, left,
    )  # fmt: skip


def screen(problem: Problem, fitted: Estimate) -> Screening:
    """Score every candidate that is not in the model, and locate the mismatch."""
    tuned = problem.tuned(fitted.coordinates, fitted.noise)
    columns: dict[str, np.ndarray] = {}
    residual, nuisance = columns_at(problem, tuned.gains, fitted, fitted.free)
    projection = Projection(residual, nuisance, np.asarray(problem.tape.run))
    scores = {}
    for group in _groups(problem, fitted.free):
        _, J = columns_at(problem, tuned.gains, fitted, group)
        position = 0
        for name in group:
            k = len(problem.layout.indices((name,)))
            columns[name] = J[:, position : position + k]
            scores[name] = projection.score(columns[name])
            position += k
    empty = np.zeros((problem.layout.size, problem.width))
    inputs, layout = traced(problem, tuned.gains, fitted.coordinates, empty)
    binnings = [time_windows(problem), *regimes(problem)]
    cells = locate(problem, inputs, layout, projection, binnings)
    return Screening(scores, columns, projection, tuple(cells))


def _groups(problem: Problem, free: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Candidates packed into groups that fit the compiled program's room."""
    groups: list[list[str]] = [[]]
    size = 0
    for effect, sizes in zip(problem.layout.effects, problem.layout.sizes, strict=True):
        if effect.name in free:
            continue
        k = len(sizes)
        if size + k > problem.seeds:
            groups.append([])
            size = 0
        groups[-1].append(effect.name)
        size += k
    return [tuple(group) for group in groups if group]


def columns_at(
    problem: Problem, gains, fitted: Estimate, names: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Residual and Jacobian columns of some coordinates at an estimate.

    The rows of the prior are those of all coordinates, so that columns can be combined.
    """
    index = [k for name in names for k in problem.layout.indices((name,))]
    matrix = np.zeros((problem.layout.size, problem.width))
    matrix[index, np.arange(len(index))] = 1.0
    inputs, layout = traced(problem, gains, fitted.coordinates, matrix)
    begin = np.zeros(problem.width)
    begin[: len(index)] = fitted.coordinates[index]
    residual, J = (np.asarray(a) for a in jacobian(jnp.asarray(begin), (inputs, layout)))
    keep = int(problem.tape.measured.size) + problem.layout.size
    return residual[:keep], J[:keep, : len(index)]


def suspicious(screening: Screening) -> bool:
    """Whether any candidate or any located force is significant, family-wise."""
    tests = [score.p_value for score in screening.scores.values()]
    tests += [cell.p_value for cell in screening.cells]
    return bool(tests) and min(tests) * len(tests) < ALPHA


def remainder(cells: tuple[Cell, ...]) -> float:
    """Family-wise p-value of the strongest located force."""
    return min(1.0, len(cells) * min((cell.p_value for cell in cells), default=1.0))


def short_list(screening: Screening) -> list[str]:
    """The strongest candidates and whatever can mimic the first three."""
    ranked = sorted(screening.scores, key=lambda n: -screening.scores[n].statistic)
    chosen = ranked[:SHORT_LIST]
    for top in ranked[:3]:
        for other in ranked[SHORT_LIST:]:
            columns = screening.columns
            close = screening.projection.mimicry(columns[top], columns[other]) > CONFUSABLE
            if close and other not in chosen:
                chosen.append(other)
    return chosen


def refit_short_list(
    data: Split, current: Estimate, screening: Screening, progress: Progress
) -> list[Fitted]:
    """Refit each candidate of the short list from the prior, best first."""
    names = short_list(screening)

    def refit(name: str) -> Fitted:
        progress(f"refitting {names.index(name) + 1} of {len(names)}: {name}")
        return _refit(data, current, name, screening.scores[name])

    # A compiled program runs on one core and lets other threads run meanwhile.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        out = list(pool.map(refit, names))
    best = max(out, key=lambda fitted: fitted.drop)
    return sorted(out, key=lambda fitted: -fitted.bic(best.estimate.inflation))


def _refit(data: Split, current: Estimate, name: str, score: Score) -> Fitted:
    """Two starts at the noise of the model without the effect; the better is fitted to its end.

    Where both end worse than that model, the effect starts from its absence there.
    """
    problem = data.train
    effect = next(e for e in problem.layout.effects if e.name == name)
    free = (*current.free, name)
    starts = [
        estimate(problem, free, start, current.noise, rounds=3, fixed_noise=True)
        for start in _starts(problem, current, effect, score)
    ]
    sound = [fitted for fitted in starts if fitted.deviance < current.deviance]
    better = min(sound, key=lambda fitted: fitted.deviance, default=current)
    fitted = estimate(problem, free, better.coordinates, current.noise)
    value = problem.layout.physical(name, fitted.coordinates)
    return Fitted(
        name, fitted, current.deviance - fitted.deviance, len(problem.layout.indices((name,))),
        float(problem.tape.count), gain(data, current, fitted), score,
        not effect.positive or bool((value > 0).all()),
    )  # fmt: skip


def _starts(
    problem: Problem, current: Estimate, effect: AbstractEffect, score: Score
) -> list[np.ndarray]:
    """The prior and the current estimate, both with the effect at its one-step estimate.

    Effects found before start from their estimate in either.
    """
    guess = np.clip(score.step, -3.0, 3.0)
    if effect.positive:
        guess = np.maximum(guess, 0.1)
    warm = current.coordinates.copy()
    warm[problem.layout.indices((effect.name,))] = guess
    prior = warm.copy()
    prior[: len(problem.layout.parameters)] = 0.0
    return [prior, warm]


def decide(
    data: Split, current: Estimate, tried: list[Fitted], progress: Progress
) -> Fitted | None:
    """The best hypothesis, if evidence and held-out data both speak for it.

    Where the held-out data leave it open, they and the training data change places.
    """
    best = next((fitted for fitted in tried if fitted.possible), None)
    if best is None or best.bic(best.estimate.inflation) <= EVIDENCE:
        return None
    if best.gain.open and data.head is None:
        progress(f"{best.effect}: held-out data leave it open; exchanging them with the others")
        other = exchanged_gain(data, current, best.estimate)
        best = dataclasses.replace(best, gain=best.gain.pooled(other))
    return best if best.gain.clear else None


def ambiguous_with(best: Fitted, tried: list[Fitted]) -> tuple[str, ...]:
    """Rivals that the same data support nearly as well, by catalogue name."""
    names: list[str] = []
    inflation = best.estimate.inflation
    for other in tried:
        name = catalogue_name(other.effect)
        same = name == catalogue_name(best.effect) or name in names
        near = best.bic(inflation) - other.bic(inflation) < EVIDENCE
        if other.possible and not same and near:
            names.append(name)
    return tuple(names)


def _verdict(accepted: list[Accepted], left: float) -> str:
    if left < ALPHA:
        return "unexplained"
    if not accepted:
        return "consistent"
    if any(one.rivals for one in accepted):
        return "ambiguous"
    return "explained"
