"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round tunes the filter at the current estimate, improves the parameters by
Gauss-Newton steps with the gains held fixed, and re-estimates the noise. A few rounds
converge.
"""

import dataclasses

import numpy as np

from diffsea.identification.estimates import Estimate, PartialProgress, Progress, made, silent
from diffsea.identification.filter import kalman
from diffsea.identification.filter.kalman import Tuned, deviance
from diffsea.identification.filter.noise_fit import Clock, Path, excerpt, refine
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
    progress: Progress = silent,
) -> Estimate:
    """Fit the free coordinates by name (parameters and effects), from `start`.

    Every round lowers the deviance: first by the noise, so that the innovations are weighed
    rightly, then by the parameters.
    """
    coordinates, first = problem.start()
    coordinates = coordinates if start is None else np.array(start, float)
    noise, steps = (first, FIRST_STEPS) if noise is None else (noise, NOISE_STEPS)
    index, matrix = selection(problem.layout, free, problem.width)
    tuned = problem.tuned(coordinates, noise)
    now = posterior(problem, coordinates, noise, tuned)
    path = [now]
    for number in range(rounds):
        last = now
        if not fixed_noise:
            better = refine(*excerpt(_path(tuned), _clock(problem)), noise, problem.prior, steps)
            steps = NOISE_STEPS
            there = problem.tuned(coordinates, better)
            value = posterior(problem, coordinates, better, there)
            if value < now or (np.isfinite(value) and not np.isfinite(now)):
                noise, tuned, now = better, there, value
        target = _target(problem, coordinates, tuned, index, matrix)
        coordinates, tuned, now = _walk(problem, coordinates, target, noise, tuned, now)
        path.append(now)
        message = f"round {number + 1}: -2 log posterior {now:.1f}"
        progress(PartialProgress(message, (number + 1) / rounds))
        if abs(last - now) < 0.05 + 1e-6 * abs(now):
            break
    else:
        if rounds == ROUNDS:
            progress(f"not at its end after {rounds} rounds: the last one gained {last - now:.1f}")
    fitted = _judged(problem, free, coordinates, noise, tuned, now, index, matrix)
    return dataclasses.replace(fitted, path=tuple(path))


def _target(
    problem: Problem, coordinates: np.ndarray, tuned: Tuned, index: np.ndarray, matrix: np.ndarray
) -> np.ndarray:
    """Coordinates that fit best with the gains held fixed."""
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    target = coordinates.copy()
    target[index] = minimise(inputs, layout, coordinates[index])
    return target


def _walk(
    problem: Problem, start: np.ndarray, target: np.ndarray, noise: Noise, tuned: Tuned, now: float
) -> tuple[np.ndarray, Tuned, float]:
    """Go to the target, or part of the way where the filter with its own gains is worse there."""
    for share in (1.0, 0.5, 0.2, 0.05):
        coordinates = start + share * (target - start)
        there = problem.tuned(coordinates, noise)
        value = posterior(problem, coordinates, noise, there)
        if value < now or (np.isfinite(value) and not np.isfinite(now)):
            return coordinates, there, value
    return start, tuned, now


def _path(tuned: Tuned) -> Path:
    g = tuned.gains
    return Path(
        tuned.F, tuned.H, g.correction, tuned.nu, g.used, tuned.kick, tuned.lasting, tuned.late
    )


def _clock(problem: Problem) -> Clock:
    tape = problem.tape
    return Clock(tape.dt, tape.starts, kalman.first_variance(problem.base))


def posterior(
    problem: Problem, coordinates: np.ndarray, noise: Noise, tuned: Tuned | None = None
) -> float:
    """-2 log posterior without its constant; `tuned` is the filter's run there, if known."""
    tuned = problem.tuned(coordinates, noise) if tuned is None else tuned
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    return float(deviance(tuned)) + float(off @ off) + float(away @ away)


def _judged(
    problem: Problem,
    free: tuple[str, ...],
    coordinates: np.ndarray,
    noise: Noise,
    tuned: Tuned,
    deviance: float,
    index: np.ndarray,
    matrix: np.ndarray,
) -> Estimate:
    """The estimate with its covariance.

    The larger of the inverse information and the sandwich with the innovations' own
    autocorrelation, which does not trust them to be white.
    """
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    residual, J = jacobian(coordinates[index], (inputs, layout))
    rows = problem.tape.measured.size
    J = J[:rows, : len(index)]
    correlation = autocorrelation(residual[:rows].reshape(-1, 6), np.asarray(problem.tape.run))
    return made(
        free, coordinates, deviance, index, problem.layout.local_spreads(coordinates), J.T @ J,
        long_run_covariance(J, correlation), noise,
    )  # fmt: skip


def normalised_rms(problem: Problem, coordinates: np.ndarray, noise: Noise) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    tuned = problem.tuned(coordinates, noise)
    count = np.asarray(tuned.gains.used).sum()
    return float(np.sqrt((np.asarray(tuned.white) ** 2).sum() / max(count, 1)))
