"""Errors of sensors and clocks, and a current, put into a recording.

Each is exact by kinematics. Settings are numbers in SI units: `size` with `side` (1 or -1),
`angle` (a direction or phase, rad), `time` (s on the run's clock), `seed`.
"""

from experiments.concealed_real.material import MOTION, Run, Series, Settings, replaced, step_of

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter


def signed(settings: Settings) -> float:
    """The size with its sign."""
    return settings["size"] * settings.get("side", 1.0)


# The environment


def current(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Everything moves with the water: `size` m/s towards `angle`, by Galilei.

    Positions from the first row on, so that a run begins where it did.
    """
    speed, t = sign * settings["size"], run["t"].to_numpy()
    north, east = speed * np.cos(settings["angle"]), speed * np.sin(settings["angle"])
    psi, elapsed = run["psi"].to_numpy(), t - t[0]
    shift = {
        "x": north * elapsed,
        "y": east * elapsed,
        "u": north * np.cos(psi) + east * np.sin(psi),
        "v": -north * np.sin(psi) + east * np.cos(psi),
    }
    return replaced(run, {c: run[c].to_numpy() + by for c, by in shift.items() if c in run})


def without_current(run: Run, settings: Settings) -> Run:
    """The inverse of `current`."""
    return current(run, settings, -1.0)


# Compass and gyro


def heading_offset(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """A compass that shows `size` rad more, from `time` on where it is given."""
    late = run["t"].to_numpy() >= settings.get("time", -np.inf)
    return replaced(run, {"psi": run["psi"].to_numpy() + sign * signed(settings) * late})


def without_heading_offset(run: Run, settings: Settings) -> Run:
    """The inverse of `heading_offset`."""
    return heading_offset(run, settings, -1.0)


def hard_iron(run: Run, settings: Settings) -> Run:
    """A compass error of amplitude `size` rad: `size sin(psi - angle)`."""
    psi = run["psi"].to_numpy()
    return replaced(run, {"psi": psi + settings["size"] * np.sin(psi - settings["angle"])})


def without_hard_iron(run: Run, settings: Settings) -> Run:
    """The inverse of `hard_iron`, by fixed-point iteration: sizes are far below 1 rad."""
    shown = run["psi"].to_numpy()
    psi = shown
    for _ in range(60):
        psi = shown - settings["size"] * np.sin(psi - settings["angle"])
    return replaced(run, {"psi": psi})


def swinging_compass(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """A compass error that swings in time with period `time` s: no entry describes it."""
    t = run["t"].to_numpy()
    error = settings["size"] * np.sin(2 * np.pi * (t - t[0]) / settings["time"])
    return replaced(run, {"psi": run["psi"].to_numpy() + sign * error})


def steady_compass(run: Run, settings: Settings) -> Run:
    """The inverse of `swinging_compass`."""
    return swinging_compass(run, settings, -1.0)


def gyro_bias(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """A gyro that shows `size` rad/s more, from `time` on where it is given."""
    late = run["t"].to_numpy() >= settings.get("time", -np.inf)
    return replaced(run, {"r": run["r"].to_numpy() + sign * signed(settings) * late})


def without_gyro_bias(run: Run, settings: Settings) -> Run:
    """The inverse of `gyro_bias`."""
    return gyro_bias(run, settings, -1.0)


def lever_arm(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Positions of an antenna `size` m from the reference point, at `angle` from ahead."""
    psi, arm = run["psi"].to_numpy(), sign * settings["size"]
    return replaced(run, {
        "x": run["x"].to_numpy() + arm * np.cos(psi + settings["angle"]),
        "y": run["y"].to_numpy() + arm * np.sin(psi + settings["angle"]),
    })  # fmt: skip


def without_lever_arm(run: Run, settings: Settings) -> Run:
    """The inverse of `lever_arm`."""
    return lever_arm(run, settings, -1.0)


# Clocks


def late_channels(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Channels in `columns` stamped `size` s late; beyond a run's ends they stay unknown.

    Between rows by a cubic spline of the samples: exact for what changes slowly against a row.
    """
    t = run["t"].to_numpy()
    when = t - sign * settings["size"]
    return replaced(run, {c: _read_at(t, run[c].to_numpy(), when) for c in settings["columns"]})


def early_channels(run: Run, settings: Settings) -> Run:
    """The inverse of `late_channels`, but for the rows that it left unknown."""
    return late_channels(run, settings, -1.0)


def clock_drift(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """All motion channels later by `size` s for every second of the run."""
    t = run["t"].to_numpy()
    rate = signed(settings)
    elapsed = t - t[0]
    # What is shown at t is of t - rate t; the inverse reads at t / (1 - rate).
    when = t[0] + (elapsed * (1 - rate) if sign > 0 else elapsed / (1 - rate))
    shown = [c for c in (*MOTION, "phi", "p") if c in run]
    return replaced(run, {c: _read_at(t, run[c].to_numpy(), when) for c in shown})


def without_clock_drift(run: Run, settings: Settings) -> Run:
    """The inverse of `clock_drift`, but for the rows that it left unknown."""
    return clock_drift(run, settings, -1.0)


def _read_at(t: Series, values: Series, when: Series) -> Series:
    """Samples at other times; unknown beyond the ends and where the nearest row has none.

    A slower sensor has one in every other row or fewer.
    """
    known = np.isfinite(values)
    if known.sum() < 4:
        return values
    read = CubicSpline(t[known], values[known])(when)
    near = np.interp(when, t, (~known).astype(float), left=1.0, right=1.0)
    return np.where(near > 0.5, np.nan, read)


# What sensors do that has no name among the effects, and must not be given one


def thinned(run: Run, settings: Settings) -> Run:
    """Every `rows`-th row only."""
    return run.iloc[:: int(settings["rows"])].reset_index(drop=True)


def dropouts(run: Run, settings: Settings) -> Run:
    """Positions without samples in `size` s after each of five instants."""
    t, rng = run["t"].to_numpy(), np.random.default_rng(int(settings["seed"]))
    starts = rng.uniform(t[0], t[-1], 5)
    lost = np.any((t >= starts[:, None]) & (t < starts[:, None] + settings["size"]), axis=0)
    there = [c for c in ("x", "y") if c in run]
    return replaced(run, {c: np.where(lost, np.nan, run[c].to_numpy()) for c in there})


def quantised(run: Run, settings: Settings) -> Run:
    """The channel in `columns` rounded to whole multiples of `size`."""
    size = settings["size"]
    return replaced(
        run, {c: np.round(run[c].to_numpy() / size) * size for c in settings["columns"]}
    )


def coloured_noise(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Positions that wander: noise of `size` m with a correlation time of `time` s."""
    rng = np.random.default_rng(int(settings["seed"]))
    kept = float(np.exp(-step_of(run) / settings["time"]))
    fresh = settings["size"] * np.sqrt(1 - kept**2)
    there = {c: rng.standard_normal(len(run)) for c in ("x", "y") if c in run}
    wander = {c: fresh * lfilter([1.0], [1.0, -kept], white) for c, white in there.items()}
    return replaced(run, {c: run[c].to_numpy() + sign * by for c, by in wander.items()})


def without_coloured_noise(run: Run, settings: Settings) -> Run:
    """The inverse of `coloured_noise`."""
    return coloured_noise(run, settings, -1.0)


def smoothed(run: Run, settings: Settings) -> Run:
    """u and v as means over `rows` rows, an odd number, without delay."""
    there = [c for c in ("u", "v") if c in run]
    rows = int(settings["rows"])
    means = pd.DataFrame(run[there].rolling(rows, center=True, min_periods=1).mean())
    return replaced(run, {c: means[c].to_numpy() for c in there})
