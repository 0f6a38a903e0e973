"""States, environments and what JAX must know of trajectories.

SI units and radians throughout. Earth axes are NED (x north, y east, psi clockwise from
north); body axes are forward, starboard, down with the origin amidships.
"""

import dataclasses

import equinox as eqx
import jax

from diffsea.scales import Scalar as Scalar
from diffsea.trajectory import Trajectory


_LABELS = ("name", "provenance", "read")  # of a trajectory: no arrays, the same in all of a batch
jax.tree_util.register_dataclass(
    Trajectory,
    [field.name for field in dataclasses.fields(Trajectory) if field.name not in _LABELS],
    list(_LABELS),
)


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


class Environment(eqx.Module):
    """Water and air around one run, steady and uniform, in earth axes.

    Components rather than speed and direction: they have a derivative at zero.
    """

    current_north: Scalar = 0.0  # m/s, where the water flows to
    current_east: Scalar = 0.0  # m/s
    wind_north: Scalar = 0.0  # m/s, where the air moves to
    wind_east: Scalar = 0.0  # m/s
    shallowness: Scalar = 0.0  # -ln(1 - T / h) of the vessel's draught and the depth, 0 is deep
    heel: Scalar = 0.0  # rad, to starboard; where it was recorded it changes within a run
