# pyright: reportArgumentType=false
"""Still water: speeding up towards eight waypoints (Table III), and tight turns (figure 5)."""

from typing import cast

from experiments.harness.reporting import compared, table
from experiments.pytheas import printed
from experiments.pytheas.boat import BEAM, LENGTH, MASS, TOP_SPEED, WATER, draught
from experiments.pytheas.sailing import Track, Trial, around, boats, run, spread

import numpy as np
from scipy.optimize import fsolve


BEARINGS = np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0])
TIMES = (2.4, 2.6, 3.0, 4.1, 5.1)  # s, Table III
DISTANCES = (2.7, 2.8, 3.0, 3.1, 3.2)  # m
SHARE = 0.99  # of the terminal speed: what "the maximum forward speed of 1.4 m/s" is taken for
REACHED = SHARE * TOP_SPEED  # m/s
THRUSTS = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0)  # N, figure 5
# Readings of D, which the paper does not define; a draught, as the same formulas have it elsewhere.
READINGS = {
    "draught of two semicircular hulls (taken)": float(draught()),
    "draught of one semicircular hull": float(draught(hulls=1)),
    "draught of a box": MASS / (WATER * LENGTH * BEAM),
    "diameter of a cylinder that displaces the mass": 2 * float(draught()),
    "width of the boat": BEAM,
}  # fmt: skip


def eight_waypoints() -> list[Track]:
    """Runs to waypoints 20 m away, every 45 degrees from -135 to 180."""
    bearings = np.deg2rad(np.arange(-135.0, 181.0, 45.0))
    return run(boats(8), around(20.0, bearings))


def acceleration(names: list[str], lever: float) -> dict[str, np.ndarray]:
    """Time (s) and distance (m) to the top speed at each bearing, for readings of D."""
    D = np.repeat([READINGS[name] for name in names], len(BEARINGS))
    trials = around(20.0, np.tile(BEARINGS, len(names)))
    found = run(boats(len(D), D=D, lever=lever), trials)
    measured = np.array([track.at_speed(REACHED) for track in found])
    return dict(zip(names, measured.reshape(len(names), len(BEARINGS), 2), strict=True))


def table_three(measured: np.ndarray) -> list[dict]:
    """Table III beside what was obtained; what was taken for it stands in every row."""
    taken = f"to {100 * SHARE:.0f} % of {TOP_SPEED:.3f} m/s; D {draught():.3f} m, thruster ahead"
    rows = []
    for k, bearing in enumerate(np.rad2deg(BEARINGS)):
        time, distance = measured[k]
        note = taken if k else f"{taken}; the share was chosen by this row"
        rows += [
            compared(f"time to top speed, waypoint at {bearing:.0f} deg", "s", TIMES[k], time,
                     note),
            compared(f"distance covered by then, {bearing:.0f} deg", "m", DISTANCES[k], distance,
                     taken),
        ]  # fmt: skip
    return rows


def rotated_acceleration() -> np.ndarray:
    """Table III by the plain equations with positions turned by the heading.

    The distance is the integral of the speed: such positions also move where the boat only turns.
    """
    rows = []
    for bearing in BEARINGS:
        trial = printed.Trial((20 * np.cos(bearing), 20 * np.sin(bearing)))
        t, _, _, _, u, v, _ = printed.run(printed.Boat(), trial, 14.0, rotated=True).T
        k = int(np.argmax(u >= REACHED))
        rows.append((t[k], np.trapezoid(np.hypot(u, v)[: k + 1], t[: k + 1])))
    return np.array(rows)


def literal_reading(track: Track) -> dict:
    """Time and distance to 1.4 m/s taken literally, straight ahead, and by closed form.

    With `m_x u' = F - d_1 u`, u = (F / d_1) (1 - exp(-t d_1 / m_x)).
    """
    time, distance = track.at_speed(1.4)
    lag = np.array([1.01, 1.03, 1.05]) * MASS / 14.0
    closed = -lag * np.log(1 - 1.4 / TOP_SPEED)
    return {"time": time, "distance": distance, "closed_form_r_0.01_0.03_0.05": closed}


def readings_table(found: dict[str, dict[str, np.ndarray]], reached: dict[str, str]) -> str:
    """Times by the reading of D and the thruster's place, with the largest error.

    `reached` has the trials of Table IV that end well, by reading and place.
    """
    rows = [("published", "", *TIMES, "", "", "D1 to D8")]
    for place, readings in found.items():
        for name, values in readings.items():
            off = np.abs(values - np.stack([TIMES, DISTANCES], axis=-1))
            worst = [
                "never" if np.isnan(part).any() else f"{part.max():.2f}"
                for part in (off[:, 0], off[:, 1])
            ]
            times = [f"{value:.2f}" if np.isfinite(value) else "never" for value in values[:, 0]]
            ends = reached.get(f"{name}, {place}")
            rows.append((f"{name}: {READINGS[name]:.3f} m", place, *times, *worst, ends))
    head = ("D", "thruster", *(f"{b:.0f} deg, s" for b in np.rad2deg(BEARINGS)),
            "largest error, s", "largest error, m", "reached of D1 to D9")  # fmt: skip
    return table(head, rows)


def tightest_turns() -> dict[float, Track]:
    """Figure 5: from rest to a waypoint astern, for full thrusts of 5 to 80 N."""
    count = len(THRUSTS)
    trials = spread(Trial(-1.5, 0.0, tolerance=1.0), count)
    return dict(zip(THRUSTS, run(boats(count, thrust=THRUSTS), trials), strict=True))


def turning_radius(track: Track) -> float:
    """Half the width of a half turn, m."""
    return float(track.y.max() - track.y.min()) / 2


def rotated_widths(quick: bool) -> dict[float, float]:
    """Half the width of the half turns (m) with positions turned by the heading."""
    trial, widths = printed.Trial((-1.5, 0.0), 1.0), {}
    for thrust in THRUSTS[-1:] if quick else THRUSTS:
        track = printed.run(printed.Boat(thrust=thrust), trial, 110.0, rotated=True)
        widths[thrust] = float(np.ptp(track[:, 2])) / 2
    return widths


def steady_radius(thrust: float) -> float:
    """Radius (m) of the steady turn at full angle under a thrust (N): the roots of (4) to (6)."""
    boat = printed.Boat()
    m_x, m_y, _ = boat.inertia
    b = boat.full_angle

    def forces(motion: np.ndarray) -> list[float]:
        u, v, r = motion
        return [
            thrust * np.cos(b) + m_y * v * r - 14 * u,
            thrust * np.sin(b) - m_x * u * r - 80 * v,
            boat.lever * thrust * np.sin(b) - (m_y - m_x) * u * v - 5 * r,
        ]

    start = [thrust * np.cos(b) / 14, thrust * np.sin(b) / 80, boat.lever * thrust / 5]
    u, v, r = cast(np.ndarray, fsolve(forces, start))
    return float(np.hypot(u, v) / r)


def turning_rows(turns: dict[float, Track]) -> list[dict]:
    """The published "around 0.2 m" beside the radius at each thrust."""
    return [
        compared(f"smallest turning radius at {thrust:.0f} N", "m", "around 0.2",
                 turning_radius(track), "half the width of a half turn")
        for thrust, track in turns.items()
    ]  # fmt: skip
