"""Laws of speed and heading: what throttle and what rudder angle to order.

Every law is a pair of pure functions: `init()` gives its memory, `step(...)` the next memory
and its output. Gains are non-dimensional, so that they suit a model and a ship: times are in
ship lengths run, throttle errors are relative to the balance of a straight run. A wanted value
is passed at every step, so guidance can change it.
"""

import abc
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.simulation.control.balance import full_throttle, throttle_for
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


Memory = TypeVar("Memory")


class AbstractSpeedLaw(eqx.Module, Generic[Memory]):
    """What throttle to order."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """Memory at the start."""

    @abc.abstractmethod
    def step(
        self, memory: Memory, state: State, share: Scalar, dt: Scalar
    ) -> tuple[Memory, Scalar]:
        """Next memory, and the throttle to order now for `share` times the law's speed."""


class AbstractHeadingLaw(eqx.Module, Generic[Memory]):
    """What rudder angle to order."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """Memory at the start."""

    @abc.abstractmethod
    def step(
        self, memory: Memory, state: State, heading: Scalar, dt: Scalar
    ) -> tuple[Memory, Scalar]:
        """Next memory, and the rudder angle (rad, positive to starboard) towards `heading` rad."""


class FixedThrottle(AbstractSpeedLaw[tuple]):
    """No speed controller: one throttle, whatever the speed."""

    throttle: Scalar

    def init(self) -> tuple:
        return ()

    def step(self, memory: tuple, state: State, share: Scalar, dt: Scalar) -> tuple[tuple, Scalar]:
        return memory, self.throttle * share


class SpeedHold(AbstractSpeedLaw[Scalar]):
    """Holds the speed over ground by a PI law on the throttle, around that of a straight run.

    The integral stops growing while the throttle is at its limit.
    """

    speed: Scalar  # m/s over ground, to hold
    throttle: Scalar  # balance in still water
    time_scale: Scalar  # s, L / U
    gain: Scalar = 4.0
    integral_gain: Scalar = 1.0
    largest: Scalar = jnp.inf  # throttle

    def init(self) -> Scalar:
        return jnp.zeros(())

    def step(
        self, memory: Scalar, state: State, share: Scalar, dt: Scalar
    ) -> tuple[Scalar, Scalar]:
        slow = share - state.u / jnp.maximum(self.speed, 1e-6)
        wanted = self.throttle * (share + self.gain * slow + self.integral_gain * memory)
        throttle = jnp.clip(wanted, -self.largest, self.largest)
        grown = memory + slow * dt / self.time_scale
        return jnp.where(throttle == wanted, grown, memory), throttle


class HeadingHold(AbstractHeadingLaw[Scalar]):
    """Holds a heading by a PID law on the rudder, with the measured yaw rate as its derivative.

    The integral, which finds the angle that a cross wind or a bias asks for, stops growing while
    the rudder is at its limit.
    """

    time_scale: Scalar  # s, L / U
    gain: Scalar = 2.0  # rad of rudder per rad
    rate_gain: Scalar = 3.0
    integral_gain: Scalar = 0.1
    largest_angle: Scalar = 0.6  # rad

    def init(self) -> Scalar:
        return jnp.zeros(())

    def step(
        self, memory: Scalar, state: State, heading: Scalar, dt: Scalar
    ) -> tuple[Scalar, Scalar]:
        off = within_half_turn(heading - state.psi)
        angle = (
            self.gain * off
            - self.rate_gain * self.time_scale * state.r
            + self.integral_gain * memory
        )
        limited = jnp.clip(angle, -self.largest_angle, self.largest_angle)
        return memory + jnp.where(angle == limited, off * dt / self.time_scale, 0.0), limited


class FilteredPD(AbstractHeadingLaw[tuple[Scalar, Scalar, Scalar]]):
    """Holds a heading by a PD law whose derivative is that of the heading error, low-passed.

    For craft without a rate gyro: the error's difference quotient passes a first-order filter
    with the time constant `filter_time` (backward Euler), as digital autopilots do.
    """

    gain: Scalar = 1.0  # rad of rudder per rad
    rate_gain: Scalar = 1.0  # s
    filter_time: Scalar = 0.5  # s
    largest_angle: Scalar = 0.6  # rad

    def init(self) -> tuple[Scalar, Scalar, Scalar]:
        """Error before (rad), filtered derivative (rad/s), and 1 once there is an error before."""
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())

    def step(
        self, memory: tuple[Scalar, Scalar, Scalar], state: State, heading: Scalar, dt: Scalar
    ) -> tuple[tuple[Scalar, Scalar, Scalar], Scalar]:
        before, slope, begun = memory
        off = within_half_turn(heading - state.psi)
        change = begun * within_half_turn(off - before)  # the first error has none before it
        slope = (self.filter_time * slope + change) / (self.filter_time + dt)
        angle = self.gain * off + self.rate_gain * slope
        limited = jnp.clip(angle, -self.largest_angle, self.largest_angle)
        return (off, slope, jnp.ones(())), limited


def within_half_turn(angle: Scalar) -> Scalar:
    """An angle (rad) within half a turn of zero; its derivative is one everywhere."""
    return angle - 2 * jnp.pi * jnp.round(angle / (2 * jnp.pi))


def speed_hold(vessel: Vessel, speed: Scalar) -> SpeedHold:
    """A speed hold that suits a vessel at `speed` m/s; differentiable in both."""
    scale = vessel.rigid_body.length / jnp.maximum(speed, 1e-6)
    return SpeedHold(speed, throttle_for(vessel, speed), scale, largest=full_throttle(vessel))


def heading_hold(vessel: Vessel, speed: Scalar) -> HeadingHold:
    """A heading hold that suits a vessel at `speed` m/s."""
    return HeadingHold(vessel.rigid_body.length / jnp.maximum(speed, 1e-6))
