"""The battery D1 to D9 (Table IV), and why two of its trials cannot end as published."""

from math import pi

from experiments.harness.reporting import compared, table
from experiments.pytheas import printed
from experiments.pytheas.boat import SWING
from experiments.pytheas.sailing import Track, Trial, battery, boats, run

import numpy as np


BIASES = (10.0, 20.0, 30.0)  # N
DIRECTIONS = (pi / 4, pi / 2, 3 * pi / 4)
NAMES = tuple(f"D{k}" for k in range(1, 10))
PUBLISHED = (*["reached"] * 7, "struggled", "failed")
WAYPOINT, TOLERANCE = (20.0, 0.0), 2.5


def trials() -> Trial:
    """The nine trials of Table IV."""
    return battery(BIASES, DIRECTIONS)


def fly() -> dict[str, Track]:
    """The nine trials with the boat of Table I."""
    return dict(zip(NAMES, run(boats(9), trials()), strict=True))


def reached(D: float, lever: float) -> str:
    """Names of the trials that reach the waypoint with another D (m) or thruster position (m)."""
    flown = dict(zip(NAMES, run(boats(9, D=D, lever=lever), trials()), strict=True))
    return " ".join(name for name, track in flown.items() if ended(track.t, track.x, track.y)[0])


def printed_run(name: str, rotated: bool, seconds: float = 120.0, D: float | None = None):
    """A trial by the plain-Python equations; `rotated` takes (1) and (2) at their word."""
    k = NAMES.index(name)
    boat = printed.Boat() if D is None else printed.Boat(D=D)
    case = printed.Trial(WAYPOINT, TOLERANCE, BIASES[k % 3], SWING, DIRECTIONS[k // 3])
    return printed.run(boat, case, seconds, rotated=rotated)


def ended(t: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[bool, float, float]:
    """Whether the waypoint was reached, when the run ended (s), the closest approach (m)."""
    distance = np.hypot(x - WAYPOINT[0], y - WAYPOINT[1])
    return bool(distance[-1] <= TOLERANCE), float(t[-1]), float(distance.min())


def words(end: tuple[bool, float, float]) -> str:
    """A run's end in words."""
    reached, time, closest = end
    return f"reached after {time:.1f} s" if reached else f"not reached, closest {closest:.1f} m"


def steady_crossing(bias: float, direction: float, thrust: float = 20.0) -> float:
    """Least angle (rad) between a steady track and the waypoint's bearing, over all headings.

    At a steady heading the thruster points ahead and velocities are forces by damping: no
    controller that settles on a heading makes good a track closer to the waypoint's bearing.
    """
    heading = np.linspace(-pi, pi, 100_001)
    u = (thrust + bias * np.cos(direction - heading)) / 14
    v = bias * np.sin(direction - heading) / 80
    north = u * np.cos(heading) - v * np.sin(heading)
    east = u * np.sin(heading) + v * np.cos(heading)
    return float(np.abs(np.arctan2(east, north)).min())


def summary(tracks: dict[str, Track], plain: dict, rotated: dict) -> tuple[list[dict], str]:
    """Comparison rows, and the table of all nine by three ways of computing."""
    rows, lines = [], []
    for k, name in enumerate(NAMES):
        bias, direction = BIASES[k % 3], DIRECTIONS[k // 3]
        track = tracks[name]
        ends = [ended(track.t, track.x, track.y)]
        ends += [ended(*runs[name].T[:3]) for runs in (plain, rotated)]
        crossing = np.rad2deg(steady_crossing(bias, direction))
        lines.append((name, f"{bias:.0f} N, {np.rad2deg(direction):.0f} deg", PUBLISHED[k],
                      words(ends[0]), words(ends[2]), f"{crossing:.1f}"))  # fmt: skip
        rows.append({
            "trial": name, "published": PUBLISHED[k],
            **{key: dict(zip(("reached", "time", "closest"), end, strict=True))
               for key, end in zip(("library", "plain", "rotated"), ends, strict=True)},
            "steady_crossing_deg": crossing,
        })  # fmt: skip
    head = ("trial", "disturbance", "published", "obtained",
            "with positions turned by the heading", "least steady crossing, deg")  # fmt: skip
    return rows, table(head, lines)


def comparison_rows(trials: list[dict]) -> list[dict]:
    """Each trial's end beside the published word."""
    rows = []
    for trial in trials:
        ends = {way: words(tuple(trial[way].values())) for way in ("library", "rotated")}
        differs = ends["library"][:7] != ends["rotated"][:7]
        note = f"{ends['rotated']} with positions turned by the heading" if differs else ""
        rows.append(compared(trial["trial"], "", trial["published"], ends["library"], note))
    return rows
