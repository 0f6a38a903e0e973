"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round tunes the filter at the current estimate, improves the parameters by
Gauss-Newton steps with the gains held fixed, and re-estimates the noise. A few rounds
converge.
"""

import dataclasses

import numpy as np

from diffsea.identification.estimates import (
    Estimate,
    PartialProgress,
    Progress,
    no_progress,
    posterior_estimate,
)
from diffsea.identification.filter import kalman
from diffsea.identification.filter.kalman import FilterRun, deviance
from diffsea.identification.filter.noise_fit import (
    LinearisedRun,
    RowTimes,
    refine_noise,
    take_excerpt,
)
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.problem import (
    Problem,
    jacobian,
    minimise,
    selection,
    traced,
)
from diffsea.statistics import autocorrelation, long_run_covariance


ROUNDS = 60  # from afar, with sensors of little noise, thirty are needed
NOISE_STEPS = 1  # of Fisher scoring in one round
FIRST_STEPS = 15  # and in the first one


def estimate(
    problem: Problem,
    free: tuple[str, ...],
    start: np.ndarray | None = None,
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
    noise, steps = (first, FIRST_STEPS) if noise is None else (noise, NOISE_STEPS)
    index, matrix = selection(problem.layout, free, problem.width)
    run = problem.run_filter(coordinates, noise)
    now = negative_log_posterior(problem, coordinates, noise, run)
    path = [now]
    for number in range(rounds):
        last = now
        if not fixed_noise:
            better = refine_noise(
                *take_excerpt(_path(run), _clock(problem)), noise, problem.prior, steps
            )
            steps = NOISE_STEPS
            there = problem.run_filter(coordinates, better)
            value = negative_log_posterior(problem, coordinates, better, there)
            if value < now or (np.isfinite(value) and not np.isfinite(now)):
                noise, run, now = better, there, value
        target = _target(problem, coordinates, run, index, matrix)
        coordinates, run, now = _walk(problem, coordinates, target, noise, run, now)
        path.append(now)
        message = f"round {number + 1}: -2 log posterior {now:.1f}"
        progress(PartialProgress(message, (number + 1) / rounds))
        if abs(last - now) < 0.05 + 1e-6 * abs(now):
            break
    else:
        if rounds == ROUNDS:
            progress(f"not at its end after {rounds} rounds: the last one gained {last - now:.1f}")
    fitted = _judged(problem, free, coordinates, noise, run, now, index, matrix)
    return dataclasses.replace(fitted, path=tuple(path))


def _target(
    problem: Problem, coordinates: np.ndarray, run: FilterRun, index: np.ndarray, matrix: np.ndarray
) -> np.ndarray:
    """Coordinates that fit best with the gains held fixed."""
    inputs, layout = traced(problem, run.gains, coordinates, matrix)
    target = coordinates.copy()
    target[index] = minimise(inputs, layout, coordinates[index])
    return target


def _walk(
    problem: Problem,
    start: np.ndarray,
    target: np.ndarray,
    noise: Noise,
    run: FilterRun,
    now: float,
) -> tuple[np.ndarray, FilterRun, float]:
    """Go to the target, or part of the way where the filter with its own gains is worse there."""
    for share in (1.0, 0.5, 0.2, 0.05):
        coordinates = start + share * (target - start)
        there = problem.run_filter(coordinates, noise)
        value = negative_log_posterior(problem, coordinates, noise, there)
        if value < now or (np.isfinite(value) and not np.isfinite(now)):
            return coordinates, there, value
    return start, run, now


def _path(run: FilterRun) -> LinearisedRun:
    g = run.gains
    return LinearisedRun(
        run.F,
        run.H,
        g.correction,
        run.innovation,
        g.used,
        run.gust_impulse,
        run.gust_acceleration,
        run.rows_late,
    )


def _clock(problem: Problem) -> RowTimes:
    dataset = problem.dataset
    return RowTimes(dataset.dt, dataset.starts, kalman.first_variance(problem.base))


def negative_log_posterior(
    problem: Problem, coordinates: np.ndarray, noise: Noise, run: FilterRun | None = None
) -> float:
    """-2 log posterior without its constant; `run` is the filter's run there, if known."""
    run = problem.run_filter(coordinates, noise) if run is None else run
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    return float(deviance(run)) + float(off @ off) + float(away @ away)


def _judged(
    problem: Problem,
    free: tuple[str, ...],
    coordinates: np.ndarray,
    noise: Noise,
    run: FilterRun,
    deviance: float,
    index: np.ndarray,
    matrix: np.ndarray,
) -> Estimate:
    """The estimate with its covariance.

    The larger of the inverse information and the sandwich with the innovations' own
    autocorrelation, which does not trust them to be white.
    """
    inputs, layout = traced(problem, run.gains, coordinates, matrix)
    residual, J = jacobian(coordinates[index], (inputs, layout))
    rows = problem.dataset.measured.size
    J = J[:rows, : len(index)]
    correlation = autocorrelation(residual[:rows].reshape(-1, 6), np.asarray(problem.dataset.run))
    return posterior_estimate(
        free, coordinates, deviance, index, problem.layout.local_spreads(coordinates), J.T @ J,
        long_run_covariance(J, correlation), noise,
    )  # fmt: skip


def normalised_rms(problem: Problem, coordinates: np.ndarray, noise: Noise) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    run = problem.run_filter(coordinates, noise)
    count = np.asarray(run.gains.used).sum()
    return float(np.sqrt((np.asarray(run.white) ** 2).sum() / max(count, 1)))
