"""A trial from start to end: approach, execute, manoeuvre, outcome."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.simulation.control import (
    AbstractSpeedLaw,
    ControlAllocation,
    Course,
    FixedThrottle,
    HeadingHold,
    SpeedHold,
    Steering,
    speed_for,
    throttle_for,
)
from diffsea.simulation.integrate import Motion, advance, begin, history_length
from diffsea.simulation.manoeuvres import Stages
from diffsea.simulation.switching import Row, executed_now, plausible, run_stages, select
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


def approach(
    vessel: Vessel,
    speed: Scalar,
    throttle: Scalar,
    environment: Environment,
    settings: TrialSettings,
    duration: float,
) -> tuple[Motion, Scalar, Scalar, Bool[Array, ""], Bool[Array, ""], Row]:
    """Straight run until speed and yaw rate are steady, for at most `duration` s.

    Returns the motion, throttle and time at the execute, whether it became steady, whether
    it diverged, and the rows. The time of the execute has no derivative: in a steady state nothing
    depends on it.
    """
    zero = jnp.zeros(())
    allocation = ControlAllocation(vessel)
    still = State(zero, zero, zero, speed, zero, zero)
    motion = begin(vessel, still, allocation.orders(throttle, zero), _memories(vessel, settings))
    scale = vessel.rigid_body.length / jnp.maximum(speed, 1e-6)
    fixed = FixedThrottle(throttle)
    pushing = SpeedHold(speed, throttle, scale) if settings.hold_speed else fixed
    hold = Steering(Course(zero), HeadingHold(scale), pushing)
    needed = jnp.ceil(settings.steady_lengths * scale / settings.step)

    def body(carry: tuple, _: None) -> tuple[tuple, Row]:
        motion, memory, t, calm, last, diverged = carry
        done = (calm >= needed) | diverged
        memory, (pushed, angle) = hold.step(memory, motion.state, settings.step)
        orders = allocation.orders(pushed, angle)
        # Orders hold from their time stamp on, so they stand beside the state before the step.
        row = Row(
            t, motion.state, orders, executed_now(vessel, motion, orders), -1 + 0 * calm, ~done
        )
        new = advance(vessel, motion, orders, environment, t, settings.step)
        steady = _steady(vessel, motion.state, new.state, speed, scale, environment, settings)
        diverged = diverged | (~done & ~plausible(vessel, new.state))
        done = done | diverged
        calm = jnp.where(done, calm, jnp.where(steady, calm + 1, 0))
        t = jnp.where(done, t, t + settings.step)
        motion = select(~done, new, motion)
        last = jnp.where(done, last, pushed)
        return (motion, memory, t, calm, last, diverged), row

    throttle, no = jnp.asarray(throttle, float), jnp.zeros((), bool)
    carry = (motion, hold.init(), zero, jnp.zeros((), int), throttle, no)
    passes = math.ceil(duration / settings.step)
    (motion, _, t, calm, throttle, wild), rows = jax.lax.scan(body, carry, length=passes)
    return motion, throttle, jax.lax.stop_gradient(t), calm >= needed, wild, rows


def _memories(vessel: Vessel, settings: TrialSettings) -> dict[str, int]:
    """How many orders each channel remembers."""
    step, longest = settings.step, settings.longest_delay
    return {c: history_length(s, step, longest=longest) for c, s in vessel.servos.items()}


def _steady(
    vessel: Vessel,
    before: State,
    after: State,
    speed: Scalar,
    scale: Scalar,
    environment: Environment,
    settings: TrialSettings,
) -> Bool[Array, ""]:
    """Speed at its target, or unchanging where none is held; no yawing, no sway building up."""
    change = jnp.abs(after.u - before.u) / settings.step * scale / jnp.maximum(speed, 1e-6)
    off = jnp.abs(after.u - speed) / jnp.maximum(speed, 1e-6)
    slow = (off < settings.steady) if settings.hold_speed else (change < settings.steady)
    swaying = jnp.abs(after.v - before.v) / settings.step * scale / jnp.maximum(speed, 1e-6)
    return slow & (jnp.abs(after.r) * scale < settings.steady) & (swaying < settings.steady)


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
    """
    environment = vessel.environment if environment is None else environment
    if throttle is None:
        throttle = throttle_for(vessel, speed) if speed is not None else jnp.zeros(())
    else:
        settings = dataclasses.replace(settings, hold_speed=False)
        if speed is None and not settings.from_rest:
            speed = speed_for(vessel, throttle)
    if settings.from_rest:
        rest = State(*(jnp.zeros(()) for _ in range(6)))
        motion = begin(
            vessel, rest, ControlAllocation(vessel).orders(0.0, 0.0), _memories(vessel, settings)
        )
        began, steady, before = jnp.zeros(()), jnp.ones((), bool), None
        wild = ~steady
    else:
        seconds = approach_seconds or approach_limit(vessel, float(speed), settings)
        motion, throttle, began, steady, wild, before = approach(
            vessel, jnp.asarray(speed, float), throttle, environment, settings, seconds
        )
    carry, rows = run_stages(
        vessel, stages, motion, throttle, environment, began, settings.step, settings.seconds,
        governor,
    )  # fmt: skip
    outcome = jnp.where(carry.stage >= stages.count, Outcome.COMPLETED, Outcome.TIME_LIMIT)
    outcome = jnp.where(steady, outcome, Outcome.APPROACH_UNSTEADY)
    outcome = jnp.where(wild | (steady & carry.diverged), Outcome.DIVERGED, outcome)
    first = _first_row(vessel, motion, began, stages, throttle)
    executed = [dataclasses.replace(r, accepted=r.accepted & steady) for r in (first, rows)]
    parts = executed if before is None else [before, *executed]
    switches = jnp.where(steady, carry.switch_times, jnp.nan)
    return _trial(parts, outcome, began, switches)


def _first_row(
    vessel: Vessel, motion: Motion, began: Scalar, stages: Stages, throttle: Scalar
) -> Row:
    orders = ControlAllocation(vessel).orders(throttle * stages.throttle[0], stages.angle[0])
    row = Row(
        began, motion.state, orders, executed_now(vessel, motion, orders), jnp.zeros((), int),
        jnp.ones((), bool),
    )  # fmt: skip
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], row)


def _trial(
    parts: list[Row], outcome: Int[Array, ""], began: Scalar, switches: Float[Array, "stage"]
) -> Trial:
    rows = jax.tree.map(lambda *columns: jnp.concatenate(columns), *parts)
    s = rows.state
    trajectory = Trajectory(
        rows.t, s.x, s.y, s.psi, s.u, s.v, s.r, rows.commanded, rows.executed, {},
        rows.accepted, outcome,
    )  # fmt: skip
    return Trial(trajectory, began, switches, rows.stage)


def approach_limit(vessel: Vessel, speed: float, settings: TrialSettings) -> float:
    """Longest approach in s: `approach_lengths` ship lengths at `speed` m/s."""
    lengths = settings.approach_lengths * float(vessel.rigid_body.length)
    return lengths / max(abs(speed), 1e-3)
