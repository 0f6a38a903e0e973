"""The controller of a mission, made for the vessel that it believes in."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.missions.record import Controller, Mission
from diffsea.simulation import planning
from diffsea.simulation.control import (
    AbstractController,
    AbstractGuidance,
    AbstractHeadingLaw,
    AbstractSpeedLaw,
    Autopilot,
    ControlAllocation,
    FilteredPD,
    FixedThrottle,
    HeadingHold,
    LineOfSight,
    Pursuit,
    Steering,
    TimedHeading,
    TimedOrders,
    TimedSpeed,
    dynamic_pd,
    dynamic_positioning,
    full_throttle,
    require_positioning,
    require_steering,
    speed_hold,
    throttle_for,
    track_keeper,
    waypoint_logic,
)
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


LOOKAHEAD = 2.5  # ship lengths, by default
RADIUS = 1.5  # ship lengths, within which a waypoint is reached by default

Points = Float[Array, "waypoint 2"]


def speed_of(mission: Mission) -> Scalar:
    """The speed (m/s) that a mission is run at: as stated, of its first step, or the usual one."""
    if mission.controller.kind == "course":
        return mission.steps[0].speed
    speed = mission.controller.numbers.get("speed")
    return planning.default_speed(mission.model) if speed is None else speed


def radius_of(mission: Mission) -> Scalar:
    """Within how many m a waypoint is reached."""
    return mission.controller.numbers.get("radius", RADIUS * mission.model.rigid_body.length)


def require_controllable(mission: Mission) -> None:
    """Raise `UserError` for a vessel that cannot be steered so, or a speed beyond its reach."""
    kind, model = mission.controller.kind, mission.model
    if kind in ("orders", "dynamic-pd", "waypoint-logic"):
        return  # whose own making tells what they need
    if kind == "positioning":
        require_positioning(model, mission.controller.limits)
        return
    require_steering(model, f"mission under {kind!r}")
    fastest = planning.top_speed(model)
    for speed in (speed_of(mission), *(one.speed for one in mission.steps)):
        if speed > fastest:
            raise UserError(
                f"{model.name!r} does not reach {speed:g} m/s: at full throttle it runs "
                f"{fastest:.3g} m/s; choose a lower speed"
            )
    if kind == "track-keeping":
        keeper = controller_of(mission, 1.0)
        if not jnp.all(jnp.isfinite(keeper.gain)):  # type: ignore[attr-defined]
            speed = speed_of(mission)
            raise UserError(f"no rudder law steadies {model.name!r} at {speed:g} m/s")


def controller_of(mission: Mission, period: float) -> AbstractController:
    """The controller of a mission, which steers every `period` s; pure in the mission's numbers.

    Raises:
        UserError: one for other thrusters than those of the vessel that it believes in.
    """
    model, asked = mission.model, mission.controller
    points = jnp.array([(one.x, one.y) for one in mission.waypoints], float).reshape(-1, 2)
    if asked.kind == "orders":
        times = jnp.array([one.time for one in mission.steps])
        columns = {c: jnp.array([one.orders[c] for one in mission.steps]) for c in model.channels}
        return TimedOrders(times, columns)
    if asked.kind == "positioning":
        times = jnp.array([one.time for one in mission.steps])
        poses = jnp.array([(one.x, one.y, one.heading) for one in mission.steps], float)
        return dynamic_positioning(
            model, times, poses, period, **asked.numbers, limits=asked.limits
        )
    if asked.kind == "dynamic-pd":
        return dynamic_pd(model, points, 0.0, **asked.numbers)
    if asked.kind == "waypoint-logic":
        fields = {key: value for key, value in asked.numbers.items() if key != "radius"}
        return waypoint_logic(model, points, radius_of(mission), **fields)
    if asked.kind == "track-keeping":
        keeper = track_keeper(model, speed_of(mission), points, period, asked.feedforward)
        return eqx.tree_at(lambda one: one.path.radius, keeper, radius_of(mission))
    guidance, speed = _guidance(mission, points), _speed_law(mission)
    steering = Steering(guidance, _heading_law(asked, model, speed_of(mission)), speed)
    return Autopilot(steering, ControlAllocation(model))


def _guidance(mission: Mission, points: Points) -> AbstractGuidance:
    numbers, radius = mission.controller.numbers, radius_of(mission)
    if mission.controller.kind == "course":
        times, headings = ([getattr(one, n) for one in mission.steps] for n in ("time", "heading"))
        return TimedHeading(jnp.array(times), jnp.array(headings))
    if mission.controller.kind == "pursuit":
        return Pursuit(points, radius)
    ahead = numbers.get("lookahead", LOOKAHEAD * mission.model.rigid_body.length)
    return LineOfSight(points, ahead, radius, numbers.get("integral_gain", 0.0))


def _heading_law(asked: Controller, model: Vessel, speed: Scalar) -> AbstractHeadingLaw:
    if asked.heading.law == "pd":
        return FilteredPD(**asked.heading.numbers)
    return HeadingHold(model.rigid_body.length / speed, **asked.heading.numbers)


def _speed_law(mission: Mission) -> AbstractSpeedLaw:
    asked, model = mission.controller, mission.model
    if asked.kind == "course":
        times, speeds = (
            jnp.array([getattr(one, n) for one in mission.steps]) for n in ("time", "speed")
        )
        throttles = jax.vmap(lambda speed: jnp.asarray(throttle_for(model, speed)))(speeds)
        length, most = model.rigid_body.length, full_throttle(model)
        return TimedSpeed(times, speeds, throttles, length, largest=most, **asked.speed_law)
    if "throttle" in asked.numbers:
        return FixedThrottle(asked.numbers["throttle"])
    hold = speed_hold(model, jnp.asarray(speed_of(mission), float))
    return dataclasses.replace(hold, **asked.speed_law)
