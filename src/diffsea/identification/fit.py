"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round runs the filter at the current estimate, improves the parameters by Gauss-Newton steps
with the gains held fixed, and re-estimates the noise. A few rounds converge.
"""

import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import (
    Estimate,
    FitOutcome,
    PartialProgress,
    Progress,
    is_at_bound,
    no_progress,
    posterior_estimate,
)
from diffsea.identification.filter.kalman import FilterRun, deviance, first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.identification.residual import fit_coordinates, linearise, residual_inputs
from diffsea.statistics import autocorrelation, long_run_covariance


ROUNDS = 60  # from afar, with sensors of little noise, thirty are needed
NOISE_STEPS = 1  # of Fisher scoring in one round
FIRST_NOISE_STEPS = 15  # and in the first one
STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # of a Gauss-Newton step, tried one after the other
LEAST_GAIN = 0.05  # of -2 log posterior, below which a round is the last: no error shows it
RELATIVE_GAIN = 1e-6  # likewise, of its value: rounding of a long recording's sum
STALLED_GAIN = 1.0  # a step that promised so much and was refused: one standard error away


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
    rightly, then by the parameters.
    """
    coordinates, first = problem.start()
    coordinates = coordinates if start is None else np.array(start, float)
    noise, steps = (first, FIRST_NOISE_STEPS) if noise is None else (noise, NOISE_STEPS)
    index = np.array(problem.layout.indices(free), int)
    times = RowTimes(problem.dataset.dt, problem.dataset.starts, first_variance(problem.base))
    run = problem.run_filter(coordinates, noise)
    now = posterior_deviance(problem, coordinates, noise, run)
    path, outcome = [now], FitOutcome.STEP_LIMIT
    refused = np.zeros(len(index))
    for number in range(rounds):
        last = now
        if not fixed_noise:
            better = refine_noise(run, times, noise, problem.prior, steps)
            steps = NOISE_STEPS
            there = problem.run_filter(coordinates, better)
            value = posterior_deviance(problem, coordinates, better, there)
            if value < now or (np.isfinite(value) and not np.isfinite(now)):
                noise, run, now = better, there, value
        before, target = coordinates, coordinates.copy()
        inputs = residual_inputs(problem, run.gains, coordinates, index)
        target[index] = fit_coordinates(inputs, coordinates[index])
        coordinates, run, now = _line_search(problem, before, target, noise, run, now)
        refused = np.where(coordinates is before, target - before, 0.0)[index]
        path.append(now)
        message = f"round {number + 1}: -2 log posterior {now:.1f}"
        progress(PartialProgress(message, (number + 1) / rounds))
        if abs(last - now) < LEAST_GAIN + RELATIVE_GAIN * abs(now):
            outcome = FitOutcome.CONVERGED
            break
    else:
        progress(f"not at its end after {rounds} rounds: the last one gained {last - now:.1f}")
    return _with_covariance(
        problem, free, coordinates, noise, run, now, index, tuple(path), outcome, refused
    )


def _line_search(
    problem: Problem,
    start: Coordinates,
    target: Coordinates,
    noise: Noise,
    run: FilterRun,
    now: float,
) -> tuple[Coordinates, FilterRun, float]:
    """Go to the target, or part of the way where the filter with its own gains is worse there."""
    for share in STEP_SHARES:
        coordinates = start + share * (target - start)
        there = problem.run_filter(coordinates, noise)
        value = posterior_deviance(problem, coordinates, noise, there)
        if value < now or (np.isfinite(value) and not np.isfinite(now)):
            return coordinates, there, value
    return start, run, now


def posterior_deviance(
    problem: Problem, coordinates: Coordinates, noise: Noise, run: FilterRun | None = None
) -> float:
    """-2 log posterior without its constant; `run` is the filter's run there, if known."""
    run = problem.run_filter(coordinates, noise) if run is None else run
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    return float(deviance(run)) + float(off @ off) + float(away @ away)


def _with_covariance(
    problem: Problem,
    free: tuple[str, ...],
    coordinates: Coordinates,
    noise: Noise,
    run: FilterRun,
    value: float,
    index: FreeIndex,
    path: tuple[float, ...],
    outcome: FitOutcome,
    refused: Float[np.ndarray, "free"],
) -> Estimate:
    """The estimate with its covariance, and how the fit ended; `refused` was its last step.

    The covariance is the larger of the inverse information and the sandwich with the innovations'
    own autocorrelation, which does not trust them to be white.
    """
    residual, J = linearise(problem, run.gains, coordinates, index)
    rows = problem.dataset.measured.size
    J = J[:rows]
    correlation = autocorrelation(residual[:rows].reshape(-1, 6), np.asarray(problem.dataset.run))
    spreads = problem.layout.local_spreads(coordinates)
    information = J.T @ J
    if outcome is FitOutcome.CONVERGED:
        promised = refused @ information @ refused + np.sum((refused / spreads[index]) ** 2)
        if not (np.isfinite(value) and promised < STALLED_GAIN):
            outcome = FitOutcome.STALLED
        elif is_at_bound(problem.layout.parameters, coordinates, index):
            outcome = FitOutcome.BOUNDED
    fitted = posterior_estimate(
        free,
        coordinates,
        value,
        index,
        spreads,
        information,
        long_run_covariance(J, correlation),
        noise,
        path,
        outcome,
    )
    fitted.keep_filter_run(problem, run)
    return fitted


def normalised_rms(run: FilterRun) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    count = np.asarray(run.gains.used).sum()
    return float(np.sqrt((np.asarray(run.white) ** 2).sum() / max(count, 1)))
