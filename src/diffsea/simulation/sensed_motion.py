"""Between true motion and what sensors show of it: late, with errors, where they are mounted."""

import dataclasses
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from diffsea.errors import UserError
from diffsea.kinematics import to_body, to_earth
from diffsea.metrics.preparation import prepare_recording
from diffsea.series import median_interval
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory
from diffsea.vessel.sensors import Clock, Sensors


Shares = Mapping[str, Samples]  # of its full thrust that each propulsion channel makes
NO_SHARES: Shares = {}

_COMPASS_ITERATIONS = 20  # a compass error of half a radian has converged by then
_EXTRAPOLATION_INTERVALS = 4  # least intervals whose slope goes on beyond the samples
_NEAREST_SAMPLE = 0.75  # of the median interval: a sample nearer than that supports a value


def shown_motion(
    sensors: Sensors, t: Samples, true: dict[str, Samples], shares: Shares
) -> dict[str, Samples]:
    """What sensors without noise show at the times of a motion, by channel.

    `shares` are those of their full thrust that the propulsion channels make.
    """
    lags = sensors.lags(t)
    late = {c: _extrapolate(t - np.asarray(lags[c]), t, true[c]) for c in MOTION_CHANNELS}
    north, east = to_earth(sensors.lever_x, sensors.lever_y, late["psi"])
    steps = _sensor_steps(sensors, t)
    psi, turned = np.asarray(sensors.shown_heading(late["psi"])), np.zeros_like(t)
    for _ in range(_COMPASS_ITERATIONS):  # an estimator's deviation depends on what it shows
        turned = _deviation(sensors, t, psi + turned, shares)
    now = t - np.asarray(lags["psi"]) + float(sensors.latency_heading)
    since = -_turned_within(-float(sensors.latency_axes), now, t, true["psi"])
    shown = sensors.shown_velocities(late["u"], late["v"], late["r"])
    u, v = to_body(*shown, turned + since)
    return {
        "x": late["x"] + np.asarray(north),
        "y": late["y"] + np.asarray(east),
        "psi": psi + turned + steps["psi"],
        "u": np.asarray(u),
        "v": np.asarray(v),
        "r": late["r"] + float(sensors.gyro_bias) + steps["r"],
    }


def true_motion(
    sensors: Sensors, run: Trajectory, shares: Shares
) -> tuple[dict[str, Samples], tuple[str, ...]]:
    """Motion in every row as the sensors' errors leave it, and notes on what was derived.

    What was not measured is derived from the rest without its errors. A run in which nothing shows
    the heading is one straight ahead, to the north.
    """
    derived, notes = [c for c in ("psi", "u", "v", "r") if not run.has(c)], ()
    turned = _shown_deviation(sensors, run, shares)
    true = {c: _true_channel(sensors, run, c, turned) for c in MOTION_CHANNELS}
    until = np.zeros_like(run.t)
    if run.has("psi"):
        until = _turned_within(float(sensors.latency_axes), run.t, run.t, true["psi"])
    u, v = to_body(true["u"], true["v"], -turned - until - sensors.axes_offset)
    if run.has("u") and run.has("v"):
        true |= {"u": np.asarray(u), "v": np.asarray(v)}
    if not (run.has("psi") or run.has("r")):
        true |= {c: np.zeros_like(run.t) for c in ("psi", "r")}
        notes = ("neither heading nor yaw rate was recorded: straight ahead is assumed",)
    if derived:
        known = {c: _where_sampled(sensors, run, c, true[c]) for c in MOTION_CHANNELS}
        whole, derivations = prepare_recording(dataclasses.replace(run, **known))
        notes += tuple(f"initial state: {d.note}" for d in derivations if d.kind == "derived")
        true |= {c: _extrapolate(run.t, whole.t, whole.motion[c]) for c in derived}
        for c in derived:
            if not np.isfinite(true[c]).all():
                raise UserError(
                    f"{run.name}: {c} was not recorded, nor anything to derive it from, so "
                    "there is no state to start from; map a velocity (u) or positions (x, y)"
                )
    # Positions, and what was derived from them, are those of the antenna.
    x, y = float(sensors.lever_x), float(sensors.lever_y)
    north, east = to_earth(x, y, true["psi"])
    true |= {"x": true["x"] - np.asarray(north), "y": true["y"] - np.asarray(east)}
    if run.has("x") and run.has("y"):
        at_antenna = {"u": true["u"] + y * true["r"], "v": true["v"] - x * true["r"]}
        true |= {c: at_antenna[c] for c in derived if c in at_antenna}
    x, y = float(sensors.velocity_lever_x), float(sensors.velocity_lever_y)
    at_sensor = {"u": true["u"] + y * true["r"], "v": true["v"] - x * true["r"]}
    true |= {c: at_sensor[c] for c in at_sensor if c not in derived}
    return true, notes


def _turned_within(seconds: float, since: Samples, t: Samples, psi: Samples) -> Samples:
    """How far (rad) a heading `psi` at times t turns within some seconds of others."""
    return _extrapolate(since + seconds, t, psi) - _extrapolate(since, t, psi)


def _shown_deviation(sensors: Sensors, run: Trajectory, shares: Shares) -> Samples:
    """How far (rad) the heading is turned that an estimator shows in every row."""
    if not (sensors.estimated_headings and run.has("psi")):
        return np.zeros_like(run.t)
    known = np.isfinite(run.psi)
    shown = _extrapolate(_times_shown(sensors, run.t, "psi"), run.t[known], run.psi[known])
    return _deviation(sensors, run.t, shown - _sensor_steps(sensors, run.t)["psi"], shares)


def _deviation(sensors: Sensors, t: Samples, shown: Samples, shares: Shares) -> Samples:
    """Of an estimator's heading (rad), where it shows one at the times."""
    begins = np.arange(t.size) == 0
    found = sensors.deviation(
        jnp.asarray(shown),
        {c: jnp.asarray(share) for c, share in shares.items()},
        jnp.asarray(np.diff(t, prepend=t[0])),
        jnp.asarray(begins),
    )
    return np.asarray(found)


def _true_channel(sensors: Sensors, run: Trajectory, channel: str, turned: Samples) -> Samples:
    """A channel in every row without its sensor's errors; NaN, positions zero, if not measured.

    Positions stay those of the antenna, and velocities are turned as they are shown; the heading
    is less by what it is `turned` (rad).
    """
    values = np.asarray(run.motion[channel])
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros_like(run.t) if channel in "xy" else np.full_like(run.t, np.nan)
    shown = _extrapolate(_times_shown(sensors, run.t, channel), run.t[finite], values[finite])
    shown = shown - _sensor_steps(sensors, run.t)[channel]
    if channel != "psi":
        return shown - float(sensors.gyro_bias) if channel == "r" else shown
    psi = shown = shown - turned
    for _ in range(_COMPASS_ITERATIONS):  # the compass error depends on the heading itself
        psi = psi + shown - np.asarray(sensors.shown_heading(psi))
    return psi


def _where_sampled(sensors: Sensors, run: Trajectory, channel: str, true: Samples) -> Samples:
    """A channel's true values in the row nearest to each of its samples, NaN in the others."""
    if not run.has(channel):
        return np.full_like(run.t, np.nan) if channel in "xy" else true
    times = run.t[np.isfinite(run.motion[channel])]
    of = times - np.asarray(sensors.lags(times)[channel])
    after = np.searchsorted(run.t, of).clip(1, run.t.size - 1)
    rows = np.where(of - run.t[after - 1] < run.t[after] - of, after - 1, after)
    found = np.full_like(run.t, np.nan)
    found[rows] = true[rows]
    return found


def _sensor_steps(sensors: Sensors, t: Samples) -> dict[str, Samples]:
    """What each channel shows too much at the times since instants of the run."""
    found = np.asarray(sensors.steps(t, np.diff(t, prepend=2 * t[0] - t[1])))
    return {channel: found[:, k] for k, channel in enumerate(MOTION_CHANNELS)}


def _times_shown(sensors: Sensors, t: Samples, channel: str) -> Samples:
    """When (s) a channel shows what was true at the times: `shown - lag(shown) = t`."""
    clock = sensors.clock or Clock()
    return (t + float(sensors.lags(0.0)[channel])) / (1 - float(clock.rate))


def _extrapolate(
    wanted: Float[np.ndarray, "wanted"], times: Samples, values: Samples
) -> Float[np.ndarray, "wanted"]:
    """Values between samples; beyond the first and the last, on with the slope there.

    A clock that is off shows the beginning or the end of a run outside its recording.
    """
    found = np.interp(wanted, times, values)
    if len(times) < 2:
        return found
    least = _EXTRAPOLATION_INTERVALS * median_interval(times)
    for edge, beyond in ((0, wanted < times[0]), (-1, wanted > times[-1])):
        if beyond.any():
            span = max(least, float(np.abs(wanted[beyond] - times[edge]).max()))
            near = np.abs(times - times[edge]) <= span
            # A line needs two samples, also where a pause follows the first or precedes the last.
            near[slice(0, 2) if edge == 0 else slice(-2, None)] = True
            slope = np.polyfit(times[near] - times[edge], values[near], 1)[0]
            found[beyond] = values[edge] + slope * (wanted[beyond] - times[edge])
    return found


def has_sample_near(sensors: Sensors, run: Trajectory, channel: str) -> Bool[np.ndarray, "time"]:
    """Rows of the true motion that have a sample of the channel near them."""
    sampled = run.t[np.isfinite(run.motion[channel])]
    if sampled.size < 2:
        return np.zeros(run.t.shape, bool)
    wanted = _times_shown(sensors, run.t, channel)
    after = np.searchsorted(sampled, wanted).clip(1, sampled.size - 1)
    distance = np.minimum(np.abs(wanted - sampled[after - 1]), np.abs(wanted - sampled[after]))
    return distance <= _NEAREST_SAMPLE * median_interval(sampled)
