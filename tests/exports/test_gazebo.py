"""Gazebo's model of a vessel, simulated beside diffsea from Gazebo's published equations."""

import json
import tomllib

import numpy as np
import pytest
from tests.boats import BOAT, CROSS_FLOW
from tests.exports import models
from tests.exports.gazebo_simulator import GazeboModel, rate_to_gazebo, to_gazebo

from diffsea.cli import main
from diffsea.exports.equations import equations_of
from diffsea.exports.gazebo import gazebo_losses, gazebo_model, hydrodynamics
from diffsea.vessel.files import build, read_vessel


# Every kind of term that Gazebo has, on a hull that is not the same to both sides, with thrusters
# at an angle and ordered by shaft speed.
SKEW = (
    BOAT.replace(
        "X_u = -40.0",
        """X_u = -40.0
Y_rdot = -12.0
N_vdot = -12.0
X_vr = 90.0
X_vv = -30.0
X_rr = 11.0
Y_u = 4.0
N_u = -3.0
Y_r = -60.0
N_v = 45.0
Y_vr = -33.0
Y_rv = 21.0
Y_ur = -70.0
N_uv = 55.0
N_vv = 17.0
N_rv = -14.0""",
    )
    + """
[[thruster]]
name = "bow"
x = 1.5
y = 0.2
angle = 1.2
unit = "rpm"
curve = { c = 0.0, d = 0.9 }
max_force = 90.0
min_force = -40.0
"""
)


def boats():
    skew = build(tomllib.loads(SKEW))
    text = SKEW.replace("[hull]", '[hull]\nadded_mass_coriolis = "no-munk"')
    bare = SKEW.replace("[hull]", '[hull]\nadded_mass_coriolis = "none"')
    shipped = {name: read_vessel(name).vessel for name in ("blueboat", "marus_usv", "wamv")}
    others = {"no-munk": build(tomllib.loads(text)), "none": build(tomllib.loads(bare))}
    return shipped | {"skew": skew} | others


NAMES = ("blueboat", "marus_usv", "wamv", "skew", "no-munk", "none")


def model_of(vessel):
    equations = equations_of(vessel)
    losses = gazebo_losses(equations)
    assert losses == ()
    return GazeboModel(gazebo_model(equations, losses))


def commands_of(vessel, orders):
    """Orders as Gazebo takes them: N, or rad/s in place of revolutions per minute."""
    unit = {"N": 1.0, "rpm": 2 * np.pi / 60}
    return {f"{c}_joint": order * unit[vessel.units[c]] for c, order in orders.items()}


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_diffsea_at_random_motions(name):
    vessel, rng = boats()[name], np.random.default_rng(5)
    model = model_of(vessel)
    for _ in range(12):
        state, orders = models.random_state(vessel, rng), models.random_orders(vessel, rng, 1.3)
        executed = {c: float(s.target(orders[c])) for c, s in vessel.servos.items()}
        expected = rate_to_gazebo(models.rate(vessel, state, executed))
        found = model.rate(to_gazebo(state), commands_of(vessel, orders))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * abs(expected).max())


@pytest.mark.parametrize(
    "name",
    ["blueboat", "skew", *(pytest.param(n, marks=pytest.mark.proof) for n in ("wamv", "no-munk"))],
)
def test_a_turn_of_a_minute_is_that_of_diffsea(name):
    vessel = boats()[name]
    start = np.array([3.0, -2.0, 0.7, 0.5, 0.0, 0.0])
    full = {c: 100.0 if s.upper is None else float(s.upper) for c, s in vessel.servos.items()}
    orders = {c: f * (0.6 if c == "port" else 0.25) for c, f in full.items()}
    track, _ = models.run(vessel, start, [(-1.0, orders)], 60.0)
    expected = to_gazebo(track[-1])
    found = model_of(vessel).run(to_gazebo(start), commands_of(vessel, orders), 60.0)
    travelled = np.hypot(*np.diff(track[:, :2], axis=0).T).sum()
    assert travelled > 20.0 and abs(track[-1, 2] - 0.7) > 1.0
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * travelled)


def test_a_current_flows_where_the_vessel_s_file_says():
    """Of a vessel without added mass; that of others is refused."""
    flow = '\n[[effect]]\nname = "current"\nspeed = 0.4\ndirection = 0.6\n'
    text = "\n".join(line for line in BOAT.splitlines() if "dot" not in line) + flow
    vessel, rng = build(tomllib.loads(text)), np.random.default_rng(2)
    current = (0.4 * np.cos(0.6), 0.4 * np.sin(0.6))
    for _ in range(5):
        state, orders = models.random_state(vessel, rng), models.random_orders(vessel, rng)
        expected = rate_to_gazebo(models.rate(vessel, state, orders, current))
        found = model_of(vessel).rate(to_gazebo(state), commands_of(vessel, orders))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10)
    with_added_mass = build(tomllib.loads(BOAT + flow))
    assert "the current in the Coriolis" in gazebo_losses(equations_of(with_added_mass))[0]


def test_couplings_keep_their_signs_and_asymmetries_change_them():
    found = hydrodynamics(equations_of(build(tomllib.loads(SKEW))))
    assert (found["yR"], found["nV"], found["xVR"]) == (-60.0, 45.0, 90.0)
    assert (found["yU"], found["nU"]) == (-4.0, 3.0)
    assert found["yRabsV"] == -33.0 and found["yVabsR"] == 21.0


def test_what_gazebo_has_no_words_for_is_refused_by_name(capsys, tmp_path):
    out = tmp_path / "out"
    boat = tmp_path / "boat.toml"
    late = 'name = "port"\ntime_constant = 0.5'
    boat.write_text(BOAT.replace('name = "port"', late).replace("Y_v =", "Y_vvv = -9.0\nY_v =")
                    + CROSS_FLOW)  # fmt: skip
    words = ["export", str(boat), "--to", "gazebo", "-o", str(out)]
    assert main(words) == 1
    message = capsys.readouterr().err
    assert "the derivative Y_vvv; the cross-flow drag; the lag of 'port'" in message
    assert not out.exists()
    assert main([*words, "--allow-loss", "--json"]) == 0
    printed = capsys.readouterr()
    assert len(json.loads(printed.out)["left_out"]) == 3
    assert "left out: the lag of 'port'" in printed.err
    assert "LEFT OUT: the derivative Y_vvv." in (out / "boat.sdf").read_text()


def test_a_prime_set_is_refused_whatever_is_allowed(capsys, tmp_path):
    words = ["export", "kvlcc2", "--to", "gazebo", "-o", str(tmp_path / "out"), "--allow-loss"]
    assert main(words) == 1
    assert "non-dimensional hull" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("mass, added, settles", [(15.0, 24.0, False), (15.0, 9.0, True)])
def test_added_mass_as_a_force_of_the_step_before_diverges_where_it_exceeds_mass(
    mass, added, settles
):
    """What the page says of Gazebo's own, `m a_k = F - A (v_k - v_(k-1)) / dt`."""
    velocity, before, step = 0.0, 0.0, 0.001
    for _ in range(200):
        change = (10.0 - 20.0 * velocity - added * (velocity - before) / step) / mass * step
        velocity, before = velocity + change, velocity
    assert (abs(velocity) < 1.0) == settles
