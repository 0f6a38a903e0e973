"""The boat of Table I as a vessel of the library: any thrust, thruster position, mass and D."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea import State, Vessel, read_vessel, replace
from diffsea.types import Scalar
from diffsea.vessel.forces import EarthForce


Tree = TypeVar("Tree")
LENGTH, BEAM, WATER = 1.0, 0.55, 1000.0  # m, m, kg/m^3
THRUST, LEVER, MASS = 20.0, 0.4, 7.0  # N, m, kg: Tables I and II
FULL_ANGLE = 0.47 * jnp.pi  # rad
SURGE_SHARE = 0.03  # r of m_xx = r m, of which [0.01, 0.05] is published
TOP_SPEED = THRUST / 14.0  # m/s, thrust by d_1
SWING, FREQUENCY = 5.0, 0.2  # N and Hz, A and w_d of the battery
BASE = read_vessel("pytheas").vessel


def draught(mass: Scalar = MASS, hulls: int = 2) -> Scalar:
    """Draught (m) of semicircular hulls that displace the boat's mass: the D that is taken."""
    return jnp.sqrt(2 * mass / (hulls * WATER * jnp.pi * LENGTH))


def boat(
    thrust: Scalar = THRUST,
    lever: Scalar = LEVER,
    mass: Scalar = MASS,
    D: Scalar | None = None,
    full_angle: Scalar = FULL_ANGLE,
) -> Vessel:
    """The catalogue's boat with other numbers: full thrust (N), thruster position (m), mass (kg),
    D (m), or largest angle of the thruster to either side (rad).

    `lever` is L_t, positive ahead of the mass centre. Inertia follows mass and D by the formulas
    of Table I; D is `draught(mass)` where none is given. Damping stays as it is.
    """
    D = draught(mass) if D is None else D
    section = WATER * jnp.pi * D**2
    vessel = replace(
        BASE,
        {
            "mass": mass,
            "draught": D,
            "I_z": mass * (BEAM**2 + LENGTH**2) / 12,
            "X_udot": -SURGE_SHARE * mass,
            "Y_vdot": -section * LENGTH / 2,
            "N_rdot": -(0.1 * mass * BEAM**2 + section * LENGTH**3) / 24,
            "thruster.x": lever,
            "thruster.thruster.force.upper": thrust,
            "thruster.thruster.angle.upper": full_angle,
            "thruster.thruster.angle.lower": -full_angle,
        },
    )
    return floats(vessel)


def disturbed(vessel: Vessel, bias: Scalar, direction: Scalar, swing: Scalar = SWING) -> Vessel:
    """The vessel under `bias + swing sin(w_d t)` N towards `direction` rad (eq. 7).

    It is the catalogue's effect `wave-force`, written in components, which can be batched.
    """
    north, east = jnp.cos(direction), jnp.sin(direction)
    force = EarthForce(
        bias * north, bias * east, swing * north, swing * east, 0.0, 0.0, FREQUENCY
    )  # fmt: skip
    forces = vessel.forces | {"wave-force": floats(force)}
    return eqx.tree_at(lambda v: v.forces, vessel, forces)


def at_rest() -> State:
    """At the origin, heading north (+X)."""
    return State(*(jnp.zeros(()) for _ in range(6)))


def floats(tree: Tree) -> Tree:
    """The same with every number an array, so that runs of several boats share a program."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)
