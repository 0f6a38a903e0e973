"""Forces that follow from others: changes during a run, shallow water, a screw's side force."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.kinematics import through_water
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import AbstractForce, AbstractSecondaryForce, Force, Vessel, step


def _resistance(vessel: Vessel, forces: dict[str, Force]) -> Force:
    """The water's resistance to the hull's motion."""
    resisting = [name for name, force in vessel.forces.items() if force.resists]
    return _sum(vessel, forces, resisting, "resistance")


def _thrust(vessel: Vessel, forces: dict[str, Force]) -> Force:
    """All forces of thrusters and propellers."""
    return _sum(vessel, forces, list(vessel.propulsors), "thrust")


def _sum(vessel: Vessel, forces: dict[str, Force], names: list[str], part: str) -> Force:
    """Forces by name, and what is part of them as far as it is known yet."""
    names += [n for n, f in vessel.secondary.items() if f.part_of == part and n in forces]
    return sum((forces[name] for name in names), Force())


class ShallowDamping(AbstractSecondaryForce):
    """What shallow water adds to the hull's resistance.

    With q = T / h, surge is multiplied by `(1 - q)^(-1/4)`, sway and yaw by `(1 - q)^(-1)`:
    twice the lateral damping at h = 2 T and three times at 1.5 T.
    """

    part_of: ClassVar[str] = "resistance"

    def __call__(
        self,
        vessel: Vessel,
        forces: dict[str, Force],
        water: State,
        environment: Environment,
        t: Scalar,
    ) -> Force:
        along = jnp.expm1(0.25 * environment.shallowness)
        across = jnp.expm1(environment.shallowness)
        drag = _resistance(vessel, forces)
        return Force(along * drag.X, across * drag.Y, across * drag.N)


class Change(AbstractSecondaryForce):
    """A change of the hull's resistance, or of all thrusts, from one time on."""

    factor: Scalar  # relative: 0.2 is a fifth more
    time: Scalar  # s, on the run's clock
    of_thrust: bool = eqx.field(static=True)

    def __call__(
        self,
        vessel: Vessel,
        forces: dict[str, Force],
        water: State,
        environment: Environment,
        t: Scalar,
    ) -> Force:
        changed = _thrust(vessel, forces) if self.of_thrust else _resistance(vessel, forces)
        share = self.factor * step(t, self.time, vessel.rigid_body.length)
        return Force(share * changed.X, share * changed.Y, share * changed.N)


class ScrewSideForce(AbstractSecondaryForce):
    """Side force and moment of a single screw, in proportion to its own force.

    `Y = Y_a |X_P|`, `N = N_a L |X_P|`, with other coefficients ahead and astern, where a
    right-handed screw moves the stern to port (Brix 1993, section 1.3).
    """

    part_of: ClassVar[str] = "thrust"

    propeller: str = eqx.field(static=True)
    Y_ahead: Scalar = 0.0
    N_ahead: Scalar = 0.0
    Y_astern: Scalar = 0.0
    N_astern: Scalar = 0.0

    def __call__(
        self,
        vessel: Vessel,
        forces: dict[str, Force],
        water: State,
        environment: Environment,
        t: Scalar,
    ) -> Force:
        push = forces[self.propeller].X
        ahead, astern = jnp.maximum(push, 0.0), jnp.maximum(-push, 0.0)
        Y = self.Y_ahead * ahead + self.Y_astern * astern
        N = self.N_ahead * ahead + self.N_astern * astern
        return Force(0.0, Y, N * vessel.rigid_body.length)


class MunkMoment(AbstractForce):
    """The moment `k u_r v_r` of added masses that are wrong relative to one another."""

    difference: Scalar  # kg, of Y_vdot - X_udot

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        water = through_water(state, environment)
        return Force(0.0, 0.0, self.difference * water.u * water.v)


class RollCoupling(AbstractForce):
    """Sway force and yaw moment of the recorded heel."""

    Y_phi: Scalar = 0.0  # N/rad
    N_phi: Scalar = 0.0  # N m/rad

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        return Force(0.0, self.Y_phi * environment.heel, self.N_phi * environment.heel)
