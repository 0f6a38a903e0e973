"""Refits: a short list of candidates, each fitted beside the effects accepted so far.

All are first refitted at the noise of the model without the effect; those that come near the best
then to their end, with noise of their own, and judged on held-out data.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from diffsea.budget import on_every_core
from diffsea.diagnosis.constancy import constancy_test
from diffsea.diagnosis.decision import EVIDENCE, ShortList
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.screening import Candidate, Screening, short_list
from diffsea.diagnosis.starts import (
    first_guess,
    start_as_part,
    start_beside,
    start_with_effects_of,
)
from diffsea.identification.estimates import Estimate, FitOutcome
from diffsea.identification.fit import (
    Start,
    estimate,
    estimate_surely,
    likeliest_start,
    settled,
)
from diffsea.identification.free_predictions import (
    MotionChange,
    motion_change,
    pooled_losses,
    relative_losses,
)
from diffsea.identification.holdout import Split, exchanged_fit, held_out_gain
from diffsea.identification.problem import Problem, first_run_coordinates, vessel_in_environment
from diffsea.progress import PartialProgress, Progress
from diffsea.vessel.effects import EFFECTS, Effect, Size, catalogue_name, spoken_name


TOLERANCE = 2.0  # standard errors by which a size may come out beyond its bounds, or zero in a run
NEAR_BEST = 60.0  # of the best evidence at fixed noise, within which a hypothesis is fitted on
NEAR_BEST_SHARE = 0.6  # of the best evidence, where that is more
FULL_REFITS = 4  # at most, and those that the evidence does not tell from the best
SAME_FIT = 0.5  # of -2 log posterior, within which an effect and a part of it fit alike
STALLED_SHARE = 0.8  # of the gain that the linear model promises: less is a stalled refit
SMALL_SHARE = 0.1  # of an effect's first guess, from which a stalled refit begins again


class Refit(NamedTuple):
    """An effect to be fitted beside a model, and where its fit may begin: the likeliest counts."""

    candidate: Candidate
    starts: Sequence[Start]

    @property
    def effect(self) -> str:
        """Its name."""
        return self.candidate.point.effect


def with_mirrors(names: Sequence[str]) -> list[str]:
    """Effects, and those that they would be with a negative size, as a first look cannot tell."""
    mirrors = (EFFECTS[name].mirror for name in names)
    return [name for name in dict.fromkeys([*names, *mirrors]) if name]


def refit_candidates(
    data: Split,
    current: Estimate,
    screening: Screening,
    progress: Progress,
    among: tuple[str, ...] = (),
) -> ShortList:
    """The short list of a screening refitted, or the effects `among`, where any are named.

    Where an accepted effect came out larger than
    its law holds for, the error of that law is left over and looks like the effect's confusables:
    these are not asked for.
    """
    problem, doubtful = data.train, set[str]()
    declared = {effect.name: effect.confusables for effect in problem.layout.effects}
    for name in set(declared) & set(current.free):
        place = problem.layout.indices((name,))[0]
        if abs(current.coordinates[place]) > EFFECTS[name].leading.valid_to:
            doubtful |= set(declared[name])
    names = [
        name
        for name in with_mirrors(among or short_list(screening, declared))
        if name in screening.candidates and catalogue_name(name) not in doubtful
    ]

    def refit_first(name: str) -> Hypothesis:
        number, stage = names.index(name), f"trying {len(names)} cause{'s' * (len(names) != 1)}"
        message = f"trying cause {number + 1} of {len(names)}: {spoken_name(name)}"
        progress(PartialProgress(message, number / len(names), stage))
        return refit_at_fixed_noise(problem, current, screening.candidates[name])

    near, rest = near_the_best(on_every_core(refit_first, names))
    near, as_parts = without_needless_wholes(near)
    rest = [*as_parts, *rest]
    starts = [Start.beside(current, start_beside(problem, current, one)) for one in near]
    asked = [Refit(one.candidate, [start]) for one, start in zip(near, starts, strict=True)]
    full = refit_fully(data, current, asked)
    return ShortList.of(problem, [*full, *rest])


def near_the_best(tried: list[Hypothesis]) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Hypotheses whose evidence comes near the best, and the others; those that diverge in none.

    One that came out of its physical range stands in the way only of what it may be confused with:
    it says that something is missing, not that everything else is wrong. Its mirror, what it would
    be with the other sign, is as near as it is.
    """
    tried = [one for one in tried if np.isfinite(one.evidence(1.0))]
    tried.sort(key=lambda one: -one.evidence(1.0))
    mirrored = {EFFECTS[one.effect].mirror: one for one in tried if not one.is_physical}

    def is_confusable(one: Hypothesis, other: Hypothesis) -> bool:
        names = [catalogue_name(hypothesis.effect) for hypothesis in (one, other)]
        declared = [EFFECTS[hypothesis.effect].confusables for hypothesis in (one, other)]
        return names[0] == names[1] or names[1] in declared[0] or names[0] in declared[1]

    def is_near(one: Hypothesis) -> bool:
        rivals = [other for other in tried if other.is_physical or is_confusable(one, other)]
        best = max((other.evidence(1.0) for other in rivals), default=0.0)
        own = max(one.evidence(1.0), mirrored.get(one.effect, one).evidence(1.0))
        return own > min(best - NEAR_BEST, NEAR_BEST_SHARE * best)

    near = [
        one
        for k, one in enumerate(filter(is_near, tried))
        if k < FULL_REFITS or tried[0].evidence(1.0) - one.evidence(1.0) < EVIDENCE
    ]
    return near, [one for one in tried if one not in near]


def without_needless_wholes(
    near: list[Hypothesis],
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Hypotheses that differ, and those whose fit is that of a part of theirs among them.

    A dead time with a slew limit that is too fast to act is that dead time.
    """

    def is_needless(one: Hypothesis) -> bool:
        return any(
            EFFECTS[other.effect].is_part_of(EFFECTS[one.effect])
            and abs(one.deviance_drop - other.deviance_drop) < SAME_FIT
            for other in near
        )

    needless = [one for one in near if is_needless(one)]
    return [one for one in near if one not in needless], needless


def refit_at_fixed_noise(problem: Problem, current: Estimate, candidate: Candidate) -> Hypothesis:
    """Refit from the current estimate at its noise; where that stalls, from elsewhere.

    Elsewhere is a small size of the effect, from which it and the parameters can move together,
    then the prior of the vessel's parameters, and at last the current model itself, than which no
    fit with an effect more need be worse. Effects accepted before start from their estimate.
    """
    name = candidate.point.effect
    place = problem.layout.indices((name,))
    warm = np.array(current.coordinates, float)
    warm[place] = first_guess(candidate)
    prior, small, without = warm.copy(), warm.copy(), np.array(current.coordinates, float)
    prior[: len(problem.layout.parameters)] = 0.0
    amounts = np.tile(EFFECTS[name].amounts, problem.layout.instances(EFFECTS[name]))
    small[place] = np.where(amounts, SMALL_SHARE * warm[place], warm[place])

    def refit(start: np.ndarray) -> Estimate:
        free = (*current.free, name)
        begin = Start.beside(current, start)
        return estimate(problem, free, begin, rounds=4, fixed_noise=True)

    def cost(one: Estimate) -> float:
        return one.deviance if np.isfinite(one.deviance) else np.inf

    better, promised = refit(warm), candidate.score.statistic * candidate.score.inflation
    # Also where it diverged: its deviance is no number then.
    for start in (small, prior, without):
        if current.deviance - better.deviance >= STALLED_SHARE * promised:
            break
        better = min(better, refit(start), key=cost)
    return make_hypothesis(problem, current, better, candidate)


def refit_fully(data: Split, current: Estimate, asked: Sequence[Refit]) -> list[Hypothesis]:
    """Hypotheses fitted to their end, with noise of their own, and judged on held-out data."""
    problem = data.train

    def fit(one: Refit) -> Estimate:
        start = likeliest_start(problem, one.starts)
        return estimate(problem, (*current.free, one.effect), start)

    first = on_every_core(fit, asked)
    ends = {one.effect: fitted for one, fitted in zip(asked, first, strict=True)}

    def judge(one: Refit) -> Hypothesis:
        parts = [
            start_as_part(problem, end, name, one.effect)
            for name, end in ends.items()
            if EFFECTS[name].is_part_of(EFFECTS[one.effect]) and end.outcome is FitOutcome.CONVERGED
        ]
        plainer = [Start.at(current), *parts]
        fitted = settled(problem, ends[one.effect], plainer)
        return judge_fitted(data, current, fitted, one.candidate)

    return on_every_core(judge, asked)


def judge_fitted(
    data: Split, current: Estimate, fitted: Estimate, candidate: Candidate
) -> Hypothesis:
    """The hypothesis that a model is, with an effect more than the current one."""
    problem, effect = data.train, candidate.point.effect
    full = make_hypothesis(problem, current, fitted, candidate)
    full = dataclasses.replace(full, gain=held_out_gain(data, current, fitted))
    if not np.isfinite(full.deviance_drop):
        return full
    test = constancy_test(problem, fitted, effect, full.deviance_drop)
    motion = motion_change(data, current, fitted) if full.is_judged else None
    return dataclasses.replace(full, constancy=test, motion=motion)


def refit_without(
    problem: Problem, current: Estimate, names: Sequence[str], known: Estimate
) -> Estimate:
    """The estimate without some of its effects, fitted with noise of its own.

    The better of two: from where it was, and with the noise of another fit without them, `known`,
    from there or from where that one ended, with the effects that it lacked. Gusts have several
    optima, and an effect must not gain by the worse of them.
    """
    free = tuple(name for name in current.free if name not in names)
    bare = np.array(current.coordinates, float)
    bare[problem.layout.indices(tuple(names))] = 0.0
    others = Start.beside(known, bare), start_with_effects_of(problem, known, current, free)
    starts = Start.beside(current, bare), likeliest_start(problem, others)
    fits = on_every_core(lambda start: estimate_surely(problem, free, start), starts)
    return min(fits, key=lambda one: np.nan_to_num(one.deviance, nan=np.inf))


def judge_exchanged(data: Split, current: Estimate, one: Hypothesis) -> Hypothesis:
    """The hypothesis judged on the training data, too, fitted to the held-out ones."""
    other = data.exchanged
    before, after = on_every_core(lambda model: exchanged_fit(data, model), (current, one.estimate))
    there = relative_losses(data, current, one.estimate)
    both = pooled_losses(there, relative_losses(other, before, after))
    gain = held_out_gain(other, before, after)
    return dataclasses.replace(
        one, exchanged=gain, motion=MotionChange.of(both), held_out_motion=one.motion
    )


def make_hypothesis(
    problem: Problem, current: Estimate, fitted: Estimate, candidate: Candidate
) -> Hypothesis:
    """The evidence for a model fitted with one effect more than the current one.

    The Occam factor is Laplace's: the log ratio of the posterior's volume to that of the prior,
    the heavy tails of the prior included.
    """
    layout, effect = problem.layout, EFFECTS[candidate.point.effect]
    index = layout.indices((effect.name,))
    volume = np.linalg.slogdet(fitted.precision)[1] - np.linalg.slogdet(current.precision)[1]
    instances = len(recorded_instances(problem, effect))
    room = 2 * np.log(layout.spreads()[index]).sum() + layout.tail_cost(effect, instances)
    # The effect's own: the mean over everything free is that of what data hardly determine.
    own = [list(fitted.index).index(k) for k in index]
    plain = np.diag(np.linalg.inv(fitted.precision))[own]
    inflation = max(1.0, float(np.mean(np.diag(fitted.covariance)[own] / plain)))
    wald, zero_p_value = _test_of_zero(problem, fitted, effect)
    return Hypothesis(
        effect=effect.name,
        estimate=fitted,
        without=current,
        deviance_drop=current.deviance - fitted.deviance,
        occam=float(volume + room),
        gain=None,
        candidate=candidate,
        is_physical=is_physical(problem, fitted, candidate),
        instances=instances,
        inflation=inflation,
        wald=wald,
        zero_p_value=zero_p_value,
    )


def _test_of_zero(problem: Problem, fitted: Estimate, effect: Effect) -> tuple[float, float]:
    """Wald's statistic of an effect's amounts, and its p-value where errors may be correlated."""
    places = np.array(problem.layout.indices((effect.name,)))
    places = places.reshape(problem.layout.instances(effect), -1)
    places = places[recorded_instances(problem, effect)][:, effect.amounts].ravel()
    order = [list(fitted.index).index(k) for k in places]
    amounts = fitted.coordinates[places]

    def statistic(covariance: Float[np.ndarray, "free free"]) -> float:
        return float(amounts @ np.linalg.solve(covariance[np.ix_(order, order)], amounts))

    coloured = statistic(fitted.covariance)
    return statistic(np.linalg.inv(fitted.precision)), float(chi2.sf(coloured, len(amounts)))


def is_physical(problem: Problem, fitted: Estimate, candidate: Candidate) -> bool:
    """Whether an effect's sizes are possible, and a change lies where it was seen, while recorded.

    Sizes count as possible as far as their standard errors tell. What cannot be negative may be
    absent in some of several runs.
    """
    effect = EFFECTS[candidate.point.effect]
    places = np.array(problem.layout.indices((effect.name,)))
    places = places.reshape(problem.layout.instances(effect), -1)
    places = places[recorded_instances(problem, effect)]
    values = fitted.coordinates[places]
    order = [list(fitted.index).index(k) for k in places.ravel()]
    stds = np.sqrt(np.diag(np.linalg.inv(fitted.precision))[order]).reshape(places.shape)
    for place, one in enumerate(effect.coordinates):
        if not (isinstance(one, Size) and one.positive):
            continue
        amounts = values[:, place]
        least = -TOLERANCE * stds[:, place] if len(amounts) > 1 else 0.0
        if not ((amounts > least).all() and (amounts > 0).any()):
            return False
    least, most = np.array(effect.bounds(problem.base)).T / effect.sizes(problem.base)
    within = (values > least - TOLERANCE * stds) & (values < most + TOLERANCE * stds)
    if not within.all():
        return False
    if effect.plausible is not None:
        own = first_run_coordinates(problem, fitted.coordinates)
        if not effect.plausible(vessel_in_environment(problem, own)):
            return False
    if effect.scanned is None:
        return True
    place, scanned = effect.scanned
    value = float(values[0, place])
    size = effect.sizes(problem.base)[place]
    times = np.asarray(problem.dataset.run_time)[problem.dataset.recorded_rows]
    if problem.before is not None:  # as much was recorded then, as far as that counts
        times = np.concatenate([np.full(len(times), -np.inf), times])
    is_near = abs(value - candidate.point.at[place]) < candidate.reach
    return is_near and scanned.lies_within(value * size, times)


def recorded_instances(problem: Problem, effect: Effect) -> list[int]:
    """Instances of an effect that belong to recorded runs: a data set has spare ones."""
    if problem.layout.instances(effect) == 1:
        return [0]
    return [number for number, rows in enumerate(problem.dataset.rows_of_runs) if len(rows)]
