"""Forces that follow from others: changes during a run, shallow water, a screw's side force.

Each of them sees the vessel's other forces by name (`AbstractDependentForce`).
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import AbstractDependentForce, Force, Forces, Vessel, step


def sum_of_part(vessel: Vessel, forces: Forces, part: str) -> Force:
    """The "resistance" of the water to the hull's motion, or the "thrust" of all propulsors.

    With the dependent forces that are part of it, as far as they are known yet.
    """
    if part == "thrust":
        names = list(vessel.propulsors)
    else:
        names = [name for name, force in vessel.forces.items() if force.resists]
    names += [n for n, f in vessel.dependent_forces.items() if f.part_of == part and n in forces]
    return sum((forces[name] for name in names), Force())


class ShallowDamping(AbstractDependentForce):
    """What shallow water adds to the hull's resistance.

    With q = T / h, surge is multiplied by `(1 - q)^(-1/4)`, sway and yaw by `(1 - q)^(-1)`:
    twice the lateral damping at h = 2 T and three times at 1.5 T.
    """

    part_of: ClassVar[str] = "resistance"

    def __call__(
        self, vessel: Vessel, forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        along = jnp.expm1(0.25 * environment.shallowness)
        across = jnp.expm1(environment.shallowness)
        drag = sum_of_part(vessel, forces, "resistance")
        return Force(along * drag.X, across * drag.Y, across * drag.N)


class Change(AbstractDependentForce):
    """A change of the hull's resistance, or of all thrusts, from one time on."""

    factor: Scalar  # relative: 0.2 is a fifth more
    time: Scalar  # s, on the run's clock
    of_thrust: bool = eqx.field(static=True)

    def __call__(
        self, vessel: Vessel, forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        changed = sum_of_part(vessel, forces, "thrust" if self.of_thrust else "resistance")
        share = self.factor * step(t, self.time, vessel.rigid_body.length)
        return Force(share * changed.X, share * changed.Y, share * changed.N)


class ScrewSideForce(AbstractDependentForce):
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
        self, vessel: Vessel, forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        push = forces[self.propeller].X
        ahead, astern = jnp.maximum(push, 0.0), jnp.maximum(-push, 0.0)
        Y = self.Y_ahead * ahead + self.Y_astern * astern
        N = self.N_ahead * ahead + self.N_astern * astern
        return Force(0.0, Y, N * vessel.rigid_body.length)
