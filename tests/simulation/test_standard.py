"""Standard trials by name: defaults on any vessel, and numbers with a closed form."""

import dataclasses
import math

import equinox as eqx
import numpy as np
import pytest

from diffsea import Outcome, UserError, read_vessel, shipped_vessels
from diffsea.metrics import stopping_metrics, turning_metrics, zigzag_metrics
from diffsea.metrics.numbers import numbers_of, trial_unit
from diffsea.simulation import planning
from diffsea.simulation.control import full_throttle, speed_for, throttle_for, throttle_for_thrust
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


DRAG, LAG = 20.0, 5.0  # N s/m, and s of mass over drag


@pytest.fixture(scope="module")
def boat():
    """Linear drag and no coupling: every axis is a first-order lag."""
    hull = {"length": 4.0, "beam": 1.0, "draught": 0.2, "mass": LAG * DRAG, "I_z": 40.0}
    hull |= {"X_u": -DRAG, "Y_v": -500.0, "N_r": -80.0}
    pair = [{"name": n, "y": y} for n, y in (("port", -0.5), ("starboard", 0.5))]
    return build({"hull": hull, "thruster": pair})


def measured(boat, manoeuvre, **options):
    plan = planning.plan_trial(boat, manoeuvre, speed=2.0, step=0.1, **options)
    trial, numbers = planning.run_and_measure(boat, plan)
    assert int(trial.trajectory.outcome) == Outcome.COMPLETED
    found = planning.summarise_trial(boat, plan, trial, numbers)
    floats = {name for name, value in found.items() if isinstance(value, float)}
    known = list(numbers_of(found))
    assert floats - {one.name for one in known} == {
        f"{one.name}_over_L" for one in known if one.unit == "m"
    }
    return found


@pytest.mark.parametrize(
    ("number", "unit"),
    [("time_to_half_speed", "s"), ("time_to_check_yaw_2", "s"), ("time_to_90", "s")]
    + [("period", "s"), ("peak_yaw_rate", "rad/s"), ("yaw_rate_3", "rad/s"), ("speed_loss", "1")]
    + [("heading_change", "rad"), ("overshoot_12", "rad"), ("final_speed", "m/s")]
    + [("head_reach", "m")],
)
def test_numbers_of_trials_have_their_units(number, unit):
    assert trial_unit(number) == unit


@pytest.mark.parametrize("name", ["vessel", "number", "overshoot_1_over_L"])
def test_a_number_without_a_unit_is_no_length(name):
    with pytest.raises(KeyError, match=name):
        trial_unit(name)
    with pytest.raises(KeyError, match="number"):
        list(numbers_of({"overshoot_1": 0.1, "number": 2.0}))


def test_acceleration_is_a_first_order_lag(boat):
    found = measured(boat, "acceleration", seconds=60.0)
    left = math.exp(-60 / LAG)
    assert found["final_speed"] == pytest.approx(2 * (1 - left), rel=1e-6)
    assert found["distance"] == pytest.approx(2 * (60 - LAG * (1 - left)), rel=1e-6)
    share = 0.9 * (1 - left)
    assert found["time_to_90_percent"] == pytest.approx(-LAG * math.log(1 - share), rel=1e-4)
    assert found["execute_time"] == 0 and "side" not in found


def test_coasting_loses_half_the_speed_in_its_half_life(boat):
    found = measured(boat, "coasting", seconds=30.0)
    left = math.exp(-30 / LAG)
    assert found["time_to_half_speed"] == pytest.approx(LAG * math.log(2), rel=1e-4)
    assert found["final_speed"] == pytest.approx(2 * left, rel=1e-5)
    assert found["distance"] == pytest.approx(2 * LAG * (1 - left), rel=1e-5)
    assert found["approach_speed"] == pytest.approx(2.0, rel=1e-9)


def test_stopping_under_reversed_thrust(boat):
    """u = 4 exp(-t / T) - 2 is zero at T ln 2, after 2 T - 2 T ln 2 m."""
    found = measured(boat, "stopping")
    assert found["stopping_time"] == pytest.approx(LAG * math.log(2), rel=1e-6)
    assert found["track_reach"] == pytest.approx(2 * LAG * (1 - math.log(2)), abs=1e-5)
    assert found["track_reach_over_L"] == pytest.approx(found["track_reach"] / 4)
    assert found["imo"]["track_reach"]["verdict"] == "pass"


@pytest.mark.parametrize(
    ("manoeuvre", "measure", "side"),
    [
        ("zigzag", zigzag_metrics, {"side": -1.0}),
        pytest.param("turning-circle", turning_metrics, {"side": -1.0}, marks=pytest.mark.proof),
        pytest.param("stopping", stopping_metrics, {}, marks=pytest.mark.proof),
    ],
)
def test_spare_rows_change_no_number(boat, manoeuvre, measure, side):
    """The rows that count, given alone, have the numbers of all rows with those that repeat."""
    plan = planning.plan_trial(boat, manoeuvre, speed=2.0, side=-1)
    trial, found = planning.run_and_measure(boat, plan)
    assert not np.all(trial.trajectory.valid)
    times = float(trial.execute_time)
    if manoeuvre == "zigzag":
        times = np.append(times, np.asarray(trial.switch_times)[:-1])
    alone = eqx.filter_jit(measure)(trial.trajectory.counted(), times, **side)
    assert alone.keys() == found.keys()
    for name, value in alone.items():
        # Rows that repeat tell the corners at orders; differences across them are a little off.
        assert float(found[name]) == pytest.approx(float(value), rel=5e-5, abs=1e-9), name


def test_nothing_follows_an_approach_that_is_not_steady(boat):
    plan = planning.plan_trial(boat, "zigzag", speed=2.0)
    short = dataclasses.replace(plan, approach_seconds=3.0, speed=1.0, throttle=0.8)
    trial, numbers = planning.run_and_measure(boat, short)
    assert int(trial.trajectory.outcome) == Outcome.APPROACH_UNSTEADY
    counted = trial.trajectory.counted()
    assert len(counted.t) == round(3.0 / plan.settings.step)
    assert np.all(np.isnan(trial.switch_times)) and np.all(counted.commanded["port"] > 0)
    assert math.isnan(numbers["overshoot_1"]) and math.isnan(numbers["initial_turning_time"])


def test_a_spiral_ends_every_step_at_the_yaw_rate_of_its_angle(boat):
    """Moment 0.5 m times the difference of thrusts, against 80 N m s of damping."""
    found = measured(boat, "spiral", seconds=15.0)
    angles = np.radians(np.concatenate([np.arange(20, -21, -4), np.arange(-16, 21, 4)]))
    rates = 0.5 * 2 * DRAG * angles / math.radians(35) / 80
    read = [found[f"yaw_rate_{k + 1}"] for k in range(21)]
    np.testing.assert_allclose(read, rates, atol=1e-6)
    assert len(found["switch_times"]) == 21
    np.testing.assert_allclose(np.diff(found["switch_times"]), 15.0, atol=1e-6)


def test_a_pull_out_to_port_comes_to_rest_after_a_full_turn(boat):
    found = measured(boat, "pull-out", side=-1, angle=math.radians(35), seconds=20.0)
    rate = 0.5 * 2 * DRAG / 80
    assert found["side"] == "port" and len(found["switch_times"]) == 2
    assert found["yaw_rate_at_release"] == pytest.approx(rate, rel=1e-6)
    # The heading at the release is a full turn: r_s (t - T (1 - e^(-t / T))) with T = I_z / N_r.
    turn = found["switch_times"][1] - found["switch_times"][0]
    assert rate * (turn - 0.5 * (1 - math.exp(-turn / 0.5))) == pytest.approx(2 * math.pi)
    assert abs(found["residual_yaw_rate"]) < 1e-9
    assert found["tactical_diameter"] > 0


# defaults


@pytest.mark.parametrize(
    ("length", "step"), [(1.2, 0.02), (4.9, 0.05), (7.0, 0.05), (20.0, 0.1), (160.0, 0.2)]
)
def test_the_default_step_is_round_and_follows_the_length(length, step):
    assert planning.default_step(length) == step
    assert 0.6 < step / (0.05 * math.sqrt(length / 9.81)) < 1.6


@pytest.mark.slow
def test_the_default_speed_is_within_reach_of_every_shipped_vessel():
    for name in shipped_vessels():
        vessel = read_vessel(name).vessel
        froude = 0.2 * math.sqrt(9.81 * float(vessel.rigid_body.length))
        speed = planning.default_speed(vessel)
        if name == "mariner":
            assert speed == 7.7175
        else:
            assert speed == pytest.approx(min(froude, 0.8 * planning.top_speed(vessel)))
            assert throttle_for(vessel, speed) < full_throttle(vessel)
    assert planning.default_speed(read_vessel("esso_osaka").vessel) < 0.6


def test_full_throttle_is_that_of_all_thrusters_together():
    assert full_throttle(read_vessel("wamv").vessel) == pytest.approx(2 * 2353.5)
    assert full_throttle(read_vessel("otter").vessel) == 16.54  # rev/s, of each
    assert full_throttle(read_vessel("kvlcc2").vessel) == math.inf


def test_a_thrust_sets_the_speed_at_which_drag_takes_it_up(boat):
    """X_0' = -0.022 by 1/2 rho L d U^2 for the tanker; 77.55 U for the Otter."""
    assert throttle_for_thrust(boat, 30.0) == 30.0
    tanker, otter = (read_vessel(name).vessel for name in ("kvlcc2", "otter"))
    for vessel, thrust, speed in (
        (tanker, 25.0, math.sqrt(25.0 / (0.022 * 500 * 7.0 * 0.46))),
        (otter, 100.0, 100.0 / 77.55),
    ):
        reached = speed_for(vessel, throttle_for_thrust(vessel, thrust))
        assert reached == pytest.approx(speed, rel=1e-9)


def test_plans_that_make_no_sense_are_told(boat):
    with pytest.raises(UserError, match="no manoeuvre 'zigzagg'; did you mean 'zigzag'"):
        planning.plan_trial(boat, "zigzagg")
    mariner = read_vessel("mariner").vessel
    with pytest.raises(UserError, match="no propulsion to command, so it cannot run stopping"):
        planning.plan_trial(mariner, "stopping")
    with pytest.raises(UserError, match="a thrust cannot be set"):
        planning.plan_trial(mariner, "zigzag", thrust=10.0)
    assert planning.plan_trial(mariner, "zigzag").throttle == 0.0


@pytest.mark.parametrize("name", ["angle", "heading", "speed", "thrust", "seconds", "step"])
@pytest.mark.parametrize("number", [0.0, -1.0, float("nan"), float("inf")])
def test_a_trial_by_a_number_that_is_not_above_zero_is_refused(boat, name, number):
    with pytest.raises(UserError, match=f"the {name} of a zigzag must be above zero"):
        planning.plan_trial(boat, "zigzag", **{name: number})
