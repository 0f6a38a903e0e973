"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round runs the filter at the current estimate, re-estimates the noise, and takes one step of
the parameters. A few rounds converge.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea.budget import current_budget, on_every_core
from diffsea.identification.descent import (
    Correction,
    Descent,
    FilteredPoint,
    descend,
    filter_at,
)
from diffsea.identification.estimates import Estimate, FitOutcome, is_at_bound, posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun, first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise, search_programs
from diffsea.identification.kept_fits import kept_fit
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.identification.residual import innovations_at, linearise
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.statistics import autocorrelation, long_run_covariance


ROUNDS = 100  # from afar, with sensors of little noise, fifty are needed
NOISE_STEPS = 1  # of the search for noise in one round: from afar, more take misfit for noise
MORE_NOISE_STEPS = 4  # where the noise gains more than the parameters do
FIRST_NOISE_STEPS = 15  # and in the first one
NOISE_ROUNDS = 5  # of noise alone
LITTLE_BY_NOISE = 0.1  # of what a round gained: the next one leaves the noise as it is
SETTLED_NOISE = 1.0  # of -2 log posterior by noise, from which on a step is not corrected yet
LEAST_GAIN = 0.02  # of -2 log posterior, below which a round is the last: no error shows it
RELATIVE_GAIN = 2e-7  # likewise, of its value: rounding of a long recording's sum
RESTARTS = 2  # of a fit that stalled
RESTART_DISTANCE = 2.0  # standard errors along each principal axis, that it starts from its end
RESTART_RISE = 10.0  # times what its covariance says: where it is less likely still is too far
RESTART_HALVINGS = 6
STALLED_GAIN = 1.0  # a step that promised so much and was refused: one standard error away


class Start(NamedTuple):
    """Where a fit may begin.

    Attributes:
        coordinates: those that are not free included.
        noise: as expected beforehand if None.
        left_out: of the slope there by gains held fixed, as of an `Estimate`; nothing if None.
    """

    coordinates: Coordinates
    noise: Noise | None = None
    left_out: Coordinates | None = None

    @classmethod
    def at(cls, fitted: Estimate) -> "Start":
        """Where another fit ended."""
        return cls(fitted.coordinates, fitted.noise, fitted.left_out)

    @classmethod
    def of_other_data(cls, fitted: Estimate) -> "Start":
        """Where a fit to other data ended, whose slopes are not those of these."""
        return cls(fitted.coordinates, fitted.noise)

    @classmethod
    def beside(cls, fitted: Estimate, coordinates: Coordinates) -> "Start":
        """At some coordinates, with all else as where another fit ended."""
        return cls(coordinates, fitted.noise, fitted.left_out)


def compile_programs(problem: Problem, screened: bool = False) -> None:
    """Have the programs of a fit compiled, several at a time, as they are not where they are met.

    They are called with whatever has their shapes, which takes as long as one round of a fit.

    Arguments:
        screened: whether innovations without their slopes are asked for, too.
    """
    coordinates, noise = problem.start()
    shapes = eqx.filter_eval_shape(problem.run_filter, coordinates, noise)
    run = jax.tree.map(lambda one: jnp.ones(one.shape, one.dtype), shapes)
    data = problem.dataset
    times = RowTimes(data.dt, data.run, first_variance(problem.base))
    calls = [
        lambda: linearise(problem, run.gains, coordinates, ()),
        lambda: problem.run_filter(coordinates, noise),
        *search_programs(run, times, problem.prior),
    ]
    if screened:
        calls.append(lambda: innovations_at(problem, run.gains, coordinates))
    on_every_core(lambda call: call(), calls)


def noise_at(problem: Problem, coordinates: Coordinates, noise: Noise | None = None) -> Noise:
    """The noise of the filter at some coordinates, which stay as they are.

    Arguments:
        noise: the noise to begin with; as expected beforehand if None.
    """
    data = problem.dataset
    noise = problem.start()[1] if noise is None else noise
    times = RowTimes(data.dt, data.run, first_variance(problem.base))
    now = filter_at(problem, coordinates, noise)
    for _ in range(NOISE_ROUNDS):
        better, _ = refine_noise(now.run, times, now.noise, problem.prior, FIRST_NOISE_STEPS)
        there = filter_at(problem, coordinates, better)
        if not now.deviance - there.deviance > LEAST_GAIN:
            break
        now = there
    return now.noise


def estimate(
    problem: Problem,
    free: tuple[str, ...],
    start: Start | None = None,
    rounds: int = ROUNDS,
    fixed_noise: bool = False,
    progress: Progress = no_progress,
) -> Estimate:
    """Fit the free coordinates by name (parameters and effects).

    Where fits are kept (`kept_fits`), one that was made before is taken from there.

    Arguments:
        start: where to begin; at the prior mean if None.
        fixed_noise: whether the noise stays as it is there.
    """
    start = Start(problem.start()[0]) if start is None else start
    steps = FIRST_NOISE_STEPS if start.noise is None else NOISE_STEPS
    settings = free, *_complete(problem, start), steps, rounds, fixed_noise
    search = functools.partial(_search, problem, *settings)
    return kept_fit(problem, settings, search, progress)


def _complete(problem: Problem, start: Start) -> tuple[Coordinates, Noise, Coordinates]:
    """What a start says, and what is usual where it says nothing."""
    coordinates = np.array(start.coordinates, float)
    noise = problem.start()[1] if start.noise is None else start.noise
    left_out = np.zeros(len(coordinates)) if start.left_out is None else start.left_out
    return coordinates, noise, left_out


def _search(
    problem: Problem,
    free: tuple[str, ...],
    coordinates: Coordinates,
    noise: Noise,
    left_out: Coordinates,
    steps: int,
    rounds: int,
    fixed_noise: bool,
    progress: Progress,
) -> Estimate:
    """The fit from some coordinates, with so many `steps` of the noise in the first round.

    Every round lowers the deviance: first by the noise, so that the innovations are weighed
    rightly, then by the parameters. None is begun once the budget is spent. With fixed noise, a
    first look, what held gains leave out of the slope stays as it was where the fit began.
    """
    index = np.array(problem.layout.indices(free), int)
    data = problem.dataset
    times = RowTimes(data.dt, data.run, first_variance(problem.base))
    now = filter_at(problem, coordinates, noise)
    path, outcome, curvature = [now.deviance], FitOutcome.STEP_LIMIT, None
    step = Descent(now, left_out[index])
    for number in range(rounds):
        if current_budget().skips("rounds of a fit"):
            outcome = FitOutcome.OUT_OF_TIME
            break
        last, taken = now.deviance, steps
        least = LEAST_GAIN + RELATIVE_GAIN * abs(last)
        if steps and not fixed_noise:
            # By a curvature that is too large a fit would seem to be at its end.
            borrowed = curvature if steps < FIRST_NOISE_STEPS else None
            better, curvature = refine_noise(
                now.run, times, now.noise, problem.prior, steps, borrowed
            )
            there = filter_at(problem, now.coordinates, better)
            now = there if there.better_than(now) else now
        by_noise = last - now.deviance
        if not (step.is_last and abs(by_noise) < least):
            corrects = Correction.NEVER
            if not fixed_noise and by_noise < SETTLED_NOISE:
                at_end = number > 0 and taken == FIRST_NOISE_STEPS
                corrects = Correction.AT_ONCE if at_end else Correction.WHERE_REFUSED
            step = descend(problem, now, index, step.left_out, corrects, least)
            now = step.point
        path.append(now.deviance)
        message = f"fitting, step {number + 1}: misfit {normalised_rms(now.run):.3f}"
        progress(PartialProgress(message, (number + 1) / rounds))
        gained = last - now.deviance
        settled = abs(gained) < least
        if settled and (fixed_noise or taken == FIRST_NOISE_STEPS and step.corrected):
            outcome = FitOutcome.CONVERGED
            break
        # Noise creeps along flat directions: a fit is at its end where many steps gain nothing.
        if settled or step.refused:
            steps = FIRST_NOISE_STEPS
        elif by_noise > gained - by_noise:
            steps = MORE_NOISE_STEPS
        else:
            # What the filter refused is tried again, from elsewhere.
            little = 0 < by_noise < LITTLE_BY_NOISE * gained
            steps = 0 if taken and little else NOISE_STEPS
    else:
        progress(f"the fit is not at its end after {rounds} steps")
    return _with_covariance(problem, free, now, step, index, path, outcome)


def likeliest_start(problem: Problem, starts: Sequence[Start]) -> Start:
    """The one that is most likely, by the filter's run there."""
    if len(starts) == 1:
        return starts[0]
    points = [filter_at(problem, *_complete(problem, one)[:2]) for one in starts]
    found = np.nan_to_num([one.deviance for one in points], nan=np.inf)
    return starts[int(np.argmin(found))]


def estimate_surely(
    problem: Problem,
    free: tuple[str, ...],
    start: Start | None = None,
    progress: Progress = no_progress,
) -> Estimate:
    """`estimate`, `settled`."""
    fitted = estimate(problem, free, start, progress=progress)
    return settled(problem, fitted, (), progress)


def settled(
    problem: Problem,
    best: Estimate,
    plainer: Sequence[Start] = (),
    progress: Progress = no_progress,
) -> Estimate:
    """A fit whose optimiser stalled, again from elsewhere until two fits end alike; else itself.

    What is compared with other fits must have ended, or the odds count how far the search came.

    Arguments:
        plainer: where models ended that this one contains. Begun there first, if that is likelier
            than where it got stuck; where nothing is gained from there, two fits end alike.
    """
    free, rng = best.free, np.random.default_rng(0)
    stuck = Start.at(best)
    if plainer and best.outcome is FitOutcome.STALLED:
        start = likeliest_start(problem, (stuck, *plainer))
        if start is not stuck:
            best = estimate(problem, free, start, progress=progress)
            if best.path[0] - best.deviance < STALLED_GAIN:
                return dataclasses.replace(best, outcome=FitOutcome.CONVERGED)
    for _ in range(RESTARTS):
        if best.outcome in (FitOutcome.CONVERGED, FitOutcome.BOUNDED):
            break
        if current_budget().skips("starting a stalled fit again"):
            break
        progress("the fit got stuck; once more from another start")
        other = estimate(problem, free, _elsewhere(problem, best, rng), progress=progress)
        is_same = abs(other.deviance - best.deviance) < STALLED_GAIN
        best = min(best, other, key=lambda one: np.nan_to_num(one.deviance, nan=np.inf))
        if is_same:
            return dataclasses.replace(best, outcome=FitOutcome.CONVERGED)
    return best


def _elsewhere(problem: Problem, best: Estimate, rng: np.random.Generator) -> Start:
    """Where a fit that stalled begins again: off by two standard errors along each principal axis.

    Were coordinates that depend on one another moved each by itself, it would be far from anything
    the data allow. Nearer, where the filter has it far less likely than its covariance does: that
    is a tangent of what a kink or a dead band bends.
    """
    root = np.linalg.cholesky(best.covariance)
    away = RESTART_DISTANCE * root @ rng.standard_normal(len(best.index))
    most = best.deviance + RESTART_RISE * RESTART_DISTANCE**2 * len(best.index)
    for _ in range(RESTART_HALVINGS):
        there = best.coordinates.copy()
        there[best.index] += away
        if filter_at(problem, there, best.noise).deviance < most:
            break
        away = away / 2
    return Start.beside(best, there)


def _with_covariance(
    problem: Problem,
    free: tuple[str, ...],
    found: FilteredPoint,
    step: Descent,
    index: FreeIndex,
    path: Sequence[float],
    outcome: FitOutcome,
) -> Estimate:
    """The estimate with its covariance, and how the fit ended; `step` was its last.

    The covariance is the larger of the inverse information and the sandwich with the innovations'
    own autocorrelation, which does not trust them to be white.
    """
    coordinates, layout = found.coordinates, problem.layout
    model = step.model if step.refused and step.point is found else None
    model = linearise(problem, found.run.gains, coordinates, index) if model is None else model
    residual, J = model
    rows = problem.dataset.measured.size
    J = J[:rows]
    correlation = autocorrelation(residual[:rows].reshape(-1, 6), np.asarray(problem.dataset.run))
    spreads = layout.local_spreads(coordinates)
    further = problem.linear_rows(coordinates, index).information
    information = J.T @ J + further
    if outcome is FitOutcome.CONVERGED:
        if step.refused and not step.promised < STALLED_GAIN or not np.isfinite(found.deviance):
            outcome = FitOutcome.STALLED
        elif is_at_bound(layout.parameters, coordinates, index):
            outcome = FitOutcome.BOUNDED
    left_out = np.zeros(layout.size)
    left_out[index] = step.left_out
    fitted = posterior_estimate(
        free,
        coordinates,
        found.deviance,
        index,
        spreads,
        information,
        long_run_covariance(J, correlation) + further,
        found.noise,
        path,
        outcome,
        left_out,
    )
    fitted.keep_filter_run(problem, found.run)
    return fitted


def normalised_rms(run: FilterRun) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    count = np.asarray(run.gains.used).sum()
    return float(np.sqrt((np.asarray(run.white) ** 2).sum() / max(count, 1)))
