"""Throttle and speed of a straight run, each from the other, with derivatives."""

import math

import jax
import jax.numpy as jnp

from diffsea.scales import froude_speed
from diffsea.simulation.control.allocation import ControlAllocation
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel


def straight_balance(vessel: Vessel, speed: Scalar, throttle: Scalar) -> Scalar:
    """Surge acceleration (m/s^2) of a straight run through still water at `speed` m/s."""
    zero = jnp.zeros(())
    state = State(zero, zero, zero, speed, zero, zero)
    orders = ControlAllocation(vessel).orders(throttle, zero)
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    return vessel.acceleration(state, executed, Environment(), zero)[0]


def throttle_for(vessel: Vessel, speed: Scalar) -> Scalar:
    """Throttle that keeps `speed` (m/s) straight ahead in still water.

    Differentiable in the vessel and the speed by the implicit-function theorem.
    """
    if not ControlAllocation(vessel).propelled:
        return jnp.zeros(())
    guess = _first_throttle(vessel, speed)
    return _root(lambda x, at: straight_balance(at[0], at[1], x), guess, (vessel, speed))


def speed_for(vessel: Vessel, throttle: Scalar) -> Scalar:
    """Speed (m/s) that a throttle keeps straight ahead in still water."""
    guess = froude_speed(vessel.rigid_body.length, 0.6) * 0.3
    return _root(lambda x, at: straight_balance(at[0], x, at[1]), guess, (vessel, throttle))


def throttle_for_thrust(vessel: Vessel, thrust: Scalar) -> Scalar:
    """Throttle of a total thrust of `thrust` N.

    Thrusters commanded in N take it as it is. Propellers and thrusters with a thrust curve
    push differently at every speed: they get the throttle that holds the speed at which the
    hull's drag, straight ahead in still water, is `thrust`.
    """
    if all(part.bollard_coefficient is None for part in vessel.propulsors.values()):
        return jnp.asarray(thrust, float)

    def excess(speed: Scalar, at: tuple[Vessel, Scalar]) -> Scalar:
        return _hull_drag(at[0], speed) / at[1] - 1

    guess = froude_speed(vessel.rigid_body.length, 0.2)
    return throttle_for(vessel, _root(excess, guess, (vessel, jnp.asarray(thrust, float))))


def _hull_drag(vessel: Vessel, speed: Scalar) -> Scalar:
    """Drag (N) of everything but the actuators, straight ahead through still water."""
    zero = jnp.zeros(())
    state = State(zero, zero, zero, speed, zero, zero)
    return -sum(force(state, Environment(), zero).X for force in vessel.forces.values())


def full_throttle(vessel: Vessel) -> Scalar:
    """Throttle at which the first propulsor reaches its limit; infinite without limits."""
    allocation = ControlAllocation(vessel)
    limits = [
        allocation.sharing(part) * jnp.asarray(upper, float)
        for part in vessel.propulsors.values()
        for name, channel in part.channels.items()
        if channel.role == "propulsion" and (upper := part.servos[name].upper) is not None
    ]
    return jnp.min(jnp.stack(limits)) if limits else math.inf


def _first_throttle(vessel: Vessel, speed: Scalar) -> Scalar:
    """A throttle of the right order: propeller at J = 0.6, or thrust equal to drag."""
    propulsors = vessel.propulsors.values()
    diameters = [part.diameter for part in propulsors if part.diameter is not None]
    if diameters:
        return speed / (0.6 * diameters[0])
    drag = -straight_balance(vessel, speed, jnp.zeros(())) * vessel.mass_matrix()[0, 0]
    coefficients = [part.bollard_coefficient for part in propulsors]
    quadratic = [coefficient for coefficient in coefficients if coefficient is not None]
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
