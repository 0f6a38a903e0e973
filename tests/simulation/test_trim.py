# pyright: reportArgumentType=false
"""The trim of a straight run against the oracle, and a track keeper that steers for it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle.simulator import Simulator
from tests.runs import state_of, varied
from tests.simulation.test_control import SHIP

from diffsea import run_controlled
from diffsea.parameters import replace
from diffsea.simulation.control import (
    ControlAllocation,
    straight_trim,
    throttle_for,
    track_keeper,
)
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


SPEED = 1.5
WIND = {"name": "wind", "speed": 7.0, "direction": 1.1, "frontal_area": 2.0, "lateral_area": 5.0}
CURRENT = {"name": "current", "speed": 0.3, "direction": 2.3}
WEATHERS = {"wind": [WIND], "current": [CURRENT], "both": [WIND, CURRENT]}
QUADRATIC = {"Y_v": 0.0, "N_v": 0.0, "Y_r": 0.0, "Y_vv": -300.0}  # no slope without drift


@functools.cache
def boat(weather: str, drag: str = "linear"):
    document = varied(SHIP, QUADRATIC if drag == "quadratic" else None, effects=WEATHERS[weather])
    return build(document), document


trim_of = jax.jit(straight_trim)


@pytest.mark.parametrize("drag", ["linear", "quadratic"])
@pytest.mark.parametrize("weather", WEATHERS)
@pytest.mark.parametrize("course", [0.0, 2.0, -2.5])
def test_a_trimmed_vessel_keeps_its_course(weather, drag, course):
    """The oracle, which knows nothing of trims, runs on straight as it was begun."""
    vessel, document = boat(weather, drag)
    trim = trim_of(vessel, SPEED, course)
    assert bool(trim.found) and abs(float(trim.crab)) > 0.02
    orders = ControlAllocation(vessel).orders(trim.throttle, trim.angle)
    state = (0.0, 0.0, course + float(trim.crab), SPEED, float(trim.sway), 0.0)
    sim = Simulator(document, state=state, command={c: float(o) for c, o in orders.items()})
    before = np.array(sim.state)
    sim.run(4.0)
    north, east = sim.state[:2]
    assert east * np.cos(course) - north * np.sin(course) == pytest.approx(0.0, abs=2e-4)
    np.testing.assert_allclose(sim.state[2:], before[2:], atol=2e-4)


def test_in_still_water_nothing_is_trimmed():
    vessel = build(SHIP)
    trim = straight_trim(vessel, SPEED, 0.7)
    assert bool(trim.found)
    assert [float(one) for one in trim[:3]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert float(trim.throttle) == pytest.approx(float(throttle_for(vessel, SPEED)))


def test_a_wind_too_strong_for_a_trim_says_so():
    vessel = build(varied(SHIP, effects=[{**WIND, "speed": 60.0}]))
    trim = straight_trim(vessel, SPEED, 0.0)
    assert not bool(trim.found) and float(trim.crab) == 0.0 and float(trim.angle) == 0.0


@pytest.mark.parametrize("drag", ["linear", pytest.param("quadratic", marks=pytest.mark.proof)])
def test_a_trim_has_the_derivative_of_its_differences(drag):
    """Also where there is no drift, where a quadratic drag has no slope."""
    vessel, _ = boat("current", drag)

    def trim(current):
        still = {"current_north": 0.1, "current_east": current}
        found = straight_trim(replace(vessel, still), SPEED, 0.4)
        return jnp.stack([found.crab, found.sway, found.angle, found.throttle])

    slope = jax.jit(lambda at: (trim(at), jax.jacfwd(trim)(at), jax.jacrev(trim)(at)))
    for east, step in ((0.0423, 1e-3), (0.25, 1e-3)):  # the first along the course, nearly
        forward, reverse = slope(east)[1:]
        wanted = (slope(east + step)[0] - slope(east - step)[0]) / (2 * step)
        np.testing.assert_allclose(forward, wanted, rtol=5e-3, atol=5e-3)
        np.testing.assert_allclose(reverse, forward, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_feedforward_takes_the_offset_that_a_wind_leaves():
    vessel, _ = boat("both")
    path = jnp.array([[0.0, 0.0], [150.0, 0.0]])

    def offset(feedforward: bool) -> float:
        """Largest distance from the leg once it is settled."""
        keeper = track_keeper(vessel, SPEED, path, 0.5, feedforward)
        run = run_controlled(vessel, keeper, state_of(u=SPEED), 80.0, 0.5, 0.25).trajectory
        late = np.asarray(run.valid) & (np.asarray(run.t) > 60)
        assert np.asarray(run.u)[late] == pytest.approx(SPEED, abs=0.01)
        return float(np.max(np.abs(np.asarray(run.y)[late])))

    assert offset(False) > 0.3 and offset(True) < 0.02
