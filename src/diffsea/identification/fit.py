"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round tunes the filter at the current estimate, improves the parameters by
Levenberg-Marquardt with the gains held fixed, and re-estimates the noise. A few rounds
converge.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array

from diffsea.identification import likelihood
from diffsea.identification.colour import autocorrelation, long_run
from diffsea.identification.gusts import Noise
from diffsea.identification.likelihood import Tuned, deviance
from diffsea.identification.noise import Clock, Path, refine
from diffsea.identification.problem import (
    Inputs,
    Problem,
    Static,
    jacobian,
    known_slope,
    selection,
    traced,
)
from diffsea.parameters import Parameter


Progress = Callable[[str], None]

ROUNDS = 8
STEPS = 6  # of Levenberg-Marquardt in one round
NOISE_STEPS = 3  # of Fisher scoring in one round
FIRST_STEPS = 15  # and in the first one


class Estimate(NamedTuple):
    """Where a fit ended."""

    free: tuple[str, ...]
    coordinates: np.ndarray  # of the whole layout
    noise: Noise
    deviance: float  # -2 log posterior, the priors of parameters and noise included
    index: np.ndarray  # which coordinates were free
    covariance: np.ndarray  # of the free coordinates
    shrinkage: np.ndarray  # share of each free coordinate that the data determine, 0 to 1
    inflation: float  # variance of the scores over the information, at least one


@eqx.filter_jit
def _improve(inputs: Inputs, layout: Static, start: Array, steps: int) -> Array:
    """Levenberg-Marquardt with the gains held fixed."""
    # Normal equations: columns are scaled alike and regularised by the prior, and a QR of
    # the tall Jacobian in every step would cost more than everything else.
    solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4, linear_solver=lx.Normal(lx.Cholesky()))
    return optx.least_squares(
        lambda free, args: known_slope(free, args=args), solver, start, (inputs, layout),
        options={"jac": "fwd"}, max_steps=steps, throw=False,
    ).value  # fmt: skip


def estimate(
    problem: Problem,
    free: tuple[str, ...],
    start: np.ndarray | None = None,
    noise: Noise | None = None,
    rounds: int = ROUNDS,
    fixed_noise: bool = False,
    progress: Progress = lambda message: None,
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
    now = _posterior(problem, coordinates, noise, tuned)
    for number in range(rounds):
        last = now
        if not fixed_noise:
            better = refine(_path(tuned), _clock(problem), noise, problem.prior, steps)
            steps = NOISE_STEPS
            there = problem.tuned(coordinates, better)
            value = _posterior(problem, coordinates, better, there)
            if value < now or (np.isfinite(value) and not np.isfinite(now)):
                noise, tuned, now = better, there, value
        target = _target(problem, coordinates, tuned, index, matrix)
        coordinates, tuned, now = _walk(problem, coordinates, target, noise, tuned, now)
        progress(f"round {number + 1}: -2 log posterior {now:.1f}")
        if abs(last - now) < 0.05 + 1e-6 * abs(now):
            break
    uncertainty = _uncertainty(problem, coordinates, noise, index, matrix)
    return Estimate(free, coordinates, noise, now, index, *uncertainty)


def _target(
    problem: Problem, coordinates: np.ndarray, tuned: Tuned, index: np.ndarray, matrix: np.ndarray
) -> np.ndarray:
    """Coordinates that fit best with the gains held fixed."""
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    begin = np.zeros(problem.width)
    begin[: len(index)] = coordinates[index]
    found = _improve(inputs, layout, jnp.asarray(begin), STEPS)
    target = coordinates.copy()
    target[index] = np.asarray(found)[: len(index)]
    return target


def _walk(
    problem: Problem, start: np.ndarray, target: np.ndarray, noise: Noise, tuned: Tuned, now: float
) -> tuple[np.ndarray, Tuned, float]:
    """Go to the target, or part of the way where the filter with its own gains is worse there."""
    for share in (1.0, 0.5, 0.2, 0.05):
        coordinates = start + share * (target - start)
        there = problem.tuned(coordinates, noise)
        value = _posterior(problem, coordinates, noise, there)
        if value < now or (np.isfinite(value) and not np.isfinite(now)):
            return coordinates, there, value
    return start, tuned, now


def _path(tuned: Tuned) -> Path:
    g = tuned.gains
    return Path(tuned.F, tuned.H, g.correction, tuned.nu, g.used, tuned.kick)


def _clock(problem: Problem) -> Clock:
    tape = problem.tape
    return Clock(tape.dt, tape.starts, likelihood.first_variance(problem.base))


def _posterior(problem: Problem, coordinates: np.ndarray, noise: Noise, tuned: Tuned) -> float:
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    away = coordinates / problem.layout.spreads()
    return float(deviance(tuned)) + float(off @ off) + float(away @ away)


def _uncertainty(
    problem: Problem, coordinates: np.ndarray, noise: Noise, index: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Covariance of the free coordinates, how much of each is due to the data, inflation.

    The larger of the inverse information and the sandwich with the innovations' own
    autocorrelation, which does not trust them to be white.
    """
    tuned = problem.tuned(coordinates, noise)
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    begin = np.zeros(problem.width)
    begin[: len(index)] = coordinates[index]
    residual, J = (np.asarray(a) for a in jacobian(jnp.asarray(begin), (inputs, layout)))
    J, rows = J[:, : len(index)], problem.tape.measured.size
    information = J.T @ J
    plain = np.linalg.inv(information)
    white = residual[:rows].reshape(-1, 6)
    correlation = autocorrelation(white, np.asarray(problem.tape.run))
    coloured = plain @ long_run(J[:rows], correlation) @ plain
    ratio = np.maximum(np.diag(coloured) / np.diag(plain), 1.0)
    widen = np.sqrt(ratio)
    prior = problem.layout.spreads()[index]
    shrinkage = 1 - np.diag(plain) / prior**2
    return plain * np.outer(widen, widen), np.clip(shrinkage, 0.0, 1.0), float(np.mean(ratio))


def block_sums(scores: np.ndarray, length: int) -> np.ndarray:
    """Sums over consecutive blocks of rows."""
    spare = -len(scores) % length
    padded = np.concatenate([scores, np.zeros((spare, scores.shape[1]))])
    return padded.reshape(-1, length, scores.shape[1]).sum(1)


def normalised_rms(problem: Problem, coordinates: np.ndarray, noise: Noise) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    tuned = problem.tuned(coordinates, noise)
    count = np.asarray(tuned.gains.used).sum()
    return float(np.sqrt((np.asarray(tuned.white) ** 2).sum() / max(count, 1)))


def physical_table(problem: Problem, fitted: Estimate) -> list[dict]:
    """One row per fitted vessel parameter: name, start, value, standard error, determined."""
    rows = []
    position = {int(k): n for n, k in enumerate(fitted.index)}
    for number, parameter in enumerate(problem.layout.parameters):
        if number not in position:
            continue
        n, at = position[number], float(fitted.coordinates[number])
        std = parameter.slope(at) * float(np.sqrt(fitted.covariance[n, n]))
        rows.append(_row(parameter, at, std, float(fitted.shrinkage[n])))
    return rows


def _row(parameter: Parameter, at: float, std: float, shrinkage: float) -> dict:
    return {
        "name": parameter.name,
        "start": parameter.value,
        "value": float(parameter.decode(at)),
        "std": std,
        "determined": shrinkage,
    }
