"""A boat whose orders act late, which its model does not know."""

import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


@pytest.fixture(scope="session")
def late_orders():
    """The fit of three derivatives to two runs of it: innovations are not white."""
    document = load(str(ORACLE / "usv.toml"))
    effects = {"thrust-delay": {"delay": 0.4, "actuators": ["port", "starboard"]}}
    runs = [random_steps(document, seed, 60.0, 0.25, effects) for seed in (4, 5)]
    return make_problem(build(document), runs, ("X_u", "Y_v", "N_r"))


@pytest.fixture(scope="session")
def late_orders_fitted(late_orders):
    """Its estimate."""
    return estimate(late_orders, ("X_u", "Y_v", "N_r"))
