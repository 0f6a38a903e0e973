# pyright: reportArgumentType=false
"""Runs to waypoints, many at once, and what is read off them."""

import operator
from typing import NamedTuple, Protocol

from experiments.pytheas.boat import SWING, at_rest, boat, disturbed

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Trajectory, Vessel, run_controlled
from diffsea.simulation.control.waypoints import WaypointLogic, waypoint_logic
from diffsea.types import Scalar


PERIOD = 0.02  # s, between the controller's samples
SECONDS = 120.0  # s, the longest run
LANES = 16


class Trial(eqx.Module):
    """Where to, and against what; every field one number, or one per trial."""

    north: Scalar  # m
    east: Scalar  # m
    tolerance: Scalar = 2.5  # m
    bias: Scalar = 0.0  # N
    swing: Scalar = 0.0  # N
    direction: Scalar = 0.0  # rad, where the force acts to


class Track(NamedTuple):
    """The rows of one run up to its end."""

    t: Float[np.ndarray, "time"]
    x: Float[np.ndarray, "time"]
    y: Float[np.ndarray, "time"]
    psi: Float[np.ndarray, "time"]
    u: Float[np.ndarray, "time"]
    v: Float[np.ndarray, "time"]
    r: Float[np.ndarray, "time"]
    commanded: dict[str, Float[np.ndarray, "time"]]

    @property
    def path(self) -> Float[np.ndarray, "time"]:
        """Distance covered over ground, m."""
        steps = np.hypot(np.diff(self.x), np.diff(self.y))
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at_speed(self, speed: float) -> tuple[float, float]:
        """Time (s) and distance covered (m) when the surge speed is first reached."""
        if self.u.max() < speed:
            return float("nan"), float("nan")
        k = int(np.argmax(self.u >= speed))
        share = (speed - self.u[k - 1]) / (self.u[k] - self.u[k - 1])
        t = self.t[k - 1] + share * (self.t[k] - self.t[k - 1])
        return float(t), float(np.interp(t, self.t, self.path))

    def closest(self, north: float, east: float) -> float:
        """Closest approach to a point, m."""
        return float(np.hypot(self.x - north, self.y - east).min())


class Allocation(Protocol):
    """What brings the waypoint logic of a vessel with other actuators."""

    def logic(self, waypoints: Float[Array, "waypoint 2"], tolerance: Scalar) -> WaypointLogic: ...


def around(radius: float, bearings: Float[Array, "trial"], **fields: Scalar) -> Trial:
    """Trials to waypoints at a distance, one for each bearing (rad)."""
    north, east = radius * jnp.cos(bearings), radius * jnp.sin(bearings)
    return spread(Trial(north, east, **fields), len(bearings))


def battery(biases: tuple, directions: tuple) -> Trial:
    """Trials D1 to D9 of Table IV: the waypoint (20, 0), each direction with each bias."""
    k, B = jnp.meshgrid(jnp.asarray(directions), jnp.asarray(biases), indexing="ij")
    return spread(Trial(20.0, 0.0, bias=B.ravel(), swing=SWING, direction=k.ravel()), B.size)


def spread(tree: Trial, count: int) -> Trial:
    """The same with every number repeated for each of `count` trials."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, float), (count,)), tree)


def run(vessels: Vessel, trials: Trial, allocation: Allocation | None = None) -> list[Track]:
    """Run every vessel of a batch through its trial, under the waypoint logic.

    `allocation` is for vessels that have other actuators than one azimuth thruster. In blocks of
    one size, so that vessels of one make share a compiled program whatever their number.
    """
    count = len(trials.north)
    found = []
    for first in range(0, count, LANES):
        rows = np.minimum(np.arange(first, first + LANES), count - 1)
        some, theirs = jax.tree.map(operator.itemgetter(rows), (vessels, trials))
        found += tracks(_run(some, theirs, allocation))[: count - first]
    return found


@eqx.filter_jit
def _run(vessels: Vessel, trials: Trial, allocation: Allocation | None) -> Trajectory:
    def one(vessel: Vessel, trial: Trial) -> Trajectory:
        point = jnp.stack([trial.north, trial.east])[None]
        if allocation is None:
            logic = waypoint_logic(vessel, point, trial.tolerance)
        else:
            logic = allocation.logic(point, trial.tolerance)
        vessel = disturbed(vessel, trial.bias, trial.direction, trial.swing)
        return run_controlled(vessel, logic, at_rest(), SECONDS, PERIOD).trajectory

    return jax.vmap(one)(vessels, trials)


def tracks(batch: Trajectory) -> list[Track]:
    """The valid rows of each run of a batch."""
    batch = jax.tree.map(np.asarray, batch)
    fields = [getattr(batch, name) for name in Track._fields[:-1]]
    made = []
    for k, valid in enumerate(batch.valid):
        commanded = {c: orders[k][valid] for c, orders in batch.commanded.items()}
        made.append(Track(*(field[k][valid] for field in fields), commanded=commanded))
    return made


def boats(count: int, **fields: Scalar) -> Vessel:
    """A batch of boats, see `boat.boat`; fields are numbers or arrays of them."""
    given = {name: jnp.broadcast_to(jnp.asarray(value), (count,)) for name, value in fields.items()}
    if not given:
        return jax.vmap(lambda _: boat())(jnp.arange(count))
    return jax.vmap(lambda values: boat(**values))(given)
