"""What is in a compiled program, and where a cubic crosses zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.diagnosis.small import usv

from diffsea import EFFECTS, Environment, State, named
from diffsea.kinematics import through_water
from diffsea.scales import Scalar, is_absent
from diffsea.simulation.switching import hermite_root
from diffsea.types import as_inputs


STATE = State(*(jnp.asarray(value) for value in (0.0, 0.0, 0.4, 1.1, 0.2, 0.1)))
NOTICEABLE = ("current", "wind", "shallow-water", "mass-change", "thrust-loss-with-speed",
              "thrust-loss-in-turns")  # fmt: skip


def program(vessel):
    """The program of the vessel's rate, of the time alone."""
    executed: dict[str, Scalar] = {channel: 20.0 for channel in vessel.channels}
    rate = lambda t: vessel.rate(STATE, executed, vessel.environment, t)
    return jax.make_jaxpr(rate)(3.0).jaxpr


def test_what_is_zero_is_an_input_no_more():
    inputs = named(as_inputs(usv()))
    for name, value in named(usv()).items():
        assert is_absent(inputs[name]) == (float(value) == 0), name
        assert float(inputs[name]) == float(value)
    assert is_absent(0.0, 0) and not is_absent(0.0, jnp.zeros(())) and not is_absent(np.zeros(()))


@pytest.mark.parametrize("name", NOTICEABLE)
def test_a_vessel_that_lacks_something_has_a_shorter_program_and_the_same_motion(name):
    effect, vessel = EFFECTS[name], usv()
    zero = jnp.zeros(len(effect.coordinates))
    there = effect.apply(vessel, zero)  # traced numbers: it may come to be
    assert len(program(vessel).eqns) < len(program(there).eqns)
    executed: dict[str, Scalar] = {channel: 20.0 for channel in vessel.channels}
    rates = [one.rate(STATE, executed, one.environment, 3.0) for one in (vessel, there)]
    for one, other in zip(*map(jax.tree.leaves, rates), strict=True):
        assert float(one) == pytest.approx(float(other), rel=1e-14)


def test_without_a_current_the_motion_through_the_water_is_that_over_ground():
    assert through_water(STATE, Environment()) is STATE
    flowing = Environment(current_north=jnp.zeros(()))
    assert through_water(STATE, flowing) is not STATE


def test_what_changes_with_time_is_in_no_program_of_a_vessel_that_does_not_change():
    time_is_used = lambda one: any(one.invars[0] in step.invars for step in one.eqns)
    assert not time_is_used(program(usv()))
    payload = EFFECTS["mass-change"].apply(usv(), jnp.zeros(2))
    assert time_is_used(program(payload))


@pytest.mark.parametrize("seed", range(40))
def test_the_root_of_a_cubic_is_found(seed):
    rng = np.random.default_rng(seed)
    first, last = -rng.uniform(0.01, 1.0), rng.uniform(0.0, 1.0)
    rise = last - first
    begin, end = rise * rng.uniform(0.5, 1.5, 2)  # growing throughout
    root = float(hermite_root(first, last, begin, end))
    cubic = np.polynomial.Polynomial(
        [first, begin, 3 * rise - 2 * begin - end, begin + end - 2 * rise]
    )
    assert 0 <= root <= 1 and abs(cubic(root)) < 1e-9 * rise


def test_an_event_that_is_over_is_at_the_beginning():
    assert float(hermite_root(0.0, 0.3, 0.2, 0.4)) == 0.0
    assert float(hermite_root(0.1, 0.3, 0.2, 0.2)) == 0.0
    assert 0 <= float(hermite_root(-0.1, -0.1, 0.0, 0.0)) <= 1
