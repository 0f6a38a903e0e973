"""Motions and orders of vessels, and diffsea's own accelerations and runs to compare with."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.simulation.integrate import advance, begin, history_lengths
from diffsea.types import Environment, State


STATES = ("x", "y", "psi", "u", "v", "r")


def environment(current=(0.0, 0.0)):
    return Environment(current_north=float(current[0]), current_east=float(current[1]))


def random_state(vessel, rng):
    """A motion about Froude number 0.3, drifting and turning."""
    length = float(vessel.rigid_body.length)
    speed = 0.3 * math.sqrt(9.81 * length)
    u = speed * rng.uniform(-0.5, 1.5)
    v, r = speed * 0.4 * rng.normal(), speed / length * 0.6 * rng.normal()
    return np.array([*rng.normal(size=2), rng.uniform(-4, 4), u, v, r])


def random_orders(vessel, rng, share=1.0):
    """Orders within the limits of every channel."""
    orders = {}
    for channel, servo in vessel.servos.items():
        low = -10.0 if servo.lower is None else float(servo.lower)
        high = 10.0 if servo.upper is None else float(servo.upper)
        orders[channel] = share * rng.uniform(low, high)
    return orders


def rate(vessel, state, executed, current=(0.0, 0.0)):
    """diffsea's time derivative of the six states."""
    made = vessel.rate(State(*map(float, state)), executed, environment(current), 0.0)
    return np.array([float(getattr(made, name)) for name in STATES])


def run(vessel, state, plan, seconds, current=(0.0, 0.0), step=0.05):
    """diffsea's run of orders `[(time, orders), ...]`, the first of which have long held.

    Returns states at every step, the first row the start, and executed values.
    """
    place = environment(current)
    motion = begin(vessel, State(*map(float, state)), plan[0][1], history_lengths(vessel, step))
    move = jax.jit(lambda motion, orders, t: advance(vessel, motion, orders, place, t, step))
    rows, executed = [np.asarray(state, float)], [motion.executed]
    for k in range(round(seconds / step)):
        t = k * step
        orders = [held for since, held in plan if since <= t + 1e-9][-1]
        given = {c: jnp.asarray(float(orders[c])) for c in vessel.channels}
        motion = move(motion, given, jnp.asarray(t))
        rows.append(np.array([float(getattr(motion.state, name)) for name in STATES]))
        executed.append(motion.executed)
    return np.array(rows), executed
