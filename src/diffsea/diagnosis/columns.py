"""Derivatives of the whitened innovations by what a diagnosis tries."""

import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate
from diffsea.identification.gusts import Noise
from diffsea.identification.likelihood import Gains
from diffsea.identification.problem import Problem, innovations, jacobian, traced


Columns = Float[np.ndarray, "value column"]


def columns_at(
    problem: Problem, gains: Gains, fitted: Estimate, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "value"], Columns]:
    """Residual and Jacobian columns of some coordinates at an estimate.

    The rows of the prior are those of all coordinates, so that columns can be combined.
    """
    index = [k for name in names for k in problem.layout.indices((name,))]
    return columns_of(problem, gains, np.asarray(fitted.coordinates), index)


def columns_of(
    problem: Problem, gains: Gains, coordinates: np.ndarray, index: list[int]
) -> tuple[np.ndarray, Columns]:
    """Residual and Jacobian columns of some coordinates, by their positions."""
    matrix = np.zeros((problem.layout.size, problem.width))
    matrix[index, np.arange(len(index))] = 1.0
    inputs, layout = traced(problem, gains, coordinates, matrix)
    residual, J = jacobian(coordinates[index], (inputs, layout))
    keep = int(problem.tape.measured.size) + problem.layout.size
    return residual[:keep], J[:keep, : len(index)]


def residual_at(problem: Problem, gains: Gains, coordinates: np.ndarray) -> np.ndarray:
    """Whitened innovations at some coordinates with these gains."""
    nothing = np.zeros((problem.layout.size, problem.width))
    return innovations(np.zeros(0), traced(problem, gains, coordinates, nothing))


def gains_at(problem: Problem, fitted: Estimate, noise: Noise | None = None) -> Gains:
    """The filter's gains at an estimate."""
    return problem.tuned(fitted.coordinates, fitted.noise if noise is None else noise).gains


def latent_acceleration(problem: Problem, fitted: Estimate) -> Float[np.ndarray, "row 3"]:
    """What the filter finds beside the model: lasting gusts and the rest (m/s^2, rad/s^2)."""
    tuned = problem.tuned(fitted.coordinates, fitted.noise)
    return np.asarray(tuned.kick) / np.maximum(np.asarray(tuned.gains.gusts.half), 1e-12)


def push_columns(
    problem: Problem, gains: Gains, fitted: Estimate, push: Float[np.ndarray, "push row 3"]
) -> Columns:
    """Columns of histories of accelerations (m/s^2, m/s^2, rad/s^2), with rows of no prior."""
    matrix = np.zeros((problem.layout.size, problem.width))
    values, parts = int(problem.tape.measured.size), []
    for first in range(0, len(push), problem.seeds):
        part = push[first : first + problem.seeds]
        args = traced(problem, gains, np.asarray(fitted.coordinates), matrix, part)
        J = jacobian(np.zeros(0), args)[1]
        parts.append(J[:values, problem.width : problem.width + len(part)])
    J = np.concatenate(parts, axis=1)
    return np.concatenate([J, np.zeros((problem.layout.size, J.shape[1]))])
