"""A trial from start to end: approach, execute, manoeuvre, outcome."""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.simulation.control import (
    AbstractSpeedLaw,
    ConstantHeading,
    ControlAllocation,
    FixedThrottle,
    HeadingHold,
    SpeedHold,
    Steering,
    speed_for,
    throttle_for,
)
from diffsea.simulation.integrate import (
    SimulationState,
    advance,
    begin,
    history_lengths,
)
from diffsea.simulation.manoeuvres import Stages
from diffsea.simulation.switching import Row, executed_now, is_plausible, run_stages, select
from diffsea.trajectory import Outcome, Trajectory
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel


@dataclasses.dataclass(frozen=True)
class TrialSettings:
    """How a trial is run.

    `steady` is the criterion of the approach: relative speed error, and yaw rate times
    L / U, both below it while the vessel runs `steady_lengths` ship lengths.
    """

    step: float = 0.1  # s
    seconds: float = 600.0  # s, for the manoeuvre after the execute
    steady: float = 1e-3
    steady_lengths: float = 2.0
    approach_lengths: float = 100.0  # the approach is given up after so many
    hold_speed: bool = True  # approach under the speed controller; else at fixed throttle
    longest_delay: float | None = None  # s; needed under jit where an actuator's delay is traced
    from_rest: bool = False  # no approach: start at rest


class Trial(eqx.Module):
    """A trial as it was run."""

    trajectory: Trajectory
    execute_time: Scalar  # s
    switch_times: Float[Array, "stage"]  # s, when each stage ended; NaN where it did not
    stage: Int[Array, "time"]  # stage in force at each row; -1 in the approach


class Approach(NamedTuple):
    """A straight run up to the execute."""

    motion: SimulationState  # at the execute
    throttle: Scalar  # at the execute
    time: Scalar  # s, of the execute; without derivative
    steady: Bool[Array, ""]
    diverged: Bool[Array, ""]
    rows: Row | None  # None from rest


def run_approach(
    vessel: Vessel,
    speed: Scalar,
    throttle: Scalar,
    environment: Environment,
    settings: TrialSettings,
    seconds: float,
) -> Approach:
    """Straight run at `speed` m/s until speed and yaw rate are steady, for at most `seconds`.

    The time of the execute has no derivative: in a steady state nothing depends on it.
    """
    zero, step = jnp.zeros(()), settings.step
    allocation = ControlAllocation(vessel)
    still = State(zero, zero, zero, speed, zero, zero)
    scale = vessel.rigid_body.length / jnp.maximum(speed, 1e-6)
    fixed = FixedThrottle(throttle)
    speed_law = SpeedHold(speed, throttle, scale) if settings.hold_speed else fixed
    hold = Steering(ConstantHeading(zero), HeadingHold(scale), speed_law)
    needed = jnp.ceil(settings.steady_lengths * scale / step).astype(int)

    def is_steady(before: State, after: State) -> Bool[Array, ""]:
        """Speed at its target, or unchanging where none is held; no yawing, no sway building up."""
        change = jnp.abs(after.u - before.u) / step * scale / jnp.maximum(speed, 1e-6)
        off = jnp.abs(after.u - speed) / jnp.maximum(speed, 1e-6)
        slow = (off < settings.steady) if settings.hold_speed else (change < settings.steady)
        swaying = jnp.abs(after.v - before.v) / step * scale / jnp.maximum(speed, 1e-6)
        return slow & (jnp.abs(after.r) * scale < settings.steady) & (swaying < settings.steady)

    def body(carry: tuple, _: None) -> tuple[tuple, Row]:
        motion, memory, t, calm, last, diverged = carry
        done = (calm >= needed) | diverged
        memory, (ordered, angle) = hold.step(memory, motion.state, step)
        orders = allocation.orders(ordered, angle)
        # Orders hold from their time stamp on, so they stand beside the state before the step.
        executed = executed_now(vessel, motion, orders)
        row = Row(t, motion.state, orders, executed, -1 + 0 * calm, ~done)
        new = advance(vessel, motion, orders, environment, t, step)
        steady = is_steady(motion.state, new.state)
        diverged = diverged | (~done & ~is_plausible(vessel, new.state))
        done = done | diverged
        calm = jnp.where(done, calm, jnp.where(steady, calm + 1, 0))
        t = jnp.where(done, t, t + step)
        motion = select(~done, new, motion)
        last = jnp.where(done, last, ordered)
        return (motion, memory, t, calm, last, diverged), row

    lengths = history_lengths(vessel, step, longest=settings.longest_delay)
    start = begin(vessel, still, allocation.orders(throttle, zero), lengths)
    no = jnp.zeros((), bool)
    carry = (start, hold.init(), zero, jnp.zeros((), int), jnp.asarray(throttle, float), no)
    passes = math.ceil(seconds / step)
    (motion, _, t, calm, last, diverged), rows = jax.lax.scan(body, carry, length=passes)
    return Approach(motion, last, jax.lax.stop_gradient(t), calm >= needed, diverged, rows)


def run_trial(
    vessel: Vessel,
    stages: Stages,
    speed: Scalar | None = None,
    throttle: Scalar | None = None,
    settings: TrialSettings = TrialSettings(),
    environment: Environment | None = None,
    approach_seconds: float | None = None,
    governor: AbstractSpeedLaw | None = None,
) -> Trial:
    """Approach, execute, and run a manoeuvre to its end. Pure: jit, vmap and differentiate it.

    Arguments:
        vessel: what is tried.
        stages: the manoeuvre.
        speed: approach speed over ground, m/s, held by the speed controller; or
        throttle: approach throttle, left as it is (with `speed`, the speed to start from).
        settings: step, time limits and the criterion of steadiness (static under jit).
        environment: water and air; the vessel's own by default.
        approach_seconds: longest approach; needed under jit where the speed is traced.
        governor: speed law that goes on after the execute; without one the throttle then stays.

    Divergence, a time limit or an unsteady approach is told by the trajectory's `outcome`.

    Raises:
        ValueError: neither a speed nor a throttle for an approach.
    """
    environment = vessel.environment if environment is None else environment
    allocation = ControlAllocation(vessel)
    if throttle is None:
        throttle = throttle_for(vessel, speed) if speed is not None else jnp.zeros(())
    else:
        settings = dataclasses.replace(settings, hold_speed=False)
        if speed is None and not settings.from_rest:
            speed = speed_for(vessel, throttle)
    if settings.from_rest:
        rest = State(*(jnp.zeros(()) for _ in range(6)))
        lengths = history_lengths(vessel, settings.step, longest=settings.longest_delay)
        motion = begin(vessel, rest, allocation.orders(0.0, 0.0), lengths)
        yes = jnp.ones((), bool)
        approach = Approach(motion, throttle, jnp.zeros(()), yes, ~yes, None)
    else:
        if speed is None:
            raise ValueError("an approach needs its speed or its throttle")
        seconds = approach_seconds or approach_limit(vessel, float(speed), settings)
        speed = jnp.asarray(speed, float)
        approach = run_approach(vessel, speed, throttle, environment, settings, seconds)
    motion, throttle, execute, steady, diverged, before = approach
    carry, after = run_stages(
        vessel,
        stages,
        motion,
        throttle,
        environment,
        execute,
        settings.step,
        settings.seconds,
        governor,
        begun=steady,
    )
    orders = allocation.orders(throttle * stages.throttle[0], stages.angle[0])
    executed = executed_now(vessel, motion, orders)
    first = Row(execute, motion.state, orders, executed, jnp.zeros((), int), steady)
    first = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], first)
    parts = [first, after] if before is None else [before, first, after]
    rows = jax.tree.map(lambda *columns: jnp.concatenate(columns), *parts)
    outcome = jnp.where(carry.stage >= stages.count, Outcome.COMPLETED, Outcome.TIME_LIMIT)
    outcome = jnp.where(steady, outcome, Outcome.APPROACH_UNSTEADY)
    outcome = jnp.where(diverged | carry.diverged, Outcome.DIVERGED, outcome)
    orders = {"commanded": rows.commanded, "executed": rows.executed, "extra": {}}
    motion = jax.tree.leaves(rows.state)
    trajectory = Trajectory(rows.t, *motion, **orders, valid=rows.accepted, outcome=outcome)
    return Trial(trajectory, execute, carry.switch_times, rows.stage)


def approach_limit(vessel: Vessel, speed: float, settings: TrialSettings) -> float:
    """Longest approach in s: `approach_lengths` ship lengths at `speed` m/s."""
    lengths = settings.approach_lengths * float(vessel.rigid_body.length)
    return lengths / max(abs(speed), 1e-3)
