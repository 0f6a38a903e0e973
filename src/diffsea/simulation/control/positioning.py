"""Dynamic positioning: a vessel is brought to poses and held there with every actuator she has.

Linear-quadratic state feedback on surge, sway and yaw at once, with integrals of position and
heading against a steady push (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion
Control, chapter 16 on linear-quadratic control and positioning), with gains scheduled by the speed
ahead.
"""

import math
from types import MappingProxyType

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float

from diffsea.errors import UserError
from diffsea.kinematics import to_body, wrap
from diffsea.scales import time_scale
from diffsea.simulation.control.autopilot import AbstractController
from diffsea.simulation.control.effectors import (
    AbstractEffector,
    Limits,
    Motion,
    effectors_of,
    orders_at_rest,
)
from diffsea.simulation.control.positioning_gains import (
    PositioningGains,
    Weights,
    inputs,
    positioning_gains,
)
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


Poses = Float[Array, "pose 3"]  # north (m), east (m), heading (rad, without jumps)

# Off the pose by so much is as bad as all of an actuator's effect.
POSITION = 0.25  # ship lengths
HEADING = math.radians(10.0)  # rad
INTEGRAL_TIME = 25.0  # sqrt(L / g), for which the same error is as bad again
_FARTHEST = 1.0  # ship lengths: a pose farther off is met no harder
_SPEEDS = 17  # ahead and astern, that gains are found for
_FASTEST = 0.1  # sqrt(g L), in addition to the poses' own speed, between which these lie
_LEAST = 1e-3  # of the largest effect on any axis: less does not hold a vessel there


class Positioned(eqx.Module):
    """What `DynamicPositioning` remembers."""

    integral: Float[Array, "3"]  # of the errors, m s north and east, and rad s
    executed: Float[Array, "share"]  # of the effectors, as the model has them executed
    angles: dict[str, Scalar]  # rad, last ordered, of what turns all the way round


class DynamicPositioning(AbstractController[Positioned]):
    """Follows poses by time, from one to the next without a jump of speed, and stays at the last.

    The reference runs from pose to pose as `3 s^2 - 2 s^3` of the time between them. Fed back
    are the errors of surge, sway and yaw rate, of position in the vessel's axes (m) and of heading
    (rad), the integrals of the last three, and what the actuators are still on their way to by
    their lags and delays. The drag that the model has at the reference's speed, in the current and
    wind of the model's environment, is met beforehand.
    """

    vessel: Vessel  # that is believed in
    times: Float[Array, "pose"]  # s, ascending
    poses: Poses
    effectors: tuple[AbstractEffector, ...]
    lags: Float[Array, "share"]  # s, how late each share acts
    gains: PositioningGains

    def init(self) -> Positioned:
        angles: dict[str, Scalar] = {}
        for effector in self.effectors:
            angles |= effector.first_angles
        return Positioned(jnp.zeros(3), jnp.zeros(len(self.lags)), angles)

    def step(
        self, memory: Positioned, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Positioned, dict[str, Scalar]]:
        pose, velocity = reference(self.times, self.poses, t)
        error = jnp.stack([state.x - pose[0], state.y - pose[1], wrap(state.psi - pose[2])])
        farthest = _FARTHEST * self.vessel.rigid_body.length
        size = jnp.sqrt(error[0] ** 2 + error[1] ** 2 + 1e-12)
        near = jnp.minimum(1.0, farthest / size)
        error = error * jnp.stack([near, near, jnp.ones(())])
        # In the pose's axes: that the vessel heads elsewhere is the heading error's.
        wanted = jnp.stack([*to_body(velocity[0], velocity[1], pose[2]), velocity[2]])
        motion = jnp.stack([state.u, state.v, state.r])
        gain, allocation = self.gains.at(state.u)
        in_axes = [
            jnp.stack([*to_body(one[0], one[1], state.psi), one[2]])
            for one in (error, memory.integral)
        ]
        steady = -allocation @ self.push(wanted, state)
        off = jnp.concatenate([motion - wanted, *in_axes, memory.executed - steady])
        asked = self.split(steady - gain @ off)
        orders: dict[str, Scalar] = {}
        for effector, shares in zip(self.effectors, asked, strict=True):
            orders |= effector.orders(shares, memory.angles)
        borne = [one.possible(shares) for one, shares in zip(self.effectors, asked, strict=True)]
        # A push that the actuators cannot bear, or a pose far off, is not summed up.
        possible = jnp.concatenate(borne)
        sums = (near == 1.0) & jnp.all(possible == jnp.concatenate(asked))
        integral = memory.integral + jnp.where(sums, dt * error, 0.0)
        way = 1 - jnp.exp(-dt / self.lags)
        executed = memory.executed + way * (possible - memory.executed)
        return Positioned(integral, executed, {c: orders[c] for c in memory.angles}), orders

    def is_finished(self, memory: Positioned) -> Bool[Array, ""]:
        return jnp.zeros((), bool)

    def split(self, shares: Float[Array, "share"]) -> list[Float[Array, "_"]]:
        """The shares of each effector."""
        counts = [effector.count for effector in self.effectors]
        return jnp.split(shares, np.cumsum(counts)[:-1])

    def push(self, wanted: Motion, state: State) -> Motion:
        """What the model's drag and weather come to at the wanted motion (m/s^2, rad/s^2)."""
        rest = orders_at_rest(self.vessel)
        rest = {c: servo.target(rest[c]) for c, servo in self.vessel.servos.items()}
        at = State(state.x, state.y, state.psi, *wanted)
        return jnp.stack(self.vessel.acceleration(at, rest, self.vessel.environment, jnp.zeros(())))


def reference(
    times: Float[Array, "pose"], poses: Poses, t: Scalar
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Pose and its rate of change (m/s, m/s, rad/s, north and east) at a time (s)."""
    if len(times) == 1:
        return poses[0], jnp.zeros(3)
    number = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    begin, duration = times[number], times[number + 1] - times[number]
    share = jnp.clip((t - begin) / duration, 0.0, 1.0)
    change = poses[number + 1] - poses[number]
    return (
        poses[number] + (3 - 2 * share) * share**2 * change,
        6 * share * (1 - share) / duration * change,
    )


def continuous_poses(poses: Poses) -> Poses:
    """The same with headings that go the short way from each pose to the next."""
    turns = jnp.concatenate([poses[:1, 2], wrap(jnp.diff(poses[:, 2]))])
    return poses.at[:, 2].set(jnp.cumsum(turns))


def dynamic_positioning(
    vessel: Vessel,
    times: ArrayLike,
    poses: ArrayLike,
    period: float,
    position: Scalar | None = None,
    heading_error: Scalar = HEADING,
    integral_time: Scalar | None = None,
    limits: Limits = MappingProxyType({}),
) -> DynamicPositioning:
    """Positioning that suits a vessel and acts every `period` s.

    Weights follow Bryson's rule: `position` m, `heading_error` rad and all of an actuator's effect
    are equally bad, and so is that error for `integral_time` s.

    Arguments:
        times: s, ascending, when each pose is due; before the first and after the last it is held.
        poses: a row of north and east (m) and heading (rad) for each; headings are taken the short
            way.
        period: s, between its steps.
        position: m; a quarter of the vessel's length by default.
        heading_error: rad; 10 deg by default.
        integral_time: s; 25 sqrt(L / g) by default.
        limits: lowest and highest order by channel, where they are narrower than the actuator's.

    Raises:
        UserError: an actuator without limits, or poses that do not go with their times. That its
            gain is finite is `require_positioning`'s.
    """
    due, places = jnp.asarray(times, float), jnp.asarray(poses, float)
    _require_schedule(due, places)
    length = vessel.rigid_body.length
    effectors = effectors_of(vessel, period, limits)
    lags = jnp.concatenate([jnp.full(one.count, one.lag) for one in effectors])
    weights = Weights(
        jnp.asarray(POSITION * length if position is None else position, float),
        jnp.asarray(heading_error, float),
        jnp.asarray(
            INTEGRAL_TIME * time_scale(length) if integral_time is None else integral_time, float
        ),
    )
    speeds = jnp.asarray(_fastest(due, places, length) * jnp.linspace(-1.0, 1.0, _SPEEDS))
    gains = positioning_gains(vessel, effectors, lags, weights, period, speeds)
    return DynamicPositioning(vessel, due, continuous_poses(places), effectors, lags, gains)


def _fastest(times: Float[Array, "pose"], poses: Poses, length: Scalar) -> Scalar:
    """Speed (m/s) up to which gains are found: what the poses ask for, and a drift besides."""
    ways = jnp.sqrt(jnp.sum(jnp.diff(poses[:, :2], axis=0) ** 2, axis=1) + 1e-12)
    asked = jnp.max(1.5 * ways / jnp.diff(times), initial=0.0)
    return asked + _FASTEST * length / time_scale(length)


def _require_schedule(times: Float[Array, "..."], poses: Float[Array, "..."]) -> None:
    """Raise `UserError` unless there is a pose for each time, and times that are known increase."""
    if times.ndim != 1 or len(times) == 0 or poses.shape != (len(times), 3):
        raise UserError(
            "positioning takes times and for each of them a pose (north, east, heading); there are "
            f"times of shape {times.shape} and poses of shape {poses.shape}"
        )
    if not isinstance(times, Tracer) and not bool(jnp.all(jnp.diff(times) > 0)):
        raise UserError("the times of poses must increase")


def require_positioning(vessel: Vessel, limits: Limits = MappingProxyType({})) -> None:
    """Raise `UserError` for a vessel that at rest cannot be pushed ahead, sideways and round.

    `limits` of orders are those of `dynamic_positioning`.
    """
    effectors = effectors_of(vessel, 1.0, limits)
    B = inputs(vessel, effectors, jnp.zeros(()))
    scaled = B * jnp.array([1.0, 1.0, vessel.rigid_body.length])[:, None]
    sizes = jnp.linalg.svd(scaled, compute_uv=False)
    if B.shape[1] >= 3 and float(sizes[2]) > _LEAST * float(sizes[0]):
        return
    missing = [
        name
        for name, row in zip(("ahead", "sideways", "round"), scaled, strict=True)
        if float(jnp.linalg.norm(row)) <= _LEAST * float(sizes[0])
    ]
    count = len(effectors)
    told = f"{count} actuator{'s'[: count - 1]} cannot push it ahead, sideways and round by itself"
    if missing:
        told = f"nothing pushes it {' or '.join(missing)}"
    raise UserError(
        f"{vessel.name!r} cannot be positioned: at rest {told}. It takes a tunnel thruster, fixed "
        "thrusters set at angles or azimuth thrusters that turn all the way round; "
        "a path needs less"
    )
