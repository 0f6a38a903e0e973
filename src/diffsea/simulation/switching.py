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
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel


class Carry(eqx.Module):
    """What one pass of the engine hands to the next."""

    motion: SimulationState
    t: Scalar
    stage: Int[Array, ""]
    began: Scalar  # s, when the stage began
    grid: Int[Array, ""]  # steps done
    mode: Int[Array, ""]  # _NORMAL, _PROBE or _LAND
    planned: Scalar  # s, step to the event while probing and landing
    slope: Scalar  # 1/s, derivative of the stage's end function along the step
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


_NORMAL, _PROBE, _LAND = 0, 1, 2


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

    def locate(self, carry: Carry, dt: Scalar, wanted: Bool[Array, ""]) -> tuple:
        """Step to the event within (0, dt] and the end function's slope there.

        Newton's method on the actual step, safeguarded by a bracket. Carries no derivative:
        the probing step that follows does. Costs nothing where no lane wants it.
        """
        run, carry, dt = jax.lax.stop_gradient((self, carry, dt))

        def value(span: Scalar) -> Scalar:
            return run.end_function(carry, run.motion_after(carry, span), carry.t + span)

        def body(loop: tuple) -> tuple:
            low, high, span, _, count, _ = loop
            g, slope = jax.jvp(value, (span,), (jnp.ones_like(span),))
            low, high = jnp.where(g < 0, span, low), jnp.where(g < 0, high, span)
            newton = span - g / slope
            inside = (newton >= low) & (newton <= high)
            after = jnp.where(inside, newton, 0.5 * (low + high))
            return low, high, after, slope, count + 1, jnp.abs(after - span) > 1e-13 * dt

        def searching(loop: tuple) -> Bool[Array, ""]:
            return wanted & loop[5] & (loop[4] < 60)

        first = (jnp.zeros_like(dt), dt, dt, jnp.ones_like(dt), 0, jnp.ones((), bool))
        _, _, span, slope, _, _ = jax.lax.while_loop(searching, body, first)
        return span, slope

    def iterate(self, carry: Carry) -> tuple[Carry, Row]:
        """One pass of the engine: an ordinary step, or one of the two that make an event.

        An ordinary step that passes the end of its stage is withdrawn and the event
        located; a probing step to it, also withdrawn, corrects the length by
        `-g / (dg/dt)`, which is zero but carries the derivative of the event's time; the
        landing step is then differentiated exactly, and the next one returns to the grid.
        """
        done = carry.grid.astype(float)
        limit = jnp.minimum(self.seconds, (done + 1) * self.step)
        dt = jnp.where(carry.mode == _NORMAL, self.start + limit - carry.t, carry.planned)
        finished = (carry.stage >= self.stages.count) | carry.diverged
        finished = finished | ((carry.mode == _NORMAL) & (done * self.step >= self.seconds))
        motion = self.motion_after(carry, dt)
        g = self.end_function(carry, motion, carry.t + dt)
        wild = ~is_plausible(self.vessel, motion.state)
        active = ~finished & ~wild
        crossing = active & (carry.mode == _NORMAL) & (g >= 0)
        span, slope = self.locate(carry, dt, crossing)
        probing = active & (carry.mode == _PROBE)
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
            mode=jnp.where(crossing, _PROBE, jnp.where(probing, _LAND, _NORMAL)),
            planned=jnp.where(
                crossing, span, jnp.where(probing, dt - g / carry.slope, carry.planned)
            ),
            slope=jnp.where(crossing, slope, carry.slope),
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
    """Whether a state is finite and its motion that of a craft of this length."""
    within = plausible_motion(vessel.rigid_body.length, state.u, state.v, state.r)
    return jnp.isfinite(state.x + state.y + state.psi) & within


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
) -> tuple[Carry, Row]:
    """Run a table of stages from a motion; rows are those of every pass of the engine.

    The throttle stays as it is, or becomes what a `governor` orders, times the stage's.
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
        stage=zero,
        began=run.start,
        grid=zero,
        mode=zero + _NORMAL,
        planned=run.step,
        slope=jnp.ones(()),
        switch_times=jnp.full(stages.count, jnp.nan),
        diverged=jnp.zeros((), bool),
        throttle=jnp.asarray(throttle, float),
        governing=governor.init(),
    )
    # An event costs three passes beside the ordinary ones: withdrawn, probe, landing.
    passes = math.ceil(seconds / step) + 3 * stages.count
    return jax.lax.scan(lambda c, _: run.iterate(c), carry, length=passes)
