"""Inertia of a vessel: the rigid body, the added mass of the water, and their Coriolis forces."""

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea.kinematics import through_water
from diffsea.scales import is_absent
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.forces import AbstractForce, Force, step


class Load(eqx.Module):
    """A point of mass that is taken on in the run."""

    mass: Scalar  # kg, negative: put down
    time: Scalar  # s of the run
    x: Scalar = 0.0  # m forward of amidships


class RigidBody(eqx.Module):
    """Mass properties and main dimensions."""

    mass: Scalar  # kg
    I_z: Scalar  # kg m^2, about the centre of gravity
    x_G: Scalar = 0.0  # m, centre of gravity forward of amidships
    length: Scalar = 1.0  # m, L_pp
    beam: Scalar = 1.0  # m
    draught: Scalar = 1.0  # m
    water_density: Scalar = 1025.0  # kg/m^3
    loads: tuple[Load, ...] = ()

    def at(self, t: Scalar) -> "RigidBody":
        """The body with what it carries at time `t` (s) of the run.

        x_G and I_z follow from the moments and inertias about amidships (Steiner).
        """
        loads = [load for load in self.loads if not is_absent(load.mass)]
        if not loads:
            return self
        mass, moment = self.mass, self.mass * self.x_G
        inertia = self.I_z + moment * self.x_G
        for load in loads:
            taken = load.mass * step(t, load.time, self.length)
            mass, moment = mass + taken, moment + taken * load.x
            inertia = inertia + taken * load.x**2
        x_G = moment / mass
        I_z = inertia - moment * x_G
        return eqx.tree_at(lambda b: (b.mass, b.x_G, b.I_z), self, (mass, x_G, I_z))

    def coriolis(self, water: State) -> Force:
        """Coriolis and centripetal force (N, N m) of the rigid body (Fossen 2021, eq. 3.63).

        `water` has velocities through the water, m/s and rad/s.
        """
        u, v, r, m = water.u, water.v, water.r, self.mass
        return Force(m * r * (v + self.x_G * r), -m * u * r, -m * self.x_G * u * r)


class AddedMass(eqx.Module):
    """Added masses of planar motion, with SNAME signs (a negative value adds inertia)."""

    X_udot: Scalar = 0.0  # kg
    Y_vdot: Scalar = 0.0  # kg
    Y_rdot: Scalar = 0.0  # kg m
    N_vdot: Scalar = 0.0  # kg m
    N_rdot: Scalar = 0.0  # kg m^2
    coriolis_terms: str = eqx.field(static=True, default="full")

    def in_depth(self, shallowness: Scalar) -> "AddedMass":
        """The added masses in shallow water, where they grow as `(1 - T / h)^(-1/2)`.

        `shallowness` is `-ln(1 - T / h)`: any number is a depth then.

        About half more at h = 2 T and three quarters more at 1.5 T, what tests in shallow
        basins show for full hulls; hulls differ from it by tens of per cent.
        """
        if is_absent(shallowness):
            return self
        growth = jnp.exp(0.5 * shallowness)
        return jax.tree.map(lambda value: value * growth, self)

    def coriolis(self, water: State) -> Force:
        """Coriolis force of the added mass from the same matrix (Fossen 2021, eq. 6.46).

        `coriolis_terms` is "full", "no-munk" where the moment proportional to `u v` is
        already in the hull's `N_v` (MMG sets), or "none" where the derivatives hold
        everything (Abkowitz sets).
        """
        if self.coriolis_terms == "none":
            return Force()
        u, v, r = water.u, water.v, water.r
        coupling = -0.5 * (self.Y_rdot + self.N_vdot)
        lateral = -self.Y_vdot * v + coupling * r
        munk = (self.Y_vdot - self.X_udot) * u * v if self.coriolis_terms == "full" else 0.0
        return Force(r * lateral, self.X_udot * u * r, munk - coupling * u * r)


class MunkMoment(AbstractForce):
    """The moment `k u_r v_r` (N m) of added masses that are wrong relative to one another."""

    difference: Scalar  # kg, of Y_vdot - X_udot

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        water = through_water(state, environment)
        return Force(0.0, 0.0, self.difference * water.u * water.v)
