"""How well a closed loop did, as pure functions of its run: differentiate and batch them.

`scores` says more about one run that is over.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.kinematics import wrap
from diffsea.missions import paths
from diffsea.missions.controllers import radius_of, speed_of
from diffsea.missions.record import Mission
from diffsea.missions.running import order_limits
from diffsea.scales import time_scale
from diffsea.simulation.closed_loop import ClosedLoop
from diffsea.simulation.control.positioning import continuous_poses, reference
from diffsea.simulation.control.timed import in_force
from diffsea.trajectory import Outcome, Trajectory
from diffsea.types import Scalar


Series = Float[Array, "time"]

HEADING_SCALE = math.radians(10.0)  # an error that counts as much as one ship length off the path
SPEED_SCALE = 0.1  # of the mission's speed, likewise
_AT_LIMIT = 1e-6  # of the room between both limits: nearer is at the limit

NUMBERS = {  # that a run may have, and their units; the likeliest to be looked at first
    "path_rms": "m",
    "path_largest": "m",
    "position_rms": "m",
    "position_largest": "m",
    "heading_rms": "rad",
    "heading_largest": "rad",
    "speed_rms": "m/s",
    "speed_largest": "m/s",
    "missed": "1",
    "time": "s",
    "distance": "m",
    "effort": "1",
    "at_limit": "1",
}


class Performance(eqx.Module):
    """Numbers of a run, SI units and rad."""

    numbers: dict[str, Scalar]
    outcome: Int[Array, ""]
    rows: Int[Array, ""]


def tracking_errors(mission: Mission, run: Trajectory) -> dict[str, Series]:
    """Errors of every row by name: `path` (m), or `heading` (rad) and `speed` (m/s) of a course,
    `position` (m) and `heading` of poses."""
    if mission.waypoints:
        points = jnp.array([(one.x, one.y) for one in mission.waypoints])
        track = jnp.stack([jnp.asarray(run.x), jnp.asarray(run.y)], -1)
        return {"path": paths.path_offsets(points, track, radius_of(mission))}
    if mission.controller.kind == "positioning":
        north, east, psi = held_poses(mission, run.t)
        off = jnp.sqrt((run.x - north) ** 2 + (run.y - east) ** 2 + 1e-12)
        return {"position": off, "heading": jnp.asarray(wrap(run.psi - psi))}
    if mission.controller.kind != "course":
        return {}
    heading, speed = (held_values(mission, run.t, name) for name in ("heading", "speed"))
    return {"heading": jnp.asarray(wrap(run.psi - heading)), "speed": jnp.asarray(run.u - speed)}


def held_values(mission: Mission, t: Series, name: str) -> Series:
    """Heading (rad) or speed (m/s) that the timed steps ask for at each time (s)."""
    times = jnp.array([one.time for one in mission.steps])
    values = jnp.array([getattr(one, name) for one in mission.steps])
    return values[jax.vmap(lambda at: in_force(times, at))(jnp.asarray(t))]


def held_poses(mission: Mission, t: Series) -> tuple[Series, Series, Series]:
    """North and east (m) and heading (rad) that poses ask for at each time (s)."""
    times = jnp.array([one.time for one in mission.steps])
    poses = continuous_poses(jnp.array([(one.x, one.y, one.heading) for one in mission.steps]))
    asked = jax.vmap(lambda at: reference(times, poses, at)[0])(jnp.asarray(t))
    return asked[:, 0], asked[:, 1], asked[:, 2]


def performance(mission: Mission, loop: ClosedLoop) -> Performance:
    """Root-mean-square and largest errors, time, distance, waypoints missed, orders' effort.

    `at_limit` is the largest share of the time of any order at its limits, `effort` the
    root-mean-square change of orders, see `order_changes`.
    """
    run = loop.trajectory
    valid = jnp.asarray(run.valid)
    count = valid.sum()

    def rms(values: Series, kept: Bool[Array, "time"] = valid) -> Scalar:
        return jnp.sqrt(
            jnp.where(kept, values**2, 0.0).sum() / jnp.maximum(kept.sum(dtype=float), 1.0)
        )

    numbers: dict[str, Scalar] = {}
    for name, errors in tracking_errors(mission, run).items():
        numbers[f"{name}_rms"] = rms(errors)
        numbers[f"{name}_largest"] = jnp.where(valid, jnp.abs(errors), 0.0).max()
    numbers["time"] = jnp.where(valid, run.t, 0.0).max()
    steps = jnp.hypot(jnp.diff(run.x), jnp.diff(run.y))
    numbers["distance"] = jnp.where(valid[1:], steps, 0.0).sum()
    if mission.waypoints:
        points = jnp.array([(one.x, one.y) for one in mission.waypoints])
        track = jnp.where(valid[:, None], jnp.stack([run.x, run.y], -1), jnp.inf)
        reached = paths.waypoints_reached(points, track, radius_of(mission))
        numbers["missed"] = jnp.sum(~reached).astype(float)
    shares = []
    for channel, orders in run.commanded.items():
        there = at_limit(orders, *order_limits(mission, channel))
        shares.append(there.mean(where=valid))
    numbers["at_limit"] = jnp.max(jnp.stack(shares))
    changes = jnp.stack([*order_changes(mission, run).values()])
    numbers["effort"] = jnp.sqrt(jnp.mean(jnp.stack([rms(one, valid[1:]) ** 2 for one in changes])))
    return Performance(numbers, jnp.asarray(run.outcome), count)


def at_limit(orders: Series, lower: Scalar, upper: Scalar) -> Bool[Array, "time"]:
    """Which orders are at either of their limits."""
    room = _AT_LIMIT * jnp.where(jnp.isfinite(upper - lower), upper - lower, 1.0)
    return (orders >= upper - room) | (orders <= lower + room)


def order_changes(mission: Mission, run: Trajectory) -> dict[str, Float[Array, "change"]]:
    """Changes of orders by channel: shares of the room between their limits in sqrt(L / g).

    Where there is no limit, of what is ordered at most.
    """
    period = run.t[1] - run.t[0]
    scale = time_scale(mission.vessel.rigid_body.length) / period
    changes = {}
    for channel, orders in run.commanded.items():
        low, high = order_limits(mission, channel)
        most = jnp.maximum(jnp.abs(orders).max(), 1e-9)
        room = jnp.where(jnp.isfinite(high - low), high - low, most)
        changes[channel] = jnp.diff(orders) / room * scale
    return changes


def cost_residuals(mission: Mission, loop: ClosedLoop, effort: float) -> Float[Array, "residual"]:
    """What a tuning makes small: the sum of squares is the cost.

    The mean square of tracking errors, in ship lengths off the path, or in 10 deg of heading and
    tenths of the speed; and `effort` times that of the changes of orders (`order_changes`).
    Those of a run that diverged are not numbers.
    """
    run, valid = loop.trajectory, jnp.asarray(loop.trajectory.valid)
    scales = {
        "path": mission.model.rigid_body.length,
        "position": mission.model.rigid_body.length,
        "heading": HEADING_SCALE,
    }
    if mission.controller.kind == "course":
        scales["speed"] = SPEED_SCALE * speed_of(mission)
    share = jnp.sqrt(valid.astype(float) / jnp.maximum(valid.sum(dtype=float), 1.0))
    errors = tracking_errors(mission, run)
    parts = [jnp.where(valid, one, 0.0) / scales[name] * share for name, one in errors.items()]
    changes = order_changes(mission, run)
    weight = jnp.sqrt(effort / len(changes)) * share[1:]
    parts += [jnp.where(valid[1:], one, 0.0) * weight for one in changes.values()]
    diverged = jnp.asarray(run.outcome) == Outcome.DIVERGED
    return jnp.where(diverged, jnp.nan, jnp.concatenate(parts))
