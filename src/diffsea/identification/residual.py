"""Whitened innovations as a least-squares residual, and its sparse Jacobian.

The gains of the filter are held fixed. Which coordinates are free is a selection matrix, an input
of the compiled program: screening and refitting compile nothing new.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.kalman import Gains, whitened_innovations
from diffsea.identification.least_squares import (
    LeastSquaresPoint,
    solve_least_squares,
    value_and_jacobian,
)
from diffsea.identification.problem import Coordinates, Problem
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


GAUSS_NEWTON_STEPS = 3  # with the gains held fixed, which are then found anew
TRUST_RADII = (1.0, 1 / 16, 1 / 256)  # at first, and where nothing was gained, in coordinates
STEP_TOLERANCE = 1e-4  # of a step, in units of the coordinates
DIRECTIONS_AT_ONCE = 12  # with more, each direction of differentiation costs more than alone
TRIED_COORDINATES = 2  # of an effect that is tried: one group holds it beside the parameters
DIVERGED = 1e4  # whitened innovation of a simulation that diverges: far beyond any other


class ColouredDirections(eqx.Module):
    """Directions of differentiation that serve several columns of the Jacobian.

    What belongs to one run moves the innovations of no other, so that one direction serves the
    instances of all runs: a colouring of the columns (Curtis, Powell and Reid 1974). Directions
    are taken a group at a time, those that no coordinate uses not at all.
    """

    directions: Float[Array, "group direction free"]
    groups: Int[Array, ""]  # the first of them that are used, at least one
    owner: Int[Array, "free"]  # the run that a column belongs to; -1: all of them


class FurtherRows(NamedTuple):
    """Residuals of data beside the recordings, linear about where they were found."""

    at_zero: Float[Array, "value"]  # where all free numbers are zero
    slopes: Float[Array, "value free"]


class ResidualInputs(eqx.Module):
    """What the compiled residual needs. Free numbers are coordinates, then sizes of pulses."""

    base: Vessel
    layout: CoordinateLayout = eqx.field(static=True)
    dataset: Dataset
    gains: Gains
    fixed: Float[Array, "coordinate"]  # values of the coordinates that are not free
    selection: Float[Array, "coordinate width"]
    spreads: Float[Array, "coordinate"]
    pulses: Float[Array, "pulse row 3"]  # acceleration histories (m/s^2, m/s^2, rad/s^2)
    colouring: ColouredDirections
    further: FurtherRows

    def coordinates(self, free: Float[Array, "free"]) -> Float[Array, "coordinate"]:
        """All coordinates at some free numbers."""
        return self.fixed + self.selection @ free[: self.selection.shape[1]]

    def innovations(self, free: Float[Array, "free"]) -> Float[Array, "value"]:
        """Whitened innovations; non-finite ones are large."""
        pulses = jnp.tensordot(free[self.selection.shape[1] :], self.pulses, axes=1)
        white = whitened_innovations(
            self.base, self.layout, self.dataset, self.gains, self.coordinates(free), pulses
        )
        return jnp.where(jnp.isfinite(white), white, DIVERGED).ravel()

    def prior_strains(self, free: Float[Array, "free"]) -> Float[Array, "strain"]:
        """Deviations from the prior; unused columns of the selection have one of their own."""
        width = self.selection.shape[1]
        coordinates = self.coordinates(free)
        unused = jnp.concatenate([1 - jnp.abs(self.selection).sum(0), jnp.ones(free.size - width)])
        return jnp.concatenate([self.layout.strains(coordinates, self.spreads), unused * free])

    def pad(self, free: Float[np.ndarray, "some"]) -> Float[Array, "free"]:
        """The free coordinates in use, then zeros for the rest and for the pulses."""
        whole = np.zeros(self.colouring.owner.size)
        whole[: len(free)] = free
        return jnp.asarray(whole)


class Linearisation(NamedTuple):
    """Residual and exact Jacobian: rows of the data set, of the prior, of further data."""

    residual: Float[np.ndarray, "value"]
    jacobian: Float[np.ndarray, "value free"]


def residual_inputs(
    problem: Problem,
    gains: Gains,
    coordinates: Coordinates,
    index: Sequence[int] | Int[np.ndarray, "used"],
    pulses: Float[np.ndarray, "pulse row 3"] | None = None,
) -> ResidualInputs:
    """The inputs of the compiled residual, the coordinates at `index` free.

    With `pulses`, at most as many as there are directions, the Jacobian is by them alone.
    """
    index = np.asarray(index, int)
    matrix = np.zeros((problem.layout.size, problem.width))
    matrix[index, np.arange(len(index))] = 1.0
    held = np.array(coordinates, float)
    held[index] = 0.0
    histories = np.zeros((problem.directions, problem.dataset.t.size, 3))
    if pulses is not None:
        histories[: len(pulses)] = pulses
    return ResidualInputs(
        problem.base,
        problem.layout,
        problem.dataset,
        gains,
        jnp.asarray(held),
        jnp.asarray(matrix),
        jnp.asarray(problem.layout.spreads()),
        jnp.asarray(histories),
        _colouring(problem, index, 0 if pulses is None else len(pulses)),
        further_rows(problem, np.asarray(coordinates, float), index),
    )


def further_rows(
    problem: Problem, coordinates: Coordinates, index: Int[np.ndarray, "used"]
) -> FurtherRows:
    """What data beside the recordings say about the coordinates at `index`, to first order."""
    misfit, slopes = problem.linear_rows(coordinates, index)
    spare = np.zeros((len(misfit), problem.width + problem.directions - len(index)))
    at_zero = misfit - slopes @ coordinates[index]
    return FurtherRows(jnp.asarray(at_zero), jnp.asarray(np.hstack([slopes, spare])))


def _colouring(problem: Problem, index: Int[np.ndarray, "used"], pulses: int) -> ColouredDirections:
    """One direction for the instances of each free coordinate, or one for each of some pulses."""
    kind, run = problem.layout.kinds()
    count, width = problem.directions, problem.width
    directions = np.zeros((count, width + count))
    if pulses:
        directions[:pulses, width : width + pulses] = np.eye(pulses)
    else:
        colours = np.unique(kind[index])
        directions[: len(colours), : len(index)] = kind[index] == colours[:, None]
    owner = np.full(width + count, -1)
    owner[: len(index)] = run[index]
    few = len(problem.layout.parameters) + TRIED_COORDINATES
    size = -(-few // -(-few // DIRECTIONS_AT_ONCE))
    padded = np.concatenate([directions, np.zeros((-count % size, width + count))])
    used = 1 + int(np.flatnonzero(padded.any(1)).max(initial=0)) // size
    grouped = padded.reshape(-1, size, width + count)
    return ColouredDirections(jnp.asarray(grouped), jnp.asarray(used), jnp.asarray(owner))


def _residual_and_jacobian(free: Array, inputs: ResidualInputs) -> tuple[Array, Array]:
    """Residual and its exact Jacobian, by coloured directions."""
    colouring = inputs.colouring
    along = lambda direction: jax.jvp(inputs.innovations, (free,), (direction,))
    together = jax.vmap(along, out_axes=(None, 0))

    def group(number: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        white, slopes = together(colouring.directions[number])
        return white, found[1].at[number].set(slopes)

    run = jnp.repeat(inputs.dataset.run, 6)
    nothing = jnp.zeros(run.size), jnp.zeros((*colouring.directions.shape[:2], run.size))
    white, slopes = jax.lax.fori_loop(0, colouring.groups, group, nothing)
    own = (colouring.owner < 0) | (colouring.owner == run[:, None])
    J = jnp.tensordot(slopes, colouring.directions, axes=((0, 1), (0, 1)))
    strains, pulls = value_and_jacobian(inputs.prior_strains, free)
    further = inputs.further
    residual = jnp.concatenate([white, strains, further.at_zero + further.slopes @ free])
    return residual, jnp.concatenate([jnp.where(own, J, 0.0), pulls, further.slopes])


def gauss_newton(
    inputs: ResidualInputs,
    start: Float[Array, "free"],
    tolerance: Scalar = STEP_TOLERANCE,
    radius: Scalar = TRUST_RADII[0],
) -> LeastSquaresPoint:
    """Free numbers after Gauss-Newton steps, and residual and Jacobian on the way."""
    return solve_least_squares(
        _residual_and_jacobian, start, inputs, GAUSS_NEWTON_STEPS, tolerance, radius
    )


# One compiled program serves fits and Jacobians, because compiling it is most of a short fit's
# time. With a tolerance that any step meets it ends where it starts, and what it returns of the
# way is the residual and the Jacobian there.
_gauss_newton = eqx.filter_jit(gauss_newton)
AT_THE_START = 1e300  # that tolerance


def fit_coordinates(
    inputs: ResidualInputs, start: Float[np.ndarray, "used"]
) -> Float[np.ndarray, "used"]:
    """Free coordinates after Gauss-Newton steps with the gains held fixed.

    Where no step within the first radii lowers the sum of squares, shorter ones are tried: the
    force of a light wind, say, is far from linear over the wind's prior.
    """
    begin, found = inputs.pad(start), start
    for radius in TRUST_RADII:
        point = _gauss_newton(inputs, begin, jnp.asarray(STEP_TOLERANCE), jnp.asarray(radius))
        found = np.asarray(point.at)[: len(start)]
        if np.any(found != start):
            break
    return found


def linearise(
    problem: Problem,
    gains: Gains,
    coordinates: Coordinates,
    index: Sequence[int] | Int[np.ndarray, "used"],
    pulses: Float[np.ndarray, "pulse row 3"] | None = None,
) -> Linearisation:
    """Residual and Jacobian by the coordinates at `index`, or by accelerations in `pulses`."""
    inputs = residual_inputs(problem, gains, coordinates, index, pulses)
    begin = inputs.pad(np.asarray(coordinates)[np.asarray(index, int)])
    tolerance, radius = jnp.asarray(AT_THE_START), jnp.asarray(TRUST_RADII[0])
    point = _gauss_newton(inputs, begin, tolerance, radius)
    first = problem.width if pulses is not None else 0
    columns = slice(first, first + (len(index) if pulses is None else len(pulses)))
    return Linearisation(np.asarray(point.residual), np.asarray(point.jacobian)[:, columns])


_whitened = eqx.filter_jit(ResidualInputs.innovations)


def innovations_at(
    problem: Problem, gains: Gains, coordinates: Coordinates
) -> Float[np.ndarray, "value"]:
    """Whitened innovations with these gains, without any derivative."""
    inputs = residual_inputs(problem, gains, coordinates, ())
    return np.asarray(_whitened(inputs, inputs.pad(np.zeros(0))))
