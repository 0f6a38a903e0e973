"""The simulator that goes into functional mock-up units, against diffsea's own."""

import ast
import inspect
import json
import sys
import tomllib

import numpy as np
import pytest
from tests.boats import BOAT, SWELL
from tests.exports import models

from diffsea.errors import UserError
from diffsea.exports import planar_model
from diffsea.exports.equations import equations_of, require_nothing_lost
from diffsea.exports.planar_model import PlanarVessel
from diffsea.vessel.files import build, read_vessel, shipped_vessels


# Stages of a servo, losses and laws that no vessel that ships has.
ODD = """
[[thruster]]
name = "curved"
x = 0.5
y = 0.3
angle = 0.4
unit = "percent"
max_force = 120.0
min_force = -60.0
deadband = 3.0
asymmetry = 0.1
with_speed = 0.05
in_turns = 0.2
rate_limit = 60.0
time_constant = 0.3
delay = 0.7
[thruster.thrust_curve]
full_thrust = 150.0
exponent = 1.6
deadband = 0.05
astern_ratio = 0.6

[[azimuth_thruster]]
name = "pod"
x = -1.5
unit = "rpm"
curve = { c = -1.0, d = 0.8 }
max_force = 200.0
min_force = -100.0
angle_rate_limit = 1.0

[[effect]]
name = "crossflow-drag"
cd = 0.8

[[effect]]
name = "current"
speed = 0.3
direction = 2.0
"""


def odd_boat():
    return build(tomllib.loads(BOAT.replace("X_u = -40.0", "X_u = -40.0\nY_rdot = -9.0") + ODD))


def vessels():
    return {name: read_vessel(name).vessel for name in shipped_vessels()} | {"odd": odd_boat()}


def simulator(vessel, *more):
    return PlanarVessel(json.loads(json.dumps(equations_of(vessel).as_dict())), *more)


def test_it_imports_the_standard_library_alone():
    tree = ast.parse(inspect.getsource(planar_model))
    imported = {
        a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names
    }
    assert imported <= set(sys.stdlib_module_names)
    assert not any(isinstance(node, ast.ImportFrom) for node in ast.walk(tree))


@pytest.mark.parametrize("name", [*shipped_vessels(), "odd"])
def test_accelerations_are_those_of_diffsea_at_random_motions(name):
    vessel, rng = vessels()[name], np.random.default_rng(7)
    for _ in range(12):
        state, executed = models.random_state(vessel, rng), models.random_orders(vessel, rng)
        current = 0.3 * rng.normal(size=2)
        expected = models.rate(vessel, state, executed, current)
        found = simulator(vessel).rate(list(state), executed, tuple(current))
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * scale)


@pytest.mark.parametrize(
    "name",
    [
        "otter",
        "odd",
        *(pytest.param(n, marks=pytest.mark.proof) for n in ("kvlcc2", "shioji_maru")),
    ],
)
def test_a_run_with_lags_slew_rates_and_delays_is_that_of_diffsea(name):
    vessel, rng = vessels()[name], np.random.default_rng(3)
    times = (0.0, 5.0, 12.3, 20.0)
    plan = [(t, models.random_orders(vessel, rng, 0.6)) for t in times]
    start = models.random_state(vessel, rng)
    expected, executed = models.run(vessel, start, plan, 30.0, (0.2, -0.1), step=0.05)
    boat = simulator(vessel, list(start), plan[0][1])
    for k in range(600):
        orders = [held for since, held in plan if since <= 0.05 * k + 1e-9][-1]
        boat.advance(0.05 * k, 0.05, orders, (0.2, -0.1))
    speed = np.abs(expected[:, 3:5]).max()
    error = np.abs(np.array(boat.state) - expected[-1])
    assert error[:2].max() < 1e-4 * 30.0 * speed
    assert error[3:5].max() < 1e-4 * speed
    for channel, value in executed[-1].items():
        assert boat.executed[channel] == pytest.approx(float(value), rel=1e-9, abs=1e-9)


def test_steps_of_any_length_end_at_the_same_place():
    vessel, orders = read_vessel("shioji_maru").vessel, {"propeller": 3.0, "bow": 2e4}
    ends = []
    for steps in (1, 7, 120):
        boat = simulator(vessel, [0.0] * 6, {"propeller": 1.0, "rudder": 0.1})
        for k in range(steps):
            boat.advance(k * 12.0 / steps, 12.0 / steps, orders)
        ends.append(boat.state)
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, rtol=1e-7, atol=1e-9)


def test_what_a_vessel_has_beyond_is_refused_by_name():
    swell = build(tomllib.loads(BOAT + SWELL))
    left_out = equations_of(swell).left_out
    with pytest.raises(UserError, match="--to mss cannot express: the force 'wave-force'.*allow"):
        require_nothing_lost(left_out, "mss", allow_loss=False)
    require_nothing_lost(left_out, "mss", allow_loss=True)
    play = BOAT + '\n[[effect]]\nname = "backlash"\nwidth = 4.0\nactuators = ["port"]\n'
    assert equations_of(build(tomllib.loads(play))).left_out == ("the play of 'port'",)
    load = BOAT + '\n[[effect]]\nname = "mass-change"\nmass = 4.0\nx = -0.2\n'
    found = equations_of(build(tomllib.loads(load))).left_out
    assert found == ("the mass taken on or lost during a run",)
