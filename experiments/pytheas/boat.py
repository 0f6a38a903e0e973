"""The boat of Table I as a vessel of the library: any thrust, thruster position, mass and D."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea import State, Vessel, named, read_vessel, replace
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


def draught(mass: Scalar = MASS, hulls: int = 2, length: Scalar = LENGTH) -> Scalar:
    """Draught (m) of semicircular hulls that displace the boat's mass: the D that is taken."""
    return jnp.sqrt(2 * mass / (hulls * WATER * jnp.pi * length))


def boat(
    thrust: Scalar = THRUST,
    lever: Scalar = LEVER,
    mass: Scalar = MASS,
    D: Scalar | None = None,
    full_angle: Scalar = FULL_ANGLE,
    scale: Scalar = 1.0,
) -> Vessel:
    """The catalogue's boat with other numbers: full thrust (N), thruster position (m), mass (kg),
    D (m), largest angle of the thruster to either side (rad), or length over the published one.

    `lever` is L_t of the published length, positive ahead of the mass centre. Inertia follows mass
    and D by the formulas of Table I; D is `draught(mass)` where none is given. Damping grows with
    the `scale` alone, by Froude's law: its forces with the cube at speeds that go with the root.
    """
    length, beam = LENGTH * scale, BEAM * scale
    D = draught(mass, length=length) if D is None else D
    section = WATER * jnp.pi * D**2
    published = named(BASE)
    vessel = replace(
        BASE,
        {
            "mass": mass,
            "draught": D,
            "length": length,
            "beam": beam,
            "I_z": mass * (beam**2 + length**2) / 12,
            "X_udot": -SURGE_SHARE * mass,
            "Y_vdot": -section * length / 2,
            "N_rdot": -(0.1 * mass * beam**2 + section * length**3) / 24,
            "X_u": published["X_u"] * scale**2.5,
            "Y_v": published["Y_v"] * scale**2.5,
            "N_r": published["N_r"] * scale**4.5,
            "thruster.x": lever * scale,
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
