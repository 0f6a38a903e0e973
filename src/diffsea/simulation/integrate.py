"""One step of a vessel: servos in closed form, motion by a Runge-Kutta step of order four."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import OrderHistory, Response


class SimulationState(eqx.Module):
    """Everything that a step carries on: state, executed actuation and pending orders."""

    state: State
    executed: dict[str, Scalar]
    histories: dict[str, OrderHistory]


def history_lengths(
    vessel: Vessel, step: float, margin: float = 1.5, longest: float | None = None
) -> dict[str, int]:
    """How many orders each channel must remember at a step of `step` s.

    A delay may grow by `margin` (in a fit, say), or to `longest` s where that is given,
    before the memory falls short; orders at switching events need room of their own.
    """
    lengths = dict.fromkeys(vessel.servos, 1)
    for channel, servo in vessel.servos.items():
        if servo.delay is not None:
            reach = margin * float(servo.delay) if longest is None else longest
            lengths[channel] = math.ceil(reach / step) + 24
    return lengths


def begin(
    vessel: Vessel, state: State, orders: dict[str, Scalar], lengths: dict[str, int]
) -> SimulationState:
    """A motion whose actuators have long settled to `orders`.

    `lengths` is the memory of each channel, see `history_lengths`.
    """
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    histories = {
        c: OrderHistory(jnp.linspace(-1e9, -1e8, lengths[c]), jnp.full(lengths[c], orders[c]))
        for c in vessel.channels
    }
    return SimulationState(state, executed, histories)


def advance(
    vessel: Vessel,
    motion: SimulationState,
    orders: dict[str, Scalar],
    environment: Environment,
    t: Scalar,
    dt: Scalar,
) -> SimulationState:
    """The motion `dt` s later, with `orders` (in each channel's unit) holding from `t` s.

    Of fourth order in `dt`, of third where a servo's response jumps within the step.
    """
    histories = {c: h.push(t, orders[c]) for c, h in motion.histories.items()}
    responses = {
        c: servo.respond(motion.executed[c], histories[c], t, dt)
        for c, servo in vessel.servos.items()
    }
    state = rk4(vessel, motion.state, responses, environment, t, dt)
    return SimulationState(state, {c: r.final for c, r in responses.items()}, histories)


def rk4(
    vessel: Vessel,
    state: State,
    responses: dict[str, Response],
    environment: Environment,
    t: Scalar,
    dt: Scalar,
) -> State:
    """Classical Runge-Kutta step of order four with the servos' response at its nodes."""
    start = {c: r.start for c, r in responses.items()}
    middle = {c: r.middle for c, r in responses.items()}
    end = {c: r.end for c, r in responses.items()}

    def rate(at: State, executed: dict[str, Scalar], fraction: Scalar) -> State:
        return vessel.rate(at, executed, environment, t + fraction * dt)

    def state_after(k: State, fraction: float) -> State:
        return jax.tree.map(lambda s, d: s + fraction * dt * d, state, k)

    k1 = rate(state, start, 0.0)
    k2 = rate(state_after(k1, 0.5), middle, 0.5)
    k3 = rate(state_after(k2, 0.5), middle, 0.5)
    k4 = rate(state_after(k3, 1.0), end, 1.0)
    return jax.tree.map(
        lambda s, a, b, c, d: s + dt / 6 * (a + 2 * b + 2 * c + d), state, k1, k2, k3, k4
    )


_NODES = np.array([0.0, 0.5, 0.5, 1.0])
_LEADS = np.array([0.5, 0.5, 1.0, 0.0])  # from one stage to where the next is evaluated
_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6


def rk4_looped(
    vessel: Vessel,
    state: State,
    responses: dict[str, Response],
    environment: Environment,
    t: Scalar,
    dt: Scalar,
) -> State:
    """The step of `rk4` with its four stages as a loop.

    A quarter of the code: many tangents of a vessel with many effects are found twice as fast
    this way and compiled in half the time. A single run or a batch of them is not.
    """
    start = jax.tree.map(lambda value: jnp.asarray(value, float), state)
    nodes = {
        c: jnp.stack([jnp.asarray(node, float) for node in (r.start, r.middle, r.middle, r.end)])
        for c, r in responses.items()
    }

    def stage(carry: tuple[State, State], at: tuple) -> tuple[tuple[State, State], None]:
        here, end = carry
        executed, node, lead, weight = at
        slope = vessel.rate(here, executed, environment, t + node * dt)
        here = jax.tree.map(lambda s, d: s + lead * dt * d, start, slope)
        return (here, jax.tree.map(lambda s, d: s + weight * dt * d, end, slope)), None

    return jax.lax.scan(stage, (start, start), (nodes, _NODES, _LEADS, _WEIGHTS))[0][1]
