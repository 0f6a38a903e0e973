"""When a change began, of several times between which the likelihood has valleys."""

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, usv
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.onsets import likeliest_of
from diffsea.identification.fit import Start, estimate_surely
from diffsea.identification.problem import make_problem


pytestmark = pytest.mark.compiles

BEGAN = 31.0  # s; thrusts are ordered anew every 4 s
FREE = ("X_u", "N_r", "thrust-change:starboard")


def test_a_fit_that_ended_in_another_valley_is_led_to_when_the_change_began():
    hidden = {"thrust-change": {"time": BEGAN, "factor": -0.3, "actuators": ["starboard"]}}
    run = random_steps(DOCUMENT, 7, 60.0, 0.25, hidden)
    effect = EFFECTS[FREE[-1]]
    problem = make_problem(usv(), [run], FREE[:2], (effect,))
    index, sizes = problem.layout.indices((effect.name,)), effect.sizes(problem.base)
    start = np.zeros(problem.layout.size)
    start[index] = -0.1 / sizes[0], 42.0 / sizes[1]
    elsewhere = estimate_surely(problem, FREE, Start(start))
    assert abs(elsewhere.coordinates[index[1]] * sizes[1] - BEGAN) > 3.0
    times = np.linspace(20.0, 58.0, 40) / sizes[1]
    found = likeliest_of(problem, elsewhere, int(index[1]), times)
    assert found.deviance < elsewhere.deviance - 10.0
    np.testing.assert_allclose(found.coordinates[index[1]] * sizes[1], BEGAN, atol=0.5)
    again = likeliest_of(problem, found, int(index[1]), times)
    assert again is found
