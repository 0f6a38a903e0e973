"""Sets whose files are no tables of one clock, milliAmpere and Kingfisher; a zig-zag's orders.

Orders hold from their stamp until the next; rows are those of the motion. Only what is known of
these sets beforehand is put right (units, and that milliAmpere's yaw is from north).
"""

import re
from pathlib import Path

from experiments.concealed_real.material import Run, Runs, Series

import numpy as np
import pandas as pd


EARTH_RADIUS = 6_371_000.0  # m
FORCE_OF_RPM = 2.0e-4  # N per rpm^2, of one of milliAmpere's thrusters
THRUSTERS = (1, 2, 3, 4)
AHEAD = 20.0  # N, what Kingfisher's vessel file takes for full ahead

STEP_LEAD, STEP_TAIL = 8.0, 15.0  # s of a Kingfisher run before and after its step
LONGEST_STEP = 45.0  # s
SHORTEST_STEP = 12.0

RUDDER_LEFT = np.radians(0.5)  # rad: a rudder that has left its place


def milliampere(folder: Path, feedback: bool) -> Run:
    """One milliAmpere run at the rows of its receiver.

    Arguments:
        feedback: with the measured speed and angle of each thruster, as `exec_` columns.
    """
    fixes = pd.read_csv(folder / "gnss_10hz.csv")
    fixes = fixes.dropna(subset=["quaternion_z", "twist_linear_x"]).reset_index(drop=True)
    t = fixes["t"].to_numpy()
    psi = np.unwrap(2 * np.arctan2(fixes["quaternion_z"], fixes["quaternion_w"]))
    latitude, longitude = (np.radians(fixes[c].to_numpy()) for c in ("latitude", "longitude"))
    east, north = fixes["twist_linear_x"].to_numpy(), fixes["twist_linear_y"].to_numpy()
    columns: dict[str, Series] = {
        "t": t,
        "x": EARTH_RADIUS * (latitude - latitude[0]),
        "y": EARTH_RADIUS * np.cos(latitude[0]) * (longitude - longitude[0]),
        "psi": psi,
        "u": north * np.cos(psi) + east * np.sin(psi),
        "v": -north * np.sin(psi) + east * np.cos(psi),
    }
    for i in THRUSTERS:
        given = pd.read_csv(folder / f"ref_{i}.csv")
        ordered = _thruster(t, f"cmd_a{i}", given, "throttle_reference", given, "angle_reference")
        columns |= ordered
        if feedback:
            speed = pd.read_csv(folder / f"motor_{i}.csv")
            angle = pd.read_csv(folder / f"azimuth_{i}.csv")
            measured = _thruster(t, f"exec_a{i}", speed, "motor_speed", angle, "azimuth_deg")
            apart = measured[f"exec_a{i}.angle"][0] - ordered[f"cmd_a{i}.angle"][0]
            measured[f"exec_a{i}.angle"] -= 2 * np.pi * np.round(apart / (2 * np.pi))
            columns |= measured
    return pd.DataFrame(columns)


def _thruster(
    t: Series, name: str, speeds: Run, speed: str, angles: Run, angle: str
) -> dict[str, Series]:
    """Force (N) and angle (rad, unwrapped) of one thruster, held at the times `t`."""
    rpm = held(t, speeds["t"].to_numpy(), speeds[speed].to_numpy())
    turned = np.unwrap(np.radians(held(t, angles["t"].to_numpy(), angles[angle].to_numpy())))
    turned -= 2 * np.pi * np.round(turned[0] / (2 * np.pi))
    return {f"{name}.force": FORCE_OF_RPM * rpm * np.abs(rpm), f"{name}.angle": turned}


def held(t: Series, stamps: Series, values: Series) -> Series:
    """Values that hold from their stamp until the next, at times `t`; the first one before it."""
    return values[np.maximum(np.searchsorted(stamps, t, side="right") - 1, 0)]


def kingfisher(folder: Path) -> Runs:
    """Kingfisher's steps straight ahead, a run each, by the order in per cent of full.

    Of a step there are two rows in `surge_cmd.csv`, its begin and its end; between steps nothing
    is ordered. Odometry has velocities on earth and no heading, so the speed is all that is known.
    """
    given, odometry = (pd.read_csv(folder / f"surge_{name}.csv") for name in ("cmd", "odom"))
    t = odometry["t"].to_numpy()
    speed = np.asarray(np.hypot(odometry["odom_vx"], odometry["odom_vy"]))
    stamps, port, starboard = given[["t", "cmd_left", "cmd_right"]].to_numpy().T
    runs: Runs = {}
    for k in range(len(stamps) - 1):
        begin, end, order = stamps[k], stamps[k + 1], port[k]
        steady = order == starboard[k] == port[k + 1] == starboard[k + 1]
        if not steady or order <= 0 or end - begin < SHORTEST_STEP:
            continue
        last = min(end + STEP_TAIL, begin + LONGEST_STEP)
        rows = (t >= begin - STEP_LEAD) & (t < last)
        now = t[rows]
        on = AHEAD * order * ((now >= begin) & (now < end))
        runs[f"step_{100 * order:03.0f}_{begin:.0f}.csv"] = pd.DataFrame(
            {"t": now, "u": speed[rows], "cmd_port": on, "cmd_starboard": on}
        )
    return runs


def zigzag_orders(name: str, run: Run) -> Run:
    """A zig-zag with the orders of its rule in place of the recorded rudder.

    The file's name has amplitude and check angle. The first execute is where the rudder first
    moves; every later one is where the heading passes the check angle on the rudder's side.
    """
    match = re.search(r"Z_(\d+)_(\d+)", name)
    if match is None:
        raise ValueError(f"{name} does not say which zig-zag it is")
    amplitude, check = (np.radians(float(number)) for number in match.groups())
    rudder, psi = run["exec_rudder"].to_numpy(), run["psi"].to_numpy()
    now = int(np.argmax(np.abs(rudder - rudder[0]) > RUDDER_LEFT))
    heading, side = np.mean(psi[: max(now, 1)]), np.sign(rudder[now] - rudder[0])
    given = np.zeros(len(psi))
    while now < len(psi):
        given[now:] = side * amplitude
        passed = np.flatnonzero(side * (psi[now:] - heading) >= check)
        if not passed.size:
            break
        now, side = now + int(passed[0]), -side
    return run.drop(columns="exec_rudder").assign(cmd_rudder=given)
