"""The joint fit: all coefficients from all runs at once, by the library's gradients."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Literal

from experiments.vrx_wamv.campaign import Run
from experiments.vrx_wamv.models import document, vessel_of

import numpy as np

from diffsea import Parameter, Vessel, named
from diffsea.identification.estimates import FitOutcome, ParameterEstimate, parameter_estimates
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.objectives.output_error import OutputError
from diffsea.identification.problem import Problem, make_problem
from diffsea.parameters import hull_prior
from diffsea.vessel.files import build


LINEAR = ("mass", "I_z", "X_u", "Y_v", "N_r")
CURVES = ("port.curve.0", "starboard.curve.0")  # c of each engine
WHOLE = (*LINEAR, "x_G", "X_uu", "Y_vv", "N_rr", *CURVES)
# Table 1 and the thrust at rest are known beforehand, drag is a guess. The simulator takes
# thrust in N: it is the anchor of the scale that motion leaves free.
START = {
    "mass": 180.0, "I_z": 333.0, "X_u": -150.0, "Y_v": -150.0, "N_r": -600.0, "X_uu": -80.0,
    "Y_vv": -80.0, "N_rr": -400.0,
}  # fmt: skip
QUADRATIC = ("X_uu", "Y_vv", "N_rr")
SPREAD = 1.0  # of the priors: a factor of e is unremarkable
# Where a fit starts: at `START`; where the innovation likelihood leads from there, whose basin is
# wider; or at the coordinates where another fit ended.
Start = Literal["guessed", "afar"] | np.ndarray


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint fit."""

    rows: list[ParameterEstimate]
    seconds: float  # of processor time, all starts together
    coordinates: np.ndarray  # of the search, where another fit may start
    deviance: float  # -2 log posterior: of two fits to the same runs the less is the better
    outcome: FitOutcome

    @property
    def values(self) -> dict[str, float]:
        """The fitted numbers, c being the mean of the engines'."""
        found = {row.name: row.value for row in self.rows}
        slopes = [found.pop(name) for name in CURVES if name in found]
        return found | ({"c": sum(slopes) / len(slopes)} if slopes else {})

    @property
    def stds(self) -> dict[str, float]:
        """Standard errors of them; that of c is one engine's."""
        found = {row.name: row.std for row in self.rows}
        slopes = [found.pop(name) for name in CURVES if name in found]
        return found | ({"c": slopes[0]} if slopes else {})

    @property
    def vessel(self) -> Vessel:
        """The fitted model."""
        return vessel_of(self.values)


def fit_linear(runs: list[Run]) -> Joint:
    """The paper's model, masses free too, by the innovation likelihood.

    Its process noise takes up what the model cannot follow; an output error would not.
    """
    values = {key: value for key, value in START.items() if key not in QUADRATIC}
    plain = document(values)
    plain["hull"] = {k: v for k, v in plain["hull"].items() if k not in QUADRATIC}
    return _fit(build(plain), runs, LINEAR, Innovations)


def fit_whole(runs: list[Run], starts: Sequence[Start] = ("guessed",)) -> Joint:
    """The model with what the paper's lacks, by the error of free runs.

    From every one of `starts`; the fit is the one of least deviance.
    """
    return _fit(vessel_of(START), runs, WHOLE, OutputError, starts)


def _fit(
    vessel: Vessel,
    runs: list[Run],
    free: tuple[str, ...],
    objective: Callable[[Problem], AbstractObjective],
    starts: Sequence[Start] = ("guessed",),
) -> Joint:
    priors = {name: _prior(name, vessel) for name in free}
    began = time.process_time()
    recordings = [run.trajectory() for run in runs]
    problem = make_problem(vessel, recordings, free, priors=priors)
    aim = objective(problem)
    fits = [aim.fit(free, _coordinates(start, problem, free)) for start in starts]
    best = min(fits, key=lambda fit: fit.deviance)
    return Joint(
        parameter_estimates(aim.parameters, best), time.process_time() - began,
        best.coordinates, best.deviance, best.outcome,
    )  # fmt: skip


def _coordinates(start: Start, problem: Problem, free: tuple[str, ...]) -> np.ndarray | None:
    if isinstance(start, np.ndarray):
        return start
    return Innovations(problem).fit(free).coordinates if start == "afar" else None


def _prior(name: str, vessel: Vessel) -> Parameter:
    """The usual prior, wider; half a metre for the centre of gravity, 5 N s^2/m for c."""
    if name in CURVES:
        return Parameter(name, 0.0, 5.0, SPREAD, unit="N s^2/m")
    return hull_prior(name, float(named(vessel)[name]), SPREAD if name != "x_G" else 0.5)
