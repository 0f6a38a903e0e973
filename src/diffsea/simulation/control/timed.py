"""Timed steps: courses, speeds and orders that hold from their time until the next."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.simulation.control.autopilot import (
    AbstractController,
    AbstractGuidance,
    AbstractSpeedLaw,
    Index,
    SpeedHold,
)
from diffsea.types import Scalar, State


Steps = Float[Array, "step"]


def in_force(times: Steps, t: Scalar) -> Index:
    """Number of the step that holds at `t` s: the last one begun, the first before all."""
    # What has taken whole periods to reach a time has reached it, whatever rounding did to the sum.
    return jnp.maximum(jnp.sum(times <= t + 1e-9 * (1 + jnp.abs(t))) - 1, 0)


class TimedHeading(AbstractGuidance[Scalar]):
    """Headings by time. Memory: time since the start, s."""

    times: Steps  # s, ascending
    headings: Steps  # rad

    def step(self, memory: Scalar, state: State, dt: Scalar) -> tuple[Scalar, Scalar]:
        return memory + dt, self.headings[in_force(self.times, memory)]


class TimedSpeed(AbstractSpeedLaw[tuple[Scalar, Scalar]]):
    """Speeds by time, each held by a PI law. Memory: time since the start, and the integral (s)."""

    times: Steps  # s, ascending
    speeds: Steps  # m/s over ground
    throttles: Steps  # balance in still water at each speed
    length: Scalar  # L, m
    gain: Scalar = 4.0
    integral_gain: Scalar = 1.0
    largest: Scalar = jnp.inf  # throttle

    def init(self) -> tuple[Scalar, Scalar]:
        return jnp.zeros(()), jnp.zeros(())

    def step(
        self, memory: tuple[Scalar, Scalar], state: State, dt: Scalar
    ) -> tuple[tuple[Scalar, Scalar], Scalar]:
        t, integral = memory
        number = in_force(self.times, t)
        speed = self.speeds[number]
        scale = self.length / jnp.maximum(speed, 1e-6)
        gains = self.gain, self.integral_gain, self.largest
        integral, throttle = SpeedHold(speed, self.throttles[number], scale, *gains).step(
            integral, state, dt
        )
        return (t + dt, integral), throttle


class TimedOrders(AbstractController[tuple]):
    """Orders by time, open loop."""

    times: Steps  # s, ascending
    orders: dict[str, Steps]  # by channel, in its unit

    def init(self) -> tuple:
        return ()

    def step(
        self, memory: tuple, state: State, t: Scalar, dt: Scalar
    ) -> tuple[tuple, dict[str, Scalar]]:
        number = in_force(self.times, t)
        return memory, {channel: steps[number] for channel, steps in self.orders.items()}

    def is_finished(self, memory: tuple) -> Bool[Array, ""]:
        return jnp.zeros((), bool)
