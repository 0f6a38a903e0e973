"""Wind without a model of the hull: how turning circles drift; and the anemometer's own zero.

The first looks at the recordings alone, the second at the measured wind, to judge its label.
"""

import math
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea import Trajectory
from diffsea.metrics.drift import circle_drift


STEADY = 30.0  # s after the rudder is over
OVER = math.radians(20.0)
_SECOND = 10  # rows


def drifts(runs: dict[str, Trajectory]) -> dict[str, dict]:
    """Where each circle drifts, and so where the wind comes from; deg, m/s."""
    found = {}
    for name, run in runs.items():
        rudder = np.asarray(run.commanded["rudder"])
        over = float(np.asarray(run.t)[np.flatnonzero(np.abs(rudder) > OVER)[0]])
        drift = circle_drift(run, over + STEADY)
        found[name] = {
            "speed": drift.speed,
            "scatter": drift.scatter,
            "laps": drift.laps,
            "from": math.degrees(drift.direction + math.pi) % 360,
        }
    return found


def scored(found: dict[str, dict], measured: dict[str, dict[str, float]]) -> dict:
    """The directions beside the measured mean wind's."""
    rows = []
    for name, one in found.items():
        there = math.degrees(measured[name]["direction"])
        off = (one["from"] - there + 180) % 360 - 180
        speed = measured[name]["speed"]
        rows.append(one | {"recording": name, "measured_from": there, "off": off,
                           "measured_speed": speed, "share": one["speed"] / speed})  # fmt: skip
    middle = float(np.median([abs(row["off"]) for row in rows]))
    return {"rows": rows, "median_direction_error": middle}


def mounting(pairs: list[tuple[np.ndarray, np.ndarray]]) -> dict:
    """By how much the anemometer's zero is turned, from (apparent wind, ship's velocity) pairs.

    Complex north + i east, m/s, each second. Apparent wind is wind less the ship's velocity,
    turned by the mounting's error: A = exp(i d) (W - V), W constant in each run and the rest
    gusts, an autoregression of first order. Returns d and its 90 % interval (deg), from the
    profile of the likelihood.
    """
    angles = np.radians(np.arange(-180, 180, 1.0))
    total = np.zeros(len(angles))
    for apparent, velocity in pairs:
        columns = np.column_stack([np.ones(len(velocity)), velocity])
        rest = apparent - columns @ np.linalg.lstsq(columns, apparent, rcond=None)[0]
        keep = float(np.real(np.vdot(rest[:-1], rest[1:]) / np.vdot(rest[:-1], rest[:-1])))
        white = lambda values, keep=keep: values[1:] - keep * values[:-1]
        scale = float(np.std(white(rest))) / math.sqrt(2)  # of one component
        for k, angle in enumerate(angles):
            left = white(apparent + np.exp(1j * angle) * velocity) / scale
            total[k] += float(np.sum(np.abs(left - left.mean()) ** 2))
    best = total.min()
    inside = np.degrees(angles[total < best + 2.706])
    return {
        "turned": float(np.degrees(angles[total.argmin()])),
        "interval": [float(inside.min()), float(inside.max())],
        "chi_squared_of_zero": float(total[np.argmin(np.abs(angles))] - best),
    }


def seconds(recording: Path, wind: Path) -> tuple[np.ndarray, np.ndarray]:
    """Apparent wind (blowing to) and the ship's velocity over ground, averaged over each second."""
    motion, air = pd.read_csv(recording), pd.read_csv(wind)
    rows = min(len(motion), len(air)) // _SECOND * _SECOND
    heading = motion["psi_hat [rad]"].to_numpy()[:rows]
    along = motion["u_velo [m/s]"].to_numpy()[:rows], motion["vm_velo [m/s]"].to_numpy()[:rows]
    speed, angle = (
        air[name].to_numpy()[:rows]
        for name in ("wind_velo_relative_mid [m/s]", "wind_dir_relative_mid [rad]")
    )
    apparent = -speed * np.exp(1j * (heading + angle))
    velocity = (along[0] + 1j * along[1]) * np.exp(1j * heading)
    return tuple(np.nanmean(z.reshape(-1, _SECOND), axis=1) for z in (apparent, velocity))
