"""A vessel under a controller: orders at the controller's period, motion in finer steps."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.simulation.control import AbstractController
from diffsea.simulation.integrate import (
    SimulationState,
    advance,
    begin,
    history_lengths,
)
from diffsea.simulation.switching import Tree, executed_now, is_plausible, select
from diffsea.trajectory import Outcome, Trajectory
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel


class ClosedLoop(eqx.Module):
    """A run under a controller."""

    trajectory: Trajectory  # a row per period, from the start on
    memory: object  # the controller's, with a row per period


def run_controlled(
    vessel: Vessel,
    controller: AbstractController,
    start: State,
    seconds: float,
    period: float,
    step: float | None = None,
    environment: Environment | Callable[[Scalar], Environment] | None = None,
    longest_delay: float | None = None,
) -> ClosedLoop:
    """Run a vessel under a controller. Pure: jit, vmap and differentiate it.

    Arguments:
        start: the state at time zero; actuators have settled to the first orders.
        seconds: the longest run; it ends sooner where the controller is finished.
        period: s between the controller's steps; its orders hold from one to the next.
        step: of integration, s; `period` by default, and divided so that whole steps fill a
            period.
        environment: water and air, or a function of the time (s) that gives them: as steady
            within a step as they are at its start; the vessel's own by default.
        longest_delay: s; needed under jit where an actuator's delay is traced.

    Rows after the end are not `valid`. The outcome is `COMPLETED` where the controller finished,
    else `TIME_LIMIT`, or `DIVERGED`.

    The controller acts at samples, as a digital one does: derivatives are those of that sampled
    loop. Where a sample decides something (a waypoint reached), the decision has no derivative.

    Raises:
        UserError: a period that is not above zero, or longer than the run.
    """
    if not (period > 0 and seconds >= period):
        raise UserError(f"a run of {seconds:g} s needs a period above zero, at most as long as it")
    environment = vessel.environment if environment is None else environment
    parts = max(1, math.ceil(period / (step or period) - 1e-9))
    dt = period / parts
    memory, orders = controller.step(controller.init(), start, jnp.zeros(()), period)
    lengths = history_lengths(vessel, dt, longest=longest_delay)
    motion = begin(vessel, _as_floats(start), _as_floats(orders), lengths)

    def body(carry: tuple, number: Scalar) -> tuple[tuple, tuple]:
        motion, memory, over, diverged = carry
        t = number * period
        after, orders = controller.step(memory, motion.state, t, period)
        orders = _as_floats(orders)
        row = (t, motion.state, orders, executed_now(vessel, motion, orders), ~over)

        def part(motion: SimulationState, number: Scalar) -> tuple[SimulationState, None]:
            now = t + number * dt
            around = environment(now) if callable(environment) else environment
            return advance(vessel, motion, orders, around, now, dt), None

        new, _ = jax.lax.scan(part, motion, jnp.arange(parts, dtype=float))
        diverged = diverged | (~over & ~is_plausible(vessel, new.state))
        memory = select(over, memory, after)
        motion = select(~over & ~diverged, new, motion)
        over = over | diverged | controller.is_finished(memory)
        return (motion, memory, over, diverged), (row, memory)

    no = jnp.zeros((), bool)
    count = math.floor(seconds / period + 1e-9) + 1
    carry = (motion, controller.init(), no, no)
    carry, (rows, memories) = jax.lax.scan(body, carry, jnp.arange(count, dtype=float))
    _, memory, _, diverged = carry
    outcome = jnp.where(controller.is_finished(memory), Outcome.COMPLETED, Outcome.TIME_LIMIT)
    outcome = jnp.where(diverged, Outcome.DIVERGED, outcome)
    t, state, commanded, executed, valid = rows
    orders = {"commanded": commanded, "executed": executed, "extra": {}}
    run = Trajectory(t, *jax.tree.leaves(state), **orders, valid=valid, outcome=outcome)
    return ClosedLoop(run, memories)


def _as_floats(tree: Tree) -> Tree:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)
