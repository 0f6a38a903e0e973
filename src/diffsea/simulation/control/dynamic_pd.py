"""Waypoints with two thrusters: a PD law whose gains and base order follow distance and error.

After Yoon and Kim, Identifying Kinetic Model Parameters and Implementing 3-DOF Control for a
Dual-Thruster USV, eq. 18 and Algorithm 1: straight at the next waypoint, slow near it, turned
by a difference of the two orders.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from diffsea.errors import UserError
from diffsea.kinematics import wrap
from diffsea.simulation.control.autopilot import AbstractController
from diffsea.simulation.control.guidance import Waypoints, bearing, offset_to
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


_WIDE_TURN = math.radians(10)  # a larger error keeps half of the base order, Algorithm 1
_SMOOTH_MARGIN = 0.1  # of a threshold: where decisions are smooth, they are made within it


class Pursued(eqx.Module):
    """What the law remembers."""

    number: Int[Array, ""]  # of the next waypoint
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
    unit (N, or rev/s with a thrust curve) and within +-`largest`.

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

    waypoints: Waypoints  # m, north and east
    K_p: Scalar  # order per rad
    K_d: Scalar  # order s per rad
    T_f: Scalar  # s
    base_min: Scalar
    base_max: Scalar
    near: Scalar  # m
    far: Scalar  # m
    radius: Scalar  # m
    largest: Scalar = jnp.inf
    port: str = eqx.field(static=True, default="port")  # channels
    starboard: str = eqx.field(static=True, default="starboard")
    smoothing: float = eqx.field(static=True, default=0.0)  # s

    def init(self) -> Pursued:
        zero = jnp.zeros(())
        return Pursued(jnp.zeros((), int), zero, zero, zero, jnp.zeros((), bool))

    def step(
        self, memory: Pursued, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Pursued, dict[str, Scalar]]:
        number, moved = self._progress(memory, state, dt)
        north, east = self._target(number, moved, state)
        error = wrap(state.psi - bearing(north, east))
        # The small constant keeps the root differentiable at the waypoint itself.
        distance = jnp.sqrt(north**2 + east**2 + 1e-12)
        change = jnp.where(memory.begun, wrap(error - memory.error), 0.0)
        gain = self.K_d * jnp.log1p(jnp.rad2deg(jnp.abs(error)))
        derivative = (self.T_f * memory.derivative + gain * change) / (self.T_f + dt)
        difference = self.K_p * jnp.log1p(distance) * error + derivative
        base = self.base(distance, error)
        orders: dict[str, Scalar] = {
            self.port: base - difference,
            self.starboard: base + difference,
        }
        over = number >= self.waypoints.shape[0]
        orders = {
            channel: jnp.where(over, 0.0, jnp.clip(order, -self.largest, self.largest))
            for channel, order in orders.items()
        }
        return Pursued(number, moved, derivative, error, jnp.ones((), bool)), orders

    def is_finished(self, memory: Pursued) -> Bool[Array, ""]:
        return memory.number >= self.waypoints.shape[0]

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

    def _progress(self, memory: Pursued, state: State, dt: Scalar) -> tuple[Int[Array, ""], Scalar]:
        """Which waypoint is next, and how far on the way to the one after it the target is."""
        north, east = offset_to(self.waypoints, memory.number, state)
        distance = jnp.sqrt(north**2 + east**2 + 1e-12)
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

    def _target(self, number: Int[Array, ""], moved: Scalar, state: State) -> tuple[Scalar, Scalar]:
        """North and east (m) of the target relative to the vessel."""
        here, after = (offset_to(self.waypoints, n, state) for n in (number, number + 1))
        share = moved**2 * (3 - 2 * moved)
        return here[0] + share * (after[0] - here[0]), here[1] + share * (after[1] - here[1])


def dynamic_pd(
    vessel: Vessel,
    waypoints: Waypoints,
    *,
    K_p: Scalar,
    K_d: Scalar,
    T_f: Scalar,
    base_min: Scalar,
    base_max: Scalar,
    near: Scalar,
    far: Scalar,
    radius: Scalar,
    largest: Scalar = jnp.inf,
    smoothing: float = 0.0,
) -> DynamicPD:
    """The law of `DynamicPD` for the pair of fixed thrusters of a vessel.

    Raises `UserError` for a vessel without exactly one such thruster on each side.
    """
    sides: dict[bool, list[str]] = {False: [], True: []}
    for part in vessel.actuators.values():
        if part.differential and float(part.y) != 0:
            sides[float(part.y) > 0] += list(part.servos)
    if any(len(channels) != 1 for channels in sides.values()):
        raise UserError(
            f"{vessel.name!r} has {len(sides[False])} fixed thrusters to port and "
            f"{len(sides[True])} to starboard; the PD law for pairs needs one on each side"
        )
    gains = (K_p, K_d, T_f, base_min, base_max, near, far, radius, largest)
    (port,), (starboard,) = sides[False], sides[True]
    return DynamicPD(jnp.asarray(waypoints, float), *gains, port, starboard, smoothing)
