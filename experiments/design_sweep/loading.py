"""The designs: an Otter loaded to a mass and pushed by a thrust, and the trials it runs."""

import dataclasses
import math
from typing import Any

import numpy as np

from diffsea import TrialPlan, Vessel, named
from diffsea.simulation import planning
from diffsea.simulation.control import speed_for, throttle_for_thrust
from diffsea.simulation.designs import Designs
from diffsea.types import Scalar


STEP = 0.1  # s; the error it makes is measured, see `independent`
THRUST = (60.0, 230.0)  # N, both thrusters together; 239.4 N is all they have
MASS = (60.0, 160.0)  # kg
NAMES = ("thrust", "mass", "I_z", "draught", "X_udot", "Y_vdot", "N_rdot")


@dataclasses.dataclass(frozen=True)
class Kind:
    """A trial of the sweep: angles in degrees, the time limit in lengths at the lowest speed."""

    label: str
    manoeuvre: str
    angle: float
    heading: float
    lengths: float


KINDS = (
    Kind("circle", "turning-circle", 35.0, 0.0, 40.0),
    Kind("zigzag 10/10", "zigzag", 10.0, 10.0, 16.0),
    Kind("zigzag 20/20", "zigzag", 20.0, 20.0, 16.0),
)
_EXECUTES = 3
_APPROACH = 2.5  # lengths; it starts steady, and two of them settle that


def loaded(vessel: Vessel, mass: Scalar) -> dict[str, Scalar]:
    """What changes with the mass (kg) of a wall-sided hull of the vessel's shape.

    The radius of gyration stays; draught and added mass in surge grow with the mass, added
    mass in sway and in yaw with the square of the draught (strip theory). Drag in surge and
    the linear and quadratic yaw damping, known for one loading only, stay.
    """
    base = named(vessel)
    ratio = mass / base["mass"]
    powers = {"I_z": 1, "draught": 1, "X_udot": 1, "Y_vdot": 2, "N_rdot": 2}
    changed: dict[str, Any] = {name: base[name] * ratio**k for name, k in powers.items()}
    return {"mass": mass} | changed


def designs(vessel: Vessel, thrust: np.ndarray, mass: np.ndarray) -> Designs:
    """A row for every pair of thrust (N) and mass (kg)."""
    columns = {"thrust": thrust} | loaded(vessel, mass)
    return Designs(NAMES, np.stack([np.asarray(columns[name], float) for name in NAMES], axis=-1))


def axes(thrusts: int, masses: int) -> tuple[np.ndarray, np.ndarray]:
    """The values on the axes of a grid."""
    return np.linspace(*THRUST, thrusts), np.linspace(*MASS, masses)


def plan(vessel: Vessel, kind: Kind) -> TrialPlan:
    """The trial with a time limit that every design of the ranges keeps."""
    lowest = float(speed_for(vessel, throttle_for_thrust(vessel, THRUST[0])))
    passing = float(vessel.rigid_body.length) / lowest  # s
    settled = planning.plan_trial(
        vessel, kind.manoeuvre, math.radians(kind.angle), math.radians(kind.heading) or None,
        thrust=THRUST[0], step=STEP, executes=_EXECUTES,
        seconds=planning.round_up(kind.lengths * passing),
    )  # fmt: skip
    return dataclasses.replace(settled, approach_seconds=planning.round_up(_APPROACH * passing))


def saturation(vessel: Vessel, angle: float) -> float:
    """Total thrust (N) above which the outer thruster of an angle (deg) is at its limit."""
    base = named(vessel)
    most = base["port.curve.1"] * base["port.upper"] ** 2  # N, of one thruster
    return float(2 * most / (1 + angle / 35.0))
