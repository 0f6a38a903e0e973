"""Guidance: what heading and what speed to steer for.

Memory of a guidance law is whatever it must remember of its path; `step` gives the next memory
and what is wanted now. A law that follows waypoints is finished at the last one.
"""

import abc
from typing import Generic

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.simulation.control.laws import Memory
from diffsea.types import Scalar, State


# m, north and east
Waypoints = Float[Array, "waypoint 2"]


class Wanted(eqx.Module):
    """What guidance asks for."""

    heading: Scalar  # rad
    share: Scalar = 1.0  # of the speed law's speed


class Leg(eqx.Module):
    """Where a vessel is relative to a leg of its path."""

    course: Scalar  # rad, of the leg
    along: Scalar  # m, from its start
    cross: Scalar  # m, to starboard of it
    length: Scalar  # m


class AbstractGuidance(eqx.Module, Generic[Memory]):
    """What to steer for."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """Memory at the start."""

    @abc.abstractmethod
    def step(self, memory: Memory, state: State, dt: Scalar) -> tuple[Memory, Wanted]:
        """Next memory, and what is wanted now."""

    @abc.abstractmethod
    def is_finished(self, memory: Memory) -> Bool[Array, ""]:
        """Whether the path's end was reached."""


class Course(AbstractGuidance[tuple]):
    """One heading for ever."""

    heading: Scalar = 0.0  # rad

    def init(self) -> tuple:
        return ()

    def step(self, memory: tuple, state: State, dt: Scalar) -> tuple[tuple, Wanted]:
        return memory, Wanted(self.heading)

    def is_finished(self, memory: tuple) -> Bool[Array, ""]:
        return jnp.zeros((), bool)


class Pursuit(AbstractGuidance[Int[Array, ""]]):
    """Straight at the next waypoint, wherever the vessel is. Memory: which waypoint is next.

    A waypoint is reached within `radius` m. Which sample reaches it is a step in anything that is
    differentiated; derivatives are those of the run with the samples that it has.
    """

    waypoints: Waypoints
    radius: Scalar  # m

    def init(self) -> Int[Array, ""]:
        return jnp.zeros((), int)

    def step(
        self, memory: Int[Array, ""], state: State, dt: Scalar
    ) -> tuple[Int[Array, ""], Wanted]:
        north, east = offset_to(self.waypoints, memory, state)
        memory = memory + (jnp.hypot(north, east) < self.radius)
        north, east = offset_to(self.waypoints, memory, state)
        return memory, Wanted(bearing(north, east))

    def is_finished(self, memory: Int[Array, ""]) -> Bool[Array, ""]:
        return memory >= self.waypoints.shape[0]


class LineOfSight(AbstractGuidance[tuple[Int[Array, ""], Scalar]]):
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

    def init(self) -> tuple[Int[Array, ""], Scalar]:
        return jnp.zeros((), int), jnp.zeros(())

    def leg(self, number: Int[Array, ""], state: State) -> Leg:
        """Position relative to a leg; the last one goes on beyond its end."""
        at = jnp.minimum(number, self.waypoints.shape[0] - 2)
        start, end = self.waypoints[at], self.waypoints[at + 1]
        north, east = end[0] - start[0], end[1] - start[1]
        length = jnp.hypot(north, east)
        x, y = state.x - start[0], state.y - start[1]
        along, cross = (x * north + y * east) / length, (y * north - x * east) / length
        return Leg(bearing(north, east), along, cross, length)

    def step(
        self, memory: tuple[Int[Array, ""], Scalar], state: State, dt: Scalar
    ) -> tuple[tuple[Int[Array, ""], Scalar], Wanted]:
        number, integral = memory
        before = self.leg(number, state)
        left = before.length - before.along
        over = (left <= 0) | (jnp.hypot(left, before.cross) < self.radius)
        number = number + (over & (number < self.waypoints.shape[0] - 1))
        leg = self.leg(number, state)
        reach = leg.cross + self.integral_gain * integral
        growth = self.lookahead * leg.cross / (self.lookahead**2 + reach**2)
        integral = jnp.where(over, 0.0, integral + growth * dt)
        return (number, integral), Wanted(leg.course - jnp.arctan2(reach, self.lookahead))

    def is_finished(self, memory: tuple[Int[Array, ""], Scalar]) -> Bool[Array, ""]:
        return memory[0] >= self.waypoints.shape[0] - 1


def bearing(north: Scalar, east: Scalar) -> Scalar:
    """Bearing (rad, clockwise from north) of a point, with a derivative of zero at no distance."""
    near = (north == 0) & (east == 0)
    return jnp.arctan2(east, jnp.where(near, 1.0, north))


def offset_to(waypoints: Waypoints, number: Int[Array, ""], state: State) -> tuple[Scalar, Scalar]:
    """North and east (m) to a waypoint, to the last one after it."""
    at = jax.lax.stop_gradient(jnp.minimum(number, waypoints.shape[0] - 1))
    return waypoints[at, 0] - state.x, waypoints[at, 1] - state.y
