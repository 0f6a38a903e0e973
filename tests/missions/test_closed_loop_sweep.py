"""Missions with many values of their numbers: names, batches beside single runs, pure functions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffsea
from diffsea.missions import mission_of, run, scores
from diffsea.missions.numbers import (
    full_names,
    mission_numbers,
    settled,
    with_numbers,
    with_numbers_in_file,
)
from diffsea.missions.paths import legs_in_force, path_offsets
from diffsea.missions.record import Flow
from diffsea.missions.studies.sweep import closed_loop_sweep
from diffsea.simulation.designs import Grid


pytestmark = pytest.mark.compiles


LIMITED = {"limits": {"port": [-6.0, 9.0]}}


def document(**changes):
    """A short leg and a corner for the Otter in a current."""
    return {
        "vessel": {"name": "otter"},
        "controller": {"kind": "line-of-sight", "speed": 1.2, "radius": 3.0},
        "waypoint": [{"x": 0.0, "y": 0.0}, {"x": 25.0, "y": 0.0}, {"x": 25.0, "y": 15.0}],
        "weather": {"current": {"speed": 0.1, "direction": 1.0}},
        "time_step": 0.05,
        "period": 0.25,
    } | changes


@pytest.mark.parametrize(
    "axes",
    [
        pytest.param(
            {"lookahead": (3.0, 9.0, 2), "heading.gain": (1.0, 2.5, 2)}, marks=pytest.mark.proof
        ),
        pytest.param(
            {"controller.speed": (0.4, 1.2, 2), "radius": (2.0, 3.0, 2)}, marks=pytest.mark.proof
        ),
        {"vessel.mass": (55.0, 100.0, 2), "model.X_u": (-90.0, -60.0, 2)},
        pytest.param(
            {"weather.current.speed": (0.0, 0.4, 2), "controller.speed": (0.8, 1.3, 2)},
            marks=pytest.mark.proof,
        ),
    ],
    ids=["gains", "slow-ones", "plant-and-model", "weather-and-speed"],
)
def test_every_design_is_the_mission_with_its_numbers(axes):
    limited = document()
    limited["controller"] |= LIMITED
    mission = mission_of(limited)
    found = closed_loop_sweep(mission, Grid(axes)).table
    names = full_names(mission, list(axes))
    assert list(found)[:2] == names and len(found) == 4
    for row in found.to_dict("records"):
        alone = scores(run(with_numbers(mission, {name: row[name] for name in names})))
        assert row["outcome"] == alone["outcome"] == "completed"
        assert row["path_rms"] == pytest.approx(alone["path_error"]["rms"], rel=1e-9)
        assert row["path_largest"] == pytest.approx(alone["path_error"]["largest"], rel=1e-9)
        assert row["time"] == pytest.approx(alone["time"])
        assert row["missed"] == sum(not point["reached"] for point in alone["waypoints"])
        at_limit = max(one["at_limit"] for one in alone["orders"].values())
        assert row["at_limit"] == pytest.approx(at_limit)
    assert max(found["at_limit"]) > 0


def test_a_course_is_judged_by_heading_and_speed():
    steps = [
        {"time": 0.0, "heading": 0.0, "speed": 1.0},
        {"time": 5.0, "heading": 0.5, "speed": 1.0},
    ]
    mission = mission_of(
        {
            "vessel": {"name": "otter"},
            "controller": {"kind": "course"},
            "step": steps,
            "seconds": 20.0,
        }
    )
    found = closed_loop_sweep(mission, Grid({"heading.rate_gain": (1.0, 4.0, 3)})).table
    assert found["outcome"].tolist() == ["completed"] * 3
    assert len(set(found["heading_rms"])) == 3 and min(found["speed_rms"]) > 0
    row = found.to_dict("records")[1]
    alone = scores(run(with_numbers(mission, {found.columns[0]: row[found.columns[0]]})))
    assert row["heading_rms"] == pytest.approx(alone["heading_error"]["rms"], rel=1e-9)


def test_names_are_those_of_the_file_or_their_ends():
    mission = mission_of(document())
    assert full_names(mission, ["lookahead", "heading.gain", "model.mass"]) == [
        "controller.lookahead",
        "controller.heading.gain",
        "model.mass",
    ]
    for name, told in {
        "gain": "may be any of controller.heading.gain, controller.speed_law.gain",
        "mass": "may be any of vessel.mass, model.mass",
        "controller.lookahed": "did you mean 'controller.lookahead'",
    }.items():
        with pytest.raises(diffsea.UserError, match=told):
            full_names(mission, [name])
    with pytest.raises(diffsea.UserError, match="given twice"):
        full_names(mission, ["lookahead", "controller.lookahead"])


def test_numbers_that_are_not_stated_are_the_usual_ones():
    mission = mission_of(document())
    stated = {name: value for name, value in mission_numbers(mission).items()}
    again = with_numbers(mission, {n: v for n, v in stated.items() if n.startswith("controller.")})
    first, second = scores(run(mission)), scores(run(again))
    assert first["path_error"] == second["path_error"]
    assert stated["controller.lookahead"] == 2.5 * float(mission.model.rigid_body.length)


def test_a_speed_beyond_reach_is_told():
    with pytest.raises(diffsea.UserError, match="does not reach 9 m/s"):
        closed_loop_sweep(mission_of(document()), Grid({"controller.speed": (1.0, 9.0, 3)}))
    with pytest.raises(diffsea.UserError, match="above zero"):
        closed_loop_sweep(mission_of(document()), Grid({"controller.speed": (0.0, 1.0, 3)}))


@pytest.mark.proof
def test_a_grid_of_a_mission_that_learns_is_its_runs():
    """Gains and the plant change; what is learnt begins at the model that the file states."""
    plain = document() | {
        "vessel": {"name": "otter"},
        "model": {"name": "otter", "parameters": {"X_u": -62.0}},
        "sensors": {"position": 0.05, "heading": 0.005, "velocity": 0.01, "yaw_rate": 0.001},
    }
    mission = mission_of(plain | {"estimator": {"kind": "kalman", "free": ["X_u", "N_r"]}})
    space = Grid({"controller.lookahead": (3.0, 4.0, 2), "vessel.X_u": (-95.0, -90.0, 2)})
    rows = closed_loop_sweep(mission, space).table.to_dict("records")
    without = closed_loop_sweep(mission_of(plain), space).table["path_rms"]
    for row, unlearnt in zip(rows, without, strict=True):
        alone = run(with_numbers(mission, {name: row[name] for name in space.names}))
        # Its own trial trip tells the filter of slightly other sensor noise.
        assert row["path_rms"] == pytest.approx(scores(alone)["path_error"]["rms"], rel=1e-5)
        assert abs(row["path_rms"] / unlearnt - 1) > 1e-3


def test_distances_from_a_path_have_derivatives_on_it_and_beyond_its_ends():
    points = jnp.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    track = jnp.array(
        [[0.0, 0.0], [5.0, 0.0], [5.0, 2.0], [13.0, 4.0], [10.0, 14.0], [13.0, 14.0], [7.0, 14.0]]
    )
    offsets = path_offsets(points, track, 0.5)
    # On the path twice, 2 m to starboard, 3 m to port of the second leg, which begins abeam of the
    # corner; then past its end straight ahead, to port and to starboard.
    np.testing.assert_allclose(np.abs(offsets), [0.0, 0.0, 2.0, 3.0, 4.0, 5.0, 5.0], atol=1e-12)
    assert offsets[2] > 0 > offsets[3] and offsets[6] > 0 > offsets[5]
    assert legs_in_force(points, track, 0.5).tolist() == [0, 0, 0, 1, 1, 1, 1]
    slopes = jax.jacfwd(lambda track: path_offsets(points, track, 0.5))(track)
    assert bool(jnp.all(jnp.isfinite(slopes)))
    assert slopes[2, 2].tolist() == [0.0, 1.0] and slopes[3, 3].tolist() == [-1.0, 0.0]
    assert slopes[4, 4].tolist() == [0.0, pytest.approx(1.0)] or slopes[4, 4, 1] == pytest.approx(
        -1
    )


def test_a_run_that_diverges_spoils_no_other():
    mission = mission_of(document(seconds=40.0))
    found = closed_loop_sweep(mission, Grid({"vessel.mass": (-50.0, 80.0, 2)})).table
    assert found["outcome"].tolist() == ["diverged", "completed"]
    first, second = found["path_rms"].tolist()
    assert np.isnan(first) and second > 0


def test_plants_differ_while_the_model_stays():
    mission = mission_of(document())
    heavy = with_numbers(mission, {"vessel.mass": 100.0})
    assert float(heavy.model.rigid_body.mass) == float(mission.model.rigid_body.mass)
    assert dataclasses.replace(heavy, vessel=mission.vessel) == mission


@pytest.mark.parametrize(
    "values",
    [
        {"vessel.mass": 70.0, "controller.heading.gain": 1.3},
        {"model.X_u": -70.0},
        {"weather.current.speed": 0.3, "weather.wind.speed": 3.0},
    ],
    ids=["plant", "model", "weather"],
)
def test_a_file_with_other_numbers_is_the_mission_with_them(values):
    written = document()
    of_file = mission_of(with_numbers_in_file(written, values))
    pure = with_numbers(settled(mission_of(written), values), values)
    first, second = scores(run(of_file)), scores(run(pure))
    assert (
        first["path_error"]
        == second["path_error"]
        != scores(run(mission_of(written)))["path_error"]
    )
    assert first["model_differs"] == second["model_differs"]
    assert "parameters" not in written["vessel"]


def test_a_flow_that_changes_is_steady_once_it_has_a_number():
    turning = [{"time": 0.0, "speed": 0.2, "direction": 1.0}]
    turning.append({"time": 50.0, "speed": 0.2, "direction": 2.0})
    mission = mission_of(document(weather={"current": turning}))
    assert "weather.current.speed" not in mission_numbers(mission)
    flow = with_numbers(mission, {"weather.current.speed": 0.5}).weather.current
    assert flow == Flow((0.0,), (0.5,), (1.0,))
