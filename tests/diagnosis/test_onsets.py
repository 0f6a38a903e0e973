"""When a change began, of several times between which the likelihood has valleys."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, candidate, judged, usv
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.onsets import likeliest_of, with_onset_beside_others
from diffsea.identification.fit import Start, estimate_surely
from diffsea.identification.problem import make_problem
from diffsea.progress import no_progress


pytestmark = pytest.mark.compiles

BEGAN = 31.0  # s; thrusts are ordered anew every 4 s
FREE = ("X_u", "N_r", "thrust-change:starboard")


@pytest.fixture(scope="module")
def problem():
    hidden = {"thrust-change": {"time": BEGAN, "factor": -0.3, "actuators": ["starboard"]}}
    run = random_steps(DOCUMENT, 7, 60.0, 0.25, hidden)
    return make_problem(usv(), [run], FREE[:2], (EFFECTS[FREE[-1]],))


@pytest.fixture(scope="module")
def elsewhere(problem):
    """A fit that ended in another valley."""
    index, sizes = places(problem)
    start = np.zeros(problem.layout.size)
    start[index] = -0.1 / sizes[0], 42.0 / sizes[1]
    fitted = estimate_surely(problem, FREE, Start(start))
    assert abs(fitted.coordinates[index[1]] * sizes[1] - BEGAN) > 3.0
    return fitted


def places(problem):
    effect = EFFECTS[FREE[-1]]
    return problem.layout.indices((effect.name,)), effect.sizes(problem.base)


def test_a_fit_that_ended_in_another_valley_is_led_to_when_the_change_began(problem, elsewhere):
    index, sizes = places(problem)
    times = np.linspace(20.0, 58.0, 40) / sizes[1]
    found = likeliest_of(problem, elsewhere, int(index[1]), times)
    assert found.deviance < elsewhere.deviance - 10.0
    np.testing.assert_allclose(found.coordinates[index[1]] * sizes[1], BEGAN, atol=0.5)
    again = likeliest_of(problem, found, int(index[1]), times)
    assert again is found


def test_a_change_that_was_seen_at_another_time_is_sought_in_all_of_the_recordings(
    problem, elsewhere
):
    index, sizes = places(problem)
    one = candidate(FREE[-1], np.ones((3, 2)))
    at = tuple(elsewhere.coordinates[list(index)])
    seen = dataclasses.replace(one, point=dataclasses.replace(one.point, at=at), reach=0.01)
    found = dataclasses.replace(judged(FREE[-1], 50.0), candidate=seen, estimate=elsewhere)
    final, moved = with_onset_beside_others(problem, elsewhere, found, no_progress)
    assert final.deviance < elsewhere.deviance - 10.0
    time = final.coordinates[index[1]]
    np.testing.assert_allclose(time * sizes[1], BEGAN, atol=0.5)
    assert moved.candidate.point.at == (at[0], time) and moved.estimate is elsewhere
    again = with_onset_beside_others(problem, final, moved, no_progress)
    assert again[0] is final and again[1] is moved
    lasting = judged("gyro-bias", 50.0)
    same = with_onset_beside_others(problem, elsewhere, lasting, no_progress)
    assert same[0] is elsewhere and same[1] is lasting
