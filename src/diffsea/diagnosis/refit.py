"""Whether a fitted effect is one that a vessel can have.

Refits of hypotheses and the evidence for each.
"""

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from diffsea.diagnosis.constancy import Constancy, constancy
from diffsea.diagnosis.screening import Seen
from diffsea.identification.estimates import Estimate, PartialProgress, Progress
from diffsea.identification.expansion_points import ExpansionPoint
from diffsea.identification.fit import estimate
from diffsea.identification.holdout import Gain, Split, held_out_gain
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name


ABSENT = 2.0  # standard errors by which a size may come out beyond its bounds, or zero in a run


def possible(problem: Problem, effect: Effect, fitted: Estimate, seen: Seen) -> bool:
    """Whether its sizes are physical, and a change lies where it was seen, within the recordings.

    Sizes count as physical as far as their standard errors tell.
    """
    values, stds = _sizes(problem, effect, fitted)
    if effect.leading.positive and not _positive(values[:, 0], stds[:, 0]):
        return False
    least, most = np.array(effect.bounds(problem.base)).T / effect.sizes(problem.base)
    if not ((values > least - ABSENT * stds) & (values < most + ABSENT * stds)).all():
        return False
    if effect.scanned is None:
        return True
    place, scanned = effect.scanned
    value = float(values[0, place])
    size = problem.layout.sizes[problem.layout.effects.index(effect)][place]
    times = np.asarray(problem.dataset.run_time)[np.asarray(problem.dataset.known).any(1)]
    near = abs(value - seen.look.at[place]) < seen.reach
    return near and scanned.lies_within(value * size, times.min(), times.max())


def _sizes(problem: Problem, effect: Effect, fitted: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Its coordinates in prior sizes and their standard errors, a row for each recorded copy."""
    places = np.array(problem.layout.indices((effect.name,)))
    places = places.reshape(problem.layout.instances(effect), -1)[recorded_copies(problem, effect)]
    order = [list(fitted.index).index(k) for k in places.ravel()]
    stds = np.sqrt(np.diag(np.linalg.inv(fitted.precision))[order])
    return fitted.coordinates[places], stds.reshape(places.shape)


def _positive(amounts: np.ndarray, stds: np.ndarray) -> bool:
    """Whether an effect that cannot be negative is not; of several copies some may be absent."""
    if len(amounts) == 1:
        return bool(amounts[0] > 0)
    return bool((amounts > -ABSENT * stds).all() and (amounts > 0).any())


def recorded_copies(problem: Problem, effect: Effect) -> list[int]:
    """Copies of an effect's coordinates that belong to recorded runs: a dataset has spare ones."""
    if problem.layout.instances(effect) == 1:
        return [0]
    return np.unique(
        np.asarray(problem.dataset.run)[np.asarray(problem.dataset.known).any(1)]
    ).tolist()


NEAR = 60.0  # of the best first evidence: what is fitted to its end, with noise of its own
FULL = 4  # at most so many, and what the evidence does not tell from the best
EVIDENCE = 10.0  # twice the log of odds of 150 to 1
ENOUGH = 0.8  # of the gain that the linear model promises: less is a stalled refit


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A refitted hypothesis: the effects added so far and one more."""

    effect: str
    estimate: Estimate
    drop: float  # of the deviance against the hypothesis without it, priors included
    occam: float  # what its room in the prior costs: -2 log of posterior over prior volume
    held_out_gain: Gain | None  # on held-out data; None where it was not fitted to its end
    seen: Seen
    possible: bool  # inside physical bounds, and a change within the recordings
    constancy: Constancy | None = None  # of its size; None where it was not fitted to its end
    copies: int = 1  # sets of coordinates: one for each run, for an environment of its own
    inflation: float = 1.0  # variance of its own scores over the information, at least one
    exchanged: Gain | None = None  # on the training data, with the held-out ones to train on

    def evidence(self, inflation: float) -> float:
        """Twice the log of the Bayes factor against the hypothesis without it (Laplace).

        `inflation` says how many dependent values count as one (of the best hypothesis:
        under a wrong one the dependence is the effect itself).
        """
        return self.drop / inflation - max(self.occam - self.size * np.log(inflation), 0.0)

    @property
    def size(self) -> int:
        """Coordinates that it adds."""
        return len(self.seen.look.at) * self.copies

    @property
    def borne_out(self) -> Gain | None:
        """What all data say that were held out once."""
        if self.gain is None or self.exchanged is None:
            return self.gain
        return self.gain.pooled(self.exchanged)

    def support(self, inflation: float) -> float:
        """Evidence and held-out gain together: what all data say; -inf where a run diverges."""
        held_out = 0.0 if self.gain is None else self.gain.total / inflation
        out = self.evidence(inflation) + held_out
        return out if np.isfinite(out) else -np.inf


def refitted(
    data: Split, current: Estimate, seen: dict[str, Seen], names: list[str], progress: Progress
) -> list[Fitted]:
    """Refit each hypothesis of a short list, best first.

    All of them at the noise of the model without the effect; those that come near the best then
    to their end, with noise of their own and judged on the held-out data.
    """

    def first(name: str) -> Fitted:
        number, stage = names.index(name), f"refitting {len(names)} hypotheses"
        message = f"refitting {number + 1} of {len(names)}: {name}"
        progress(PartialProgress(message, number / len(names), stage))
        return _first(data.train, current, seen[name])

    # A compiled program runs on one core and lets other threads run meanwhile.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        tried = list(pool.map(first, names))
    tried = [one for one in tried if np.isfinite(one.evidence(1.0))]
    tried.sort(key=lambda fitted: -fitted.evidence(1.0))
    near = [one for one in tried if near_the_best(one, tried)]
    near = [one for k, one in enumerate(near) if k < FULL or _level(one, tried[0])]
    rest = [one for one in tried if one not in near]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        full = list(pool.map(lambda one: completed(data, current, one), near))
    return ranked([*full, *rest])


def near_the_best(one: Fitted, tried: list[Fitted]) -> bool:
    """Whether a hypothesis comes near the best of those that stand in its way.

    One that came out of its physical range stands in the way only of what it may be confused with:
    it says that something is missing, not that everything else is wrong.
    """
    rivals = [other for other in tried if other.possible or _confusable(one, other)]
    best = max((other.evidence(1.0) for other in rivals), default=0.0)
    return one.evidence(1.0) > min(best - NEAR, 0.6 * best)


def _level(one: Fitted, best: Fitted) -> bool:
    """Whether the evidence for both is so alike that one may be the other's rival."""
    return best.evidence(1.0) - one.evidence(1.0) < EVIDENCE


def _confusable(one: Fitted, other: Fitted) -> bool:
    names = (catalogue_name(one.effect), catalogue_name(other.effect))
    declared = [set(EFFECTS[fitted.effect].confusables) for fitted in (one, other)]
    return names[0] == names[1] or names[1] in declared[0] or names[0] in declared[1]


def ranked(tried: list[Fitted]) -> list[Fitted]:
    """Hypotheses by what all data say, those not judged on held-out data last."""
    judged = [one for one in tried if one.gain is not None and one.possible]
    best = max(judged, key=lambda one: np.nan_to_num(one.drop, nan=-np.inf), default=None)
    inflation = 1.0 if best is None else best.inflation
    return sorted(tried, key=lambda one: (one.gain is None, -one.support(inflation)))


def _first(problem: Problem, current: Estimate, seen: Seen) -> Fitted:
    """From the current estimate and at its noise; from the prior, too, where that stalls."""
    name = seen.look.effect
    free = (*current.free, name)
    effect = next(e for e in problem.layout.effects if e.name == name)
    warm, prior = (
        lambda start=start: estimate(
            problem, free, start, current.noise, rounds=2, fixed_noise=True
        )
        for start in _starts(problem, current, effect, seen)
    )
    better, promised = warm(), seen.score.statistic * seen.score.inflation
    # Also where it diverged: its deviance is no number then.
    if not current.deviance - better.deviance >= ENOUGH * promised:
        better = min(better, prior(), key=_finite_deviance)
    return _made(problem, current, better, effect, seen, None)


def _finite_deviance(fitted: Estimate) -> float:
    return fitted.deviance if np.isfinite(fitted.deviance) else np.inf


def completed(
    data: Split, current: Estimate, one: Fitted, start: np.ndarray | None = None
) -> Fitted:
    """The hypothesis fitted to its end, with noise of its own, and judged on held-out data.

    From `start`, if that is known better than `beside` knows it.
    """
    problem, free = data.train, (*current.free, one.effect)
    start = beside(problem, current, one) if start is None else start
    fitted = estimate(problem, free, start, current.noise)
    effect = next(e for e in problem.layout.effects if e.name == one.effect)
    made = _made(problem, current, fitted, effect, one.seen, held_out_gain(data, current, fitted))
    if not np.isfinite(made.drop):
        return made
    constant = constancy(problem, fitted, one.effect, made.drop)
    return dataclasses.replace(made, constancy=constant)


def beside(problem: Problem, current: Estimate, one: Fitted) -> np.ndarray:
    """Coordinates of a current estimate with one effect more, where its own fit may start.

    As it was refitted, if that was on top of these very effects; else its coordinates alone, for
    what it was fitted together with may not be in the model any more.
    """
    if set(one.estimate.free) == {*current.free, one.effect}:
        better = one.estimate.deviance < current.deviance
        return one.estimate.coordinates if better else current.coordinates
    out = np.array(current.coordinates, float)
    place = problem.layout.indices((one.effect,))
    out[place] = one.estimate.coordinates[place]
    return out


def _made(
    problem: Problem,
    current: Estimate,
    fitted: Estimate,
    effect: Effect,
    seen: Seen,
    judged: Gain | None,
) -> Fitted:
    spreads = problem.layout.spreads()[problem.layout.indices((effect.name,))]
    volume = np.linalg.slogdet(fitted.precision)[1] - np.linalg.slogdet(current.precision)[1]
    copies = len(recorded_copies(problem, effect))
    room = 2 * np.log(spreads).sum() + problem.layout.tail_cost(effect, copies)
    return Fitted(
        effect.name, fitted, current.deviance - fitted.deviance,
        float(volume + room), judged, seen,
        possible(problem, effect, fitted, seen), copies=copies,
        inflation=_own_inflation(problem, effect, fitted),
    )  # fmt: skip


def _own_inflation(problem: Problem, effect: Effect, fitted: Estimate) -> float:
    """How many dependent values count as one for an effect's coordinates.

    The mean over everything free would be that of the parameters that data hardly determine.
    """
    own = [list(fitted.index).index(k) for k in problem.layout.indices((effect.name,))]
    plain = np.diag(np.linalg.inv(fitted.precision))[own]
    return max(1.0, float(np.mean(np.diag(fitted.covariance)[own] / plain)))


def _starts(problem: Problem, current: Estimate, effect: Effect, seen: Seen) -> list[np.ndarray]:
    """The current estimate and the prior, both with the effect at its one-step estimate.

    Effects found before start from their estimate in either.
    """
    warm = np.array(current.coordinates, float)
    warm[problem.layout.indices((effect.name,))] = first_guess(effect, seen)
    prior = warm.copy()
    prior[: len(problem.layout.parameters)] = 0.0
    return [warm, prior]


def first_guess(effect: Effect, seen: Seen) -> np.ndarray:
    """Coordinates of the effect, in every copy, from its one-step estimate."""
    look: ExpansionPoint = seen.look
    step = np.clip(seen.score.step, -3.0, 3.0).reshape(-1, len(look.directions))
    out = np.tile(np.array(look.at, float), (len(step), 1))
    out[:, list(look.directions)] = step
    if look.secant:
        out[:, 0] = look.at[0]
    if effect.leading.positive:
        out[:, 0] = np.maximum(out[:, 0], 0.1)
    return out.ravel()


def has_room(problem: Problem, current: Estimate, name: str) -> bool:
    """Whether the compiled program has room for one more effect beside those of an estimate.

    For its coordinates, and for the directions to differentiate in, which copies share.
    """
    index = problem.layout.indices((*current.free, name))
    kind, _ = problem.layout.kinds()
    return len(index) <= problem.width and len(np.unique(kind[index])) <= problem.directions


def without(problem: Problem, current: Estimate, names: list[str]) -> Estimate:
    """The estimate without some of its effects."""
    free = tuple(name for name in current.free if name not in names)
    start = np.array(current.coordinates, float)
    start[problem.layout.indices(tuple(names))] = 0.0
    return estimate(problem, free, start, current.noise)
