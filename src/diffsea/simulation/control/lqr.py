"""Linear-quadratic control: Riccati's equation, a vessel's linear model, and a track keeper.

All of it is differentiable and can be batched: the Riccati equation is solved by doubling with a
fixed number of passes, of which each squares the closed loop's decay.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.simulation.control.allocation import (
    ControlAllocation,
    require_steering,
    settled_acceleration,
    throttle_for,
)
from diffsea.simulation.control.autopilot import (
    AbstractController,
    LineOfSight,
    SpeedHold,
    speed_hold,
    within_half_turn,
)
from diffsea.simulation.control.trim import straight_trim
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


Square = Float[Array, "n n"]
Inputs = Float[Array, "n m"]

_DOUBLINGS = 32  # a closed loop that decays by 1e-9 a step has settled by then
_LARGEST_ANGLE = 0.6  # rad, that a track keeper orders: hard over of most ships


def riccati(
    A: Square, B: Inputs, Q: Square, R: Float[Array, "m m"], doublings: int = _DOUBLINGS
) -> Square:
    """The stabilising solution P of the discrete algebraic Riccati equation.

    `P = A' P A - A' P B (R + B' P B)^-1 B' P A + Q`, by the structure-preserving doubling
    algorithm (Chu, Fan, Lin and Wang 2004). Not finite where no input stabilises the system.

    `doublings`: the pass number k looks 2^k steps ahead; fewer will do where the closed loop
    settles within so many, which counts where a gain is found at every step of a run.
    """
    identity = jnp.eye(A.shape[0])

    def double(carry: tuple, _: None) -> tuple[tuple, None]:
        F, G, H = carry
        W = identity + G @ H
        both = jnp.linalg.solve(W, jnp.concatenate([F, G], axis=1))
        WF, WG = both[:, : F.shape[0]], both[:, F.shape[0] :]
        return (F @ WF, G + F @ WG @ F.T, H + F.T @ H @ WF), None

    start = (A, B @ jnp.linalg.solve(R, B.T), Q)
    return jax.lax.scan(double, start, length=doublings)[0][2]


def discrete_lqr(
    A: Square, B: Inputs, Q: Square, R: Float[Array, "m m"], doublings: int = _DOUBLINGS
) -> Float[Array, "m n"]:
    """The gain K of `u = -K x` that minimises the sum of `x' Q x + u' R u` for `x+ = A x + B u`.

    `doublings` as of `riccati`.
    """
    P = riccati(A, B, Q, R, doublings)
    return jnp.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


def discretise(A: Square, B: Inputs, period: Scalar) -> tuple[Square, Inputs]:
    """Transition and input matrix of `x' = A x + B u` with `u` held over `period` s."""
    n, m = B.shape
    block = jnp.zeros((n + m, n + m)).at[:n, :n].set(A).at[:n, n:].set(B)
    exponential = jax.scipy.linalg.expm(block * period)
    return exponential[:n, :n], exponential[:n, n:]


def steering_model(
    vessel: Vessel, speed: Scalar
) -> tuple[Float[Array, "2 2"], Float[Array, "2 1"]]:
    """Sway and yaw about a straight run: d(v, r)/dt against (v, r), and against the rudder angle.

    Arguments:
        speed: m/s.

    Returns:
        State matrix and input column of d(v, r)/dt (m/s^2, rad/s^2) by automatic differentiation;
        actuators answer at once here.
    """
    throttle, straight = throttle_for(vessel, speed), jnp.asarray(speed, float)

    def rates(motion: Float[Array, "2"], angle: Float[Array, "1"]) -> Float[Array, "2"]:
        v, r = motion[0], motion[1]
        return jnp.stack(settled_acceleration(vessel, straight, v, r, throttle, angle[0])[1:])

    at = (jnp.zeros(2), jnp.zeros(1))
    return jax.jacfwd(rates, 0)(*at), jax.jacfwd(rates, 1)(*at)


class TrackKeeper(AbstractController[tuple]):
    """Keeps a vessel on the legs between waypoints by state feedback on the rudder.

    Memory: that of the path and of the speed hold. The state fed back is sway velocity (m/s), yaw
    rate (rad/s), course error (rad) and cross-track error (m): what is off the trim of the leg
    where there is feedforward, else off the leg itself.
    """

    gain: Float[Array, "4"]
    path: LineOfSight
    speed: SpeedHold
    allocation: ControlAllocation
    largest_cross: Scalar  # m, beyond which an error is met no harder
    # Whether it steers for the trim of the leg in the current and wind that its vessel is in.
    feedforward: bool = eqx.field(static=True, default=False)

    def init(self) -> tuple:
        return self.path.init(), self.speed.init()

    def step(
        self, memory: tuple, state: State, t: Scalar, dt: Scalar
    ) -> tuple[tuple, dict[str, Scalar]]:
        path, _ = self.path.step(memory[0], state, dt)
        leg = self.path.leg(path[0], state)
        cross = jnp.clip(leg.cross, -self.largest_cross, self.largest_cross)
        off = within_half_turn(state.psi - leg.course)
        wanted, crab, sway, hold = jnp.zeros(()), 0.0, 0.0, self.speed
        if self.feedforward:
            crab, sway, wanted, throttle, _ = straight_trim(
                self.allocation.vessel, hold.speed, leg.course
            )
            hold = dataclasses.replace(hold, offset=throttle - hold.throttle)
        fed_back = jnp.stack([state.v - sway, state.r, off - crab, cross])
        angle = jnp.clip(wanted - self.gain @ fed_back, -_LARGEST_ANGLE, _LARGEST_ANGLE)
        speed, throttle = hold.step(memory[1], state, dt)
        return (path, speed), self.allocation.orders(throttle, angle)

    def is_finished(self, memory: tuple) -> Bool[Array, ""]:
        return self.path.is_finished(memory[0])


def track_keeper(
    vessel: Vessel,
    speed: Scalar,
    waypoints: Float[Array, "waypoint 2"],
    period: float,
    feedforward: bool = False,
) -> TrackKeeper:
    """A track keeper that suits a vessel at `speed` m/s and steers every `period` s.

    Weights follow Bryson's rule: a cross-track error of half a ship length, a course error of
    10 deg and a rudder angle at the limit of 0.6 rad are equally bad.

    Arguments:
        waypoints: m, north and east; the first leg begins at the first.
        feedforward: meet the current and wind of the vessel's environment by the trim of each leg
            (`straight_trim`), so that feedback is left with what is not known.

    Its gain is not finite where no rudder law steadies the vessel.

    Raises:
        UserError: a vessel that cannot be steered.
    """
    require_steering(vessel, "path under a track keeper")
    length = vessel.rigid_body.length
    A, B = steering_model(vessel, speed)
    whole = jnp.zeros((4, 4)).at[:2, :2].set(A).at[2, 1].set(1.0)
    whole = whole.at[3, 0].set(1.0).at[3, 2].set(speed)
    inputs = jnp.zeros((4, 1)).at[:2].set(B)
    Q = jnp.diag(jnp.array([0.0, 0.0, 1 / jnp.radians(10.0) ** 2, 4 / length**2]))
    gain = discrete_lqr(*discretise(whole, inputs, period), Q, jnp.eye(1) / _LARGEST_ANGLE**2)
    path = LineOfSight(jnp.asarray(waypoints, float), 2 * length, length)
    hold = speed_hold(vessel, jnp.asarray(speed, float))
    return TrackKeeper(gain[0], path, hold, ControlAllocation(vessel), 2 * length, feedforward)
