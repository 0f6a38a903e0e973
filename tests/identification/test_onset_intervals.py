"""When a change began, where it may have begun at any moment of a pause."""

import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import ordered_run

from diffsea import EFFECTS
from diffsea.identification.fit import Start, estimate_surely
from diffsea.identification.problem import make_problem
from diffsea.identification.uncertainty.onsets import onset_interval
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles

SECONDS, STEP = 60.0, 0.25
PAUSE = 20.0, 40.0  # s, in which no thruster is ordered
LATE = {"factor": -0.4, "actuators": ["port", "starboard"]}


@pytest.mark.parametrize(
    "began, guessed, low, high",
    [(30.0, 33.0, (18.0, 24.0), (38.0, 42.0)), (10.0, 11.0, (8.5, 10.0), (10.0, 11.5))],
)
def test_a_change_in_a_pause_may_have_begun_at_any_moment_of_it(began, guessed, low, high):
    document, rng = load(ORACLE / "usv.toml"), np.random.default_rng(3)
    orders = []
    for t in np.arange(0.0, SECONDS, 4.0):
        size = 0.0 if PAUSE[0] <= t < PAUSE[1] else 1.0
        orders.append(
            (t, dict(zip(("port", "starboard"), size * rng.uniform(60, 210, 2), strict=True)))
        )
    late = {"thrust-change": {"time": began, **LATE}}
    run = ordered_run(document, orders, SECONDS, STEP, rng, late, noise=0.3)
    problem = make_problem(build(document), [run], ("X_u",), (EFFECTS["thrust-change"],))
    sizes = EFFECTS["thrust-change"].sizes(problem.base)
    start = np.zeros(problem.layout.size)
    start[problem.layout.indices(("thrust-change",))] = -0.2 / sizes[0], guessed / sizes[1]
    fitted = estimate_surely(problem, ("X_u", "thrust-change"), Start(start))
    found = onset_interval(problem, fitted, "thrust-change")
    assert low[0] < found[0] < low[1] and high[0] < found[1] < high[1]
