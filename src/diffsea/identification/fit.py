"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round runs the filter at the current estimate, re-estimates the noise, and improves the
parameters by Gauss-Newton steps with the gains held fixed. A few rounds converge.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffsea.budget import current_budget
from diffsea.identification.estimates import Estimate, FitOutcome, is_at_bound, posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun, deviance, first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.identification.residual import fit_coordinates, linearise, residual_inputs
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.statistics import autocorrelation, long_run_covariance


ROUNDS = 60  # from afar, with sensors of little noise, thirty are needed
NOISE_STEPS = 1  # of the search for noise in one round: from afar, more take misfit for noise
MORE_NOISE_STEPS = 4  # where the noise gains more than the parameters do
FIRST_NOISE_STEPS = 15  # and in the first one
NOISE_ROUNDS = 5  # of noise alone
STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # of a Gauss-Newton step, tried one after the other
LEAST_GAIN = 0.05  # of -2 log posterior, below which a round is the last: no error shows it
RELATIVE_GAIN = 1e-6  # likewise, of its value: rounding of a long recording's sum
LINE_STEP = 0.5  # standard errors to both sides, by which a parabola is laid
LINE_REACH = 3.0  # of them that its vertex may be away
RESTARTS = 2  # of a fit that stalled
RESTART_DISTANCE = 2.0  # standard errors that it starts from its end
STALLED_GAIN = 1.0  # a step that promised so much and was refused: one standard error away


class FilteredPoint(NamedTuple):
    """The filter's run at some coordinates and noise, and how likely they are."""

    coordinates: Coordinates
    noise: Noise
    run: FilterRun
    deviance: float  # -2 log posterior without its constant; priors, further data included

    def better_than(self, other: "FilteredPoint") -> bool:
        """Whether it is more likely; where the filter diverged, any other point is."""
        mended = np.isfinite(self.deviance) and not np.isfinite(other.deviance)
        return self.deviance < other.deviance or bool(mended)


def filter_at(problem: Problem, coordinates: Coordinates, noise: Noise) -> FilteredPoint:
    """Run the filter at some coordinates and noise."""
    run = problem.run_filter(coordinates, noise)
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    value = float(deviance(run)) + float(off @ off) + float(away @ away)
    value += problem.further_cost(coordinates)
    return FilteredPoint(coordinates, noise, run, value)


def noise_at(problem: Problem, coordinates: Coordinates, noise: Noise | None = None) -> Noise:
    """The noise of the filter at some coordinates, which stay as they are.

    Arguments:
        noise: the noise to begin with; as expected beforehand if None.
    """
    data = problem.dataset
    noise = problem.start()[1] if noise is None else noise
    times = RowTimes(data.dt, data.starts, data.run, first_variance(problem.base))
    now = filter_at(problem, coordinates, noise)
    for _ in range(NOISE_ROUNDS):
        better = refine_noise(now.run, times, now.noise, problem.prior, FIRST_NOISE_STEPS)
        there = filter_at(problem, coordinates, better)
        if not now.deviance - there.deviance > LEAST_GAIN:
            break
        now = there
    return now.noise


def estimate(
    problem: Problem,
    free: tuple[str, ...],
    start: Coordinates | None = None,
    noise: Noise | None = None,
    rounds: int = ROUNDS,
    fixed_noise: bool = False,
    progress: Progress = no_progress,
) -> Estimate:
    """Fit the free coordinates by name (parameters and effects), from `start`.

    Every round lowers the deviance: first by the noise, so that the innovations are weighed
    rightly, then by the parameters. None is begun once the budget is spent.

    Arguments:
        start: coordinates to begin at, those that are not free included; the prior mean if None.
        noise: the noise to begin with; as expected beforehand if None.
        fixed_noise: whether it stays as it is.
    """
    coordinates, first = problem.start()
    coordinates = coordinates if start is None else np.array(start, float)
    noise, steps = (first, FIRST_NOISE_STEPS) if noise is None else (noise, NOISE_STEPS)
    index = np.array(problem.layout.indices(free), int)
    data = problem.dataset
    times = RowTimes(data.dt, data.starts, data.run, first_variance(problem.base))
    now = filter_at(problem, coordinates, noise)
    path, outcome = [now.deviance], FitOutcome.STEP_LIMIT
    refused = np.zeros(len(index))
    for number in range(rounds):
        if current_budget().skips("rounds of a fit"):
            outcome = FitOutcome.OUT_OF_TIME
            break
        last, taken = now.deviance, steps
        if not fixed_noise:
            better = refine_noise(now.run, times, now.noise, problem.prior, steps)
            there = filter_at(problem, now.coordinates, better)
            now = there if there.better_than(now) else now
        by_noise = last - now.deviance
        before, target = now.coordinates, now.coordinates.copy()
        inputs = residual_inputs(problem, now.run.gains, before, index)
        target[index] = fit_coordinates(inputs, before[index])
        refused = (target - before)[index]
        # Part of the way where the filter with its own gains is worse at the target.
        for share in STEP_SHARES:
            there = filter_at(problem, before + share * (target - before), now.noise)
            if there.better_than(now):
                now, refused = there, np.zeros(len(index))
                break
        path.append(now.deviance)
        message = f"fitting, step {number + 1}: misfit {normalised_rms(now.run):.3f}"
        progress(PartialProgress(message, (number + 1) / rounds))
        gained = last - now.deviance
        settled = abs(gained) < LEAST_GAIN + RELATIVE_GAIN * abs(now.deviance)
        if settled and (fixed_noise or taken == FIRST_NOISE_STEPS):
            there = now
            if refused.any() and not fixed_noise:
                there = line_minima(problem, now, index, refused)
                refused = np.zeros(len(index))
            if not now.deviance - there.deviance > LEAST_GAIN:
                outcome = FitOutcome.CONVERGED
                break
            now = there
        # Noise creeps along flat directions: a fit is at its end where many steps gain nothing.
        more = MORE_NOISE_STEPS if by_noise > gained - by_noise else NOISE_STEPS
        steps = FIRST_NOISE_STEPS if settled else more
    else:
        progress(f"the fit is not at its end after {rounds} steps")
    return _with_covariance(problem, free, now, index, path, outcome, refused)


def line_minima(
    problem: Problem, now: FilteredPoint, index: FreeIndex, refused: Float[np.ndarray, "free"]
) -> FilteredPoint:
    """The point after one search along each principal axis of the posterior, by parabolas.

    A step with the gains held fixed neglects how they change with the coordinates: where a step
    that promised something was `refused`, what the filter itself says leads on.
    """
    J = linearise(problem, now.run.gains, now.coordinates, index).jacobian
    if not refused @ J.T @ J @ refused > LEAST_GAIN:
        return now
    values, axes = np.linalg.eigh(J.T @ J)

    def along(axis: Float[np.ndarray, "free"], errors: float) -> FilteredPoint:
        there = now.coordinates.copy()
        there[index] += errors * axis
        return filter_at(problem, there, now.noise)

    for axis in (axes / np.sqrt(values)).T:
        tried = [along(axis, -LINE_STEP), along(axis, LINE_STEP)]
        below, above = (one.deviance for one in tried)
        bend = (above + below - 2 * now.deviance) / LINE_STEP**2
        if bend > 0:
            vertex = (below - above) / (2 * LINE_STEP * bend)
            tried.append(along(axis, float(np.clip(vertex, -LINE_REACH, LINE_REACH))))
        for there in tried:
            now = there if there.better_than(now) else now
    return now


def estimate_surely(
    problem: Problem,
    free: tuple[str, ...],
    start: Coordinates | None = None,
    noise: Noise | None = None,
    progress: Progress = no_progress,
) -> Estimate:
    """`estimate`; where the optimiser stalled, again from elsewhere until two fits end alike.

    What is compared with other fits must have ended, or the odds count how far the search came.
    """
    best, rng = estimate(problem, free, start, noise, progress=progress), np.random.default_rng(0)
    for _ in range(RESTARTS):
        if best.outcome in (FitOutcome.CONVERGED, FitOutcome.BOUNDED):
            break
        if current_budget().skips("starting a stalled fit again"):
            break
        progress("the fit got stuck; once more from another start")
        elsewhere = best.coordinates.copy()
        elsewhere[best.index] += RESTART_DISTANCE * best.stds * rng.standard_normal(len(best.index))
        other = estimate(problem, free, elsewhere, best.noise, progress=progress)
        is_same = abs(other.deviance - best.deviance) < STALLED_GAIN
        best = min(best, other, key=lambda one: np.nan_to_num(one.deviance, nan=np.inf))
        if is_same:
            return dataclasses.replace(best, outcome=FitOutcome.CONVERGED)
    return best


def _with_covariance(
    problem: Problem,
    free: tuple[str, ...],
    found: FilteredPoint,
    index: FreeIndex,
    path: Sequence[float],
    outcome: FitOutcome,
    refused: Float[np.ndarray, "free"],
) -> Estimate:
    """The estimate with its covariance, and how the fit ended; `refused` was its last step.

    The covariance is the larger of the inverse information and the sandwich with the innovations'
    own autocorrelation, which does not trust them to be white.
    """
    coordinates, layout = found.coordinates, problem.layout
    residual, J = linearise(problem, found.run.gains, coordinates, index)
    rows = problem.dataset.measured.size
    J = J[:rows]
    correlation = autocorrelation(residual[:rows].reshape(-1, 6), np.asarray(problem.dataset.run))
    spreads = layout.local_spreads(coordinates)
    further = problem.linear_rows(coordinates, index).information
    information = J.T @ J + further
    if outcome is FitOutcome.CONVERGED:
        promised = refused @ information @ refused + np.sum((refused / spreads[index]) ** 2)
        if not (np.isfinite(found.deviance) and promised < STALLED_GAIN):
            outcome = FitOutcome.STALLED
        elif is_at_bound(layout.parameters, coordinates, index):
            outcome = FitOutcome.BOUNDED
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
    )
    fitted.keep_filter_run(problem, found.run)
    return fitted


def normalised_rms(run: FilterRun) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    count = np.asarray(run.gains.used).sum()
    return float(np.sqrt((np.asarray(run.white) ** 2).sum() / max(count, 1)))
