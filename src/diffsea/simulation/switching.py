"""The engine that runs a table of stages: steps, and events located inside them.

The instant at which a stage ends is located inside the step and carries its derivative,
so everything after it is differentiable through the switching.
"""

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.scales import plausible_motion
from diffsea.simulation.control import AbstractSpeedLaw, ControlAllocation, FixedThrottle
from diffsea.simulation.integrate import SimulationState, advance
from diffsea.simulation.manoeuvres import Stages
from diffsea.types import Environment, Scalar, State, in_any_lane
from diffsea.vessel.base import Vessel


class Carry(eqx.Module):
    """What one pass of the engine hands to the next."""

    motion: SimulationState
    t: Scalar
    stage: Int[Array, ""]
    began: Scalar  # s, when the stage began
    grid: Int[Array, ""]  # steps done
    mode: Int[Array, ""]  # _NORMAL, _PROBE, _PROBE_AGAIN or _LAND
    planned: Scalar  # s, step to the event while probing and landing
    switch_times: Float[Array, "stage"]
    diverged: Bool[Array, ""]
    throttle: Scalar  # held until the governor's next step
    governing: object  # the governor's memory


class Row(eqx.Module):
    """What one pass records; only `accepted` rows count."""

    t: Scalar
    state: State
    commanded: dict[str, Scalar]
    executed: dict[str, Scalar]
    stage: Int[Array, "..."]
    accepted: Bool[Array, "..."]


_NORMAL, _PROBE, _PROBE_AGAIN, _LAND = range(4)
_EVENT_PASSES = 4  # beside the ordinary ones: withdrawn, two probes, landing
_CUBIC_ITERATIONS = 4
_WITHIN = 1e-6  # of a step: how far beyond its ends an event may come out, by rounding


class _StageRun(eqx.Module):
    """One manoeuvre of one vessel after the execute."""

    vessel: Vessel
    stages: Stages
    environment: Environment
    governor: AbstractSpeedLaw
    heading: Scalar  # rad, psi_0
    start: Scalar  # s, the execute
    step: Scalar
    seconds: Scalar

    def orders(self, carry: Carry) -> dict[str, Scalar]:
        """Orders in the stage; those of the last one after the end."""
        at = jnp.minimum(carry.stage, self.stages.count - 1)
        throttle = carry.throttle * self.stages.throttle[at]
        return ControlAllocation(self.vessel).orders(throttle, self.stages.angle[at])

    def motion_after(self, carry: Carry, dt: Scalar) -> SimulationState:
        """The motion `dt` s on, in the stage's orders."""
        orders = self.orders(carry)
        return advance(self.vessel, carry.motion, orders, self.environment, carry.t, dt)

    def end_function(self, carry: Carry, motion: SimulationState, t: Scalar) -> Scalar:
        """Reaches zero from below where the stage ends."""
        at = jnp.minimum(carry.stage, self.stages.count - 1)
        s, state = self.stages, motion.state
        turned = s.on_heading[at] * (state.psi - self.heading)
        return turned + s.on_time[at] * (t - carry.began) + s.on_speed[at] * state.u - s.level[at]

    def end_slope(self, carry: Carry, motion: SimulationState, t: Scalar) -> Scalar:
        """How fast the end function of a carry's stage grows (1/s) at a motion. No derivative."""
        run, carry, motion, t = jax.lax.stop_gradient((self, carry, motion, t))
        at = jnp.minimum(carry.stage, run.stages.count - 1)
        s, state = run.stages, motion.state
        slope = s.on_heading[at] * state.r + s.on_time[at]
        if not s.by_speed:
            return slope
        executed = executed_now(run.vessel, motion, run.orders(carry))
        rate = run.vessel.rate(state, executed, run.environment, t)
        return slope + s.on_speed[at] * rate.u

    def first_guess(self, carry: Carry, motion: SimulationState, g: Scalar, dt: Scalar) -> Scalar:
        """Step to the event of a step of `dt` that ends in `motion`, with the end function `g`.

        The event of the cubic through the step's ends. Carries no derivative.
        """
        run, carry, motion, g, dt = jax.lax.stop_gradient((self, carry, motion, g, dt))
        begin = run.end_function(carry, carry.motion, carry.t)
        slopes = (
            run.end_slope(carry, carry.motion, carry.t),
            run.end_slope(carry, motion, carry.t + dt),
        )
        return dt * hermite_root(begin, g, dt * slopes[0], dt * slopes[1])

    def corrected(self, carry: Carry, motion: SimulationState, g: Scalar, dt: Scalar) -> Scalar:
        """Step to the event by Newton's method from a probe of `dt` that ends in `motion`.

        It stays within the step to the grid; where that is left no correction is made.
        """
        slope = self.end_slope(carry, motion, carry.t + dt)
        after = dt - g / jnp.where(slope == 0, 1.0, slope)
        near = self.step * _WITHIN
        inside = (after >= -near) & (carry.t + after <= self.grid_time(carry) + near)
        return jnp.where(inside & (slope != 0), after, dt)

    def planned_step(
        self,
        carry: Carry,
        motion: SimulationState,
        g: Scalar,
        dt: Scalar,
        crossing: Bool[Array, ""],
        probing: Bool[Array, ""],
    ) -> Scalar:
        """Step to the event: guessed by a pass that crosses it, corrected by one that probes."""
        guessed = jax.lax.cond(
            in_any_lane(crossing),
            lambda: jnp.where(crossing, self.first_guess(carry, motion, g, dt), carry.planned),
            lambda: carry.planned,
        )
        return jax.lax.cond(
            in_any_lane(probing),
            lambda: jnp.where(probing, self.corrected(carry, motion, g, dt), guessed),
            lambda: guessed,
        )

    def grid_time(self, carry: Carry) -> Scalar:
        """When (s) the next ordinary step ends."""
        done = carry.grid.astype(float)
        return self.start + jnp.minimum(self.seconds, (done + 1) * self.step)

    def iterate(self, carry: Carry) -> tuple[Carry, Row]:
        """One pass of the engine: an ordinary step, or one of the three that make an event.

        An ordinary step that passes the end of its stage is withdrawn, and the event guessed. Two
        probing steps to it, also withdrawn, correct the length by `-g / (dg/dt)`. Where the first
        leaves a share e of the error, and of the derivative of the event's time, the second leaves
        e^2: both are right to rounding. The landing step is then differentiated exactly, and the
        next one returns to the grid.
        """
        done = carry.grid.astype(float)
        dt = jnp.where(carry.mode == _NORMAL, self.grid_time(carry) - carry.t, carry.planned)
        finished = (carry.stage >= self.stages.count) | carry.diverged
        finished = finished | ((carry.mode == _NORMAL) & (done * self.step >= self.seconds))
        motion = self.motion_after(carry, dt)
        g = self.end_function(carry, motion, carry.t + dt)
        wild = ~is_plausible(self.vessel, motion.state)
        active = ~finished & ~wild
        crossing = active & (carry.mode == _NORMAL) & (g >= 0)
        probing = active & ((carry.mode == _PROBE) | (carry.mode == _PROBE_AGAIN))
        landing = active & (carry.mode == _LAND)
        stepping = active & (carry.mode == _NORMAL) & ~crossing
        accepted = stepping | landing
        stage = carry.stage + landing.astype(int)
        t = jnp.where(accepted, carry.t + dt, carry.t)
        # The governor acts on the grid, as a digital one does; events come between its samples.
        governing, throttle = self.governor.step(carry.governing, motion.state, self.step)
        carry = Carry(
            motion=select(accepted, motion, carry.motion),
            t=t,
            stage=stage,
            began=jnp.where(landing, t, carry.began),
            grid=carry.grid + stepping.astype(int),
            mode=jnp.where(crossing, _PROBE, jnp.where(probing, carry.mode + 1, _NORMAL)),
            planned=self.planned_step(carry, motion, g, dt, crossing, probing),
            switch_times=jnp.where(
                landing & (jnp.arange(self.stages.count) == carry.stage), t, carry.switch_times
            ),
            diverged=carry.diverged | (wild & ~finished),
            throttle=jnp.where(stepping, throttle, carry.throttle),
            governing=select(stepping, governing, carry.governing),
        )
        orders = self.orders(carry)  # that hold from now on
        executed = executed_now(self.vessel, carry.motion, orders)
        return carry, Row(carry.t, carry.motion.state, orders, executed, carry.stage, accepted)


def hermite_root(first: Scalar, last: Scalar, begin: Scalar, end: Scalar) -> Scalar:
    """Where in [0, 1] the cubic of two values and two slopes crosses zero upwards, or nearly so.

    Newton's method from the secant, from `first` below zero to `last`, which is not; zero where
    `first` is not below.
    """
    rise = jnp.where(last > first, last - first, 1.0)
    curve, twist = 3 * (last - first) - 2 * begin - end, begin + end - 2 * (last - first)
    secant = jnp.clip(-first / rise, 0.0, 1.0)
    at = secant
    for _ in range(_CUBIC_ITERATIONS):
        value = first + at * (begin + at * (curve + at * twist))
        slope = begin + at * (2 * curve + 3 * at * twist)
        at = at - value / jnp.where(slope == 0, 1.0, slope)
        at = jnp.where((at >= 0) & (at <= 1), at, secant)
    return jnp.where(first < 0, at, 0.0)


def executed_now(
    vessel: Vessel, motion: SimulationState, orders: dict[str, Scalar]
) -> dict[str, Scalar]:
    """Executed actuation from now on: what answers at once has answered."""
    return {
        c: servo.target(orders[c]) if servo.direct else motion.executed[c]
        for c, servo in vessel.servos.items()
    }


Tree = TypeVar("Tree")


def select(condition: Bool[Array, ""], new: Tree, old: Tree) -> Tree:
    """`new` where the condition holds, else `old`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def is_plausible(vessel: Vessel, state: State) -> Bool[Array, ""]:
    """Whether the motion is finite and that of a craft of this length.

    Position and heading are not asked: they are sums of velocities that were. To look at them here
    has XLA compute the position, sines included, once more for what depends on the answer.
    """
    within = plausible_motion(vessel.rigid_body.length, state.u, state.v, state.r)
    return jnp.asarray(within)


def run_stages(
    vessel: Vessel,
    stages: Stages,
    motion: SimulationState,
    throttle: Scalar,
    environment: Environment,
    start: Scalar,
    step: float,
    seconds: float,
    governor: AbstractSpeedLaw | None = None,
    begun: Bool[Array, ""] | bool = True,
) -> tuple[Carry, Row]:
    """Run a table of stages from a motion; rows are those of every pass of the engine.

    A pass that is not accepted repeats the row before. The throttle stays as it is, or becomes
    what a `governor` orders, times the stage's. What has not `begun` stays where it is.
    """
    governor = FixedThrottle(jnp.asarray(throttle, float)) if governor is None else governor
    run = _StageRun(
        vessel,
        stages,
        environment,
        governor,
        heading=motion.state.psi,
        start=jnp.asarray(start, float),
        step=jnp.asarray(step, float),
        seconds=jnp.asarray(seconds, float),
    )
    zero = jnp.zeros((), int)
    carry = Carry(
        motion,
        t=run.start,
        stage=jnp.where(begun, zero, stages.count),
        began=run.start,
        grid=zero,
        mode=zero + _NORMAL,
        planned=run.step,
        switch_times=jnp.full(stages.count, jnp.nan),
        diverged=jnp.zeros((), bool),
        throttle=jnp.asarray(throttle, float),
        governing=governor.init(),
    )
    passes = math.ceil(seconds / step) + _EVENT_PASSES * stages.count
    return jax.lax.scan(lambda c, _: run.iterate(c), carry, length=passes)
