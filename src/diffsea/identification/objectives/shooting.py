"""Multiple shooting: runs simulated in windows, each from a state of its own.

A long free run from poor parameters drifts so far that its misfit says nothing about the way
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
from diffsea.identification.filter import kalman
from diffsea.identification.problem import Static
from diffsea.vessel.base import Vessel


MOST_WINDOWS = 80


@dataclasses.dataclass(frozen=True)
class ShootingWindows:
    """How rows fall into windows, in order along the dataset."""

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
    seconds = max(seconds, total / MOST_WINDOWS)
    inside = np.floor((t - first) / seconds + 1e-9).astype(int)
    inside[~measured & (np.asarray(dataset.dt) == 0)] = -1  # spare rows stay in the last window
    inside = np.where(inside < 0, np.maximum.accumulate(np.where(inside < 0, 0, inside)), inside)
    begins = starts | (np.diff(inside, prepend=-1) > 0)
    begins &= np.asarray(dataset.dt) > 0
    begins[starts] = True
    number = np.cumsum(begins) - 1
    return ShootingWindows(number, begins, np.flatnonzero(begins & ~starts), int(number[-1]) + 1)


class Shot(eqx.Module):
    """Misfits of a simulation: measured less shown, and each window's end at the next's start."""

    misfit: Float[Array, "row 6"]  # zero where nothing was measured
    end: Float[Array, "join 6"]


class ShotSlopes(NamedTuple):
    """Derivatives of a shot, `slope` first."""

    by_parameter: Shot
    by_state: Shot  # by the first state of the row's own window, of the join's earlier one


@eqx.filter_jit
def shoot(
    base: Vessel,
    layout: Static,
    dataset: Dataset,
    cut: tuple[Array, Array, Array],
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
) -> Shot:
    """Simulate every window from its first state, without any correction."""
    return _shoot(base, layout.value, dataset, cut, coordinates, states)


@eqx.filter_jit
def shoot_with_slopes(
    base: Vessel,
    layout: Static,
    dataset: Dataset,
    cut: tuple[Array, Array, Array],
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
    directions: Float[Array, "free coordinate"],
) -> tuple[Shot, ShotSlopes]:
    """The shot and its derivatives."""

    def shot(at: tuple) -> Shot:
        return _shoot(base, layout.value, dataset, cut, *at)

    # All directions together, so that the run itself is simulated once.
    free = directions.shape[0]
    along = jnp.concatenate([directions, jnp.zeros((6, coordinates.size))])
    first = jnp.concatenate([jnp.zeros((free, 6)), jnp.eye(6)])
    first = jnp.broadcast_to(first[:, None, :], (free + 6, *states.shape))
    at = (coordinates, states)
    here, slope = jax.vmap(
        lambda d, f: jax.jvp(shot, (at,), ((d, f),)), out_axes=(None, 0)
    )(along, first)  # fmt: skip
    return here, ShotSlopes(
        jax.tree.map(lambda leaf: leaf[:free], slope), jax.tree.map(lambda leaf: leaf[free:], slope)
    )


def _shoot(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    cut: tuple[Array, Array, Array],
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
) -> Shot:
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = kalman.on_order_clock(vessel, dataset)
    number, begins, joins = cut

    def body(x: Float[Array, "6"], inputs: tuple) -> tuple:
        row, begin, first = inputs
        end = x
        x = jnp.where(begin, first, x)
        z = jnp.concatenate([x, jnp.zeros(3)])
        nu = kalman.innovation_of(row, kalman.expected_measurements(vessel, z, row, row["flow"]))
        return kalman.propagate(vessel, x, row, row["flow"], dataset.substeps), (nu, end)

    inputs = kalman.filter_rows(vessel, flows, dataset), begins, states[number]
    misfit, end = jax.lax.scan(body, jnp.zeros(6), inputs)[1]
    return Shot(jnp.where(jnp.isfinite(misfit), misfit, 1e6), end[joins])
