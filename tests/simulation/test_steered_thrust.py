"""A helm and a throttle drive an outboard as its own channels do."""

import numpy as np
import pytest

from diffsea import predict
from diffsea.progress import Remark
from diffsea.simulation.order_units import with_usable_actuation
from diffsea.trajectory import Trajectory
from diffsea.vessel.files import build


HULL = {
    "length": 5.0, "beam": 2.0, "draught": 0.3, "mass": 800.0, "I_z": 1500.0,
    "X_udot": -40.0, "Y_vdot": -500.0, "N_rdot": -800.0, "X_u": -100.0, "Y_v": -800.0,
    "N_r": -2500.0,
}  # fmt: skip
OUTBOARD = {"name": "outboard", "x": -2.5, "unit": "percent", "max_force": 900.0, "max_angle": 0.6}
T = 0.1 * np.arange(300)


def boat(**more):
    return build({"hull": HULL, "azimuth_thruster": [OUTBOARD | more]})


def run(orders, name="run.csv"):
    still = np.zeros(T.size)
    return Trajectory(T, *(still,) * 6, commanded=orders, executed={}, extra={},
                      valid=np.ones(T.size, bool), name=name)  # fmt: skip


HELM = {"rudder": np.full(T.size, 0.3), "motor": np.full(T.size, 60.0)}


@pytest.mark.parametrize("x, side", [(-2.5, 1), (2.5, 1)])
def test_a_helm_to_starboard_turns_the_boat_to_starboard_wherever_the_thruster_is(x, side):
    (steered,) = with_usable_actuation(boat(x=x), [run(HELM)])
    assert set(steered.commanded) == {"outboard.force", "outboard.angle"}
    assert np.all(steered.commanded["outboard.force"] == 60.0)
    predicted = predict(boat(x=x), run(HELM)).predicted
    assert np.sign(predicted.psi[-1]) == side
    assert abs(predicted.psi[-1]) > 0.2


def test_it_is_said_once_for_all_recordings():
    said = []
    with_usable_actuation(boat(), [run(HELM, "a.csv"), run(HELM, "b.csv")], said.append)
    assert said == [Remark("helm and throttle are taken for those of outboard (a.csv, b.csv)")]


@pytest.mark.parametrize("orders", [
    {"outboard.force": HELM["motor"], "outboard.angle": HELM["rudder"]},
    {"outboard.force": HELM["motor"], "outboard.angle": HELM["rudder"], **HELM},
    {"rudder": HELM["rudder"]},
    HELM | {"propeller": HELM["motor"]},
])  # fmt: skip
def test_other_recordings_are_left_alone(orders):
    found = with_usable_actuation(boat(), [run(orders)])
    assert set(found[0].commanded) == set(orders)


def test_a_boat_with_a_rudder_keeps_its_helm():
    rudder = {"name": "rudder", "x": -2.5, "area": 0.05}
    two = build({"hull": HULL, "rudder": [rudder], "thruster": [
        {"name": "motor", "x": -2.5, "unit": "percent", "max_force": 900.0}]})  # fmt: skip
    (kept,) = with_usable_actuation(two, [run(HELM)])
    assert set(kept.commanded) == set(HELM)
