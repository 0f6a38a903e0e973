"""Rudders: by the MMG method, in a propeller's slipstream or not, and by derivatives."""

import dataclasses
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.types import Scalar, State
from diffsea.vessel.actuators.propeller import Propeller, drift_speed
from diffsea.vessel.base import AbstractActuator, CommandChannel, Jet, Vessel
from diffsea.vessel.forces import Force
from diffsea.vessel.hull import PrimeDamping, Scaling, is_rudder_derivative
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, numbers, positive


_KEYS = ("name", *Servo.KEYS, "max_angle", "min_angle")
_COMMAND = CommandChannel("steering", "rad")


def rudder_from_table(name: str, table: Table, vessel: Vessel) -> AbstractActuator:
    """The rudder of a `[[rudder]]` table: by derivatives where it has some, else by its area."""
    kind = DerivativeRudder if any(map(is_rudder_derivative, table)) else Rudder
    return kind.from_table(name, table, vessel)


def _servo_from_table(table: Table, where: str) -> Servo:
    """The servo of a rudder's table, its limits to both sides where it states one."""
    servo = Servo.from_table(table, where, "min_angle", "max_angle")
    if servo.upper is not None and servo.lower is None:
        return dataclasses.replace(servo, lower=-servo.upper)
    return servo


class Rudder(AbstractActuator):
    """A rudder in MMG form, behind a propeller or in the free stream; turns to starboard at +.

    Normal force `F_N = 1/2 rho A f_alpha U_R^2 sin(alpha_R)` with the propeller's
    slipstream in the inflow (Yasukawa and Yoshimura 2015, eqs. 17 to 25):
    `u_R = epsilon sqrt(eta (u_P + kappa (sqrt(u_P^2 + 8 K_T n^2 D^2 / pi) - u_P))^2 +
    (1 - eta) u_P^2)` and `v_R = U gamma_R (beta - l_R r / U)`, eta = D / H. Then
    `X = -(1 - t_R) F_N sin(delta)`, `Y = -(1 + a_H) F_N cos(delta)`,
    `N = -(x_R + a_H x_H) F_N cos(delta)`.
    """

    command: ClassVar[CommandChannel] = _COMMAND

    servos: dict[str, Servo]
    area: Scalar  # m^2
    x: Scalar  # m, x_R, negative aft
    height: Scalar  # m, span
    water_density: Scalar  # kg/m^3
    y: Scalar = 0.0  # m to starboard
    lift_slope: Scalar = 2.0  # f_alpha, per rad
    t_R: Scalar = 0.0  # steering resistance deduction
    a_H: Scalar = 0.0  # rise of the lateral force by the hull
    x_H: Scalar = 0.0  # m, where that rise acts
    gamma_R_port: Scalar = 1.0  # flow straightening, inflow from one side ...
    gamma_R_starboard: Scalar = 1.0  # ... and the other
    l_R: Scalar = 0.0  # m, effective longitudinal position of the rudder
    epsilon: Scalar = 1.0  # ratio of wakes at rudder and propeller
    kappa: Scalar = 0.5
    wake_fraction: Scalar = 0.0  # used without a propeller
    hull_lever: Scalar = 0.0  # m, beyond a_H x_H: a product that has a derivative at a_H = 0
    propeller: str | None = eqx.field(static=True, default=None)

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (delta,) = (executed[channel] for channel in self.servos)
        u_R, v_R = self._inflow(water, jets)
        alpha = delta - jnp.arctan2(v_R, u_R)
        square = u_R**2 + v_R**2
        normal = 0.5 * self.water_density * self.area * self.lift_slope * square * jnp.sin(alpha)
        side = -normal * jnp.cos(delta)
        X = -(1 - self.t_R) * normal * jnp.sin(delta)
        N = (self.x + self.a_H * self.x_H + self.hull_lever) * side - self.y * X
        return Force(X, (1 + self.a_H) * side, N)

    def _inflow(self, water: State, jets: dict[str, Jet]) -> tuple[Scalar, Scalar]:
        """Velocity of the water at the rudder, u_R aft and v_R across (m/s).

        Behind a propeller eta of the span lies in its slipstream, the rest in its inflow.
        """
        crossing = drift_speed(water) - self.l_R * water.r
        gamma = jnp.where(crossing < 0, self.gamma_R_port, self.gamma_R_starboard)
        if self.propeller is None:
            axial = (1 - self.wake_fraction) * water.u
        else:
            jet = jets[self.propeller]
            eta = jnp.minimum(jet.diameter / self.height, 1.0)
            u_P = jet.inflow
            # The small constant keeps the square roots differentiable at rest.
            race = jnp.sqrt(u_P**2 + jet.loading + 1e-12) - u_P
            mixed = eta * (u_P + self.kappa * race) ** 2 + (1 - eta) * u_P**2
            axial = self.epsilon * jnp.sqrt(mixed + 1e-12)
        # A floor on the axial inflow keeps the angle of attack differentiable at rest.
        return jnp.where(jnp.abs(axial) < 1e-9, 1e-9, axial), gamma * crossing

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "Rudder":
        where, body = f"[[rudder]] {name!r}", vessel.rigid_body
        optional = ("y", "lift_slope", "t_R", "a_H", "x_H", "gamma_R_port", "gamma_R_starboard")
        optional += ("l_R", "epsilon", "kappa", "wake_fraction")
        check_keys(table, (*_KEYS, "area", "x", "height", "propeller", *optional), where)
        servo, area = _servo_from_table(table, where), positive(table, "area", where)
        propeller = table.get("propeller")
        propellers = [n for n, part in vessel.actuators.items() if isinstance(part, Propeller)]
        if propeller is not None and propeller not in propellers:
            raise UserError(
                f"rudder {name!r} stands behind propeller {propeller!r}, which the file does not "
                f"have; it has: {', '.join(propellers) or 'none'}"
            )
        return cls(
            {name: servo},
            area=area,
            height=positive({"height": math.sqrt(1.6 * area)} | table, "height", where),
            water_density=body.water_density,
            propeller=propeller,
            **{"x": -0.5 * body.length} | numbers(table, ("x", *optional), where),
        )


class DerivativeRudder(AbstractActuator):
    """A rudder given by derivatives with the letter d, as in Abkowitz sets.

    `tau = sum_k D_k m_k(u, v, r, d)` in the scaling of the hull's own set; d is positive
    to starboard (published sets for the opposite sign flip the odd powers of d).
    """

    command: ClassVar[CommandChannel] = _COMMAND
    y: ClassVar[float] = 0.0

    servos: dict[str, Servo]
    derivatives: dict[str, Scalar]
    scaling: Scaling

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (delta,) = (executed[channel] for channel in self.servos)
        return self.scaling.force(self.derivatives, water, delta)

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "DerivativeRudder":
        where, hull = f"[[rudder]] {name!r}", vessel.forces["damping"]
        derivatives = numbers(table, filter(is_rudder_derivative, table), where)
        check_keys(table, (*_KEYS, *derivatives), where)
        if not isinstance(hull, PrimeDamping):
            raise UserError(f"{where}: rudder derivatives need [hull] nondimensional")
        return cls({name: _servo_from_table(table, where)}, {**derivatives}, hull.scaling)
