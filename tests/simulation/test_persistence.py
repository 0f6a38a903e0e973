"""Going on as before, against arcs and straight lines that are written out."""

import dataclasses

import numpy as np
import pytest

from diffsea import Trajectory
from diffsea.report.wording.horizons import persistence_sentence
from diffsea.simulation.persistence import persistence_errors
from diffsea.vessel.sensors import Sensors


T = 0.5 * np.arange(161)  # s


def run(x, y, psi, u, v, r) -> Trajectory:
    columns = [np.broadcast_to(np.asarray(one, float), T.shape) for one in (x, y, psi, u, v, r)]
    nothing = {}
    return Trajectory(
        T, *columns, commanded=nothing, executed=nothing, extra=nothing,
        valid=np.ones(T.shape, bool),
    )  # fmt: skip


@pytest.mark.parametrize("rate", [0.0, 0.05, -0.3])
def test_nothing_is_missed_of_a_motion_that_goes_on(rate):
    """A drifting craft on a circle: its centre lies abeam of where it is bound."""
    u, v, psi = 1.5, -0.2, 0.4 + rate * T
    if rate:
        x = (u * (np.sin(psi) - np.sin(0.4)) + v * (np.cos(psi) - np.cos(0.4))) / rate
        y = (-u * (np.cos(psi) - np.cos(0.4)) + v * (np.sin(psi) - np.sin(0.4))) / rate
    else:
        x, y = (u * np.cos(0.4) - v * np.sin(0.4)) * T, (u * np.sin(0.4) + v * np.cos(0.4)) * T
    found = persistence_errors(run(x, y, psi, u, v, rate), Sensors())
    assert set(found) == {5.0, 20.0, 60.0}
    assert all(max(one[k] for k in one if k != "starts") < 1e-9 for one in found.values())
    assert found[60.0]["starts"] == 3 and found[5.0]["starts"] == 8


def test_speed_that_rises_is_missed_by_as_much_as_it_rose():
    """x = a t^2 / 2: after s seconds a s^2 / 2 further than by the speed of the start."""
    found = persistence_errors(run(0.05 * T**2, 0, 0, 0.1 * T, 0, 0), Sensors(), (5.0, 20.0))
    for seconds, errors in found.items():
        assert errors["position"] == pytest.approx(0.05 * seconds**2)
        assert errors["u"] == pytest.approx(0.1 * seconds) and errors["heading"] == 0.0
    assert persistence_errors(run(T, 0, 0, 1, 0, 0), Sensors(), (200.0,)) == {}


def test_an_antenna_that_swings_round_is_no_motion_of_the_boat():
    """3 m ahead of the origin of a boat on a circle, as her file says."""
    psi, rate = 0.1 * T, 0.1
    x = 2.0 * np.sin(psi) / rate + 3.0 * np.cos(psi)
    y = -2.0 * (np.cos(psi) - 1) / rate + 3.0 * np.sin(psi)
    circle = run(x, y, psi, 2.0, 0.0, rate)
    known = dataclasses.replace(Sensors(), lever_x=3.0)
    assert persistence_errors(circle, known)[20.0]["position"] < 1e-9
    assert persistence_errors(circle, Sensors())[20.0]["position"] > 3.0


def test_a_model_that_is_no_better_is_told_with_both_errors():
    kept = {5.0: {"position": 1.0, "heading": 0.1}, 20.0: {"position": 8.0, "heading": 0.5}}
    better = {5.0: {"position": 2.0, "heading": 0.1}, 20.0: {"position": 3.0, "heading": 0.9}}
    assert persistence_sentence(better, kept) == ""
    worse = {5.0: {"position": 0.5, "heading": 0.1}, 20.0: {"position": 12.0, "heading": 0.1}}
    told = persistence_sentence(worse, kept)
    assert told.startswith("the position 20 s ahead is off by 12 m, and would be by 8.0 m if")
    turning = {20.0: {"heading": 0.9}}
    assert (
        "the heading 20 s ahead is off by 52 deg, and would be by 29 deg"
        in persistence_sentence(turning, {20.0: {"heading": 0.5}})
    )
    assert persistence_sentence({20.0: {"u": 1.0}}, {20.0: {"u": 0.5}}) == ""
    assert persistence_sentence({}, {}) == persistence_sentence(kept, kept) == ""
