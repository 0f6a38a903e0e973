"""Helm and controllers: from throttle and rudder angle to orders, and holding a course.

A throttle is a vessel's own measure of push: total thrust in N for thrusters, rev/s for
propellers and for thrusters with a thrust curve. Every trial speaks in throttle and
rudder angle, whatever the vessel is steered by.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.actuators import (
    AzimuthThruster,
    DerivativeRudder,
    FixedThruster,
    Propeller,
    Rudder,
)
from diffsea.vessel.base import Vessel


RUDDER_EQUIVALENT = 0.6108652381980153  # rad, 35 deg: all thrust on one side


class Helm(eqx.Module):
    """Allocation of throttle and rudder angle to a vessel's channels.

    Twin thrusters take rudder-equivalent angles: angle / 35 deg is the difference of port
    and starboard thrust over their sum. An azimuth thruster turns as a rudder would.
    """

    vessel: Vessel

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders by channel; positive `angle` (rad) turns to starboard."""
        orders = {channel: jnp.zeros(()) for channel in self.vessel.channels}
        for part in self.vessel.actuators.values():
            channels = tuple(part.servos)
            if isinstance(part, FixedThruster):
                orders[channels[0]] = self._thruster(part, throttle, angle)
            elif isinstance(part, Propeller):
                orders[channels[0]] = throttle
            elif isinstance(part, Rudder | DerivativeRudder):
                orders[channels[0]] = angle
            elif isinstance(part, AzimuthThruster):
                orders[part.force_channel] = throttle / self._count(AzimuthThruster)
                orders[part.angle_channel] = jnp.sign(part.x) * angle
        return {channel: jnp.asarray(order, float) for channel, order in orders.items()}

    def _count(self, kind: type) -> int:
        return sum(isinstance(part, kind) for part in self.vessel.actuators.values())

    def _thruster(self, part: FixedThruster, throttle: Scalar, angle: Scalar) -> Scalar:
        turn = -jnp.sign(part.y) * angle / RUDDER_EQUIVALENT
        if part.curve is None:
            return throttle / self._count(FixedThruster) * (1 + turn)
        # Thrust goes with |n| n, so a share of the thrust is a root of the speed.
        return throttle * jnp.sign(1 + turn) * jnp.sqrt(jnp.abs(1 + turn) + 1e-16)

    @property
    def steerable(self) -> bool:
        """Whether an angle changes anything."""
        sided = [p for p in self.vessel.actuators.values() if isinstance(p, FixedThruster)]
        turned = (Rudder, DerivativeRudder, AzimuthThruster)
        return any(float(abs(p.y)) > 0 for p in sided) or any(map(self._count, turned))

    @property
    def propelled(self) -> bool:
        """Whether a throttle changes anything."""
        return any(map(self._count, (FixedThruster, Propeller, AzimuthThruster)))


def straight_balance(vessel: Vessel, speed: Scalar, throttle: Scalar) -> Scalar:
    """Surge acceleration (m/s^2) of a straight run through still water at `speed` m/s."""
    zero = jnp.zeros(())
    state = State(zero, zero, zero, speed, zero, zero)
    orders = Helm(vessel).orders(throttle, zero)
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    return vessel.acceleration(state, executed, Environment(), zero)[0]


def throttle_for(vessel: Vessel, speed: Scalar) -> Scalar:
    """Throttle that keeps `speed` (m/s) straight ahead in still water.

    Differentiable in the vessel and the speed by the implicit-function theorem.
    """
    if not Helm(vessel).propelled:
        return jnp.zeros(())
    return _root(lambda throttle, at: straight_balance(at[0], at[1], throttle),
                 _first_throttle(vessel, speed), (vessel, speed))  # fmt: skip


def speed_for(vessel: Vessel, throttle: Scalar) -> Scalar:
    """Speed (m/s) that a throttle keeps straight ahead in still water."""
    guess = 0.6 * jnp.sqrt(9.81 * vessel.rigid_body.length) * 0.3
    return _root(lambda speed, at: straight_balance(at[0], speed, at[1]), guess,
                 (vessel, throttle))  # fmt: skip


def throttle_for_thrust(vessel: Vessel, thrust: Scalar) -> Scalar:
    """Throttle of a total thrust of `thrust` N.

    Thrusters commanded in N take it as it is. Propellers and thrusters with a thrust curve
    push differently at every speed: they get the throttle that holds the speed at which the
    hull's drag, straight ahead in still water, is `thrust`.
    """
    parts = vessel.actuators.values()
    if not any(isinstance(p, Propeller) or getattr(p, "curve", None) is not None for p in parts):
        return jnp.asarray(thrust, float)

    def excess(speed: Scalar, at: tuple[Vessel, Scalar]) -> Scalar:
        return _hull_drag(at[0], speed) / at[1] - 1

    guess = 0.2 * jnp.sqrt(9.81 * vessel.rigid_body.length)
    return throttle_for(vessel, _root(excess, guess, (vessel, jnp.asarray(thrust, float))))


def _hull_drag(vessel: Vessel, speed: Scalar) -> Scalar:
    """Drag (N) of everything but the actuators, straight ahead through still water."""
    zero = jnp.zeros(())
    state = State(zero, zero, zero, speed, zero, zero)
    return -sum(force(state, Environment(), zero).X for force in vessel.forces.values())


def full_throttle(vessel: Vessel) -> float:
    """Throttle at which the first propulsor reaches its limit; infinite without limits."""
    helm = Helm(vessel)
    limits = []
    for part in vessel.actuators.values():
        if isinstance(part, FixedThruster | Propeller | AzimuthThruster):
            thrust = getattr(part, "force_channel", next(iter(part.servos)))
            upper = part.servos[thrust].upper
            in_newton = not isinstance(part, Propeller) and getattr(part, "curve", None) is None
            share = helm._count(type(part)) if in_newton else 1
            limits += [] if upper is None else [share * float(upper)]
    return min(limits, default=math.inf)


def _first_throttle(vessel: Vessel, speed: Scalar) -> Scalar:
    """A throttle of the right order: propeller at J = 0.6, or thrust equal to drag."""
    diameters = [p.diameter for p in vessel.actuators.values() if isinstance(p, Propeller)]
    if diameters:
        return speed / (0.6 * diameters[0])
    drag = -straight_balance(vessel, speed, jnp.zeros(())) * vessel.mass_matrix()[0, 0]
    curves = [getattr(p, "curve", None) for p in vessel.actuators.values()]
    quadratic = [curve[1] for curve in curves if curve is not None]
    return jnp.sqrt(drag / sum(quadratic)) if quadratic else drag


def _root(residual, guess: Scalar, args) -> Scalar:
    """Where `residual(x, args)` is zero, by Newton's method; differentiable in `args`.

    The iterations carry no derivative. One more step from the root is of length zero and
    carries that of the implicit-function theorem.
    """
    fixed = jax.lax.stop_gradient(args)

    def at(x: Scalar) -> tuple[Scalar, Scalar]:
        return jax.jvp(lambda value: residual(value, fixed), (x,), (jnp.ones_like(x),))

    def improved(loop: tuple) -> tuple:
        x, _, count = loop
        value, slope = at(x)
        after = x - value / jnp.where(slope == 0, 1.0, slope)
        return after, jnp.abs(after - x) > 1e-12 * (1 + jnp.abs(after)), count + 1

    start = (jax.lax.stop_gradient(jnp.asarray(guess, float)), jnp.ones((), bool), 0)
    x, _, _ = jax.lax.while_loop(lambda loop: loop[1] & (loop[2] < 64), improved, start)
    slope = jax.lax.stop_gradient(at(x)[1])
    return x - residual(x, args) / jnp.where(slope == 0, 1.0, slope)


class CourseHold(eqx.Module):
    """Holds speed by a PI law on the throttle and heading by a PID law on the rudder.

    Gains are non-dimensional: times are in ship lengths run, throttle errors relative to
    the balance of a straight run.
    """

    speed: Scalar  # m/s over ground, to hold
    heading: Scalar  # rad, to hold
    throttle: Scalar  # balance in still water
    time_scale: Scalar  # s, L / U
    hold_speed: bool = eqx.field(static=True, default=True)
    speed_gain: float = 4.0
    speed_integral: float = 1.0
    heading_gain: float = 2.0
    heading_rate: float = 3.0
    heading_integral: float = 0.1
    largest_angle: float = 0.6

    def init(self) -> tuple[Scalar, Scalar]:
        """Integrals of the speed error and of the heading error, both at zero."""
        return jnp.zeros(()), jnp.zeros(())

    def step(
        self, memory: tuple[Scalar, Scalar], state: State, dt: Scalar
    ) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Next memory, and the throttle and rudder angle (rad) to order now."""
        slow = (self.speed - state.u) / jnp.maximum(self.speed, 1e-6)
        off = self.heading - state.psi
        angle = (
            self.heading_gain * off
            - self.heading_rate * self.time_scale * state.r
            + self.heading_integral * memory[1]
        )
        limited = jnp.clip(angle, -self.largest_angle, self.largest_angle)
        factor = 1 + self.speed_gain * slow + self.speed_integral * memory[0]
        wound = jnp.where(angle == limited, off * dt / self.time_scale, 0.0)
        memory = (memory[0] + slow * dt / self.time_scale, memory[1] + wound)
        return memory, (self.throttle * (factor if self.hold_speed else 1.0), limited)


def require_helm(vessel: Vessel, manoeuvre: str) -> None:
    """Raise `UserError` if a vessel cannot be steered through a manoeuvre."""
    if not Helm(vessel).steerable:
        raise UserError(
            f"{vessel.name!r} cannot be steered, so it cannot run a {manoeuvre}: it has no rudder, "
            "no azimuth thruster and no thruster off the centreline"
        )
