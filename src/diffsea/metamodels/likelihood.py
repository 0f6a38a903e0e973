"""Norrbin's metamodel by the innovation likelihood, every trial's disturbances as nuisances.

Each trial has a steady wind of its own and lasting gusts; both are estimated with the
coefficients, where `fit.identify` takes all that disturbs for white noise of the sensor.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffsea.identification.data.dataset import ANY_SHAPE, DatasetShape
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate
from diffsea.identification.problem import Problem, make_problem
from diffsea.metamodels.norrbin import Norrbin
from diffsea.parameters import Parameter
from diffsea.trajectory import Trajectory
from diffsea.vessel.effects import EFFECTS


NORRBIN_PARAMETERS = ("norrbin.a0", "norrbin.a1", "norrbin.a2", "norrbin.a3", "rudder.N_d")


@dataclasses.dataclass(frozen=True)
class LikelihoodFit:
    """What the likelihood found: the model, its covariance, and the whole estimate."""

    model: Norrbin
    covariance: Float[np.ndarray, "5 5"]  # in the order a_0, a_1, a_2, a_3, b
    estimate: Estimate
    problem: Problem


def identify_by_likelihood(
    recordings: Sequence[Trajectory],
    start: Norrbin,
    length: float,
    speed: float,
    wind_angle: float = math.radians(1.0),
    least: DatasetShape = ANY_SHAPE,
) -> LikelihoodFit:
    """Coefficients by the innovation likelihood, disturbances of every trial as nuisances.

    Arguments:
        recordings: trials with yaw rate, heading or both, and the rudder (rad).
        start: where to start from, such as what `identify` found.
        length: of the vessel, m; with it sizes of gusts are judged.
        speed: of the trials, m/s.
        wind_angle: the rudder angle (rad) that wind of 10 m/s would ask for: it sets how far the
            trials' own moments may be from zero, three times as far for 15 m/s.
        least: shape of the dataset; fits of one shape share their compiled programs.

    Wind is each trial's own, two components in the earth, zero on average over trials; gusts
    of yaw acceleration that last have their strength and memory estimated.
    """
    runs = [_yaw_only(run, speed) for run in recordings]
    vessel = start.vessel(length, speed, wind_moment=wind_angle * float(start.b))
    problem = make_problem(
        vessel,
        runs,
        NORRBIN_PARAMETERS,
        (EFFECTS["wind"],),
        per_run=True,
        capacity=2,
        priors=_wide_priors(start),
        least=least,
    )
    found = estimate(problem, (*NORRBIN_PARAMETERS, "wind"))
    pairs = zip(problem.layout.parameters, found.coordinates, strict=False)
    values = {p.name: p.decode(c) for p, c in pairs}
    scale = np.array([p.scale for p in problem.layout.parameters])
    order = [problem.layout.indices((name,))[0] for name in NORRBIN_PARAMETERS]
    place = [list(found.index).index(k) for k in order]
    covariance = found.covariance[np.ix_(place, place)] * np.outer(scale[order], scale[order])
    model = Norrbin(*(float(values[name]) for name in NORRBIN_PARAMETERS))
    return LikelihoodFit(model, covariance, found, problem)


def _yaw_only(run: Trajectory, speed: float) -> Trajectory:
    """The recording without what the metamodel says nothing of, at its constant speed."""
    nothing = np.full(np.shape(run.t), np.nan)
    steady = np.full(np.shape(run.t), speed)
    rudder = {
        group: {c: s for c, s in getattr(run, group).items() if c == "rudder"}
        for group in ("commanded", "executed")
    }
    return dataclasses.replace(
        run, x=nothing, y=nothing, u=steady, v=0 * steady, extra={}, **rudder
    )


def _wide_priors(start: Norrbin) -> dict[str, Parameter]:
    """Wide normal priors about the start: they rule nothing out."""
    T = 1 / max(abs(float(start.a1)), 1e-6)
    usual = math.radians(0.5)  # rad/s
    b = abs(float(start.b))
    sizes = (b * math.radians(2.0), 1 / T, 1 / (T * usual), 1 / (T * usual**2), b)
    values = (start.a0, start.a1, start.a2, start.a3, start.b)
    return {
        name: Parameter(name, float(value), float(size), 3.0)
        for name, value, size in zip(NORRBIN_PARAMETERS, values, sizes, strict=True)
    }
