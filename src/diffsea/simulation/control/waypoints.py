"""Published controllers that steer from one waypoint straight to the next.

`DynamicPD` is for a pair of fixed thrusters: a PD law whose gains and base order follow distance
and error, after Yoon and Kim, Identifying Kinetic Model Parameters and Implementing 3-DOF Control
for a Dual-Thruster USV, eq. 18 and Algorithm 1. `WaypointLogic` is for a vectored thruster, full
thrust ahead and less in wide turns, after Huang and Ji, Autonomous boat dynamics: How far away is
simulation from the high sea?, section II.B and appendix B, with its constants as fields.
"""

import math
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool

from diffsea.errors import UserError
from diffsea.kinematics import wrap
from diffsea.simulation.control.allocation import ControlAllocation
from diffsea.simulation.control.autopilot import (
    AbstractController,
    Index,
    Pursuit,
    Waypoints,
    bearing,
    offset_to,
    within_half_turn,
)
from diffsea.types import Scalar, State
from diffsea.vessel.actuators import AzimuthThruster, FixedThruster
from diffsea.vessel.base import Vessel


_WIDE_TURN = math.radians(10)  # a larger error keeps half of the base order, Algorithm 1
_SMOOTH_MARGIN = 0.1  # of a threshold: where decisions are smooth, they are made within it


def _distance(north: Scalar, east: Scalar) -> Scalar:
    """Distance (m); the small constant keeps the root differentiable at the waypoint itself."""
    return jnp.sqrt(north**2 + east**2 + 1e-12)


# A pair of thrusters


class Pursued(eqx.Module):
    """What `DynamicPD` remembers."""

    number: Index  # of the next waypoint
    moved: Scalar  # share of the way that the target has moved on to the one after
    derivative: Scalar  # filtered
    error: Scalar  # rad, of heading, a step before
    begun: Bool[Array, ""]


class DynamicPD(AbstractController[Pursued]):
    """Steers a pair of thrusters straight at one waypoint after the other.

    With the heading error `e = psi - psi_d` (rad, in [-pi, pi)), the distance `s` (m), and the
    period `T` (s):

        df = T_f / (T_f + T) df_before + K_d log(1 + |e| in deg) / (T_f + T) (e - e_before)
        dn = K_p log(1 + s) e + df,    port = base - dn,    starboard = base + dn

    `base` goes linearly from `base_min` at `near` m to `base_max` at `far` m; nearer than that
    it is `base_min`, or half-way where |e| is above 10 deg. Orders are in the thrusters' own
    unit, counted ahead from neutral, and within +-`largest`.

    Two logarithms differ from the published eq. 18. `log(psi_e)` has no value for errors to
    port and is negative below one unit, so that the derivative would destabilise: it is taken
    of one plus the error's size, in deg as in Algorithm 1. `log(dist)` changes sign at one
    metre: it is taken of one plus the distance. The error of Algorithm 1 is taken by its size,
    and `arctan` of the bearing in four quadrants.

    A waypoint counts as reached within `radius` m. That decision and those of Algorithm 1 are
    steps, without a derivative. With `smoothing` (s) above zero the steps are smooth and the
    target moves over to the next waypoint in some four times as long: gains can then be tuned
    by gradient.
    """

    waypoints: Waypoints
    K_p: Scalar  # order per rad
    K_d: Scalar  # order s per rad
    T_f: Scalar  # s
    base_min: Scalar
    base_max: Scalar
    near: Scalar  # m
    far: Scalar  # m
    radius: Scalar  # m
    largest: Scalar = jnp.inf
    neutral: tuple[Scalar, Scalar] = (0.0, 0.0)  # of port and starboard
    reversed: tuple[bool, bool] = eqx.field(static=True, default=(False, False))
    port: str = eqx.field(static=True, default="port")  # channels
    starboard: str = eqx.field(static=True, default="starboard")
    smoothing: float = eqx.field(static=True, default=0.0)  # s

    def init(self) -> Pursued:
        zero = jnp.zeros(())
        return Pursued(jnp.zeros((), int), zero, zero, zero, jnp.zeros((), bool))

    def step(
        self, memory: Pursued, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Pursued, dict[str, Scalar]]:
        number, moved = self._move_target(memory, state, dt)
        here, after = (offset_to(self.waypoints, n, state) for n in (number, number + 1))
        share = moved**2 * (3 - 2 * moved)
        north, east = (a + share * (b - a) for a, b in zip(here, after, strict=True))
        error = wrap(state.psi - bearing(north, east))
        distance = _distance(north, east)
        change = jnp.where(memory.begun, wrap(error - memory.error), 0.0)
        damping = self.rate_gain(error) * change
        derivative = (self.T_f * memory.derivative + damping) / (self.T_f + dt)
        difference = self.heading_gain(distance) * error + derivative
        base = self.base(distance, error)
        over = number >= self.waypoints.shape[0]

        def order(ahead: Scalar, side: int) -> Scalar:
            limited = jnp.where(over, 0.0, jnp.clip(ahead, -self.largest, self.largest))
            return self.neutral[side] + (-limited if self.reversed[side] else limited)

        orders = {
            self.port: order(base - difference, 0),
            self.starboard: order(base + difference, 1),
        }
        return Pursued(number, moved, derivative, error, jnp.ones((), bool)), orders

    def is_finished(self, memory: Pursued) -> Bool[Array, ""]:
        return memory.number >= self.waypoints.shape[0]

    def heading_gain(self, distance: Scalar) -> Scalar:
        """Order per rad of heading error at a distance (m) from the waypoint."""
        return self.K_p * jnp.log1p(distance)

    def rate_gain(self, error: Scalar) -> Scalar:
        """Order s per rad of change of the heading error, at an error (rad)."""
        return self.K_d * jnp.log1p(jnp.rad2deg(jnp.abs(error)))

    def base(self, distance: Scalar, error: Scalar) -> Scalar:
        """Base order of Algorithm 1 at a distance (m) and a heading error (rad)."""
        share = jnp.clip((distance - self.near) / (self.far - self.near), 0.0, 1.0)
        turning = self._whether(jnp.abs(error) - _WIDE_TURN, _WIDE_TURN)
        turning = turning * self._whether(self.near - distance, self.near)
        return self.base_min + (self.base_max - self.base_min) * (share + 0.5 * turning)

    def progress(self, memory: Pursued) -> Scalar:
        """Share of the waypoints reached, 0 to 1; smooth where decisions are."""
        return (memory.number.astype(float) + memory.moved) / self.waypoints.shape[0]

    def _whether(self, excess: Scalar, scale: Scalar) -> Scalar:
        """One where `excess` is not negative, else zero; where it is smooth, within the margin."""
        if self.smoothing == 0:
            return jnp.where(excess >= 0, 1.0, 0.0)
        return jax.nn.sigmoid(excess / (_SMOOTH_MARGIN * scale))

    def _move_target(self, memory: Pursued, state: State, dt: Scalar) -> tuple[Index, Scalar]:
        """Which waypoint is next, and how far on the way to the one after it the target is."""
        distance = _distance(*offset_to(self.waypoints, memory.number, state))
        if self.smoothing == 0:
            reached = distance < self.radius
            return jnp.where(reached, memory.number + 1, memory.number), memory.moved
        # Once it has begun to move it goes all the way, though the waypoint may fall behind; it
        # arrives slowly, so that the sample in which it does makes no difference.
        moved = memory.moved
        pace = self._whether(self.radius - distance, self.radius) + 4 * moved**2 * (1.05 - moved)
        moved = moved + pace * dt / self.smoothing
        over = moved >= 1
        number = jnp.where(over, memory.number + 1, memory.number)
        return number, jnp.where(over, 0.0, moved)


def dynamic_pd(
    vessel: Vessel, waypoints: ArrayLike, smoothing: float = 0.0, **gains: Scalar
) -> DynamicPD:
    """The law of `DynamicPD` for the pair of fixed thrusters of a vessel.

    Arguments:
        waypoints: m, north and east, one row each.
        smoothing: s, within which the target moves on; zero for steps.
        gains: `K_p`, `K_d`, `T_f`, `base_min`, `base_max`, `near`, `far` and `radius`, and
            `largest` where orders have a limit, as the fields of `DynamicPD`.

    Raises:
        UserError: a vessel without exactly one such thruster on each side.
    """
    aside = [
        part
        for part in vessel.actuators.values()
        if isinstance(part, FixedThruster) and part.differential and float(part.y) != 0
    ]
    sides = [part for part in aside if part.y < 0], [part for part in aside if part.y > 0]
    if any(len(side) != 1 for side in sides):
        raise UserError(
            f"{vessel.name!r} has {len(sides[0])} fixed thrusters to port and "
            f"{len(sides[1])} to starboard; the PD law for pairs needs one on each side"
        )
    (port,), (starboard,) = sides
    middles = [part.servos[part.force_channel].neutral for part in (port, starboard)]
    left, right = (0.0 if middle is None else middle for middle in middles)
    return DynamicPD(
        jnp.asarray(waypoints, float),
        port=port.force_channel,
        starboard=starboard.force_channel,
        neutral=(left, right),
        reversed=(port.drive.reversed, starboard.drive.reversed),
        smoothing=smoothing,
        **gains,
    )


# A vectored thruster


class Allocation(Protocol):
    """Turns a thrust (N) and an angle (rad, positive to starboard) into orders by channel."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders of all the vessel's channels. `ControlAllocation` is one."""
        ...


class WaypointLogic(AbstractController[Index]):
    """Heads straight for the next waypoint. Memory: which waypoint is next.

    With the heading error e, in a small turn (|e| < `wide`) thrust is full and the angle is
    `full_angle e / wide`. In a wide turn the angle is full and the thrust `wide_share` of full,
    or `near_share d / near` of it where the waypoint is nearer than `near`. At the last waypoint
    thrust and angle are zero and the run ends.

    Thrust jumps between these cases, and a jump that moves from one sample to the next has no
    derivative. With a `sharpness` the cases blend within about `1 / sharpness` of their limits
    (in parts of `wide` and `near`): then the closed loop is differentiable throughout, but for the
    sample that reaches a waypoint and for a heading exactly away from it.
    """

    pursuit: Pursuit
    allocation: Allocation
    full_thrust: Scalar  # N
    full_angle: Scalar  # rad
    wide: Scalar = 0.5 * jnp.pi  # rad, heading error from which on a turn is a wide one
    wide_share: Scalar = 1 / 2  # of full thrust
    near: Scalar = 10.0  # m
    near_share: Scalar = 1 / 3
    sharpness: Scalar | None = None

    def init(self) -> Index:
        return self.pursuit.init()

    def step(
        self, memory: Index, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Index, dict[str, Scalar]]:
        memory, heading = self.pursuit.step(memory, state, dt)
        distance = _distance(*offset_to(self.pursuit.waypoints, memory, state))
        wanted = self.demand(within_half_turn(heading - state.psi), distance)
        over = self.is_finished(memory)
        thrust, angle = (jnp.where(over, 0.0, value) for value in wanted)
        return memory, self.allocation.orders(thrust, angle)

    def demand(self, error: Scalar, distance: Scalar) -> tuple[Scalar, Scalar]:
        """Thrust (N) and angle (rad, positive to starboard) at a heading error and a distance."""
        wide = self._beyond(jnp.abs(error) / self.wide)
        far = self._beyond(distance / self.near)
        near_share = self.near_share * distance / self.near
        reduced = far * self.wide_share + (1 - far) * near_share
        angle = self.full_angle * jnp.clip(error / self.wide, -1.0, 1.0)
        return self.full_thrust * (1 + wide * (reduced - 1)), angle

    def _beyond(self, ratio: Scalar) -> Scalar:
        """One where a ratio is above one, else zero; a blend of both with a sharpness."""
        if self.sharpness is None:
            return jnp.where(ratio >= 1, 1.0, 0.0)
        return jax.nn.sigmoid(self.sharpness * (ratio - 1))

    def is_finished(self, memory: Index) -> Bool[Array, ""]:
        return self.pursuit.is_finished(memory)


def waypoint_logic(
    vessel: Vessel, waypoints: ArrayLike, tolerance: Scalar = 2.5, **fields: Scalar
) -> WaypointLogic:
    """The logic for a vessel with one azimuth thruster, whose limits are full thrust and angle.

    For other vessels make a `WaypointLogic` with an allocation of your own.

    Arguments:
        waypoints: m, north and east, one row each.
        tolerance: m; a waypoint is reached within it.
        fields: any other field of `WaypointLogic`.

    Raises:
        UserError: a vessel without exactly one azimuth thruster, or one without limits.
    """
    parts = [p for p in vessel.actuators.values() if isinstance(p, AzimuthThruster)]
    if len(parts) != 1:
        raise UserError(
            f"{vessel.name!r} has {len(parts)} azimuth thrusters; the waypoint logic is for one"
        )
    (part,) = parts
    thrust = part.full_throttle
    angle = vessel.servos[part.angle_channel].upper
    if thrust is None or angle is None:
        raise UserError(
            f"the azimuth thruster of {vessel.name!r} needs max_force and max_angle: "
            "they are the logic's full thrust and angle"
        )
    points = jnp.atleast_2d(jnp.asarray(waypoints, float))
    limits = {"full_thrust": thrust, "full_angle": angle} | fields
    return WaypointLogic(Pursuit(points, tolerance), ControlAllocation(vessel), **limits)
