"""Hypotheses: refits of a short list, the evidence for each, and which of them to believe.

A hypothesis is the model with the effects accepted so far and one more. All are first refitted at
the noise of the model without the effect; those that come near the best then to their end, with
noise of their own, and judged on held-out data. A name is given where evidence, held-out data and
one size in all the data speak for it, together with what else would do.
"""

import dataclasses
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float

from diffsea.budget import in_this_budget
from diffsea.diagnosis.constancy import LAWS, Constancy, constancy_test
from diffsea.diagnosis.screening import CONFUSABLE, Candidate, Screening, mimicry, short_list
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate, estimate_surely
from diffsea.identification.free_predictions import (
    MotionChange,
    motion_change,
    pooled_losses,
    relative_losses,
)
from diffsea.identification.holdout import Gain, Split, exchanged_fits, held_out_gain
from diffsea.identification.problem import Problem
from diffsea.progress import PartialProgress, Progress
from diffsea.vessel.effects import EFFECTS, Effect, Size, catalogue_name


EVIDENCE = 10.0  # twice the log of odds of 150 to 1
TOLERANCE = 2.0  # standard errors by which a size may come out beyond its bounds, or zero in a run
NEAR_BEST = 60.0  # of the best evidence at fixed noise, within which a hypothesis is fitted on
NEAR_BEST_SHARE = 0.6  # of the best evidence, where that is more
FULL_REFITS = 4  # at most, and those that the evidence does not tell from the best
STALLED_SHARE = 0.8  # of the gain that the linear model promises: less is a stalled refit
SMALL_SHARE = 0.1  # of an effect's first guess, from which a stalled refit begins again
NEARLY_ONE_SIZE = 0.5  # of what an effect explains is due to sizes that differ, at most
LARGEST_STEP = 3.0  # prior sizes that a one-step estimate may start a refit at


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A refitted model: the effects accepted so far and one more."""

    effect: str
    estimate: Estimate
    deviance_drop: float  # against the model without the effect, priors included
    occam: float  # what its room in the prior costs: -2 log of posterior over prior volume
    gain: Gain | None  # on held-out data; None where it was not fitted to its end
    candidate: Candidate
    is_physical: bool  # inside physical bounds, and a change within the recordings
    constancy: Constancy | None = None  # of its size; None where it was not fitted to its end
    instances: int = 1  # sets of coordinates: one for each run, for an environment of its own
    inflation: float = 1.0  # variance of its own scores over the information, at least one
    exchanged: Gain | None = None  # on the training data, with the held-out ones to train on
    motion: MotionChange | None = (
        None  # of free predictions; None where it was not fitted to its end
    )

    @property
    def predicts_motion(self) -> bool:
        """Whether free predictions of held-out runs get no worse with it, beyond chance."""
        return self.motion is None or not self.motion.is_worse

    @property
    def is_judged(self) -> bool:
        """Whether it is physical and was judged on held-out data."""
        return self.is_physical and self.gain is not None

    @property
    def has_one_size(self) -> bool:
        """Whether it was fitted to its end and has one size in all the data.

        Or one size predicts the motion better beyond chance, and explains most of what it does, or
        is, of a law of hull or actuators, that of every run: on real vessels laws hold nearly, a
        wind blows in gusts, and what else is missing comes and goes with the phases of a manoeuvre.
        """
        if self.constancy is not None and self.constancy.holds:
            return True
        is_better = self.motion is not None and self.motion.is_better
        return is_better and self.has_nearly_one_size

    @property
    def has_nearly_one_size(self) -> bool:
        """Whether one size in all the data is to be believed, if it predicts the motion better."""
        if self.constancy is None:
            return False
        in_runs = self.constancy.same_in_runs and EFFECTS[self.effect].family in LAWS
        predicts = in_runs and self.gain is not None and self.gain.clear
        return predicts or self.constancy.share < NEARLY_ONE_SIZE

    @property
    def is_undecided(self) -> bool:
        """Whether the runs held out are too few to say what is asked of them.

        They leave open whether single steps are predicted better; or the size is one only nearly,
        and is believed by the motion alone: that asks for as many runs as there are.
        """
        if self.constancy is None or self.gain is None or not self.predicts_motion:
            return False
        if self.constancy.holds:
            return self.gain.open
        is_tried = self.motion is not None and min(self.motion.ratio.values(), default=1.0) < 1.0
        may_be_gain = self.gain.open or self.gain.clear
        return is_tried and may_be_gain and self.has_nearly_one_size

    def is_part_of(self, other: "Hypothesis") -> bool:
        """Whether the other is this with something more, on the same channels."""
        own, whole = EFFECTS[self.effect], EFFECTS[other.effect]
        return catalogue_name(own.name) in whole.parts and own.place == whole.place

    def is_plainer_than(self, other: "Hypothesis") -> bool:
        """Whether it is to be believed of two that are supported nearly as well.

        A part rather than the whole, and a property of hull or actuators rather than the weather:
        no vessel is exactly what its file says, whereas weather is there or it is not.
        """
        families = EFFECTS[self.effect].family, EFFECTS[other.effect].family
        is_own = families[0] in ("hull", "actuator") and families[1] == "environment"
        return is_own or self.is_part_of(other)

    def share_mimicked_by(self, other: "Hypothesis") -> float:
        """Share of its information that the other reproduces, to first order, 0 to 1."""
        return mimicry(self.candidate.columns, other.candidate.columns)

    def is_akin_to(self, other: "Hypothesis") -> bool:
        """Whether it has the other's name, or one of the two is part of the other."""
        is_same = catalogue_name(self.effect) == catalogue_name(other.effect)
        return is_same or self.is_part_of(other) or other.is_part_of(self)

    @property
    def size(self) -> int:
        """Coordinates that it adds."""
        return len(self.candidate.point.at) * self.instances

    @property
    def pooled_gain(self) -> Gain | None:
        """What all data say that were held out once."""
        if self.gain is None or self.exchanged is None:
            return self.gain
        return self.gain.pooled(self.exchanged)

    @property
    def has_held_out_support(self) -> bool:
        """Whether data speak for it that were held out once.

        What single steps leave open, which a few events that no model knows may spoil, free
        predictions decide.
        """
        gain = self.pooled_gain
        if gain is None or gain.clear:
            return gain is not None
        return gain.open and self.motion is not None and self.motion.is_probably_better

    def still_stands(self, needed: float) -> bool:
        """Whether an effect that held-out data spoke for once is still needed beside others.

        Then they may leave it open; against it speaks a lack of evidence, or their loss.
        """
        if self.gain is None or not (self.is_judged and self.has_one_size):
            return False
        if not self.predicts_motion:
            return False
        return self.evidence(self.inflation) > needed and (self.gain.open or self.gain.clear)

    def evidence(self, inflation: float) -> float:
        """Twice the log of the Bayes factor against the model without the effect (Laplace).

        `inflation` says how many dependent values count as one (of the best hypothesis:
        under a wrong one the dependence is the effect itself).
        """
        occam = max(self.occam - self.size * np.log(inflation), 0.0)
        return self.deviance_drop / inflation - occam

    def support(self, inflation: float) -> float:
        """Evidence and held-out gain together: what all data say; -inf where a run diverges.

        Of a gain counts what is beyond its error: where a few events spoil it, rivals differ by how
        they happen to meet these.
        """
        counted = 0.0 if self.gain is None else self.gain.sure
        out = self.evidence(inflation) + counted / inflation
        return out if np.isfinite(out) else -np.inf


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


def rank_hypotheses(tried: list[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses by what all data say, those not judged on held-out data last."""
    judged = [one for one in tried if one.is_judged]
    best = max(judged, key=lambda one: np.nan_to_num(one.deviance_drop, nan=-np.inf), default=None)
    inflation = 1.0 if best is None else best.inflation
    return sorted(tried, key=lambda one: (one.gain is None, -one.support(inflation)))


def refit_at_fixed_noise(problem: Problem, current: Estimate, candidate: Candidate) -> Hypothesis:
    """Refit from the current estimate at its noise; where that stalls, from elsewhere.

    Elsewhere is the prior of the vessel's parameters, and a small size of the effect, from which
    it and the parameters can move together. Effects accepted before start from their estimate.
    """
    name = candidate.point.effect
    place = problem.layout.indices((name,))
    warm = np.array(current.coordinates, float)
    warm[place] = first_guess(candidate)
    prior, small = warm.copy(), warm.copy()
    prior[: len(problem.layout.parameters)] = 0.0
    amounts = np.tile(EFFECTS[name].amounts, problem.layout.instances(EFFECTS[name]))
    small[place] = np.where(amounts, SMALL_SHARE * warm[place], warm[place])

    def refit(start: np.ndarray) -> Estimate:
        free = (*current.free, name)
        return estimate(problem, free, start, current.noise, rounds=2, fixed_noise=True)

    def cost(one: Estimate) -> float:
        return one.deviance if np.isfinite(one.deviance) else np.inf

    better, promised = refit(warm), candidate.score.statistic * candidate.score.inflation
    # Also where it diverged: its deviance is no number then.
    for start in (prior, small):
        if current.deviance - better.deviance >= STALLED_SHARE * promised:
            break
        better = min(better, refit(start), key=cost)
    return make_hypothesis(problem, current, better, candidate)


def refit_fully(
    data: Split,
    current: Estimate,
    candidate: Candidate,
    start: Float[np.ndarray, "coordinate"],
) -> Hypothesis:
    """A hypothesis fitted to its end, with noise of its own, and judged on held-out data."""
    problem, effect = data.train, candidate.point.effect
    fitted = estimate_surely(problem, (*current.free, effect), start, current.noise)
    full = make_hypothesis(problem, current, fitted, candidate)
    full = dataclasses.replace(full, gain=held_out_gain(data, current, fitted))
    if not np.isfinite(full.deviance_drop):
        return full
    test = constancy_test(problem, fitted, effect, full.deviance_drop)
    motion = motion_change(data, current, fitted) if full.is_judged else None
    return dataclasses.replace(full, constancy=test, motion=motion)


def start_beside(
    problem: Problem, current: Estimate, one: Hypothesis
) -> Float[np.ndarray, "coordinate"]:
    """Coordinates of a current estimate with one effect more, where its own fit may start.

    As it was refitted, if that was on top of these very effects; else its coordinates alone, for
    what it was fitted together with may not be in the model any more.
    """
    if set(one.estimate.free) == {*current.free, one.effect}:
        return min(current, one.estimate, key=lambda fitted: fitted.deviance).coordinates
    out = np.array(current.coordinates, float)
    place = problem.layout.indices((one.effect,))
    out[place] = one.estimate.coordinates[place]
    return out


def first_guess(candidate: Candidate) -> Float[np.ndarray, "coordinate"]:
    """Coordinates of the effect, in every instance, from its one-step estimate.

    At most three prior sizes; those of a secant at its size, positive ones above zero.
    """
    point = candidate.point
    step = np.clip(candidate.score.step, -LARGEST_STEP, LARGEST_STEP)
    step = step.reshape(-1, len(point.directions))
    out = np.tile(np.array(point.at, float), (len(step), 1))
    out[:, list(point.directions)] = step
    if point.secant:
        out[:] = point.at
    for place, one in enumerate(EFFECTS[point.effect].coordinates):
        if isinstance(one, Size) and one.positive:
            out[:, place] = np.maximum(out[:, place], 0.1)
    return out.ravel()


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
    return Hypothesis(
        effect=effect.name,
        estimate=fitted,
        deviance_drop=current.deviance - fitted.deviance,
        occam=float(volume + room),
        gain=None,
        candidate=candidate,
        is_physical=is_physical(problem, fitted, candidate),
        instances=instances,
        inflation=inflation,
    )


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
    if effect.scanned is None:
        return True
    place, scanned = effect.scanned
    value = float(values[0, place])
    size = effect.sizes(problem.base)[place]
    times = np.asarray(problem.dataset.run_time)[problem.dataset.recorded_rows]
    is_near = abs(value - candidate.point.at[place]) < candidate.reach
    return is_near and scanned.lies_within(value * size, times)


def recorded_instances(problem: Problem, effect: Effect) -> list[int]:
    """Instances of an effect that belong to recorded runs: a data set has spare ones."""
    if problem.layout.instances(effect) == 1:
        return [0]
    return [number for number, rows in enumerate(problem.dataset.rows_of_runs) if len(rows)]


def has_room(problem: Problem, current: Estimate, name: str) -> bool:
    """Whether the compiled program has room for one more effect beside those of an estimate.

    For its coordinates, and for the directions to differentiate in, which instances share.
    """
    index = problem.layout.indices((*current.free, name))
    kind, _ = problem.layout.kinds()
    return len(index) <= problem.width and len(np.unique(kind[index])) <= problem.directions


def refit_without(problem: Problem, current: Estimate, names: list[str]) -> Estimate:
    """The estimate without some of its effects, fitted from where it was with noise of its own."""
    free = tuple(name for name in current.free if name not in names)
    start = np.array(current.coordinates, float)
    start[problem.layout.indices(tuple(names))] = 0.0
    return estimate_surely(problem, free, start, current.noise)


@dataclasses.dataclass(frozen=True)
class ShortList:
    """Refitted hypotheses, best first, and the evidence that a name needs."""

    hypotheses: tuple[Hypothesis, ...]
    needed: float  # twice the natural log of odds

    @classmethod
    def of(cls, problem: Problem, tried: list[Hypothesis]) -> "ShortList":
        """Hypotheses ranked; a name needs odds of 150 to 1, with one chance for all the names."""
        names = {catalogue_name(effect.name) for effect in problem.layout.effects}
        return cls(tuple(rank_hypotheses(tried)), EVIDENCE + 2 * float(np.log(len(names))))

    @property
    def judged(self) -> list[Hypothesis]:
        """Physical hypotheses that were judged on held-out data."""
        return [one for one in self.hypotheses if one.is_judged]

    @property
    def plainest_first(self) -> list[Hypothesis]:
        """The judged ones, before each those that are plainer and supported nearly as well."""
        ordered = dict[str, Hypothesis]()
        for one in self.judged:
            enough = one.support(self.inflation) - EVIDENCE
            plainer = [other for other in self.judged if other.is_plainer_than(one)]
            near = [other for other in plainer if other.support(self.inflation) > enough]
            ordered |= {
                other.effect: other for other in (*near, one) if other.effect not in ordered
            }
        return list(ordered.values())

    def owed_beside(self, accepted: Hypothesis) -> tuple[str, ...]:
        """Effects that have the evidence for a name, beside one that was accepted of them.

        It may explain what they do, or part of it; in any case they are to be asked for beside it.
        """
        return tuple(
            one.effect
            for one in self.hypotheses
            if one.evidence(one.inflation) > self.needed and not one.is_akin_to(accepted)
        )

    def left_behind(self) -> tuple[str, ...]:
        """Effects with evidence of their own that better ones had left behind, for nothing.

        For a list of which `decide` accepted none. What was fitted to its end and failed may say
        that something is missing; an effect of which it mimics little is not concerned by that.
        """
        failed = [one for one in self.hypotheses if one.gain is not None]
        return tuple(
            one.effect
            for one in self.hypotheses
            if one.gain is None
            and one.is_physical
            and one.evidence(one.inflation) > self.needed
            and all(one.share_mimicked_by(other) < CONFUSABLE for other in failed)
        )

    @property
    def inflation(self) -> float:
        """How many dependent values count as one, by the best judged hypothesis."""
        return self.judged[0].inflation if self.judged else 1.0

    @property
    def has_something_nameless(self) -> bool:
        """Whether something is missing that no name could be given to, where none was.

        All data together speak for it, but what comes nearest does not predict held-out runs
        clearly, is not physical, or has not one size in all the data. What held-out runs contradict
        as strongly as the others support it is no sign of anything.
        """
        supported = (one for one in self.hypotheses if one.support(one.inflation) > self.needed)
        return any(np.isfinite(one.deviance_drop) for one in supported)

    def pair_candidates(self) -> list[Hypothesis]:
        """Hypotheses beside which another effect may be missing; those of one size come first.

        For a list of which `decide` accepted none. There are some only where the best lacks nothing
        but one size in all the data: what else is missing may come and go beside it, or it stands
        for two effects at once.
        """
        sound = [
            one
            for one in self.judged
            if one.evidence(self.inflation) > self.needed and one.gain and one.gain.clear
        ]
        if not sound or sound[0] is not self.judged[0]:
            return []
        return sorted(sound, key=lambda one: not one.has_one_size)


def judge_exchanged(data: Split, current: Estimate, one: Hypothesis) -> Hypothesis:
    """The hypothesis judged on the training data, too, fitted to the held-out ones."""
    other, (before, after) = exchanged_fits(data, (current, one.estimate))
    there = relative_losses(data, current, one.estimate)
    both = pooled_losses(there, relative_losses(other, before, after))
    gain = held_out_gain(other, before, after)
    return dataclasses.replace(one, exchanged=gain, motion=MotionChange.of(both))


def decide(
    short_list: ShortList, exchange: Callable[[Hypothesis], Hypothesis] | None
) -> Hypothesis | None:
    """The best hypothesis for which evidence and held-out data both speak.

    It is the one that all data support most, or one that they support nearly as well, the plainer
    one before the other. Where held-out data leave one undecided, they and the training data change
    places: `exchange` judges it there, too; None where they cannot.
    """
    inflation = short_list.inflation
    for one in short_list.plainest_first:
        behind = short_list.judged[0].support(inflation) - one.support(inflation)
        if behind > EVIDENCE:
            return None
        if one.evidence(inflation) <= short_list.needed:
            continue
        if one.is_undecided and exchange is not None:
            # Not part of its support: the training data speak in the evidence already, and the
            # others are not asked.
            one = exchange(one)
        if one.has_one_size and one.predicts_motion and one.has_held_out_support:
            return one
    return None


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

    As far as the compiled program has room for them. Where an accepted effect came out larger than
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
        if name in screening.candidates
        and has_room(problem, current, name)
        and catalogue_name(name) not in doubtful
    ]

    def refit_first(name: str) -> Hypothesis:
        number, stage = names.index(name), f"trying {len(names)} causes"
        message = f"trying cause {number + 1} of {len(names)}: {name}"
        progress(PartialProgress(message, number / len(names), stage))
        return refit_at_fixed_noise(problem, current, screening.candidates[name])

    # A compiled program runs on one core and lets other threads run meanwhile.
    def refit_on(one: Hypothesis) -> Hypothesis:
        return refit_fully(data, current, one.candidate, start_beside(problem, current, one))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        near, rest = near_the_best(list(pool.map(in_this_budget(refit_first), names)))
        full = list(pool.map(in_this_budget(refit_on), near))
    return ShortList.of(problem, [*full, *rest])


@dataclasses.dataclass(frozen=True)
class AcceptedEffect:
    """An effect that was accepted, with what else could have been."""

    hypothesis: Hypothesis
    short_list: ShortList  # that it was chosen from

    @property
    def name(self) -> str:
        """The effect's name in the catalogue's registry."""
        return self.hypothesis.effect

    @property
    def rivals(self) -> tuple[str, ...]:
        """Catalogue names that the same data support nearly as well, the best first."""
        best, names = self.hypothesis, dict[str, None]()
        for other in self.short_list.judged:
            is_near = best.support(best.inflation) - other.support(best.inflation) < EVIDENCE
            if is_near and not other.is_akin_to(best):
                names[catalogue_name(other.effect)] = None
        return tuple(names)

    @property
    def lead(self) -> float:
        """Twice the log of its odds against the next best name, or none; all data together."""
        best = self.hypothesis
        others = [
            one.support(best.inflation)
            for one in self.short_list.hypotheses
            if one.is_physical and not one.is_akin_to(best)
        ]
        return best.support(best.inflation) - max([0.0, *others])
