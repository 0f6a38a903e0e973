"""A response that is late in two ways at once is found whole, and before either of its parts."""

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, usv
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.refits import refit_at_fixed_noise
from diffsea.diagnosis.screening import screen
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem


FREE = ("X_u", "N_r")
NAMES = (
    "thrust-delay:propulsion",
    "thrust-lag:propulsion",
    "rate-limit:propulsion",
    "actuator-response:propulsion",
    "actuator-response:propulsion-slew",
)
LATE = {  # parameters, what they are made of, and the hypothesis that has them all
    "lag": ({"delay": 0.7, "time_constant": 0.9}, "actuator-response:propulsion"),
    "slew": ({"delay": 0.7, "rate_limit": 60.0}, "actuator-response:propulsion-slew"),
}


@pytest.mark.slow
@pytest.mark.parametrize("way", LATE)
def test_a_late_answer_is_refitted_with_both_its_amounts(way):
    parameters, whole = LATE[way]
    run = random_steps(DOCUMENT, 5, 80.0, 0.25, {"actuator-response": parameters})
    effects = tuple(EFFECTS[name] for name in NAMES)
    problem = make_problem(usv(), [run], FREE, effects)
    nominal = estimate(problem, FREE)
    screening = screen(problem, nominal)
    refitted = {
        name: refit_at_fixed_noise(problem, nominal, screening.candidates[name]) for name in NAMES
    }
    best = max(refitted.values(), key=lambda one: one.evidence(one.inflation))
    assert best.effect == whole and best.is_physical
    place = problem.layout.physical(whole, best.estimate.coordinates)[0]
    found = EFFECTS[whole].decode(problem.base, np.asarray(place))
    assert {k: float(v) for k, v in found.items()} == pytest.approx(parameters, rel=0.2)
