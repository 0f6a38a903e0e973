"""Multiple shooting: runs simulated in windows, each from a state of its own.

A long simulation from poor parameters drifts so far that its misfit says nothing about the way
back. Windows that start anew keep it near the data; what a window's end and the next one's
start differ by is a misfit too, which is weighed more and more until the windows join
(Bock 1983). Data of a window depend on its own first state only, so that six directions of
differentiation serve all first states.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.kalman import (
    expected_measurements,
    filter_rows,
    innovation_of,
    propagate,
)
from diffsea.identification.filter.latency import align_to_order_clock
from diffsea.identification.problem import Problem
from diffsea.vessel.base import Vessel


WINDOW_LIMIT = 80  # the normal equations have six rows for each
DIVERGED = 1e6  # misfit of a simulation that diverges, in the channel's unit


@dataclasses.dataclass(frozen=True)
class ShootingWindows:
    """How rows fall into windows, in order along the data set."""

    number: Int[np.ndarray, "row"]
    begins: Bool[np.ndarray, "row"]
    joins: Int[np.ndarray, "join"]  # rows at which a window begins where one of its run ended
    count: int


def shooting_windows(dataset: Dataset, seconds: float) -> ShootingWindows:
    """Windows of about `seconds`; longer where there would be too many."""
    t, starts = np.asarray(dataset.run_time), np.asarray(dataset.starts)
    measured = np.asarray(dataset.known).any(1)
    run = np.cumsum(starts) - 1
    first = t[np.flatnonzero(starts)][run]
    total = sum(np.ptp(t[run == k]) for k in range(dataset.runs))
    seconds = max(seconds, total / WINDOW_LIMIT)
    inside = np.floor((t - first) / seconds + 1e-9).astype(int)
    inside[~measured & (np.asarray(dataset.dt) == 0)] = -1  # spare rows stay in the last window
    inside = np.where(inside < 0, np.maximum.accumulate(np.where(inside < 0, 0, inside)), inside)
    begins = starts | (np.diff(inside, prepend=-1) > 0)
    begins &= np.asarray(dataset.dt) > 0
    begins[starts] = True
    number = np.cumsum(begins) - 1
    return ShootingWindows(number, begins, np.flatnonzero(begins & ~starts), int(number[-1]) + 1)


class ShootingInputs(eqx.Module):
    """What the compiled simulation of all windows needs beside coordinates and states."""

    base: Vessel
    layout: CoordinateLayout = eqx.field(static=True)
    dataset: Dataset
    number: Int[Array, "row"]  # of the row's window
    begins: Bool[Array, "row"]
    joins: Int[Array, "join"]

    @staticmethod
    def of(problem: Problem, windows: ShootingWindows) -> "ShootingInputs":
        """For a problem cut into windows."""
        cut = (jnp.asarray(part) for part in (windows.number, windows.begins, windows.joins))
        return ShootingInputs(problem.base, problem.layout, problem.dataset, *cut)


class Shot(eqx.Module):
    """Misfits of a simulation: measured less shown, and each window's end at the next's start."""

    misfit: Float[Array, "*slope row 6"]  # zero where nothing was measured
    end: Float[Array, "*slope join 6"]


class ShotSlopes(NamedTuple):
    """Derivatives of a shot, `slope` first."""

    by_parameter: Shot
    by_state: Shot  # by the first state of the row's own window, of the join's earlier one


@eqx.filter_jit
def shoot(
    inputs: ShootingInputs,
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
) -> Shot:
    """Simulate every window from its first state, without any correction."""
    return _simulate_windows(inputs, coordinates, states)


@eqx.filter_jit
def shoot_with_slopes(
    inputs: ShootingInputs,
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
    directions: Float[Array, "free coordinate"],
) -> tuple[Shot, ShotSlopes]:
    """The shot and its derivatives."""
    # All directions together, so that the run itself is simulated once.
    free = directions.shape[0]
    along = jnp.concatenate([directions, jnp.zeros((6, coordinates.size))])
    first = jnp.concatenate([jnp.zeros((free, 6)), jnp.eye(6)])
    first = jnp.broadcast_to(first[:, None, :], (free + 6, *states.shape))

    def derivative(d: Array, f: Array) -> tuple[Shot, Shot]:
        simulate = lambda *at: _simulate_windows(inputs, *at)
        return jax.jvp(simulate, (coordinates, states), (d, f))

    here, slope = jax.vmap(derivative, out_axes=(None, 0))(along, first)
    by_parameter = jax.tree.map(lambda leaf: leaf[:free], slope)
    return here, ShotSlopes(by_parameter, jax.tree.map(lambda leaf: leaf[free:], slope))


def _simulate_windows(
    inputs: ShootingInputs,
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
) -> Shot:
    vessel, flows = vessel_at(inputs.base, inputs.layout, coordinates)
    vessel, dataset = align_to_order_clock(vessel, inputs.dataset)

    def body(x: Float[Array, "6"], row_inputs: tuple) -> tuple:
        row, begin, first = row_inputs
        end = x
        x = jnp.where(begin, first, x)
        expected = expected_measurements(vessel, jnp.concatenate([x, jnp.zeros(3)]), row)
        return propagate(vessel, x, row, dataset.substeps), (innovation_of(row, expected), end)

    rows = filter_rows(vessel, flows, dataset), inputs.begins, states[inputs.number]
    misfit, end = jax.lax.scan(body, jnp.zeros(6), rows)[1]
    return Shot(jnp.where(jnp.isfinite(misfit), misfit, DIVERGED), end[inputs.joins])
