"""Missions with many masses of the vessel, beside timed orders in the controller's place.

Vessel, seconds, steps, periods and batches are the same: what differs is who orders.
"""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks import boats
from benchmarks.boats import BATCH
from benchmarks.record import UNIT, Figure

import tomli_w


TIMES = 3
SPREAD = 0.1  # of the mass, to both sides at most
COMMON = {"format": 1, "seconds": 120.0, "time_step": 0.05, "period": 0.25}
WAYPOINTS = [{"x": x, "y": y} for x, y in ((0.0, 0.0), (60.0, 0.0), (60.0, 20.0), (0.0, 20.0))]
STARTS = (0.0, 40.0, 80.0)  # s, of timed orders
POSES = (
    {"time": 0.0, "x": 0.0, "y": 0.0, "heading": 0.0},
    {"time": 80.0, "x": 10.0, "y": -10.0, "heading": 1.0},
)


def measure() -> list[Figure]:
    """Line of sight on the engine's boat, positioning on one with two azimuth thrusters."""
    import diffsea

    diffsea.prepare_jax()
    boat, ferry = boats.document(), boats.ferry()
    steered = {"controller": {"kind": "line-of-sight", "speed": 1.0}, "waypoint": WAYPOINTS}
    placed = {"controller": {"kind": "positioning"}, "step": list(POSES)}
    return [
        _in_turns("closed-loop-line-of-sight", boat, steered, ("port", "starboard")),
        _in_turns(
            "closed-loop-positioning",
            ferry,
            placed,
            ("bow.force", "bow.angle", "stern.force", "stern.angle"),
        ),
    ]


def _in_turns(
    name: str, vessel: dict[str, Any], closed: dict[str, Any], channels: tuple[str, ...]
) -> Figure:
    steps = [{"time": t, "orders": dict.fromkeys(channels, 5.0 + k)} for k, t in enumerate(STARTS)]
    opened = {"controller": {"kind": "orders"}, "step": steps}
    turns = [(_rate(vessel, closed), _rate(vessel, opened)) for _ in range(TIMES)]
    ours, theirs = map(list, zip(*turns, strict=True))
    return Figure(name, UNIT, ours, theirs, "the same with timed orders")


def _rate(vessel: dict[str, Any], mission: dict[str, Any]) -> float:
    """Vessel-steps/s of a mission with as many masses as the engine has boats."""
    import diffsea
    from diffsea.simulation.designs import LatinHypercube

    mass = vessel["hull"]["mass"]
    masses = {"vessel.mass": ((1 - SPREAD) * mass, (1 + SPREAD) * mass)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "boat.toml")
        path.write_text(tomli_w.dumps(vessel))
        document = COMMON | {"vessel": {"file": str(path)}} | mission
        done = diffsea.sweep_mission(document, LatinHypercube(masses, BATCH, 0))
    return done.found.steps_per_second
