# pyright: reportArgumentType=false
"""Fixes of a satellite receiver, which wander by decimetres within a minute."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import Trajectory
from diffsea.identification.estimates import parameter_estimates
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


FREE = ("X_u", "X_uu", "Y_v", "N_r", "x_G")
WANDER, MEMORY = 0.4, 40.0  # m, s: a first-order Gauss-Markov process on each axis
STEP = 0.1


def wandering(run: Trajectory, seed: int) -> Trajectory:
    """A run of which positions, heading and yaw rate are known, and fixes wander."""
    rng, share = np.random.default_rng(seed), np.exp(-STEP / MEMORY)
    drawn = rng.normal(0, WANDER * np.sqrt(1 - share**2), (2, run.t.size))
    drawn[:, 0] = rng.normal(0, WANDER, 2)
    north, east = lfilter([1.0], [1.0, -share], drawn)
    gone = np.full_like(run.t, np.nan)
    return dataclasses.replace(run, x=run.x + north, y=run.y + east, u=gone, v=gone)


def test_how_fixes_wander_is_found_beside_the_vessel():
    """A Gauss-Markov error walks by sigma sqrt(2 / T) in the square root of a second.

    Taken for motion it biases N_r and x_G by twenty of their standard errors.
    """
    document = load(str(ORACLE / "usv.toml"))
    runs = [wandering(random_steps(document, seed, 120.0, STEP), seed) for seed in (14, 15, 16)]
    truth = {name: float(document["hull"][name]) for name in FREE}
    wrong = {"X_u": -35.0, "X_uu": -90.0, "Y_v": -350.0, "N_r": -650.0, "x_G": 0.2}
    problem = make_problem(build(document | {"hull": document["hull"] | wrong}), runs, FREE)
    fitted = estimate(problem, FREE)
    assert np.exp(fitted.noise.walk[0]) == pytest.approx(WANDER * np.sqrt(2 / MEMORY), rel=0.15)
    for found in parameter_estimates(problem.layout.parameters, fitted):
        assert abs(found.value - truth[found.name]) < 3 * found.std
