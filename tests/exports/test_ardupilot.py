"""ArduPilot's parameters against steady runs and turns of the independent simulator.

Outputs become orders here by the formulas of ArduPilot's documentation and AP_MotorsUGV, written
anew: a side's thrust is throttle plus or minus steering, negative ones by MOT_THST_ASYM more.
"""

import json
import math
import tomllib

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.boats import BOAT
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE

from diffsea.cli import main
from diffsea.exports.ardupilot import parameters_of, withheld_by_fit
from diffsea.exports.ardupilot_mixers import expo_of, mixer_of
from diffsea.vessel.files import build, shipped_vessels


TWIN = tomllib.loads(BOAT)  # 400 N ahead, 300 N astern


def values(vessel, speed=None):
    found = parameters_of(vessel, speed)
    return {name: one.value for name, one in found.items() if one.value is not None}


def newtons(share):
    """Thrust of TWIN at an output: of full thrust ahead and astern."""
    share = share * 400 / 300 if share < 0 else share
    return share * (400.0 if share > 0 else 300.0)


def steady(document, orders, speed, seconds):
    """Forward, sway velocity and yaw rate that constant orders end in."""
    run = simulate(document, [(0.0, orders)], seconds, state=(0, 0, 0, speed, 0, 0))
    end = run.at([0.9 * seconds, seconds])
    assert abs(np.diff(end["r"])[0]) < 1e-4 * abs(end["r"][1])
    return end["u"][1], end["v"][1], end["r"][1]


def test_cruise_throttle_keeps_cruise_speed_in_closed_form():
    found = values(build(TWIN), 1.5)
    drag = 40.0 * 1.5 + 60.0 * 1.5**2
    assert found["CRUISE_SPEED"] == 1.5
    assert found["CRUISE_THROTTLE"] == pytest.approx(100 * drag / 800.0, rel=1e-9)
    fastest = brentq(lambda u: 40 * u + 60 * u * u - 800, 0, 10)
    assert found["SPEED_MAX"] == pytest.approx(fastest, rel=1e-9)
    assert found["ATC_ACCEL_MAX"] == pytest.approx((800 - drag) / 215.0, rel=1e-9)
    assert found["MOT_THST_ASYM"] == pytest.approx(4 / 3)
    assert found["MOT_THST_EXPO"] == 0.0


def test_steering_of_thrusters_on_both_sides_is_that_of_the_independent_simulator():
    found, speed = values(build(TWIN), 1.5), 1.5
    throttle = found["CRUISE_THROTTLE"] / 100
    limit = min(1 - throttle, throttle + 3 / 4)
    turns = {}
    for share in (0.5, 1.0):
        sides = throttle + share * limit, throttle - share * limit
        turns[share] = steady(TWIN, [newtons(side) for side in sides], speed, 120.0)
    u, v, r = turns[1.0]
    assert found["ATC_STR_RAT_FF"] == pytest.approx(0.5 * limit / turns[0.5][2], rel=1e-4)
    assert found["ATC_STR_RAT_MAX"] == pytest.approx(math.degrees(r), rel=1e-4)
    assert found["TURN_RADIUS"] == pytest.approx(math.hypot(u, v) / r, rel=1e-4)
    # Sway and yaw from rest on a straight course: M (v', r') = (0, moment).
    moment = 0.9 * 2 * limit * 400.0
    M = np.array([[350.0, 20.0], [20.0, 300.0 + 200 * 0.1**2 + 120.0]])
    swing = np.linalg.solve(M, [0.0, moment])[1]
    assert found["ATC_STR_ACC_MAX"] == pytest.approx(math.degrees(swing), rel=1e-6)


def test_a_shaft_speed_s_square_is_undone_by_the_curve_that_is_written():
    otter = load(str(shipped_vessels()["otter"]))
    del otter["hull"]["added_mass_coriolis"]  # the simulator has Kirchhoff's forces alone
    found = values(build(otter), 1.2)
    assert found["MOT_THST_EXPO"] == 1.0
    throttle = found["CRUISE_THROTTLE"] / 100
    # At expo 1 an output is the root of the thrust's share.
    assert throttle == pytest.approx(77.55 * 1.2 / (2 * 0.4374 * 16.54**2), rel=1e-9)
    asymmetry = (16.54 / 12.35) ** 2
    limit = min(1 - throttle, throttle + 1 / asymmetry)

    def shaft_speed(share):
        if share < 0:
            return -12.35 * math.sqrt(-share * asymmetry)
        return 16.54 * math.sqrt(share)

    sides = throttle + 0.5 * limit, throttle - 0.5 * limit
    _, _, r = steady(otter, [shaft_speed(side) for side in sides], 1.2, 200.0)
    assert found["ATC_STR_RAT_FF"] == pytest.approx(0.5 * limit / r, rel=1e-4)


def test_a_rudder_takes_a_share_of_its_largest_angle():
    ship = load(str(ORACLE / "ship.toml"))
    found = values(build(ship), 0.8)
    n = 16.0 * math.sqrt(found["CRUISE_THROTTLE"] / 100)
    straight = simulate(ship, [(0.0, {"propeller": n, "rudder": 0.0})], 5.0,
                        state=(0, 0, 0, 0.8, 0, 0)).at([5.0])  # fmt: skip
    assert straight["u"][0] == pytest.approx(0.8, rel=1e-6)
    _, _, r = steady(ship, {"propeller": n, "rudder": 0.5 * 0.61}, 0.8, 600.0)
    assert found["ATC_STR_RAT_FF"] == pytest.approx(0.5 / r, rel=1e-3)
    assert found["MOT_SPD_SCA_BASE"] == 0.8 and "MOT_THST_ASYM" not in found
    # At full rudder this ship swings without end.
    assert "ATC_STR_RAT_MAX" not in found and "TURN_RADIUS" not in found
    assert "does not settle" in parameters_of(build(ship), 0.8)["TURN_RADIUS"].reason


def test_a_thruster_that_turns_makes_the_steering_of_its_side_force():
    pytheas = load(str(shipped_vessels()["pytheas"]))
    found = values(build(pytheas), 0.5)
    assert found["MOT_VEC_ANGLEMAX"] == pytest.approx(math.degrees(1.47655))
    throttle = found["CRUISE_THROTTLE"] / 100
    steering = 0.5 * min(1.0, throttle * math.tan(1.47655))
    angle = math.atan(steering / throttle)
    force = 20.0 * min(throttle / math.cos(angle), 1.0)
    # The same boat for the independent simulator, its thruster welded at that angle.
    welded: dict = {"hull": {key: x for key, x in pytheas["hull"].items() if key != "exponents"}}
    welded["thruster"] = [{"name": "welded", "x": 0.4, "y": 0.0, "angle": angle}]
    _, _, r = steady(welded, [force], 0.5, 60.0)
    assert found["ATC_STR_RAT_FF"] == pytest.approx(steering / r, rel=1e-3)


def test_the_thrust_curve_that_is_written_is_the_nearest_one():
    shares = np.linspace(0, 1, 20001)
    for exponent in (1.0, 1.3, 1.7, 2.0):
        wanted, line = shares**exponent, shares**2 - shares
        best = line @ (wanted - shares) / (line @ line)
        assert expo_of(exponent) == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("throttle, steering", [(0.2, 0.1), (0.3, -0.6), (0.5, 0.5), (0.1, 0.7)])
def test_both_sides_are_thrust_plus_and_minus_steering(throttle, steering):
    orders = mixer_of(build(TWIN)).orders(throttle, steering)
    assert orders["port"] == pytest.approx(newtons(throttle + steering))
    assert orders["starboard"] == pytest.approx(newtons(throttle - steering))


def test_a_thruster_that_pushes_across_is_left_alone():
    across = {"name": "bow", "x": 1.2, "angle": math.pi / 2, "unit": "percent"}
    across |= {"thrust_curve": {"full_thrust": 40.0}}
    boat = build(TWIN | {"thruster": [*TWIN["thruster"], across]})
    mixer = mixer_of(boat)
    orders = mixer.orders(0.3, 0.1)
    assert mixer.kind == "skid" and orders["bow"] == 0.0
    assert orders["port"] == pytest.approx(newtons(0.4))
    assert values(boat, 1.5) == pytest.approx(values(build(TWIN), 1.5))


# A fit's record


def record(**intervals):
    """A fit.json of TWIN: each number's interval as shares of it, and what data determine."""
    rows = {}
    for symbol, (low, high, determined) in intervals.items():
        value = TWIN["hull"][symbol]
        row = {"value": value, "interval": sorted((low * value, high * value))}
        rows[symbol] = row | {"determined": determined}
    return {"format": 1, "parameters": rows}


def test_what_data_do_not_determine_is_withheld_with_the_reason():
    found = parameters_of(build(TWIN), 1.5)
    fit = record(N_rr=(0.1, 3.0, 0.03), X_uu=(0.98, 1.02, 0.99), Y_v=(0.5, 1.5, 0.2))
    withheld = withheld_by_fit(TWIN, fit, found)
    assert {"ATC_STR_RAT_FF", "ATC_STR_RAT_MAX"} <= set(withheld)
    assert "N_rr moves it by" in withheld["ATC_STR_RAT_FF"]
    assert withheld["ATC_STR_RAT_FF"].endswith("data determine 3 % of N_rr")
    assert not {"CRUISE_THROTTLE", "SPEED_MAX", "ATC_STR_ACC_MAX"} & set(withheld)
    sure = record(N_rr=(0.95, 1.05, 0.97), X_uu=(0.98, 1.02, 0.99))
    assert withheld_by_fit(TWIN, sure, found) == {}


def test_the_command_writes_what_is_determined_and_says_why_not_the_rest(capsys, tmp_path):
    boat, fit = tmp_path / "boat.toml", tmp_path / "fit.json"
    boat.write_text(BOAT)
    fit.write_text(json.dumps(record(X_uu=(0.2, 4.0, 0.1))))
    words = ["export", str(boat), "--to", "ardupilot", "-o", str(tmp_path / "out"), "--json"]
    assert main([*words, "--fit", str(fit), "--speed", "1.5"]) == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert "CRUISE_THROTTLE" in result["withheld"] and "CRUISE_SPEED" in result["parameters"]
    assert "left out: CRUISE_THROTTLE: X_uu moves it" in printed.err
    lines = (tmp_path / "out" / "boat.param").read_text().splitlines()
    assert "CRUISE_SPEED,1.5" in lines
    assert any(line.startswith("# CRUISE_THROTTLE WITHHELD: X_uu") for line in lines)
    written = dict(line.split(",") for line in lines if not line.startswith("#"))
    assert {name: float(value) for name, value in written.items()} == pytest.approx(
        result["parameters"], rel=1e-4
    )


@pytest.mark.parametrize(
    "text, message",
    [
        ("{", "is not JSON"),
        ('{"format": 1}', "it has no parameters"),
        (json.dumps(record(X_u=(0.9, 1.1, 1.0))).replace("-40.0", "-41.0"), "X_u = -41 there"),
    ],
)
def test_a_fit_of_something_else_is_refused(text, message, capsys, tmp_path):
    boat, fit = tmp_path / "boat.toml", tmp_path / "fit.json"
    boat.write_text(BOAT)
    fit.write_text(text)
    words = ["export", str(boat), "--to", "ardupilot", "-o", str(tmp_path / "out")]
    assert main([*words, "--fit", str(fit)]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "vessel, more, message",
    [
        ("marus_usv", [], "nothing says what full throttle of 'port' is"),
        ("mariner", [], "none of the frames"),
        ("wamv", ["--speed", "9"], "no throttle keeps 9 m/s"),
    ],
)
def test_a_vessel_that_does_not_tell_is_refused(vessel, more, message, capsys, tmp_path):
    words = ["export", vessel, "--to", "ardupilot", "-o", str(tmp_path / "out"), *more]
    assert main(words) == 1
    assert message in capsys.readouterr().err


def test_its_options_are_refused_for_other_tools(capsys, tmp_path):
    words = ["export", "otter", "--to", "mss", "--speed", "1", "-o", str(tmp_path / "out")]
    assert main(words) == 1
    assert "--fit and --speed are for --to ardupilot" in capsys.readouterr().err
