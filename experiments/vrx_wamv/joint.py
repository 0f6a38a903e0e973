"""The joint fit: all coefficients from all runs at once, by the library's gradients."""

import copy
import dataclasses
import time

import numpy as np
from campaign import Run
from plant import THRUST_PER_SPEED
from procedure import PUBLISHED

from diffsea.identification.study import Settings, Study, identify
from diffsea.parameters import named, replace
from diffsea.priors import Parameter, hull_prior
from diffsea.vessel.base import Vessel
from diffsea.vessel.catalogue import build


LINEAR = ("mass", "I_z", "X_u", "Y_v", "N_r")
WHOLE = (*LINEAR, "x_G", "X_uu", "Y_vv", "N_rr", "port.curve.0", "starboard.curve.0")
SPREAD = 1.0  # of the priors: a factor of e is unremarkable


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint fit."""

    study: Study
    vessel: Vessel
    seconds: float

    @property
    def rows(self) -> dict[str, dict]:
        """The table of parameters by name."""
        return {row["name"]: row for row in self.study.rows}


def start_document(quadratic: bool) -> dict:
    """What is known beforehand: Table 1 and thrust by engine speed; drag is a guess.

    Thrust is the anchor of the scale: the simulator takes it in N.
    """
    document = copy.deepcopy(PUBLISHED.document("vrx_wamv", ""))
    document["hull"] |= {"X_udot": 0.0, "Y_vdot": 0.0, "X_u": -150.0, "Y_v": -150.0, "N_r": -600.0}
    if quadratic:
        document["hull"] |= {"x_G": 0.0, "X_uu": -80.0, "Y_vv": -80.0, "N_rr": -400.0}
    for engine in document["thruster"]:
        engine["curve"] = {"c": 0.0, "d": THRUST_PER_SPEED}
        engine["y"] = np.sign(engine["y"]) * 1.027
    return document


def fit(runs: list[Run], quadratic: bool) -> Joint:
    """Fit the linear model, or the one with what it lacks: free-run error, windows joined."""
    vessel = build(start_document(quadratic))
    free = WHOLE if quadratic else LINEAR
    slopes = {name: Parameter(name, 0.0, 5.0, SPREAD) for name in free if "curve" in name}
    priors = {name: _wide(name, vessel) for name in free if name not in slopes}
    settings = Settings(
        objective="free-run", free=free, anchor="thrust", priors=priors | slopes, profiles=()
    )
    began = time.perf_counter()
    study = identify(vessel, [run.trajectory() for run in runs], settings)
    seconds = time.perf_counter() - began
    return Joint(study, replace(vessel, study.values), seconds)


def _wide(name: str, vessel: Vessel) -> Parameter:
    """The usual prior, wider; that of the centre of gravity is half a metre wide."""
    return hull_prior(name, float(named(vessel)[name]), SPREAD if name != "x_G" else 0.5)
