"""What a prediction must undercut to be worth anything: going on as before."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from diffsea.kinematics import to_earth
from diffsea.simulation.replay import HORIZONS, horizons_within, rms_errors, spans_ahead
from diffsea.simulation.sensed_motion import NO_SHARES, Shares, has_sample_near, true_motion
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory
from diffsea.vessel.sensors import Sensors


def persistence_errors(
    recording: Trajectory,
    sensors: Sensors,
    horizons: Sequence[float] = HORIZONS,
    spacing: float = 10.0,
    shares: Shares = NO_SHARES,
) -> dict[float, dict[str, float]]:
    """Errors of going on with the speeds of each start, whatever is ordered.

    Along an arc, with the yaw rate of the start, or straight on: of each quantity the smaller
    error. At the same starts and horizons, and by the same names, as `horizon_errors`.
    `shares` are those of `recorded_shares`, where the sensors depend on them.
    """
    run = recording.counted()
    t = run.t
    if t[0] + min(horizons) > t[-1]:
        return {}
    motion, _ = true_motion(sensors, run, shares)
    known = {c: has_sample_near(sensors, run, c) for c in MOTION_CHANNELS}
    begin, end = spans_ahead(t, horizons, spacing)
    errors = {}
    for k, horizon, counted in horizons_within(t, horizons, end):
        start, at = begin[counted], end[counted, k]
        missed = [_missed(motion, known, t, start, at, turning) for turning in (1.0, 0.0)]
        smaller = {name: min(one[name] for one in missed) for name in missed[0]}
        errors[horizon] = {**smaller, "starts": len(start)}
    return errors


def _missed(
    motion: dict[str, Samples],
    known: dict[str, Bool[np.ndarray, "time"]],
    t: Samples,
    start: Int[np.ndarray, "start"],
    end: Int[np.ndarray, "start"],
    turning: float,
) -> dict[str, float]:
    """Errors in some rows of what was kept up from others on, of their yaw rate a share."""
    first = {c: motion[c][start] for c in MOTION_CHANNELS}
    first["r"] = turning * first["r"]
    reached = _kept_up(first, t[end] - t[start])
    return rms_errors(
        {c: np.where(known[c][end], reached[c] - motion[c][end], np.nan) for c in MOTION_CHANNELS}
    )


def _kept_up(motion: dict[str, Samples], seconds: Samples) -> dict[str, Samples]:
    """Motion after some time of constant speeds and yaw rate: along an arc."""
    turned = motion["r"] * seconds
    along = seconds * np.sinc(turned / np.pi)
    across = seconds * np.sin(turned / 2) * np.sinc(turned / (2 * np.pi))
    ahead = motion["u"] * along - motion["v"] * across
    aside = motion["u"] * across + motion["v"] * along
    north, east = to_earth(ahead, aside, motion["psi"])
    x, y = motion["x"] + np.asarray(north), motion["y"] + np.asarray(east)
    return {**motion, "x": x, "y": y, "psi": motion["psi"] + turned}
