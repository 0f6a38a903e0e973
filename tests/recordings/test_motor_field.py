# pyright: reportArgumentType=false
"""A compass that motors deflect, as an audit sees it: on runs whose truth SciPy integrated."""

import dataclasses
import math

import numpy as np
import pytest
from tests.identification.test_estimated_heading import FIELD, error, recorded

from diffsea.recordings.auditing.audit import audit
from diffsea.recordings.auditing.kinematics.motor_field import motor_field
from diffsea.recordings.motion import motion_of


def found_in(run):
    return [one for one in audit(run) if one.kind == "hard-iron"]


@pytest.mark.parametrize("seed", range(3))
def test_its_size_phase_and_time_constant_are_found_and_taken_off(seed):
    run = recorded(error(), 1.0, seed)
    (finding,) = found_in(run)
    found = finding.parameters
    largest = 220 / 250  # of full thrust, of both motors: the largest in this run
    # What the motors take astern against ahead, no run tells: 150 of 180 N count as 150 of 250.
    assert found["amplitude_at_largest_thrust"] == pytest.approx(
        FIELD["amplitude"] * largest, rel=0.2
    )
    assert math.remainder(found["phase"] - FIELD["phase"], math.tau) == pytest.approx(0, abs=0.15)
    assert found["time_constant"] == pytest.approx(FIELD["time_constant"], rel=0.2)
    assert finding.channels == ("psi", "u", "v")
    assert finding.cost > 1.0
    assert "motors' current deflects the compass" in finding.message
    repaired = finding.edits[0].apply(run)
    truth = recorded(0.0, 1.0, seed)
    off = lambda one: np.std(one.psi - truth.psi)
    assert off(repaired) < 0.2 * off(run)
    assert np.std(repaired.v - truth.v) < 0.3 * np.std(run.v - truth.v)


def test_velocities_that_are_right_stay_as_they_are():
    run, truth = recorded(error(), 1.0, 5), recorded(0.0, 1.0, 5)
    (finding,) = found_in(dataclasses.replace(run, u=truth.u, v=truth.v))
    assert finding.channels == ("psi",)
    assert not finding.edits[0].velocities


@pytest.mark.parametrize("seed", range(6))
def test_a_sound_compass_is_not_blamed_for_its_motors(seed):
    assert found_in(recorded(0.0, 1.0, seed)) == []


def test_a_field_of_the_hull_is_none_of_the_motors():
    t, turning = np.arange(0, 120, 0.1), 0.12
    run = recorded(0.0, 1.0, 3)
    psi = 0.3 + turning * t + 0.004 * np.random.default_rng(1).standard_normal(t.size)
    shown = psi + 0.15 * np.sin(psi - 0.8)
    r = turning + 0.003 * np.random.default_rng(2).standard_normal(t.size)
    nothing = np.full(t.size, np.nan)
    run = dataclasses.replace(run, psi=shown, r=r, x=nothing, y=nothing, u=nothing, v=nothing)
    (finding,) = found_in(run)
    assert set(finding.parameters) == {"amplitude", "phase"}
    assert finding.parameters["phase"] == pytest.approx(0.8, abs=0.1)
    assert finding.value == pytest.approx(0.15, abs=0.02)


def test_motors_that_push_the_same_all_the_time_have_no_field_of_their_own():
    run = recorded(error(), 1.0)
    steady = {name: np.full(run.t.size, 100.0) for name in run.commanded}
    run = dataclasses.replace(run, commanded=steady | {"rudder": 0.1 * np.sin(run.t)})
    assert motor_field(run, motion_of(run)) is None


def test_pulses_count_from_their_neutral():
    run = recorded(error(), 1.0)
    pulses = {name: 1500 + 1.5 * thrust for name, thrust in run.commanded.items()}
    (finding,) = found_in(dataclasses.replace(run, commanded=pulses))
    (of_thrusts,) = found_in(run)
    assert finding.value == pytest.approx(of_thrusts.value, rel=1e-6)


def test_motors_that_ran_before_a_log_began_have_deflected_the_compass_already():
    whole = recorded(error(), 0.0)
    run = whole.rows(np.flatnonzero(whole.t >= 16.0))  # amid a burst that began at 10 s
    field = motor_field(run, motion_of(run))
    sine = FIELD["amplitude"] * math.cos(FIELD["phase"])
    cosine = -FIELD["amplitude"] * math.sin(FIELD["phase"])
    off = field.deviation(sine, cosine)
    assert off[0] == pytest.approx(FIELD["amplitude"] * math.sin(run.psi[0] - FIELD["phase"]), 0.01)


@pytest.mark.parametrize("phase", [0.7, -0.87, 2.2])
def test_where_motors_hardly_pause_a_field_of_the_hull_is_plainer(phase):
    """Of thrusts that are on but for the beginning, the fields look much alike."""
    rng = np.random.default_rng(7)
    t = np.arange(0, 120, 0.1)
    r = np.where(t > 8, 0.12, 0.0)
    psi = np.cumsum(0.1 * r)
    shown = psi + 0.12 * np.sin(psi - phase) + 0.004 * rng.standard_normal(t.size)
    nothing, on = np.full(t.size, np.nan), np.where(t > 8, 100.0, 0.0)
    run = dataclasses.replace(
        recorded(),
        **dict.fromkeys(("x", "y", "u", "v"), nothing),
        psi=shown,
        r=r + 0.003 * rng.standard_normal(t.size),
        commanded={"port": on, "starboard": on},
    )
    (finding,) = found_in(run)
    assert set(finding.parameters) == {"amplitude", "phase"}
