# pyright: reportArgumentType=false
"""A clock that is off against the orders, alone and beside a channel that is late, fitted from
zero: the oracle's runs of random steps of thrust, of which the orders were recorded.
"""

import dataclasses

import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import EFFECTS, Trajectory
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.identification.residual import innovations_at, linearise
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


CLOCK, LATE = EFFECTS["clock-drift"], EFFECTS["sensor-latency:yaw_rate"]
FREE = ("X_u", "N_r")
STEP = 0.2  # s


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


def fitted(document, offset: float, rate: float, delay: float, names: tuple[str, ...]) -> tuple:
    """Rate, offset and delay with their standard errors, by a fit from zero."""
    effects = {"clock-drift": {"offset": offset, "rate": rate}}
    if delay:
        effects["sensor-latency"] = {"delay": delay, "channels": ["r"]}
    run = whole_rows(random_steps(document, 5, 60.0, STEP, effects))
    problem = make_problem(build(document), [run], FREE, (CLOCK, LATE))
    found = estimate(problem, (*FREE, *names))
    sizes = np.concatenate([problem.layout.spreads()[: len(FREE)], *problem.layout.sizes])
    stds = np.zeros(problem.layout.size)
    stds[found.index] = found.stds
    return (found.coordinates * sizes)[len(FREE) :], (stds * sizes)[len(FREE) :], found


def whole_rows(run: Trajectory) -> Trajectory:
    """The run from its first second on: what a late channel shows before is of no run."""
    kept = run.t > 1.0 - 0.5 * STEP
    series = {name: getattr(run, name)[kept] for name in ("t", *MOTION_CHANNELS, "valid")}
    commanded = {name: values[kept] for name, values in run.commanded.items()}
    return dataclasses.replace(run, **series, commanded=commanded)


@pytest.mark.parametrize(
    ("offset", "rate"), [(0.3, 0.004), (0.3, -0.004), (-0.3, 0.004), (-0.3, -0.004)]
)
def test_offset_and_drift_of_either_sign_are_recovered(document, offset, rate):
    found, stds, fit = fitted(document, offset, rate, 0.0, (CLOCK.name,))
    away = np.abs(found[:2] - [rate, offset]) / stds[:2]
    assert (away < 3).all(), (found, stds)
    assert stds[0] < 4e-4 and stds[1] < 0.015


@pytest.mark.parametrize(("offset", "delay"), [(0.3, 0.0), (0.0, 0.4), (0.3, 0.4), (-0.3, 0.4)])
def test_a_clock_and_a_late_channel_are_told_apart(document, offset, delay):
    """Either alone leaves nothing for the other, and together both are what they are."""
    found, stds, fit = fitted(document, offset, 0.0, delay, (CLOCK.name, LATE.name))
    away = np.abs(found - [0.0, offset, delay]) / stds
    assert (away < 3).all(), (found, stds)
    assert stds[1] < 0.015 and stds[2] < 0.01
    correlation = fit.covariance[-2, -1] / np.prod(fit.stds[-2:])
    assert abs(correlation) < 0.6


def test_the_slope_at_a_clock_that_is_right_is_the_mean_of_both_sides(document):
    run = random_steps(document, 5, 60.0, STEP, {})
    problem = make_problem(build(document), [run], FREE, (CLOCK,))
    coordinates, noise = problem.start()
    gains = problem.run_filter(coordinates, noise).gains
    place = problem.layout.indices((CLOCK.name,))[1]  # the offset

    def at(step: float) -> np.ndarray:
        moved = np.array(coordinates, float)
        moved[place] += step
        return np.asarray(innovations_at(problem, gains, moved))

    step = 1e-4
    sides = (at(step) - at(0.0)) / step, (at(0.0) - at(-step)) / step
    slope = linearise(problem, gains, coordinates, [place]).jacobian[: len(sides[0]), 0]
    size = np.linalg.norm(slope)
    assert np.linalg.norm(sides[0] - sides[1]) > 0.5 * size
    assert np.linalg.norm(slope - 0.5 * (sides[0] + sides[1])) < 0.01 * size
