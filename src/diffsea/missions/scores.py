"""What a mission is judged by: path and time errors, closest approaches, orders against limits."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from diffsea.identification.online.guarded import OnlineRun
from diffsea.missions.controllers import radius_of
from diffsea.missions.performance import at_limit, tracking_errors
from diffsea.missions.record import Mission
from diffsea.missions.running import MissionRun
from diffsea.parameters import named
from diffsea.scales import time_scale
from diffsea.series import stretches
from diffsea.simulation.actuation import yaw_moments
from diffsea.simulation.planning import outcome_label
from diffsea.trajectory import Samples, Trajectory


_NOTICED = 0.05  # of the largest moment: less turns nothing
_LASTING = 5.0  # sqrt(L / g), that the wrong way must last


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
    errors = tracking_errors(mission, motion)
    found |= {f"{name}_error": _size(np.asarray(one)) for name, one in errors.items()}
    if mission.waypoints:
        off = np.asarray(errors["path"])
        found["path_error"]["time_of_largest"] = float(motion.t[np.abs(off).argmax()])
        found["waypoints"] = approaches(mission, motion)
        found["wrong_way"] = wrong_way(run, off)
    if run.estimates is not None:
        found["estimator"] = estimator_scores(run, run.estimates)
    return found | {"orders": orders_against_limits(run)}


def estimator_scores(run: MissionRun, estimates: OnlineRun) -> dict[str, Any]:
    """What the estimator beside the controller found: last estimates beside model and plant."""
    mission = run.mission
    plant, believed = named(mission.vessel), named(mission.model)
    units = {one.name: one.unit for one in estimates.guard.estimator.parameters}
    found: dict[str, Any] = {}
    for name, series in estimates.estimate.items():
        # Water and air are the mission's, not the vessel's.
        true = None if name.startswith(("current_", "wind_")) else plant.get(name)
        found[name] = {
            "unit": units[name],
            "model": float(believed[name]),
            "vessel": None if true is None else float(true),
            "value": float(series[-1]),
            "std": float(estimates.std[name][-1]),
            "passed": float(estimates.handed[name][-1]),
        }
    asked = mission.estimator
    return {
        "kind": None if asked is None else asked.kind,
        "adapt": asked is not None and asked.adapt,
        "trust": {"last": float(estimates.trust[-1]), "least": float(estimates.trust.min())},
        "open": float(estimates.open.mean()),
        "estimates": found,
    }


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
        there = np.asarray(at_limit(jnp.asarray(orders), lower, upper))
        rate = float(np.abs(np.diff(orders)).max(initial=0.0)) / run.setup.times.period
        slew = vessel.servos[channel].rate_limit
        found[channel] = {
            "unit": vessel.units[channel],
            "least": float(orders.min()),
            "largest": float(orders.max()),
            "lower": lower,
            "upper": upper,
            "at_limit": float(there.mean()),
            "limit_events": int(there[0]) + int(np.sum(there[1:] & ~there[:-1])),
            "largest_rate": rate,
            "rate_limit": math.inf if slew is None else float(slew),
        }
    return found
