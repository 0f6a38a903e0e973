"""Record the four trials, and a run to judge by, from a boat that the fit is not told of.

    python -m examples.blueboat.make_runs OUT

The boat is the shipped BlueBoat with other numbers (`CHANGED`), thrusters ordered in pulse widths
and unlike each other, and a steady current. It is simulated by `tests/oracle`, which shares no code
with the library, with gusts and sensor noise. What was true goes to OUT/truth.json.
"""

import copy
import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tests.oracle.make_recordings import GUST, gust_scale, stream
from tests.oracle.sensors import gust, record, suite, write_csv
from tests.oracle.simulator import Simulator, load
from tests.paths import ROOT


class Trial(NamedTuple):
    """Orders one after the other, from rest: seconds, and shares of full order on both sides."""

    heading: float  # deg, at the start
    orders: tuple[tuple[float, float, float], ...]  # s, port, starboard
    run_up: float = 0.0  # s at the beginning that are not recorded


# The same as in trials.lua, in this order.
TRIALS = {
    "acceleration": Trial(30, ((2, 0, 0), (6, 0.5, 0.5), (6, 1, 1))),
    "coasting": Trial(210, ((8, 1, 1), (25, 0, 0)), run_up=7),
    "steady": Trial(
        30, tuple((20, s, s) for s in (0.2, 0.35, 0.55, 0.75, 1.0, 0, -0.35, -0.7))
    ),
    "turning": Trial(
        120,
        (
            (6, 0.5, 0.5), (15, 0.6, 0.2), (15, 0.2, 0.6), (12, 0.9, 0.4), (12, 0.4, 0.9),
            (12, 0.4, 0), (12, 0, 0.4), (8, 0.3, -0.4), (8, -0.4, 0.3),
        ),
    ),
    "weaving": Trial(
        300,
        ((4, 0.5, 0.5), *((5, *sides) for sides in ((0.7, 0.3), (0.3, 0.7)) * 4), (10, 0.2, 0.5)),
    ),
}  # fmt: skip
HELD_OUT = "weaving"

CHANGED = {  # factors on the shipped vessel's derivatives
    "X_udot": 1.3, "Y_vdot": 0.85, "N_rdot": 0.8, "X_u": 1.25, "X_uu": 1.15, "Y_v": 0.8,
    "Y_vv": 1.2, "N_r": 1.5, "N_rr": 0.75, "Y_uv": 1.2, "Y_ur": 0.8, "N_uv": 1.3, "N_ur": 1.25,
}  # fmt: skip
ABOARD = {"mass": 16.4, "x_G": 0.04, "I_z": 2.1}  # with batteries and a sonar
FULL_THRUST = {"port": 51.0, "starboard": 50.0}  # N
EXPONENT, ASTERN_RATIO = 1.7, 0.6
CURRENT = {"speed": 0.12, "direction": math.radians(75)}  # m/s, and where to
NEUTRAL, SPAN = 1500, 400  # us
RATE, FIXES = 10.0, 2  # Hz of the rows; every so many have a satellite fix
GUSTS = 0.25  # of 1 % of full thrust: a calm day
NOISE = 2.0  # 0.1 m, 0.04 m/s, 1 deg, 0.4 deg/s
SEED = 20


def true_vessel() -> dict:
    """The document of the boat that is recorded; its thrusters take newtons."""
    document = copy.deepcopy(load(ROOT / "src" / "diffsea" / "vessel" / "data" / "blueboat.toml"))
    hull = document["hull"]
    hull |= {name: factor * hull[name] for name, factor in CHANGED.items()} | ABOARD
    for thruster in document["thruster"]:
        full = FULL_THRUST[thruster["name"]]
        thruster |= {"max_force": full, "min_force": -ASTERN_RATIO * full}
    return document


def truth() -> dict[str, float]:
    """True values by the names that a fit has for them."""
    hull = true_vessel()["hull"]
    found = {name: hull[name] for name in (*CHANGED, *ABOARD)}
    for side, full in FULL_THRUST.items():
        curve = {"full_thrust": full, "exponent": EXPONENT, "astern_ratio": ASTERN_RATIO}
        found |= {f"{side}.thrust_curve.{key}": value for key, value in curve.items()}
    return found


def thrust(side: str, share: float) -> float:
    """Newtons at a share of full order."""
    return FULL_THRUST[side] * (-ASTERN_RATIO if share < 0 else 1.0) * abs(share) ** EXPONENT


def recorded(name: str) -> dict[str, np.ndarray]:
    """One trial as the autopilot logs it, time from the beginning of the recording."""
    trial, vessel = TRIALS[name], true_vessel()
    seconds = sum(step[0] for step in trial.orders)
    psi = math.radians(trial.heading)
    along = CURRENT["direction"] - psi
    state = (0, 0, psi, CURRENT["speed"] * math.cos(along), CURRENT["speed"] * math.sin(along), 0)
    blow = gust(stream(SEED, name, "gust"), 0.0, seconds, GUSTS * gust_scale(vessel))
    sim = Simulator(vessel, {"current": CURRENT}, state, 0.0, gust=blow, **GUST)
    for duration, *shares in trial.orders:
        sim.order({s: thrust(s, o) for s, o in zip(FULL_THRUST, shares, strict=True)})
        sim.run(sim.t + duration)
    t = np.arange(round(trial.run_up * RATE), round(seconds * RATE) + 1) / RATE
    rows = record(sim, t, suite(NOISE, FIXES), stream(SEED, name, "noise"))
    for channel in "uv":  # of the same receiver
        rows[channel] = np.where(np.isnan(rows["x"]), np.nan, rows[channel])
    begin = np.cumsum([0.0, *(step[0] for step in trial.orders)])[:-1]
    now = np.searchsorted(begin, t + 1e-6, side="right") - 1
    for k, side in enumerate(FULL_THRUST, 1):
        share = np.array([step[k] for step in trial.orders], float)[now]
        rows[f"cmd_{side}"] = np.round(NEUTRAL + SPAN * share)
    return rows | {"t": np.round(t - t[0], 3)}


def main(folder: Path) -> None:
    """Write one recording of each trial into a folder, and what was true."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in TRIALS:
        write_csv(folder / f"{name}.csv", recorded(name))
    (folder / "truth.json").write_text(json.dumps(truth() | {"current": CURRENT}, indent=1) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m examples.blueboat.make_runs OUT")
    main(Path(sys.argv[1]))
