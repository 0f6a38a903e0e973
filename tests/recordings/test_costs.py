"""What a fault costs in a minute, by hand: metres by which a reckoned track goes off."""

import numpy as np
import pytest

from diffsea import Trajectory
from diffsea.recordings.auditing.costs import cost
from diffsea.recordings.auditing.edits import Affine, Blank, MergeRows, Shift, Swap
from diffsea.recordings.auditing.finding import KINDS, MAPPING_KINDS, Finding
from diffsea.report.wording.findings import cost_words, heaviest_first


SPEED, STEP = 2.0, 0.1


def straight(seconds=120.0, without=(), **changed):
    """North at 2 m/s, all channels sound but those that are changed."""
    t = np.arange(0.0, seconds + 0.5 * STEP, STEP)
    motion = {"x": SPEED * t, "y": 0 * t, "psi": 0 * t, "u": 0 * t + SPEED, "v": 0 * t, "r": 0 * t}
    motion |= {name: change(motion[name]) for name, change in changed.items()}
    motion |= {name: np.full(t.size, np.nan) for name in without}
    order = {"port": 10.0 + 0 * t, "starboard": -10.0 + 0 * t}
    return Trajectory(
        t, **motion, commanded=order, executed={}, extra={}, valid=np.ones(t.size, bool)
    )


def fault(kind, channels, *edits):
    return Finding(kind, 1.0, 0.1, "1", "", channels=channels, edits=edits)


def test_a_heading_that_is_off_costs_the_chord_of_a_minutes_way():
    run = straight(psi=lambda psi: psi + 0.1)
    found = fault("heading-offset", ("psi",), Affine(("psi",), 1.0, -0.1))
    assert cost(found, run) == pytest.approx(60 * SPEED * 2 * np.sin(0.05), rel=1e-6)


def test_a_speed_that_is_scaled_costs_its_share_of_the_way():
    run = straight(u=lambda u: 1.05 * u, v=lambda v: 1.05 * v)
    found = fault("scale", ("u", "v"), Affine(("u", "v"), 1 / 1.05))
    assert cost(found, run) == pytest.approx(0.05 * 60 * SPEED, rel=1e-6)


def test_a_gyro_that_is_off_bends_the_way():
    bias = 0.01
    run = straight(r=lambda r: r + bias)
    found = fault("gyro-bias", ("r",), Affine(("r",), 1.0, -bias))
    bent = SPEED * (np.exp(1j * bias * 60) - 1) / (1j * bias)
    assert cost(found, run) == pytest.approx(abs(bent - 60 * SPEED), rel=1e-4)


def test_speed_comes_from_the_positions_where_none_is_measured():
    run = straight(without=("u", "v"), psi=lambda psi: psi + 0.1)
    found = fault("heading-offset", ("psi",), Affine(("psi",), 1.0, -0.1))
    assert cost(found, run) == pytest.approx(60 * SPEED * 2 * np.sin(0.05), rel=1e-6)


def test_an_outlier_costs_its_share_in_the_scatter_of_positions():
    def wild(x):
        out = x.copy()
        out[600] += 30.0
        return out

    run = straight(x=wild)
    found = fault("outliers", ("x",), Blank(("x",), ((59.95, 60.05),)))
    assert cost(found, run) == pytest.approx(30 / np.sqrt(run.t.size), rel=1e-6)


def test_late_positions_are_off_by_the_way_of_the_delay():
    run = straight()
    found = fault("sensor-latency", ("x", "y"), Shift(("x", "y"), 0.5))
    assert cost(found, run) == pytest.approx(0.5 * SPEED, rel=1e-6)


def in_waves(u):
    """A speed that swings by a tenth every five seconds."""
    return u * (1 + 0.1 * np.sin(2 * np.pi * STEP * np.arange(u.size) / 5))


def test_a_speed_that_is_blanked_keeps_the_way_between():
    run = straight(60.0, u=in_waves)
    found = fault("stuck", ("u",), Blank(("u",), ((20.2, 40.3),)))
    assert 0 < cost(found, run) < 0.1 * SPEED * 20


def test_velocities_that_are_late_cost_little_at_a_nearly_steady_speed():
    run = straight(30.0, u=in_waves)
    late = cost(fault("sensor-latency", ("u", "v"), Shift(("u", "v"), 1.0)), run)
    assert 0 < late < 2 * 0.1 * SPEED


def test_a_run_shorter_than_a_minute_is_taken_whole():
    run = straight(30.0, u=lambda u: 1.1 * u)
    found = fault("scale", ("u",), Affine(("u",), 1 / 1.1))
    assert cost(found, run) == pytest.approx(0.1 * 30 * SPEED, rel=1e-6)


def test_what_no_track_tells_has_no_cost():
    run = straight()
    sides = fault("swapped-actuators", ("cmd_port",), Swap("cmd_port", "cmd_starboard"))
    assert np.isnan(cost(sides, run))
    assert np.isnan(cost(fault("gap", ("t",)), run))
    assert np.isnan(cost(fault("duplicate", ("t",), MergeRows()), run))
    adrift = straight(without=("x", "y", "u", "v"), r=lambda r: r + 0.01)
    assert np.isnan(cost(fault("gyro-bias", ("r",), Affine(("r",), 1.0, -0.01)), adrift))


def test_labels_come_before_costs_and_costs_before_what_is_not_known():
    def found(kind, metres):
        return Finding(kind, 1.0, 0.1, "1", "", cost=metres)

    gap, light = found("gap", np.nan), found("outliers", 0.003)
    heavy, sides = found("scale", 6.0), found("swapped-actuators", np.nan)
    turned = found("axes", 40.0)
    assert {"swapped-actuators", "axes"} <= set(MAPPING_KINDS) <= set(KINDS)
    assert heaviest_first([gap, light, heavy, sides, turned]) == [turned, sides, heavy, light, gap]
    records = [one.as_dict() for one in (gap, light, heavy)]
    assert heaviest_first(records) == records[::-1]
    # As files of before had them.
    assert heaviest_first([{"kind": "gap"}, {"kind": "scale", "cost": 1.0}])[0]["kind"] == "scale"
    told = [cost_words(one) for one in (None, np.nan, 0.003, 0.1234, 41.2)]
    assert told == ["", "", "below 0.01 m", "0.12 m", "41 m"]
