"""A screw propeller: thrust by the open-water polynomial, slipstream, side force."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import (
    AbstractDependentForce,
    AbstractPropulsor,
    CommandChannel,
    Forces,
    Jet,
    Losses,
    Vessel,
)
from diffsea.vessel.forces import Force
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, needed, numbers, positive


def drift_speed(water: State) -> Scalar:
    """Drift angle times speed, `U beta` with `beta = atan(-v / |u|)` (m/s): nearly -v."""
    # The small constant keeps the angle differentiable at rest.
    u = jnp.sqrt(water.u**2 + 1e-12)
    return jnp.sqrt(u**2 + water.v**2) * jnp.arctan2(-water.v, u)


class Propeller(AbstractPropulsor):
    """A fixed-pitch propeller commanded in rev/s.

    `T = rho D^4 (k_0 n |n| + k_1 |n| V + k_2 V |V|)` with V = (1 - w) u_r / D: the open-water
    polynomial `rho n^2 D^4 K_T(J)` made continuous through n = 0, where J is not defined.
    Astern the first term is multiplied by `astern_factor`. The wake fraction falls with
    the drift angle at the propeller, `w = w_0 exp(-wake_decay beta_P^2)` with
    `beta_P = beta - x r / U`, and `X = (1 - t) T` (Yasukawa and Yoshimura 2015, eqs. 9 to 16).
    """

    command: ClassVar[CommandChannel] = CommandChannel("propulsion", "rev/s")

    servos: dict[str, Servo]
    x: Scalar  # m forward of amidships
    diameter: Scalar  # m
    k_T: tuple[Scalar, Scalar, Scalar]
    water_density: Scalar  # kg/m^3
    y: Scalar = 0.0  # m to starboard
    wake_fraction: Scalar = 0.0
    wake_decay: Scalar = 0.0
    thrust_deduction: Scalar = 0.0
    astern_factor: Scalar = 0.7
    losses: Losses = Losses()

    @property
    def bollard_coefficient(self) -> Scalar:
        return self.water_density * self.diameter**4 * self.k_T[0]

    def _advance(self, water: State) -> Scalar:
        """Speed into the disc, m/s."""
        drift = drift_speed(water) - self.x * water.r
        speed_squared = water.u**2 + water.v**2 + 1e-12
        wake = self.wake_fraction * jnp.exp(-self.wake_decay * drift**2 / speed_squared)
        return (1 - wake) * water.u

    def _coefficient_times_square(self, n: Scalar, advance: Scalar) -> Scalar:
        """K_T n^2, in 1/s^2."""
        k0, k1, k2 = self.k_T
        V = advance / self.diameter
        bollard = k0 * jnp.where(n < 0, self.astern_factor, 1.0)
        return bollard * n * jnp.abs(n) + k1 * jnp.abs(n) * V + k2 * V * jnp.abs(V)

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        """Thrust (N) of the executed shaft speed (rev/s), after deduction and losses."""
        (n,) = (executed[channel] for channel in self.servos)
        square = self._coefficient_times_square(n, self._advance(water))
        thrust = (1 - self.thrust_deduction) * (self.water_density * self.diameter**4 * square)
        return Force.of_thrust(thrust * self.losses.factor(water), self.x, self.y, 0.0)

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet:
        """The slipstream, without loading where the shaft does not turn ahead."""
        (n,) = (executed[channel] for channel in self.servos)
        advance = self._advance(water)
        square = jnp.where(n > 0, self._coefficient_times_square(n, advance), 0.0)
        loading = 8 * jnp.maximum(square, 0.0) * self.diameter**2 / jnp.pi
        return Jet(advance, loading, self.diameter)

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "Propeller":
        where, limits = f"[[propeller]] {name!r}", ("min_speed", "max_speed")
        optional = ("wake_fraction", "wake_decay", "thrust_deduction", "astern_factor")
        keys = ("name", *Servo.KEYS, *Losses.KEYS, "x", "y", "diameter", "k_T")
        check_keys(table, (*keys, *optional, *limits), where)
        given = table.get("k_T")
        if not isinstance(given, list) or len(given) != 3:
            raise UserError(f"{where}: k_T = [k_0, k_1, k_2] of K_T(J) = k_0 + k_1 J + k_2 J^2")
        polynomial = {f"k_T[{i}]": k for i, k in enumerate(given)}
        k0, k1, k2 = (needed(polynomial, key, where) for key in polynomial)
        return cls(
            {name: Servo.from_table(table, where, *limits)},
            diameter=positive(table, "diameter", where),
            k_T=(k0, k1, k2),
            water_density=vessel.rigid_body.water_density,
            losses=Losses.from_table(table, where),
            **{"x": 0.0} | numbers(table, ("x", "y", *optional), where),
        )


class ScrewSideForce(AbstractDependentForce):
    """Side force (N) and yaw moment (N m) of a single screw, in proportion to its own force.

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
