"""What each kind of standard trial is summed up by: pure in the trial, in SI units."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.metrics import (
    Curve,
    curve,
    first_crossing,
    slopes,
    stopping_metrics,
    turning_metrics,
    value_at,
    zigzag_metrics,
)
from diffsea.metrics.crossings import known
from diffsea.simulation.trials import Trial
from diffsea.types import Scalar, Trajectory


Numbers = dict[str, Float[Array, ""]]


def turning(side: float, trial: Trial) -> Numbers:
    """Advance, transfer, diameters and the rest of a turn."""
    return turning_metrics(trial.trajectory, trial.execute_time, side)


def zigzag(side: float, trial: Trial) -> Numbers:
    """Overshoots, times and rates of a zig-zag."""
    times = jnp.concatenate([jnp.asarray(trial.execute_time)[None], trial.switch_times[:-1]])
    return zigzag_metrics(trial.trajectory, times, side=side)


def stopping(side: float, trial: Trial) -> Numbers:
    """Reaches and time of a stop."""
    return stopping_metrics(trial.trajectory, trial.execute_time)


def _surge(run: Trajectory) -> Curve:
    return curve(run.t, run.u, slopes(run.t, run.u), run.valid)


def _distance(run: Trajectory, start: Scalar) -> Float[Array, ""]:
    """Distance made good (m) from `start` to the end."""
    at = [value_at(curve(run.t, p, slopes(run.t, p), run.valid), start) for p in (run.x, run.y)]
    last = jnp.max(jnp.where(run.valid, run.t, -jnp.inf))
    end = [value_at(curve(run.t, p, slopes(run.t, p), run.valid), last) for p in (run.x, run.y)]
    square = (end[0] - at[0]) ** 2 + (end[1] - at[1]) ** 2
    return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)


def _speed_change(trial: Trial, share: float, upwards: bool) -> Numbers:
    """Speed at the end, distance made good, and when a share of the change was over."""
    run = trial.trajectory
    surge = _surge(run)
    last = surge.value[-1]
    start = value_at(surge, trial.execute_time)
    level = start + share * ((last if upwards else 0.0) - start)
    reached = first_crossing(surge, level, +1 if upwards else -1, after=trial.execute_time)
    time = known(reached.time - trial.execute_time, reached.found)
    name = "time_to_90_percent" if upwards else "time_to_half_speed"
    distance = _distance(run, trial.execute_time)
    ends = {"final_speed": last, "distance": distance, name: time}
    return ends if upwards else {**ends, "approach_speed": start}


def acceleration(side: float, trial: Trial) -> Numbers:
    """Final speed, distance made good, and when nine tenths of the speed were there."""
    return _speed_change(trial, 0.9, True)


def coasting(side: float, trial: Trial) -> Numbers:
    """Speeds, distance made good, and when half of the speed was lost."""
    return _speed_change(trial, 0.5, False)


def _yaw(trial: Trial) -> Curve:
    run = trial.trajectory
    return curve(run.t, run.r, slopes(run.t, run.r), run.valid)


def pull_out(side: float, trial: Trial) -> Numbers:
    """The turn until the release, and yaw rates (rad/s, towards the side) then and at the end."""
    yaw, ends = _yaw(trial), trial.switch_times
    released = jnp.isfinite(ends[0])
    until = jnp.where(released, ends[0], jnp.inf)
    run = trial.trajectory
    turn = dataclasses.replace(run, valid=run.valid & (run.t <= until))
    rate = side * value_at(yaw, jnp.where(released, ends[0], 0.0))
    return {
        **turning_metrics(turn, trial.execute_time, side),
        "yaw_rate_at_release": known(rate, released),
        "residual_yaw_rate": known(side * yaw.value[-1], jnp.isfinite(ends[1])),
    }


def spiral(side: float, trial: Trial) -> Numbers:
    """Yaw rate (rad/s) at the end of every stage, in the order in which they were held."""
    yaw, ends = _yaw(trial), trial.switch_times
    there = jnp.isfinite(ends)
    rates = jax.vmap(lambda t: value_at(yaw, t))(jnp.where(there, ends, 0.0))
    return {f"yaw_rate_{k + 1}": known(rates[k], there[k]) for k in range(ends.size)}
