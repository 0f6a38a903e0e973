"""An online estimator beside a mission's controller: what it finds, what the controller takes."""

import numpy as np
import pytest

import diffsea
from diffsea.missions import mission_of, run, scores


pytestmark = pytest.mark.compiles


NOISE = {"position": 0.05, "heading": 0.004, "velocity": 0.01, "yaw_rate": 0.002}
ESTIMATED = {"kind": "kalman", "free": ["X_u", "N_r"]}


def document(estimator=None, **changes):
    """The Otter steered from side to side, by an autopilot that believes in less drag."""
    headings = [0.0, 0.7, -0.7, 0.7, -0.7, 0.0, 0.7, -0.7]
    steps = [
        {"time": 10.0 * k, "heading": heading, "speed": 1.2 if k % 2 else 0.8}
        for k, heading in enumerate(headings)
    ]
    written = {
        "vessel": {"name": "otter"},
        "model": {"name": "otter", "parameters": {"X_u": -62.0}},
        "controller": {"kind": "course"},
        "step": steps,
        "seconds": 80.0,
        "time_step": 0.05,
        "period": 0.2,
        "sensors": NOISE,
    } | changes
    return written if estimator is None else written | {"estimator": estimator}


@pytest.fixture(scope="module")
def learnt():
    return run(mission_of(document(ESTIMATED)))


def test_the_drag_is_learnt_and_passes_the_gate(learnt):
    told = scores(learnt)["estimator"]
    drag = told["estimates"]["X_u"]
    assert drag["model"] == -62.0 and drag["vessel"] == pytest.approx(-77.55, abs=0.1)
    assert abs(drag["value"] - drag["vessel"]) < 3 * drag["std"]
    assert abs(drag["value"] - drag["model"]) > 2 * drag["std"]
    assert abs(drag["passed"] - drag["vessel"]) < abs(drag["passed"] - drag["model"])
    assert told["kind"] == "kalman" and told["adapt"] and 0 < told["open"] <= 1
    assert len(learnt.estimates.t) == len(learnt.true.t)


@pytest.mark.proof
def test_the_controller_works_with_what_passed_and_with_nothing_else(learnt):
    alone = run(mission_of(document()))
    watched = run(mission_of(document(ESTIMATED | {"adapt": False})))
    for channel, orders in alone.true.commanded.items():
        np.testing.assert_allclose(watched.true.commanded[channel], orders, atol=1e-9)
    passed = learnt.estimates.handed["X_u"]
    first = int(np.argmax(passed != passed[0]))
    assert first > 50
    before, after = slice(0, first), slice(first, None)
    own, taught = alone.true.commanded["port"], learnt.true.commanded["port"]
    np.testing.assert_allclose(taught[before], own[before], atol=1e-9)
    assert np.abs(taught[after] - own[after]).max() > 0.1


def test_least_squares_run_in_the_loop_too():
    mission = mission_of(document({"kind": "least-squares", "free": ["X_u"], "memory": 200.0}))
    found = run(mission).estimates
    assert found is not None
    assert found.estimate["X_u"][-1] == pytest.approx(-77.55, abs=4 * found.std["X_u"][-1])


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"kind": "kalmann"}, "did you mean 'kalman'"),
        ({"kind": "kalman", "memory": 3.0}, "unknown key 'memory'"),
        ({"free": "X_u"}, "is no list of names"),
        ({"free": ["X_uv"]}, "has no parameter 'X_uv'"),
        ({"adapt": 1}, "neither true nor false"),
        ({"drift": 0.0}, "drift"),
    ],
)
def test_tables_that_are_wrong_are_refused(table, told):
    with pytest.raises(diffsea.UserError, match=told):
        mission_of(document(table))
