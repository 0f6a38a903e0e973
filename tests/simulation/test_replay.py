"""Replays against closed forms: one boat going straight, one turning at rest."""

import dataclasses

import numpy as np
import pytest

from diffsea import Outcome, Sensors, Trajectory, UserError, horizon_errors, replay
from diffsea.simulation.actuation import (
    how_actuated,
    over_rows,
    recorded_actuation,
    with_common_feedback,
)
from diffsea.simulation.replay import prediction_misses, replay_errors
from diffsea.simulation.sensed_motion import shown_motion, true_motion
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build
from diffsea.vessel.sensors import Clock, Step


def boat(**thruster):
    """Linear drag only: u' = (T - 20 u) / 100, one thruster on the centreline."""
    hull = {"length": 4.0, "beam": 1.0, "draught": 0.2, "mass": 100.0, "I_z": 50.0}
    hull |= {"X_u": -20.0, "Y_v": -20.0, "N_r": -50.0}
    return build({"hull": hull, "thruster": [{"name": "screw", "x": -1.0, **thruster}]})


def straight(t, u0=1.0, thrust=60.0, psi=0.4):
    """The closed form of a straight run from u0 under constant thrust."""
    end = thrust / 20
    u = end + (u0 - end) * np.exp(-0.2 * t)
    way = end * t + (u0 - end) * (1 - np.exp(-0.2 * t)) / 0.2
    zero = np.zeros_like(t)
    return Trajectory(
        t, way * np.cos(psi), way * np.sin(psi), psi + zero, u, zero, zero,
        {"screw": thrust + zero}, {}, {}, np.ones(t.shape, bool), name="straight",
    )  # fmt: skip


def missing(run, *channels):
    return dataclasses.replace(run, **{c: np.full(run.t.shape, np.nan) for c in channels})


UNEVEN = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.4, 200))
UNEVEN = UNEVEN - UNEVEN[0]


def test_a_straight_run_is_the_closed_form_at_uneven_times():
    run = straight(UNEVEN)
    predicted = replay(boat(), run)
    assert predicted.outcome == Outcome.COMPLETED
    np.testing.assert_array_equal(predicted.t, run.t)
    for channel in ("x", "y", "psi", "u", "v", "r"):
        np.testing.assert_allclose(getattr(predicted, channel), getattr(run, channel), atol=1e-6)
    assert replay_errors(predicted, run)["position"] < 1e-6
    assert "reconstructed from the orders" in " ".join(predicted.provenance)


def test_coarse_samples_are_stepped_finely():
    """Samples 5 s apart, four times the time constant of yaw: RK4 in one step diverges."""
    t = np.arange(0.0, 100.0, 12.0)
    predicted = replay(boat(), dataclasses.replace(straight(t), r=np.append(0.5, 0 * t[1:])))
    assert predicted.r[1] == pytest.approx(0.5 * np.exp(-12.0), abs=1e-6)
    assert predicted.u[-1] == pytest.approx(straight(t).u[-1], abs=1e-5)


def test_orders_hold_until_the_next_and_lag_as_the_servo_says():
    t = np.arange(0.0, 20.0, 0.25)
    run = dataclasses.replace(straight(t), commanded={"screw": np.where(t < 5, 0.0, 60.0)})
    late = replay(boat(delay=1.0, time_constant=0.5), run).executed["screw"]
    expected = np.where(t < 6, 0.0, 60 * (1 - np.exp(-np.maximum(t - 6, 0) / 0.5)))
    np.testing.assert_allclose(late, expected, atol=1e-9)
    direct = replay(boat(max_force=40.0), run)
    np.testing.assert_array_equal(direct.executed["screw"], np.where(t < 5, 0.0, 40.0))
    np.testing.assert_array_equal(direct.commanded["screw"], run.commanded["screw"])


def test_measured_actuation_is_taken_as_measured_unless_told_otherwise():
    t = np.arange(0.0, 20.0, 0.25)
    run = dataclasses.replace(straight(t), executed={"screw": np.full(t.shape, 30.0)})
    slower = straight(t, thrust=30.0)
    assert replay(boat(), run).u[-1] == pytest.approx(slower.u[-1], abs=1e-6)
    assert replay(boat(), run, measured_actuation=False).u[-1] == pytest.approx(
        straight(t).u[-1], abs=1e-6
    )


def test_executed_values_hold_until_the_next_but_not_where_they_were_lost():
    t = np.arange(0.0, 20.0, 0.25)
    done = 30.0 + t
    executed = lambda there: recorded_actuation(
        boat(),
        dataclasses.replace(straight(t), executed={"screw": np.where(there, done, np.nan)}),
    )[1]
    every_second = np.round(t / 0.25) % 4 == 0
    np.testing.assert_allclose(executed(every_second)["screw"], 30.0 + np.floor(t))
    gap = every_second & ~((t > 8) & (t < 11))
    np.testing.assert_allclose(executed(gap)["screw"][t < 8], 30.0 + np.floor(t[t < 8]))
    for lost in (t > 5, t < 12, (t < 8) | (t > 12), t > 30):
        assert executed(lost) == {}


def test_executed_values_are_not_lost_where_the_recording_pauses_as_a_whole():
    t = np.arange(0.0, 20.0, 0.25)
    t = t[(t < 8) | (t > 12)]
    done = 30.0 + t
    run = dataclasses.replace(straight(t), executed={"screw": done})
    np.testing.assert_array_equal(recorded_actuation(boat(), run)[1]["screw"], done)
    lost = np.where((t > 5) & (t < 7.5), np.nan, done)
    assert recorded_actuation(boat(), dataclasses.replace(run, executed={"screw": lost}))[1] == {}


def test_a_measured_actuator_on_its_way_acts_between_its_samples():
    """u' + u / 5 = 0.6 (1 - exp(-t)), from rest: the closed form, and not half a row late."""
    t = np.arange(0.0, 20.0, 0.25)
    run = straight(t, u0=0.0)
    u = 3 * (1 - np.exp(-0.2 * t)) + 0.75 * (np.exp(-t) - np.exp(-0.2 * t))
    run = dataclasses.replace(run, u=u, executed={"screw": 60 * (1 - np.exp(-t))})
    predicted = replay(boat(), run)
    np.testing.assert_allclose(predicted.u, u, atol=3e-3)  # held until the next: 0.05
    np.testing.assert_array_equal(predicted.executed["screw"], run.executed["screw"])


def acting(done, ordered=None, sampled=None):
    t = 0.1 * np.arange(len(done))
    seen = done if sampled is None else np.where(sampled, done, np.nan)
    orders = {} if ordered is None else {"screw": ordered}
    run = dataclasses.replace(straight(t), commanded=orders, executed={"screw": seen})
    return over_rows(run, *recorded_actuation(boat(), run))["screw"]


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_what_moves_in_steps_holds_and_what_is_on_its_way_has_the_mean_of_a_row(noise):
    rng = np.random.default_rng(3)
    steps = np.repeat(rng.uniform(-30.0, 30.0, 30), 40)
    slewing = np.empty_like(steps)
    now = 0.0
    for k, order in enumerate(steps):
        slewing[k] = now
        now += np.clip(order - now, -1.5, 1.5)
    slewing += noise * rng.normal(size=len(steps))
    steps = steps + noise * rng.normal(size=len(steps))
    np.testing.assert_array_equal(acting(steps), steps)
    means = np.append(0.5 * (slewing[1:] + slewing[:-1]), slewing[-1])
    np.testing.assert_allclose(acting(slewing), means)
    np.testing.assert_allclose(acting(slewing, steps), means)


def test_smooth_orders_that_are_executed_at_once_hold():
    smooth = 20 * np.sin(0.05 * np.arange(600))
    np.testing.assert_array_equal(acting(0.8 * smooth, smooth), 0.8 * smooth)
    late = 20 * np.sin(0.05 * np.arange(600) - 1.0)
    assert not np.array_equal(acting(late, smooth), late)


def test_an_actuator_sampled_more_rarely_than_the_rows_is_on_straight_lines():
    ramp = np.abs(np.linspace(-30.0, 30.0, 601))
    seen = np.arange(601) % 4 == 0
    means = np.append(0.5 * (ramp[1:] + ramp[:-1]), ramp[-1])
    np.testing.assert_allclose(acting(ramp, sampled=seen), means)


def test_a_channel_is_measured_only_where_all_recordings_have_it():
    t = np.arange(0.0, 20.0, 0.25)
    whole = dataclasses.replace(straight(t), executed={"screw": np.full(t.shape, 30.0)})
    bare = dataclasses.replace(straight(t), name="bare.csv")
    assert how_actuated(boat(), [whole, whole]) == {"screw": "measured"}
    assert how_actuated(boat(), [bare, bare]) == {"screw": "reconstructed"}
    said = how_actuated(boat(), [whole, bare])["screw"]
    assert said.startswith("reconstructed") and "bare.csv" in said
    namesakes = [bare, dataclasses.replace(whole, name="bare.csv")]
    assert how_actuated(boat(), namesakes)["screw"].startswith("reconstructed")


def test_a_start_that_was_not_measured_is_derived():
    run = missing(straight(UNEVEN), "u", "v", "r")
    predicted = replay(boat(), run)
    assert predicted.u[0] == pytest.approx(1.0, abs=0.02)
    assert abs(predicted.v[0]) < 0.01 and abs(predicted.r[0]) < 1e-12
    assert "u and v not recorded" in " ".join(predicted.provenance)
    assert set(replay_errors(predicted, run)) == {"position", "heading"}
    assert set(replay_errors(predicted, missing(straight(UNEVEN), "x"))) == {
        "heading", "u", "v", "r"
    }  # fmt: skip


def test_a_start_is_derived_from_positions_with_noise():
    """Differences of two positions to 0.1 m, 0.1 s apart, would miss by 1 m/s."""
    t = np.arange(0.0, 60.0, 0.1)
    rng = np.random.default_rng(4)
    run = missing(straight(t, u0=2.0), "u", "v", "r")
    x, y = (getattr(run, c) + 0.1 * rng.normal(size=t.shape) for c in "xy")
    psi = run.psi + np.deg2rad(0.5) * rng.normal(size=t.shape)
    predicted = replay(boat(), dataclasses.replace(run, x=x, y=y, psi=psi))
    assert predicted.u[0] == pytest.approx(2.0, abs=0.15)
    assert predicted.v[0] == pytest.approx(0.0, abs=0.15)
    assert predicted.r[0] == pytest.approx(0.0, abs=np.deg2rad(0.5))


def test_velocities_are_derived_from_positions_as_they_truly_were():
    """On a circle, a quarter of its time late and from an antenna far from amidships."""
    t, speed, rate, lag = np.arange(0.0, 60.0, 0.1), 1.2, 0.3, 1.4
    late, x, y = t - lag, 0.8, -0.5
    psi = 0.4 + rate * t
    north = speed / rate * np.sin(0.4 + rate * late)
    east = -speed / rate * np.cos(0.4 + rate * late)
    c, s = np.cos(0.4 + rate * late), np.sin(0.4 + rate * late)
    fixes = north + c * x - s * y, east + s * x + c * y
    known = np.arange(t.size) % 5 == 2
    shown = [np.where(known, fix, np.nan) for fix in fixes]
    run = dataclasses.replace(straight(t), x=shown[0], y=shown[1], psi=psi, r=rate + 0 * t)
    sensors = Sensors(latency_position=lag, lever_x=x, lever_y=y)
    vessel = dataclasses.replace(boat(), sensors=sensors)
    predicted = replay(vessel, missing(run, "u", "v"))
    assert predicted.u[0] == pytest.approx(speed, abs=0.05)
    assert predicted.v[0] == pytest.approx(0.0, abs=0.05)
    assert prediction_misses(vessel, missing(run, "u", "v"), [1.0])[1.0]["u"].size > 3


def test_an_antenna_says_nothing_of_velocities_where_there_are_no_positions():
    t = np.arange(0.0, 20.0, 0.1)
    run = missing(dataclasses.replace(straight(t), r=0.3 + 0 * t), "x", "y", "v")
    vessel = dataclasses.replace(boat(), sensors=Sensors(lever_x=2.0, lever_y=1.0))
    predicted = replay(vessel, run)
    assert predicted.v[0] == 0.0 and predicted.u[0] == run.u[0]


def test_velocities_of_an_antenna_askew_are_put_right_and_shown_again():
    """A boat that circles at 1.2 m/s without drift, seen from 2 m ahead and 1 m to starboard."""
    t, speed, rate, turned, (x, y) = np.arange(0.0, 60.0, 0.1), 1.2, 0.3, 0.2, (2.0, 1.0)
    arrow = (speed - rate * y + 1j * rate * x) * np.exp(-1j * turned)
    sensors = Sensors(axes_offset=turned, velocity_lever_x=x, velocity_lever_y=y)
    psi, none = 0.4 + rate * t, np.zeros_like(t)
    track = speed / rate * np.sin(psi), -speed / rate * np.cos(psi)
    seen = dataclasses.replace(
        straight(t), x=track[0], y=track[1], psi=psi + turned, u=none + arrow.real,
        v=none + arrow.imag, r=none + rate,
    )  # fmt: skip
    for run in (seen, missing(seen, "r")):
        true, _ = true_motion(sensors, run, {})
        expected = {"psi": psi, "u": none + speed, "v": none, "r": none + rate}
        for channel, values in expected.items():
            np.testing.assert_allclose(true[channel][5:-5], values[5:-5], atol=1e-3)
        shown = shown_motion(sensors, t, true, {})
        for channel in MOTION_CHANNELS:
            np.testing.assert_allclose(shown[channel], seen.motion[channel], atol=1e-2)


def test_late_samples_are_continued_back_to_the_start():
    run = straight(UNEVEN, u0=3.0)
    x = run.x.copy()
    x[:3] = np.nan
    predicted = replay(boat(), dataclasses.replace(run, x=x))
    assert run.x[3] - run.x[0] > 1.0
    assert predicted.x[0] == pytest.approx(run.x[0], abs=1e-6)


@pytest.mark.parametrize("lost", [slice(2, 40), slice(-40, -2)])
def test_a_lone_sample_before_or_after_a_pause_is_continued_by_the_next_one(lost):
    """The rows before the first sample and after the last are nearer to it than any other is."""
    run = straight(np.arange(0.0, 30.0, 0.1), u0=3.0)
    x = run.x.copy()
    edge = slice(0, 1) if lost.start == 2 else slice(-1, None)
    x[lost] = x[edge] = np.nan
    true, _ = true_motion(Sensors(), dataclasses.replace(run, x=x), {})
    np.testing.assert_allclose(true["x"][edge], run.x[edge], atol=0.1)


def test_a_clock_that_runs_ahead_shows_the_run_before_its_recording_begins():
    vessel = dataclasses.replace(boat(), sensors=Sensors(clock=Clock(offset=-0.5)))
    t = np.arange(0.0, 60.0, 0.1)
    seen = dataclasses.replace(straight(t + 0.5, u0=3.0), t=t)
    assert replay_errors(replay(vessel, seen), seen)["position"] < 0.01
    assert horizon_errors(vessel, seen, horizons=(5.0,))[5.0]["position"] < 1e-6


def test_the_sensors_errors_are_taken_off_and_put_on_again():
    """A boat that drives straight, seen through a turned compass and a late receiver."""
    vessel = boat()
    wrong = Sensors(heading_offset=0.2, gyro_bias=0.01, lever_x=1.0, latency_position=0.5)
    vessel = dataclasses.replace(vessel, sensors=wrong)
    t = np.arange(0.0, 60.0, 0.1)
    true, earlier = straight(t, u0=3.0), straight(t - 0.5, u0=3.0)
    seen = dataclasses.replace(
        true, x=earlier.x + np.cos(0.4), y=earlier.y + np.sin(0.4), psi=true.psi + 0.2,
        r=true.r + 0.01,
    )  # fmt: skip
    predicted = replay(vessel, seen)
    errors = replay_errors(predicted, seen)
    assert errors["position"] < 1e-3 and errors["heading"] < 1e-9 and errors["r"] < 1e-9
    ahead = horizon_errors(vessel, seen, horizons=(20.0,))
    assert ahead[20.0]["position"] < 1e-3 and ahead[20.0]["heading"] < 1e-9


def test_steps_of_the_sensors_are_taken_off_and_put_on_again():
    """A boat that drives straight, whose compass is knocked and whose gyro is reset at 30 s."""
    wrong = Sensors(heading_steps=(Step(0.3, 30.0),), gyro_steps=(Step(0.01, 30.0),))
    vessel = dataclasses.replace(boat(), sensors=wrong)
    t = np.arange(0.0, 60.0, 0.1)
    true, late = straight(t, u0=3.0), t > 30.05
    seen = dataclasses.replace(true, psi=true.psi + 0.3 * late, r=true.r + 0.01 * late)
    errors = replay_errors(replay(vessel, seen), seen)
    assert errors["heading"] < 1e-9 and errors["r"] < 1e-9
    ahead = horizon_errors(vessel, seen, horizons=(5.0,))[5.0]
    assert ahead["position"] < 1e-3 and ahead["heading"] < 1e-9
    assert horizon_errors(boat(), seen, horizons=(5.0,))[5.0]["position"] > 1.0


def test_horizons_grow_as_the_closed_form_of_a_wrong_thrust():
    """Thrust 6 N too small from the right speed: u falls behind by 0.3 (1 - exp(-h / 5))."""
    t = np.arange(0.0, 100.0, 0.1)
    run = straight(t)
    weak = dataclasses.replace(run, commanded={"screw": np.full(t.shape, 54.0)})
    found = horizon_errors(boat(), weak, horizons=(5.0, 20.0, 60.0, 200.0))
    assert list(found) == [5.0, 20.0, 60.0]
    for h, errors in found.items():
        behind = 0.3 * (1 - np.exp(-h / 5))
        assert errors["u"] == pytest.approx(behind, abs=1e-5)
        assert errors["position"] == pytest.approx(0.3 * h - 5 * behind, abs=1e-4)
        assert errors["starts"] == {5.0: 10, 20.0: 8, 60.0: 4}[h]


def test_every_one_of_many_starts_begins_in_its_own_recorded_state():
    """From u_k the speed decays to that of the thrust: 3 + (u_k - 3) exp(-h / 5), for 96 starts."""
    t = np.arange(0.0, 100.0, 0.1)
    u = straight(t).u + 0.2 * np.sin(t)
    found = prediction_misses(boat(), dataclasses.replace(straight(t), u=u), (4.0, 7.0), 1.0)
    for h, misses in found.items():
        k = np.arange(96 if h == 4.0 else 93) * 10
        expected = 3 + (u[k] - 3) * np.exp(-h / 5) - u[k + round(10 * h)]
        np.testing.assert_allclose(misses["u"], expected, atol=1e-5)


def test_horizons_count_only_where_there_are_samples_to_compare():
    t = np.arange(0.0, 61.0, 0.5)
    run = missing(straight(t), "v")
    there = (np.arange(t.size) % 2 == 0) & (t < 30)  # positions at 1 Hz, then none
    x, y = (np.where(there, p, np.nan) for p in (run.x, run.y))
    found = horizon_errors(boat(), dataclasses.replace(run, x=x, y=y), horizons=(5.0, 30.0))
    assert "v" not in found[5.0] and found[5.0]["position"] < 1e-3
    assert "position" not in found[30.0] and found[30.0]["u"] < 1e-5
    assert horizon_errors(boat(), run, horizons=(100.0,)) == {}


def test_predictions_that_diverge_are_counted_and_not_averaged():
    """An order of ten meganewtons at 45 s: what starts up to 20 s before meets it."""
    run = straight(np.arange(0.0, 100.0, 0.1))
    orders = np.where(np.abs(run.t - 45.0) < 0.05, 1e7, run.commanded["screw"])
    wild = dataclasses.replace(run, commanded={"screw": orders})
    found = horizon_errors(boat(), wild, horizons=(5.0, 20.0))
    assert found[20.0]["starts"] == 8 and found[20.0]["diverged"] == 2
    assert found[20.0]["u"] < 1e-4
    assert "diverged" not in horizon_errors(boat(), run, horizons=(20.0,))[20.0]


def test_divergence_and_missing_orders_are_told():
    run = straight(np.arange(0.0, 60.0, 0.5))
    wild = dataclasses.replace(run, commanded={"screw": np.full(run.t.shape, 1e6)})
    assert replay(boat(), wild).outcome == Outcome.DIVERGED
    other = dataclasses.replace(run, commanded={"engine": run.t})
    with pytest.raises(UserError, match="neither a cmd_screw nor an exec_screw.*it has: engine"):
        replay(boat(), other)
    empty = dataclasses.replace(run, commanded={"screw": np.full(run.t.shape, np.nan)})
    with pytest.raises(UserError, match="no value"):
        replay(boat(), empty)
    with pytest.raises(UserError, match="u was not recorded, nor anything to derive it from"):
        replay(boat(), missing(run, "x", "y", "u", "v"))
    with pytest.raises(UserError, match="too long to replay.*unit of its time"):
        replay(boat(), dataclasses.replace(run, t=1e9 * run.t))


def test_a_run_of_speeds_alone_is_predicted_straight_ahead():
    t = np.arange(0.0, 40.0, 0.5)
    run = missing(straight(t), "x", "y", "psi", "v", "r")
    predicted = replay(boat(), run)
    assert "neither heading nor yaw rate was recorded: straight ahead" in str(predicted.provenance)
    np.testing.assert_allclose(predicted.psi, 0.0)
    assert replay_errors(predicted, run) == {"u": pytest.approx(0.0, abs=1e-5)}
    late = boat(delay=5.0)
    assert set(horizon_errors(late, run, (5.0,))[5.0]) == {"u", "starts"}


def test_measured_actuation_counts_where_every_recording_has_it_and_what_is_left_out_is_told():
    t = np.arange(0.0, 20.0, 0.25)
    orders = {"screw": np.full(t.shape, 50.0)}
    done = {"screw": np.full(t.shape, 48.0)}
    whole = dataclasses.replace(straight(t), name="whole", commanded=orders, executed=done)
    lost = {"screw": np.where((t > 5) & (t < 15), np.nan, 48.0)}
    gappy = dataclasses.replace(whole, name="gappy", executed=lost)
    unordered = dataclasses.replace(whole, name="unordered", commanded={})
    kept, notes = with_common_feedback(boat(), [whole, whole])
    assert kept[0] is whole and kept[1] is whole and not notes
    (first, second), _ = with_common_feedback(boat(), [whole, whole], stale={"screw"})
    assert not first.executed and not second.executed
    (first, second, third), notes = with_common_feedback(boat(), [whole, gappy, unordered])
    assert not first.executed and not second.executed
    assert third.executed == done  # it stands for the orders
    assert notes == [
        "exec_screw is not known throughout in gappy: what was executed is reconstructed from "
        "the orders"
    ]
