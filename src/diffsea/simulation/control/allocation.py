"""Control allocation, and throttle and speed of a straight run, each from the other.

A throttle is a vessel's own measure of push: total thrust in N for thrusters, whatever the unit of
their orders, and rev/s for propellers and for thrusters with a curve of their shaft speed. Every
trial speaks in throttle and rudder angle, whatever the vessel is steered by.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.scales import froude_speed
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import AbstractActuator, AbstractPropulsor, Vessel


class ControlAllocation(eqx.Module):
    """Allocation of throttle and rudder angle to a vessel's channels.

    Actuators know what they take of either (`AbstractActuator.orders`); a throttle in N is
    divided among all of a kind before.
    """

    vessel: Vessel

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders by channel; positive `angle` (rad) turns to starboard."""
        orders: dict[str, Scalar] = {}
        for part in self.vessel.actuators.values():
            orders |= part.orders(throttle / self.sharing(part), angle)
        return {channel: jnp.asarray(orders[channel], float) for channel in self.vessel.channels}

    def sharing(self, part: AbstractActuator) -> int:
        """How many actuators divide a throttle of its kind: all alike where it is in N."""
        if not isinstance(part, AbstractPropulsor) or part.bollard_coefficient is not None:
            return 1
        return max(sum(type(one) is type(part) for one in self.vessel.driving), 1)

    @property
    def steerable(self) -> bool:
        """Whether an angle changes anything."""
        return any(
            any(channel.role == "steering" for channel in part.channels.values())
            or (part.differential and float(abs(part.y)) > 0)
            for part in self.vessel.actuators.values()
        )

    @property
    def propelled(self) -> bool:
        """Whether a throttle changes anything."""
        return bool(self.vessel.driving)


def require_steering(vessel: Vessel, manoeuvre: str) -> None:
    """Raise `UserError` if a vessel cannot be steered through a manoeuvre."""
    if not ControlAllocation(vessel).steerable:
        raise UserError(
            f"{vessel.name!r} cannot be steered, so it cannot run a {manoeuvre}: it has no rudder, "
            "no azimuth thruster and no thruster off the centreline"
        )


def settled_acceleration(
    vessel: Vessel, u: Scalar, v: Scalar, r: Scalar, throttle: Scalar, angle: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Acceleration in still water, actuators settled to a throttle and a rudder angle (rad).

    Arguments:
        u, v, r: forward and starboard velocity (m/s) and yaw rate (rad/s); heading north.

    Returns:
        Time derivatives of `u` and `v` (m/s^2) and of `r` (rad/s^2).
    """
    zero = jnp.zeros(())
    orders = ControlAllocation(vessel).orders(throttle, angle)
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    state = State(zero, zero, zero, u, v, r)
    return vessel.acceleration(state, executed, Environment(), zero)


def straight_balance(vessel: Vessel, speed: Scalar, throttle: Scalar) -> Scalar:
    """Surge acceleration (m/s^2) of a straight run through still water at `speed` m/s."""
    zero = jnp.zeros(())
    return settled_acceleration(vessel, speed, zero, zero, throttle, zero)[0]


def throttle_for(vessel: Vessel, speed: Scalar) -> Scalar:
    """Throttle that keeps `speed` (m/s) straight ahead in still water; zero without propulsion.

    Differentiable in the vessel and the speed by the implicit-function theorem. Newton's method
    starts from a propeller at J = 0.6, or from a thrust equal to the drag.
    """
    propulsors = vessel.driving
    if not propulsors:
        return jnp.zeros(())
    diameters = [part.diameter for part in propulsors if part.diameter is not None]
    if diameters:
        guess = speed / (0.6 * diameters[0])
    else:
        guess = -straight_balance(vessel, speed, jnp.zeros(())) * vessel.mass_matrix()[0, 0]
        coefficients = [part.bollard_coefficient for part in propulsors]
        quadratic = [coefficient for coefficient in coefficients if coefficient is not None]
        guess = jnp.sqrt(guess / sum(quadratic)) if quadratic else guess
    return _root(lambda x, at: straight_balance(at[0], at[1], x), guess, (vessel, speed))


def speed_for(vessel: Vessel, throttle: Scalar) -> Scalar:
    """Speed (m/s) that a throttle keeps straight ahead in still water.

    Differentiable in the vessel and the throttle by the implicit-function theorem.
    """
    guess = froude_speed(vessel.rigid_body.length, 0.6) * 0.3
    return _root(lambda x, at: straight_balance(at[0], x, at[1]), guess, (vessel, throttle))


def throttle_for_thrust(vessel: Vessel, thrust: Scalar) -> Scalar:
    """Throttle of a total thrust of `thrust` N.

    Thrusters whose throttle is in N take it as it is. Propellers, and thrusters with a curve of
    their shaft speed, push differently at every speed: they get the throttle that holds the speed
    at which the hull's drag, straight ahead in still water, is `thrust`.
    """
    if all(part.bollard_coefficient is None for part in vessel.driving):
        return jnp.asarray(thrust, float)

    def excess(speed: Scalar, at: tuple[Vessel, Scalar]) -> Scalar:
        """Drag of everything but the actuators over the thrust, less one."""
        zero = jnp.zeros(())
        state = State(zero, zero, zero, speed, zero, zero)
        drag = -sum(force(state, Environment(), zero).X for force in at[0].forces.values())
        return drag / at[1] - 1

    guess = froude_speed(vessel.rigid_body.length, 0.2)
    return throttle_for(vessel, _root(excess, guess, (vessel, jnp.asarray(thrust, float))))


def full_throttle(vessel: Vessel) -> Scalar:
    """Throttle at which the first propulsor reaches its limit; infinite without limits."""
    allocation = ControlAllocation(vessel)
    limits = [
        allocation.sharing(part) * jnp.asarray(full, float)
        for part in vessel.driving
        if (full := part.full_throttle) is not None
    ]
    return jnp.min(jnp.stack(limits)) if limits else math.inf


def _root(residual, guess: Scalar, args) -> Scalar:
    """Where `residual(x, args)` is zero, by Newton's method; differentiable in `args`.

    The iterations carry no derivative. One more step from the root is of length zero and
    carries that of the implicit-function theorem.
    """
    fixed = jax.lax.stop_gradient(args)

    def at(x: Scalar) -> tuple[Scalar, Scalar]:
        return jax.jvp(lambda value: residual(value, fixed), (x,), (jnp.ones_like(x),))

    def newton_step(loop: tuple) -> tuple:
        x, _, count = loop
        value, slope = at(x)
        after = x - value / jnp.where(slope == 0, 1.0, slope)
        return after, jnp.abs(after - x) > 1e-12 * (1 + jnp.abs(after)), count + 1

    start = (jax.lax.stop_gradient(jnp.asarray(guess, float)), jnp.ones((), bool), 0)
    x, _, _ = jax.lax.while_loop(lambda loop: loop[1] & (loop[2] < 64), newton_step, start)
    slope = jax.lax.stop_gradient(at(x)[1])
    return x - residual(x, args) / jnp.where(slope == 0, 1.0, slope)
