# pyright: reportArgumentType=false
"""A compass and a gyro that step in mid-run, on the oracle's runs with noise: found by screening
at the reading, and fitted to their size.
"""

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.starts import first_guess
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


FREE = ("X_u", "N_r")
STEP = 0.2  # s
STEPS = {
    "heading-offset:step": {"name": "heading-offset", "angle": 0.3, "time": 24.3},
    "gyro-bias:step": {"name": "gyro-bias", "bias": -0.03, "time": 24.3},
}


@pytest.mark.parametrize("name", STEPS)
def test_a_step_is_found_where_it_is_and_fitted_to_its_size(name):
    document = load(str(ORACLE / "usv.toml"))
    effect, table = EFFECTS[name], dict(STEPS[name])
    run = random_steps(document, 5, 60.0, STEP, {table.pop("name"): table})
    problem = make_problem(build(document), [run], FREE, tuple(EFFECTS[n] for n in STEPS))
    nominal = estimate(problem, FREE)
    found = screen(problem, nominal).candidates
    assert max(found, key=lambda one: found[one].expected) == name
    sizes = np.array(problem.layout.sizes[list(STEPS).index(name)])
    start = np.array(nominal.coordinates)
    place = problem.layout.indices((name,))
    start[place] = first_guess(found[name])
    assert start[place][1] * sizes[1] == pytest.approx(table["time"], abs=0.6)
    fit = estimate(problem, (*FREE, name), Start(start))
    std = fit.stds[list(fit.index).index(place[0])] * sizes[0]
    size, time = fit.coordinates[place] * sizes
    assert size == pytest.approx(table[effect.leading.key], abs=4 * std)
    assert std < 0.1 * abs(size)
    assert time == pytest.approx(table["time"], abs=0.5 * STEP + 0.01 if "angle" in table else 1.0)
    assert nominal.deviance - fit.deviance > 100


def test_a_turn_that_no_model_knows_is_no_step_of_the_compass():
    """A kick turns the boat by 0.1 rad between two readings, and nothing tells where she goes."""
    t = np.arange(-1.0, 61.0, 0.05)
    yaw = np.where((t > 24.2) & (t <= 24.4), 2.5, np.where((t > 24.4) & (t <= 24.6), -2.5, 0.0))
    kick = CubicSpline(t, np.stack([0 * t, 0 * t, yaw], axis=1))
    document = load(str(ORACLE / "usv.toml"))
    run = random_steps(document, 5, 60.0, STEP, {}, kick)
    unknown = np.full(run.t.shape, np.nan)
    run = dataclasses.replace(run, x=unknown, y=unknown, r=unknown)
    effects = tuple(EFFECTS[name] for name in STEPS)
    problem = make_problem(build(document), [run], FREE, effects)
    found = screen(problem, estimate(problem, FREE)).candidates["heading-offset:step"]
    assert found.expected < 5.0
