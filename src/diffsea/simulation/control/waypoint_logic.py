"""Waypoints by a rule of thumb for a vectored thruster: full thrust ahead, less in wide turns.

After Huang and Ji (Autonomous boat dynamics: How far away is simulation from the high sea?,
section II.B and appendix B), with its constants as fields.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from diffsea.errors import UserError
from diffsea.simulation.control.allocation import ControlAllocation
from diffsea.simulation.control.autopilot import AbstractController
from diffsea.simulation.control.guidance import Pursuit, Waypoints, offset_to
from diffsea.simulation.control.laws import within_half_turn
from diffsea.types import Scalar, State
from diffsea.vessel.actuators import AzimuthThruster
from diffsea.vessel.base import Vessel


class Allocation(Protocol):
    """Turns a thrust (N) and an angle (rad, positive to starboard) into orders by channel."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders of all the vessel's channels. `ControlAllocation` is one."""
        ...


class WaypointLogic(AbstractController[Int[Array, ""]]):
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

    def init(self) -> Int[Array, ""]:
        return self.pursuit.init()

    def step(
        self, memory: Int[Array, ""], state: State, t: Scalar, dt: Scalar
    ) -> tuple[Int[Array, ""], dict[str, Scalar]]:
        memory, wanted = self.pursuit.step(memory, state, dt)
        error = within_half_turn(wanted.heading - state.psi)
        thrust, angle = self.demand(error, self._distance(memory, state))
        over = self.is_finished(memory)
        thrust, angle = (jnp.where(over, 0.0, value) for value in (thrust, angle))
        return memory, self.allocation.orders(thrust, angle)

    def demand(self, error: Scalar, distance: Scalar) -> tuple[Scalar, Scalar]:
        """Thrust (N) and angle (rad, positive to starboard) at a heading error and a distance."""
        turn = jnp.abs(error) / self.wide
        wide = self._beyond(turn)
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

    def _distance(self, memory: Int[Array, ""], state: State) -> Scalar:
        north, east = offset_to(self.pursuit.waypoints, memory, state)
        # The small constant keeps the root differentiable at the waypoint.
        return jnp.sqrt(north**2 + east**2 + 1e-12)

    def is_finished(self, memory: Int[Array, ""]) -> Bool[Array, ""]:
        return self.pursuit.is_finished(memory)


def waypoint_logic(
    vessel: Vessel, waypoints: Waypoints, tolerance: Scalar = 2.5, **fields: Scalar
) -> WaypointLogic:
    """The logic for a vessel with one azimuth thruster, whose limits are full thrust and angle.

    **Arguments:**

    - `waypoints`: m, north and east, one row each.
    - `tolerance`: m; a waypoint is reached within it.
    - `fields`: any other field of `WaypointLogic`.

    Raises `UserError` for a vessel without exactly one azimuth thruster, or one without limits.
    For other vessels make a `WaypointLogic` with an allocation of your own.
    """
    parts = [p for p in vessel.actuators.values() if isinstance(p, AzimuthThruster)]
    if len(parts) != 1:
        raise UserError(
            f"{vessel.name!r} has {len(parts)} azimuth thrusters; the waypoint logic is for one"
        )
    (part,) = parts
    thrust = vessel.servos[part.force_channel].upper
    angle = vessel.servos[part.angle_channel].upper
    if thrust is None or angle is None:
        raise UserError(
            f"the azimuth thruster of {vessel.name!r} needs max_force and max_angle: "
            "they are the logic's full thrust and angle"
        )
    points = jnp.atleast_2d(jnp.asarray(waypoints, float))
    limits = {"full_thrust": thrust, "full_angle": angle} | fields
    return WaypointLogic(Pursuit(points, tolerance), ControlAllocation(vessel), **limits)
