"""What a mission is judged by: path and time errors, closest approaches, orders against limits."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from diffsea.kinematics import wrap
from diffsea.parameters import named
from diffsea.scales import time_scale
from diffsea.series import stretches
from diffsea.simulation.actuation import yaw_moments
from diffsea.simulation.control.timed import in_force
from diffsea.missions.controllers import radius_of
from diffsea.missions.record import Mission
from diffsea.missions.running import MissionRun
from diffsea.simulation.planning import outcome_label
from diffsea.trajectory import Samples, Trajectory


Points = Float[np.ndarray, "waypoint 2"]

_NOTICED = 0.05  # of the largest moment: less turns nothing
_LASTING = 5.0  # sqrt(L / g), that the wrong way must last
_AT_LIMIT = 1e-6  # of the room between both limits: nearer is at the limit


def scores(run: MissionRun) -> dict[str, Any]:
    """The content of run.json, SI units and rad; of the true motion."""
    mission, motion = run.mission, run.true
    steps = np.hypot(np.diff(motion.x), np.diff(motion.y))
    found: dict[str, Any] = {
        "format": 1,
        "mission": mission.name,
        "vessel": mission.vessel.name,
        "model": mission.model.name,
        "model_differs": model_differences(mission),
        "controller": mission.controller.kind,
        "outcome": outcome_label(run.outcome),
        "outcome_message": run.sentence,
        "time": float(motion.t[-1]),
        "distance": float(steps.sum()),
    }
    if mission.waypoints:
        off = path_offsets(mission, motion)
        found["path_error"] = _size(off) | {
            "time_of_largest": float(motion.t[np.abs(off).argmax()])
        }
        found["waypoints"] = approaches(mission, motion)
        found["wrong_way"] = wrong_way(run, off)
    elif mission.controller.kind == "course":
        courses, speeds = (held_values(mission, motion.t, name) for name in ("heading", "speed"))
        found["heading_error"] = _size(np.asarray(wrap(motion.psi - courses)))
        found["speed_error"] = _size(motion.u - speeds)
    return found | {"orders": orders_against_limits(run)}


def model_differences(mission: Mission) -> dict[str, dict[str, float | None]]:
    """Numbers in which the model that is believed in differs from the vessel; None is absent."""
    sides = {"vessel": named(mission.vessel), "model": named(mission.model)}
    found = {}
    for name in dict.fromkeys(name for numbers in sides.values() for name in numbers):
        both = {side: numbers.get(name) for side, numbers in sides.items()}
        values = {side: None if value is None else float(value) for side, value in both.items()}
        if values["vessel"] != values["model"]:
            found[name] = values
    return found


def _size(errors: Samples) -> dict[str, float]:
    return {"rms": float(np.sqrt(np.mean(errors**2))), "largest": float(np.abs(errors).max())}


def held_values(mission: Mission, t: Samples, name: str) -> Samples:
    """Heading (rad) or speed (m/s) that the timed steps ask for at each time."""
    times = jnp.array([one.time for one in mission.steps])
    values = np.array([getattr(one, name) for one in mission.steps])
    return values[np.asarray(jax.vmap(lambda at: in_force(times, at))(jnp.asarray(t)))]


def legs_in_force(points: Points, x: Samples, y: Samples, radius: float) -> Int[np.ndarray, "time"]:
    """Which leg of the path a vessel is on at each position, whatever steers it.

    A leg ends within `radius` m of its end or abeam of it.
    """
    number, legs = 0, np.zeros(len(x), int)
    for row, at in enumerate(np.column_stack([x, y])):
        while number < len(points) - 2:
            start, end = points[number], points[number + 1]
            left = (end - at) @ (end - start)
            if left > 0 and np.hypot(*(end - at)) >= radius:
                break
            number += 1
        legs[row] = number
    return legs


def path_offsets(mission: Mission, motion: Trajectory) -> Samples:
    """Distance (m) from the path, positive to starboard of it.

    That to the nearest point of the leg in force or of the one before: a corner that is cut or
    overshot is measured from whichever leg is nearer.
    """
    points = np.array([(one.x, one.y) for one in mission.waypoints])
    legs = legs_in_force(points, motion.x, motion.y, radius_of(mission))
    at = np.column_stack([motion.x, motion.y])
    now, before = (_from_legs(points, numbers, at) for numbers in (legs, np.maximum(legs - 1, 0)))
    return np.where(np.abs(now) <= np.abs(before), now, before)


def _from_legs(
    points: Points, legs: Int[np.ndarray, "time"], at: Float[np.ndarray, "time 2"]
) -> Samples:
    """Distance (m) of each position from the nearest point of its leg, positive to starboard."""
    start, along = points[legs], points[legs + 1] - points[legs]
    offset = at - start
    share = (offset * along).sum(1) / (along**2).sum(1)
    distance = np.hypot(*(offset - np.clip(share, 0.0, 1.0)[:, None] * along).T)
    return np.copysign(distance, along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0])


def approaches(mission: Mission, motion: Trajectory) -> list[dict[str, Any]]:
    """How near each waypoint was come to and when, and how late, where a time was stated.

    A waypoint is sought from when the one before was come closest to; the time is that of the
    closest approach by then, that of the first sample within the radius where it is reached.
    """
    radius, rows, first = radius_of(mission), [], 0
    for point in mission.waypoints:
        distance = np.hypot(motion.x[first:] - point.x, motion.y[first:] - point.y)
        within = np.flatnonzero(distance < radius)
        reached = within.size > 0
        nearest = first + int(distance.argmin())
        row = first + int(within[0]) if reached else nearest
        entry: dict[str, Any] = {
            "x": point.x,
            "y": point.y,
            "reached": reached,
            "time": float(motion.t[row]),
            "closest_approach": float(distance.min()),
        }
        if point.time is not None:
            entry |= {"planned_time": point.time, "time_error": entry["time"] - point.time}
        rows.append(entry)
        first = row if reached else first
    return rows


def wrong_way(run: MissionRun, off: Samples) -> dict[str, Any]:
    """How often and for how long (s) a vessel that leaves its path was turned further from it.

    It is off by half a ship length and moving away, its actuators turn it to that side by more
    than a twentieth of their largest moment, and this lasts for 5 sqrt(L / g).

    Arguments:
        off: m, from the path, positive to starboard.
    """
    vessel, t = run.setup.vessel, run.true.t
    length, moments = float(vessel.rigid_body.length), yaw_moments(vessel, run.true)
    least = _NOTICED * np.abs(moments).max()
    away = (np.abs(off) > 0.5 * length) & (np.gradient(np.abs(off), t) > 0)
    flags = away & (np.sign(off) * moments > least)
    seconds = [float(t[rows.stop - 1] - t[rows.start]) for rows in stretches(flags)]
    lasting = [one for one in seconds if one >= _LASTING * time_scale(length)]
    return {"events": len(lasting), "seconds": sum(lasting)}


def orders_against_limits(run: MissionRun) -> dict[str, dict[str, Any]]:
    """By channel the orders' range, their limits, and how long and how often they were there.

    `lower` and `upper` are the narrower of what the mission and what the actuator allows;
    `at_limit` is a share of the time. The largest rate is that of orders from one period to the
    next, beside the actuator's `rate_limit`.
    """
    vessel, found = run.mission.vessel, {}
    for channel, orders in run.true.commanded.items():
        lower, upper = run.limits(channel)
        room = _AT_LIMIT * (upper - lower if math.isfinite(upper - lower) else 1.0)
        at_limit = (orders >= upper - room) | (orders <= lower + room)
        rate = float(np.abs(np.diff(orders)).max(initial=0.0)) / run.setup.period
        slew = vessel.servos[channel].rate_limit
        found[channel] = {
            "unit": vessel.units[channel],
            "least": float(orders.min()),
            "largest": float(orders.max()),
            "lower": lower,
            "upper": upper,
            "at_limit": float(at_limit.mean()),
            "limit_events": int(at_limit[0]) + int(np.sum(at_limit[1:] & ~at_limit[:-1])),
            "largest_rate": rate,
            "rate_limit": math.inf if slew is None else float(slew),
        }
    return found
