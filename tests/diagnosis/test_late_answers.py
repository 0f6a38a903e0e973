"""A response that is late in two ways at once, or on one side, is found before what is like it."""

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, usv
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.refits import refit_at_fixed_noise
from diffsea.diagnosis.screening import screen
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.vessel.effects import catalogue_name


FREE = ("X_u", "N_r")
NAMES = (
    "thrust-delay:propulsion",
    "thrust-delay:port",
    "thrust-delay:starboard",
    "thrust-lag:propulsion",
    "rate-limit:propulsion",
    "actuator-response:propulsion",
    "actuator-response:propulsion-slew",
    "actuator-response:port",
    "actuator-response:starboard",
)
BOTH = ["port", "starboard"]
LATE = {  # parameters, actuators, and the hypothesis that has them all
    "lag": ({"delay": 0.7, "time_constant": 0.9}, BOTH, "actuator-response:propulsion"),
    "slew": ({"delay": 0.7, "rate_limit": 60.0}, BOTH, "actuator-response:propulsion-slew"),
    "port": ({"delay": 0.5}, ["port"], "thrust-delay:port"),
    "starboard": (
        {"delay": 0.4, "time_constant": 0.8},
        ["starboard"],
        "actuator-response:starboard",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "way",
    [pytest.param(way, marks=() if way in ("lag", "port") else pytest.mark.proof) for way in LATE],
)
def test_a_late_answer_is_refitted_with_all_its_amounts(way):
    parameters, actuators, whole = LATE[way]
    truth = {catalogue_name(whole): parameters | {"actuators": actuators}}
    run = random_steps(DOCUMENT, 5, 80.0, 0.25, truth)
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
