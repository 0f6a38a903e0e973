"""Autopilots: from a vessel's state to the orders of its actuators.

An autopilot is assembled from guidance (what heading to steer for), a heading law (what rudder
angle to order), a speed law (what throttle to order) and an allocation. Each is a pair of pure
functions: `init()` gives its memory, `step(...)` the next memory and its output. Gains are
non-dimensional, so that they suit a model and a ship: times are in ship lengths run, throttle
errors are relative to the balance of a straight run.

Anything with `init`, `step` and `is_finished` is a controller and runs in `simulation.closed_loop`.
"""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.simulation.control.allocation import (
    ControlAllocation,
    full_throttle,
    require_steering,
    throttle_for,
)
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


Memory = TypeVar("Memory")
Index = Int[Array, ""]
Waypoints = Float[Array, "waypoint 2"]  # m, north and east


class AbstractController(eqx.Module, Generic[Memory]):
    """Orders from the state, at the controller's own period."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """Memory at the start."""

    @abc.abstractmethod
    def step(
        self, memory: Memory, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Memory, dict[str, Scalar]]:
        """Next memory, and the orders by channel that hold until the next step, `dt` s later."""

    @abc.abstractmethod
    def is_finished(self, memory: Memory) -> Bool[Array, ""]:
        """Whether the task is done: the run ends there."""


class _Law(eqx.Module, Generic[Memory]):
    """What remembers something from one step to the next: one number, zero at the start.

    A law that remembers something else says so by its own `init`.
    """

    def init(self) -> Any:
        """Memory at the start."""
        return jnp.zeros(())


# Speed


class AbstractSpeedLaw(_Law[Memory]):
    """What throttle to order."""

    @abc.abstractmethod
    def step(self, memory: Memory, state: State, dt: Scalar) -> tuple[Memory, Scalar]:
        """Next memory, and the throttle to order now."""


class FixedThrottle(AbstractSpeedLaw[Scalar]):
    """No speed controller: one throttle, whatever the speed."""

    throttle: Scalar

    def step(self, memory: Scalar, state: State, dt: Scalar) -> tuple[Scalar, Scalar]:
        return memory, self.throttle


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
    offset: Scalar = 0.0  # throttle, that a current or wind is known to ask for besides

    def step(self, memory: Scalar, state: State, dt: Scalar) -> tuple[Scalar, Scalar]:
        slow = 1.0 - state.u / jnp.maximum(self.speed, 1e-6)
        share = 1.0 + self.gain * slow + self.integral_gain * memory
        wanted = self.throttle * share + self.offset
        throttle = jnp.clip(wanted, -self.largest, self.largest)
        grown = memory + slow * dt / self.time_scale
        return jnp.where(throttle == wanted, grown, memory), throttle


def speed_hold(vessel: Vessel, speed: Scalar) -> SpeedHold:
    """A speed hold that suits a vessel at `speed` m/s; differentiable in both."""
    scale = vessel.rigid_body.length / jnp.maximum(speed, 1e-6)
    return SpeedHold(speed, throttle_for(vessel, speed), scale, largest=full_throttle(vessel))


# Heading


class AbstractHeadingLaw(_Law[Memory]):
    """What rudder angle to order."""

    @abc.abstractmethod
    def step(
        self, memory: Memory, state: State, heading: Scalar, dt: Scalar
    ) -> tuple[Memory, Scalar]:
        """Next memory, and the rudder angle (rad, positive to starboard) towards `heading` rad."""


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

    def step(
        self, memory: Scalar, state: State, heading: Scalar, dt: Scalar
    ) -> tuple[Scalar, Scalar]:
        off = within_half_turn(heading - state.psi)
        damping = self.rate_gain * self.time_scale * state.r
        angle = self.gain * off - damping + self.integral_gain * memory
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


# Guidance


class AbstractGuidance(_Law[Memory]):
    """What heading to steer for. A law that follows waypoints is finished at the last one."""

    @abc.abstractmethod
    def step(self, memory: Memory, state: State, dt: Scalar) -> tuple[Memory, Scalar]:
        """Next memory, and the heading (rad) that is wanted now."""

    def is_finished(self, memory: Memory) -> Bool[Array, ""]:
        """Whether the path's end was reached; never, unless a law says so."""
        return jnp.zeros((), bool)


class ConstantHeading(AbstractGuidance[Scalar]):
    """One heading for ever."""

    heading: Scalar = 0.0  # rad

    def step(self, memory: Scalar, state: State, dt: Scalar) -> tuple[Scalar, Scalar]:
        return memory, self.heading


class Pursuit(AbstractGuidance[Index]):
    """Straight at the next waypoint, wherever the vessel is. Memory: which waypoint is next.

    A waypoint is reached within `radius` m. Which sample reaches it is a step in anything that is
    differentiated; derivatives are those of the run with the samples that it has.
    """

    waypoints: Waypoints
    radius: Scalar  # m

    def init(self) -> Index:
        return jnp.zeros((), int)

    def step(self, memory: Index, state: State, dt: Scalar) -> tuple[Index, Scalar]:
        north, east = offset_to(self.waypoints, memory, state)
        memory = memory + (jnp.hypot(north, east) < self.radius).astype(int)
        return memory, bearing(*offset_to(self.waypoints, memory, state))

    def is_finished(self, memory: Index) -> Bool[Array, ""]:
        return memory >= self.waypoints.shape[0]


class Leg(eqx.Module):
    """Where a vessel is relative to a leg of its path."""

    course: Scalar  # rad, of the leg
    along: Scalar  # m, from its start
    cross: Scalar  # m, to starboard of it
    length: Scalar  # m


class LineOfSight(AbstractGuidance[tuple[Index, Scalar]]):
    """Along the legs between waypoints, the first of which is where the first leg begins.

    Steers for a point `lookahead` m ahead on the leg. With `integral_gain` above zero the
    cross-track error is integrated, so that a current is met by a constant crab angle (Borhaug,
    Pavlov and Pettersen 2008, eq. 9; Fossen 2021, section 12.5). A leg ends within `radius` m of
    its waypoint or abeam of it. Memory: the leg, and the integral (s).
    """

    waypoints: Waypoints
    lookahead: Scalar  # m
    radius: Scalar  # m
    integral_gain: Scalar = 0.0  # m/s, below the speed

    def init(self) -> tuple[Index, Scalar]:
        return jnp.zeros((), int), jnp.zeros(())

    def leg(self, number: Index, state: State) -> Leg:
        """Position relative to a leg; the last one goes on beyond its end."""
        at = jnp.minimum(number, self.waypoints.shape[0] - 2)
        start, end = self.waypoints[at], self.waypoints[at + 1]
        north, east = end[0] - start[0], end[1] - start[1]
        length = jnp.hypot(north, east)
        x, y = state.x - start[0], state.y - start[1]
        along, cross = (x * north + y * east) / length, (y * north - x * east) / length
        return Leg(bearing(north, east), along, cross, length)

    def step(
        self, memory: tuple[Index, Scalar], state: State, dt: Scalar
    ) -> tuple[tuple[Index, Scalar], Scalar]:
        number, integral = memory
        before = self.leg(number, state)
        left = before.length - before.along
        over = (left <= 0) | (jnp.hypot(left, before.cross) < self.radius)
        number = number + (over & (number < self.waypoints.shape[0] - 1)).astype(int)
        leg = self.leg(number, state)
        reach = leg.cross + self.integral_gain * integral
        growth = self.lookahead * leg.cross / (self.lookahead**2 + reach**2)
        integral = jnp.where(over, 0.0, integral + growth * dt)
        return (number, integral), leg.course - jnp.arctan2(reach, self.lookahead)

    def is_finished(self, memory: tuple[Index, Scalar]) -> Bool[Array, ""]:
        return memory[0] >= self.waypoints.shape[0] - 1


def bearing(north: Scalar, east: Scalar) -> Scalar:
    """Bearing (rad, clockwise from north) of a point, with a derivative of zero at no distance."""
    near = (north == 0) & (east == 0)
    return jnp.arctan2(east, jnp.where(near, 1.0, north))


def offset_to(waypoints: Waypoints, number: Index, state: State) -> tuple[Scalar, Scalar]:
    """North and east (m) to a waypoint, to the last one after it."""
    at = jax.lax.stop_gradient(jnp.minimum(number, waypoints.shape[0] - 1))
    return waypoints[at, 0] - state.x, waypoints[at, 1] - state.y


# All together


class Steering(eqx.Module):
    """Guidance, heading law and speed law: throttle and rudder angle for any vessel."""

    guidance: AbstractGuidance
    heading: AbstractHeadingLaw
    speed: AbstractSpeedLaw

    def init(self) -> tuple:
        """Memories of the three."""
        return self.guidance.init(), self.heading.init(), self.speed.init()

    def step(self, memory: tuple, state: State, dt: Scalar) -> tuple[tuple, tuple[Scalar, Scalar]]:
        """Next memory, and the throttle and rudder angle (rad) to order now."""
        guidance, course = self.guidance.step(memory[0], state, dt)
        heading, angle = self.heading.step(memory[1], state, course, dt)
        speed, throttle = self.speed.step(memory[2], state, dt)
        return (guidance, heading, speed), (throttle, angle)


class Autopilot(AbstractController[tuple]):
    """Steers a vessel: throttle and rudder angle, allocated to its channels.

    All orders are zero once the path is finished.
    """

    steering: Steering
    allocation: ControlAllocation

    def init(self) -> tuple:
        return self.steering.init()

    def step(
        self, memory: tuple, state: State, t: Scalar, dt: Scalar
    ) -> tuple[tuple, dict[str, Scalar]]:
        memory, wanted = self.steering.step(memory, state, dt)
        over = self.is_finished(memory)
        throttle, angle = (jnp.where(over, 0.0, value) for value in wanted)
        return memory, self.allocation.orders(throttle, angle)

    def is_finished(self, memory: tuple) -> Bool[Array, ""]:
        return self.steering.guidance.is_finished(memory[0])


def autopilot(
    vessel: Vessel,
    speed: Scalar,
    guidance: AbstractGuidance | None = None,
    heading: AbstractHeadingLaw | None = None,
) -> Autopilot:
    """An autopilot that suits a vessel at `speed` m/s: holds heading zero without guidance.

    Arguments:
        heading: `HeadingHold` with its default gains where none is given.

    Raises:
        UserError: a vessel that cannot be steered.
    """
    require_steering(vessel, "path under an autopilot")
    hold = HeadingHold(vessel.rigid_body.length / jnp.maximum(speed, 1e-6))
    steering = Steering(guidance or ConstantHeading(), heading or hold, speed_hold(vessel, speed))
    return Autopilot(steering, ControlAllocation(vessel))
