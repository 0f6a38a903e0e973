"""A few of the designs against the tests' simulator, which shares no code with the library."""

import tomllib
from importlib import resources

from experiments.design_sweep.loading import KINDS, Kind
from experiments.design_sweep.sweeping import Swept

import numpy as np
from tests.oracle import trials as oracle


ANGLE = np.radians
COMPARED = {
    "circle": ("advance", "transfer", "tactical_diameter", "peak_yaw_rate"),
    "zigzag 10/10": ("overshoot_1", "overshoot_2", "peak_yaw_rate"),
    "zigzag 20/20": ("overshoot_1", "overshoot_2", "peak_yaw_rate"),
}


def document(mass: float) -> dict:
    """The Otter's file loaded to a mass (kg), in words that the other simulator knows."""
    text = resources.files("diffsea.vessel").joinpath("data/otter.toml").read_text()
    vessel = tomllib.loads(text)
    hull, ratio = vessel["hull"], mass / vessel["hull"]["mass"]
    for name, power in (
        ("mass", 1), ("I_z", 1), ("draught", 1), ("X_udot", 1), ("Y_vdot", 2), ("N_rdot", 2),
    ):  # fmt: skip
        hull[name] *= ratio**power
    for thruster in vessel["thruster"]:
        thruster["limit"] = thruster["max_speed"]
    # The other simulator always has the Munk moment; this takes it out again.
    moment = {"name": "munk-moment", "Y_vdot - X_udot": hull["X_udot"] - hull["Y_vdot"]}
    vessel["effect"].append(moment)
    return vessel


def trial(kind: Kind, thrust: float, mass: float) -> dict[str, float]:
    """Numbers of one design's trial by the other simulator: adaptive steps, located events."""
    vessel = document(mass)
    if kind.manoeuvre == "turning-circle":
        return oracle.circle(vessel, thrust, ANGLE(kind.angle), turns=1.5).metrics
    return oracle.zigzag(vessel, thrust, ANGLE(kind.angle), ANGLE(kind.heading), executes=4).metrics


def drawn(found: Swept, count: int, seed: int = 0) -> list[int]:
    """Rows of the tables, at random."""
    total = found.mass.size * found.thrust.size
    return np.random.default_rng(seed).choice(total, count, replace=False).tolist()


def differences(found: Swept, rows: list[int]) -> list[dict]:
    """Relative differences of the sweep's numbers from the other simulator's."""
    result = []
    for row in rows:
        for kind in KINDS:
            if kind.label not in found.tables:
                continue
            ours = found.tables[kind.label].iloc[row]
            theirs = trial(kind, float(ours["thrust"]), float(ours["mass"]))
            for name in COMPARED[kind.label]:
                result.append(
                    {
                        "thrust": float(ours["thrust"]), "mass": float(ours["mass"]),
                        "trial": kind.label, "number": name, "swept": float(ours[name]),
                        "independent": theirs[name],
                        "relative_difference": float(ours[name]) / theirs[name] - 1,
                    }
                )  # fmt: skip
    return result
