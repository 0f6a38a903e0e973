"""Models of the boat as vessels of the library, all of one form, so that they share programs."""

from collections.abc import Mapping

from experiments.vrx_wamv.campaign import Run
from experiments.vrx_wamv.plant import CHANNELS, THRUST_PER_SPEED, Plant, speed_for

import numpy as np

from diffsea import Vessel, replay
from diffsea.simulation.replay import replay_errors
from diffsea.vessel.files import build


HULL = (
    "mass", "I_z", "x_G", "X_udot", "Y_vdot", "X_u", "X_uu", "Y_v", "Y_vv", "N_r", "N_rr",
)  # fmt: skip
# Table 1 of the paper.
SIZE = {"length": 4.0, "beam": 2.44, "draught": 0.089}


def document(values: Mapping[str, float], name: str = "vrx_wamv") -> dict:
    """A vessel file: hull numbers, thrust curve `c`, `d` (commands in rev/s) and engines' `arm`.

    What is not given is zero; thrust is the simulator's and the arm that of its description.
    """
    engine = {
        "x": 0.0, "max_speed": speed_for(2353.5), "min_speed": speed_for(-1000.0),
        "curve": {"c": float(values.get("c", 0.0)), "d": float(values.get("d", THRUST_PER_SPEED))},
    }  # fmt: skip
    arm = float(values.get("arm", 1.027))
    return {
        "format": 1, "name": name,
        "hull": SIZE | {key: float(values.get(key, 0.0)) for key in HULL},
        "thruster": [
            {"name": "port", "y": -arm, **engine}, {"name": "starboard", "y": arm, **engine},
        ],
    }  # fmt: skip


def vessel_of(values: Mapping[str, float], name: str = "vrx_wamv") -> Vessel:
    """The vessel of some values."""
    return build(document(values, name))


def truth(plant: Plant) -> dict[str, float]:
    """The plant's own numbers under the names of a vessel file."""
    pairs = {"X": (plant.surge, "u"), "Y": (plant.sway, "v"), "N": (plant.yaw, "r")}
    drag = {}
    for axis, ((linear, square), letter) in pairs.items():
        drag |= {f"{axis}_{letter}": 0.0 - linear, f"{axis}_{letter}{letter}": 0.0 - square}
    inertia = {"mass": plant.mass, "x_G": plant.x_G, "I_z": plant.I_zz - plant.mass * plant.x_G**2}
    return inertia | drag | {"c": 0.0, "d": THRUST_PER_SPEED}


def errors_on(vessel: Vessel, runs: list[Run]) -> dict[str, float]:
    """Errors of open-loop predictions of runs: rms of position (m), speed (m/s), yaw rate (rad/s).

    Against the true motion; every prediction starts from rest, as the runs do.
    """
    found = []
    for run in runs:
        recording = run.trajectory()
        exact = type(recording)(**{**vars(recording), **{c: run.true[c] for c in CHANNELS}})
        found.append(replay_errors(replay(vessel, exact), exact))
    return {key: float(np.sqrt(np.mean([e[key] ** 2 for e in found]))) for key in found[0]}
