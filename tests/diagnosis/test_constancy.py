"""Whether an effect's size is one: a lasting gyro bias, and one that comes and goes."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, usv
from tests.runs import random_steps

from diffsea import EFFECTS, Trajectory
from diffsea.diagnosis.constancy import TOLERATED_SHARE, Constancy, constancy_test
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import make_problem


pytestmark = pytest.mark.slow


FREE, BIAS = ("X_u", "N_r"), 0.01  # rad/s
SECONDS, STEP = 96.0, 0.25


@pytest.fixture(scope="module")
def plain() -> Trajectory:
    """A run of the oracle without any bias."""
    return random_steps(DOCUMENT, 7, SECONDS, STEP)


def judged(run: Trajectory, bias: np.ndarray):
    """The test of a gyro bias fitted to a run whose yaw rate has some bias in each row."""
    biased = dataclasses.replace(run, r=run.r + bias)
    problem = make_problem(usv(), [biased], FREE, (EFFECTS["gyro-bias"],))
    without = estimate(problem, FREE)
    fitted = estimate(problem, (*FREE, "gyro-bias"), Start(without.coordinates))
    return constancy_test(problem, fitted, "gyro-bias", without.deviance - fitted.deviance)


def test_a_lasting_bias_has_one_size(plain):
    found = judged(plain, np.full(len(plain.t), BIAS))
    assert found.holds and found.share < 0.05
    assert found.scatter < 1.5
    assert not found.same_in_runs  # there is but one


def test_a_bias_that_comes_and_goes_in_each_half_has_not(plain):
    # Four eighths of the run, two in either half: halves alone would agree.
    on = np.isin(np.arange(len(plain.t)) * 8 // len(plain.t), (1, 3, 5, 7))
    found = judged(plain, np.where(on, 2 * BIAS, 0.0))
    assert not found.holds and found.share > 0.5
    assert found.scatter > 5


def test_a_bias_of_one_half_has_not(plain):
    late = np.arange(len(plain.t)) > len(plain.t) // 2
    assert not judged(plain, np.where(late, 2 * BIAS, 0.0)).holds


def test_a_sensor_error_must_be_there_all_the_time(plain):
    on = np.arange(len(plain.t)) * 12 // len(plain.t) != 5
    found = judged(plain, np.where(on, 4 * BIAS, 0.0))
    assert not found.holds and found._replace(tolerated=TOLERATED_SHARE).holds


def test_coefficients_of_a_wind_are_one_in_all_parts(plain):
    """Two components in each half or eighth, less those of the whole; three coefficients not."""
    name, boat = "wind:coefficients", usv()
    problem = make_problem(boat, [plain], FREE, (EFFECTS[name],))
    fitted = estimate(problem, (*FREE, name), rounds=1)
    assert len(problem.layout.indices((name,))) == 5
    assert constancy_test(problem, fitted, name, 10.0).degrees in (2, 14)


@pytest.mark.parametrize("name, parts", [("hard-iron:motors", (1, 7)), ("hard-iron", (2, 14))])
def test_an_estimators_deviation_is_a_law_that_holds_nearly(plain, name, parts):
    """One multiple of its components in each part, less the whole's; a compass's own are exact."""
    problem = make_problem(usv(), [plain], FREE, (EFFECTS[name],))
    begin = np.array(problem.start()[0])
    begin[problem.layout.indices((name,))[:2]] = 1.0
    fitted = estimate(problem, (*FREE, name), Start(begin), rounds=1)
    found = constancy_test(problem, fitted, name, 10.0)
    assert found.degrees in parts
    assert (found.tolerated == TOLERATED_SHARE) == (name == "hard-iron:motors")


SEVERAL_NUMBERS = {  # effect, its table, coordinates to start from
    "thrust-curve:law": (
        {"thrust-curve": {"deadband": 30.0, "gain": 1.4, "slope": 0.1}},
        (3.0, 0.0, 0.0, 0.0, 2.0, 0.0),
    ),
    "sway-yaw-coupling": ({"sway-yaw-coupling": {"Y_r": 60.0, "N_v": 40.0}}, (0.5, 0.5)),
}


@pytest.mark.parametrize("where", ["in both runs", "in one of them"])
@pytest.mark.parametrize(
    "name", ["sway-yaw-coupling", pytest.param("thrust-curve:law", marks=pytest.mark.proof)]
)
def test_a_law_of_several_numbers_has_one_size_where_their_proportion_is_the_same(name, where):
    """One multiple of all of them in each half or eighth of two runs, less that of the whole."""
    table, begin = SEVERAL_NUMBERS[name]
    effects = [table, table if where == "in both runs" else None]
    runs = [
        random_steps(DOCUMENT, 7 + k, SECONDS, STEP, effects=own) for k, own in enumerate(effects)
    ]
    problem = make_problem(usv(), runs, FREE, (EFFECTS[name],))
    without = estimate(problem, FREE)
    start = np.array(without.coordinates)
    start[problem.layout.indices((name,))] = begin
    fitted = estimate(problem, (*FREE, name), Start(start))
    found = constancy_test(problem, fitted, name, without.deviance - fitted.deviance)
    assert found.degrees in (3, 15)
    assert found.holds == found.same_in_runs == (where == "in both runs")


def test_errors_widened_by_the_scatter_of_parts_cover_their_mean():
    """Parts of equal weight whose sizes scatter three times as far as their errors say."""
    rng = np.random.default_rng(3)
    parts, errors, far = 8, 0.5, 3.0
    covered = []
    for _ in range(2000):
        sizes = 10 + far * errors * rng.normal(size=parts)
        statistic = float(((sizes - sizes.mean()) ** 2).sum() / errors**2)
        std = errors / np.sqrt(parts) * Constancy(statistic, 0.0, 0.0, degrees=parts - 1).scatter
        covered.append(abs(sizes.mean() - 10) < 1.645 * std)
    # Of a normal quantile with seven degrees of freedom; without the scatter it is 42 %.
    assert np.mean(covered) == pytest.approx(0.86, abs=0.03)
    assert Constancy(3.0, 0.9, 0.0, degrees=7).scatter == 1.0
    assert Constancy(0.0, 1.0, 0.0).scatter == 1.0
