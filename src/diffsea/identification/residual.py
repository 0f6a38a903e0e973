"""Whitened innovations as a least-squares residual, and its sparse Jacobian.

The gains of the filter are held fixed. Directions of differentiation are inputs of the compiled
program, so many at a time: whatever is free, screening and refitting compile nothing new.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diffsea.budget import on_every_core
from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.kalman import Gains, whitened_innovations
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.identification.problem import Coordinates, Problem
from diffsea.vessel.base import Vessel


DIRECTIONS_AT_ONCE = 12  # with more, each direction of differentiation costs more than alone
TRIED_COORDINATES = 2  # of an effect that is tried: one group holds it beside the parameters
DIVERGED = 1e4  # whitened innovation of a simulation that diverges: far beyond any other

Pulses = Float[np.ndarray, "pulse row 3"]  # accelerations of each row: m/s^2, m/s^2, rad/s^2


class Linearisation(NamedTuple):
    """Residual and exact Jacobian: rows of the data set, of the prior, of further data."""

    residual: Float[np.ndarray, "value"]
    jacobian: Float[np.ndarray, "value free"]

    @property
    def gradient(self) -> Float[np.ndarray, "free"]:
        """Of the sum of squares."""
        return 2 * self.jacobian.T @ self.residual

    @property
    def curvature(self) -> Float[np.ndarray, "free free"]:
        """Of the sum of squares, by Gauss and Newton."""
        return 2 * self.jacobian.T @ self.jacobian


def linearise(
    problem: Problem,
    gains: Gains,
    coordinates: Coordinates,
    index: Sequence[int] | Int[np.ndarray, "used"],
) -> Linearisation:
    """Residual and Jacobian by the coordinates at `index`.

    What belongs to one run moves the innovations of no other, so that one direction serves the
    instances of all runs: a colouring of the columns (Curtis, Powell and Reid 1974).
    """
    index = np.asarray(index, int)
    kind, run = problem.layout.kinds()
    colours, colour = np.unique(kind[index], return_inverse=True)
    directions = np.zeros((len(colours), problem.layout.size))
    directions[colour, index] = 1.0
    white, slopes = _slopes(problem, gains, coordinates, directions)
    rows_run, owner = np.repeat(np.asarray(problem.dataset.run), 6), run[index]
    is_own = (owner < 0) | (owner == rows_run[:, None])
    strains, pulls = _strains(problem.layout, coordinates, problem.layout.spreads())
    further = problem.linear_rows(coordinates, index)
    return Linearisation(
        np.concatenate([white, np.asarray(strains), further.misfit]),
        np.concatenate(
            [np.where(is_own, slopes[colour].T, 0.0), np.asarray(pulls)[:, index], further.slopes]
        ),
    )


def slopes_by_pulses(
    problem: Problem, gains: Gains, coordinates: Coordinates, pulses: Pulses
) -> Float[np.ndarray, "value pulse"]:
    """Slopes of the whitened innovations by the sizes of accelerations, beside all forces."""
    nothing = np.zeros((len(pulses), problem.layout.size))
    return _slopes(problem, gains, coordinates, nothing, pulses)[1].T


def innovations_at(
    problem: Problem, gains: Gains, coordinates: Coordinates
) -> Float[np.ndarray, "value"]:
    """Whitened innovations with these gains, without any derivative."""
    inputs = problem.base, problem.layout, problem.dataset, gains
    return np.asarray(_innovations_alone(*inputs, jnp.asarray(coordinates)))


def group_size(layout: CoordinateLayout) -> int:
    """Directions that are differentiated along together, so that few groups are partly empty."""
    few = len(layout.parameters) + TRIED_COORDINATES
    return -(-few // -(-few // DIRECTIONS_AT_ONCE))


def _slopes(
    problem: Problem,
    gains: Gains,
    coordinates: Coordinates,
    directions: Float[np.ndarray, "direction coordinate"],
    pulses: Pulses | None = None,
) -> tuple[Float[np.ndarray, "value"], Float[np.ndarray, "direction value"]]:
    """Whitened innovations and their slopes along directions, a group of them on each core.

    A direction moves the coordinates, and the size of its own pulse where there are any.
    """
    inputs = problem.base, problem.layout, problem.dataset, gains
    at, size, rows = jnp.asarray(coordinates), group_size(problem.layout), problem.dataset.t.size
    count = max(len(directions), 1)

    def along(first: int) -> tuple[np.ndarray, np.ndarray]:
        some, histories = np.zeros((size, directions.shape[1])), np.zeros((size, rows, 3))
        part = slice(first, first + size)
        some[: len(directions[part])] = directions[part]
        if pulses is not None:
            histories[: len(pulses[part])] = pulses[part]
        found = _innovations_along(*inputs, at, jnp.asarray(some), jnp.asarray(histories))
        return np.asarray(found[0]), np.asarray(found[1])

    groups = on_every_core(along, range(0, count, size))
    return groups[0][0], np.concatenate([slopes for _, slopes in groups])[: len(directions)]


def _innovations(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    accelerations: Float[Array, "row 3"] | None = None,
) -> Float[Array, "value"]:
    """Whitened innovations; non-finite ones are large."""
    white = whitened_innovations(base, layout, dataset, gains, coordinates, accelerations)
    return jnp.where(jnp.isfinite(white), white, DIVERGED).ravel()


_innovations_alone = eqx.filter_jit(_innovations)


@eqx.filter_jit
def _innovations_along(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    directions: Float[Array, "direction coordinate"],
    pulses: Float[Array, "direction row 3"],
) -> tuple[Float[Array, "value"], Float[Array, "direction value"]]:
    """Whitened innovations and their slopes along each direction and its pulse together."""
    innovations = lambda *moved: _innovations(base, layout, dataset, gains, *moved)
    here = coordinates, jnp.zeros(pulses.shape[1:])
    along = lambda *direction: jax.jvp(innovations, here, direction)
    return jax.vmap(along, out_axes=(None, 0))(directions, pulses)


@functools.partial(jax.jit, static_argnums=0)
def _strains(
    layout: CoordinateLayout,
    coordinates: Float[Array, "coordinate"],
    spreads: Float[Array, "coordinate"],
) -> tuple[Float[Array, "coordinate"], Float[Array, "coordinate coordinate"]]:
    """Deviations from the prior and their Jacobian."""
    return value_and_jacobian(lambda at: layout.strains(at, spreads), coordinates)
