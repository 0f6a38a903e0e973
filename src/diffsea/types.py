"""States, environments and what JAX must know of trajectories.

SI units and radians throughout. Earth axes are NED (x north, y east, psi clockwise from
north); body axes are forward, starboard, down with the origin amidships.
"""

import dataclasses
from collections.abc import Iterable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from diffsea.scales import Scalar as Scalar
from diffsea.trajectory import Trajectory


_ARRAYS = tuple(
    field.name
    for field in dataclasses.fields(Trajectory)
    if field.name not in ("name", "provenance", "read")  # the same in all of a batch
)


def _flatten(run: Trajectory) -> tuple[list, tuple]:
    labels = (run.name, run.provenance, run.read)
    return [(jax.tree_util.GetAttrKey(n), getattr(run, n)) for n in _ARRAYS], labels


def _unflatten(labels: tuple, arrays: Iterable) -> Trajectory:
    """A trajectory of whatever JAX puts in place of arrays, without any check."""
    run = object.__new__(Trajectory)
    names = (*_ARRAYS, "name", "provenance", "read")
    for name, value in zip(names, (*arrays, *labels), strict=True):
        object.__setattr__(run, name, value)
    return run


jax.tree_util.register_pytree_with_keys(Trajectory, _flatten, _unflatten)


Tree = TypeVar("Tree")


def as_inputs(tree: Tree) -> Tree:
    """A vessel, say, as the input of a compiled program: arrays, and Python's zero for zeros.

    A Python number is part of the program, an array is given to it. What is absent is then in no
    program (`is_absent`), and vessels that have the same parts share one.
    """
    numbers = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)
    return jax.tree.map(lambda leaf: 0.0 if leaf.ndim == 0 and leaf == 0 else leaf, numbers)


@jax.custom_batching.custom_vmap
def in_any_lane(condition: Bool[Array, ""]) -> Bool[Array, ""]:
    """The condition; under `vmap` whether it holds in any lane.

    A `jax.lax.cond` on it stays a branch there, skipped where no lane needs it, and does not become
    a choice between both results in every lane.
    """
    return condition


@in_any_lane.def_vmap
def _reduced_over_lanes(
    axis_size: int, in_batched: list[bool], condition: Bool[Array, "lane"]
) -> tuple[Bool[Array, ""], bool]:
    return jnp.any(condition, axis=0), False


class State(eqx.Module):
    """Position and motion of one vessel at one instant.

    `u` and `v` are velocities over ground in body axes, so that they are what a
    satellite receiver measures; forces see the velocity through the water.
    """

    x: Scalar  # m, north
    y: Scalar  # m, east
    psi: Scalar  # rad, clockwise from north, not wrapped
    u: Scalar  # m/s over ground, forward
    v: Scalar  # m/s over ground, to starboard
    r: Scalar  # rad/s, positive to starboard


class MeasuredDisturbance(eqx.Module):
    """What was measured of what disturbs the vessel, at a time; leaves may be of rows or steps.

    Zero where nothing was measured.
    """

    heel: Scalar = 0.0  # rad, to starboard
    wind_north: Scalar = 0.0  # m/s, where the air moves to
    wind_east: Scalar = 0.0  # m/s


class Environment(eqx.Module):
    """Water and air around one run, steady and uniform, in earth axes.

    Components rather than speed and direction: they have a derivative at zero.
    """

    current_north: Scalar = 0.0  # m/s, where the water flows to
    current_east: Scalar = 0.0  # m/s
    wind_north: Scalar = 0.0  # m/s, where the air moves to
    wind_east: Scalar = 0.0  # m/s
    shallowness: Scalar = 0.0  # -ln(1 - T / h) of the vessel's draught and the depth, 0 is deep
    disturbance: MeasuredDisturbance = MeasuredDisturbance()  # it changes within a run
