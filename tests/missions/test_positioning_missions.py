# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
"""Missions of poses: what they are judged by, many at once, mirrored, and what is refused."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import tomli_w
from tests.boats import square_boat_document

import diffsea
from diffsea import UserError
from diffsea.kinematics import wrap
from diffsea.missions import mission_of, run, scores
from diffsea.missions.controllers import controller_of
from diffsea.missions.numbers import mission_numbers
from diffsea.missions.performance import held_poses, tracking_errors
from diffsea.missions.studies.sweep import closed_loop_sweep
from diffsea.missions.studies.tuning import mirrored, turned
from diffsea.simulation.control.positioning import reference
from diffsea.simulation.designs import Grid
from diffsea.workflows.missions import run_battery


pytestmark = pytest.mark.compiles


POSES = ((0.0, 0.0, 0.0, 0.0), (12.0, 2.0, -1.5, 0.6), (20.0, 2.0, -1.5, 0.6))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("poses")
    (folder / "square.toml").write_text(tomli_w.dumps(square_boat_document()))
    return folder


def document(**changes):
    return {
        "vessel": {"file": "square.toml"},
        "controller": {"kind": "positioning"},
        "step": [dict(zip(("time", "x", "y", "heading"), pose, strict=True)) for pose in POSES],
        "weather": {"current": {"speed": 0.1, "direction": 1.0}},
        "seconds": 30.0, "time_step": 0.05, "period": 0.25,
    } | changes  # fmt: skip


def test_a_mission_of_poses_begins_in_the_first_and_is_judged_by_place_and_heading(folder):
    found = run(mission_of(document(), folder))
    true, told = found.true, scores(found)
    assert (true.x[0], true.y[0], true.psi[0], true.u[0]) == (0.0, 0.0, 0.0, 0.0)
    assert told["outcome"] == "completed" and "waypoints" not in told
    t = np.clip(true.t, 0.0, 12.0) / 12.0
    ease = 3 * t**2 - 2 * t**3
    off = np.hypot(true.x - 2.0 * ease, true.y + 1.5 * ease)
    turned_off = np.asarray(wrap(true.psi - 0.6 * ease))
    assert told["position_error"]["largest"] == pytest.approx(off.max(), rel=1e-6)
    assert told["position_error"]["rms"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-6)
    assert told["heading_error"]["largest"] == pytest.approx(np.abs(turned_off).max(), rel=1e-6)
    assert off[-1] < 0.1 and "speed_error" not in told


@pytest.mark.proof
def test_batches_beside_one_another_come_to_their_end(folder):
    """In a process of its own, whose batches may wait for each other for ever."""
    square = {"file": str(folder / "square.toml")}
    path = folder / "poses.toml"
    path.write_text(tomli_w.dumps(document(vessel=square, seconds=6.0)))
    words = ["run", path, "--grid", "controller.position=0.2:0.6:260", "-o", folder / "grid"]
    done = subprocess.run([sys.executable, "-m", "diffsea", *map(str, words)], timeout=200)
    assert done.returncode == 0 and len(pd.read_csv(folder / "grid" / "grid.csv")) == 260


def test_many_numbers_at_once_are_the_mission_with_each(folder):
    mission = mission_of(document(), folder)
    axes = {"position": (0.2, 0.8, 2), "vessel.mass": (120.0, 180.0, 2)}
    table = closed_loop_sweep(mission, Grid(axes)).table
    assert len(table) == 4
    for row in table.to_dict("records"):
        given = document(
            controller={"kind": "positioning", "position": row["controller.position"]},
            vessel={"file": "square.toml", "parameters": {"mass": row["vessel.mass"]}},
            model={"file": "square.toml"},
        )
        told = scores(run(mission_of(given, folder)))
        assert row["position_rms"] == pytest.approx(told["position_error"]["rms"], rel=1e-6)
        assert row["heading_largest"] == pytest.approx(told["heading_error"]["largest"], rel=1e-6)
    assert {"controller.position", "controller.heading_error", "controller.integral_time"} <= set(
        mission_numbers(mission)
    )


def test_a_mirrored_or_turned_mission_of_poses_is_the_mirrored_or_turned_run(folder):
    mission = mission_of(document(weather={}), folder)
    one = run(mission)
    other, round_ = run(mirrored(mission)), run(turned(mission, 1.0))
    np.testing.assert_allclose(other.true.y, -one.true.y, atol=1e-9)
    np.testing.assert_allclose(other.true.psi, -one.true.psi, atol=1e-9)
    north = np.cos(1.0) * one.true.x - np.sin(1.0) * one.true.y
    np.testing.assert_allclose(round_.true.x, north, atol=1e-6)
    np.testing.assert_allclose(round_.true.psi, one.true.psi + 1.0, atol=1e-6)


def test_limits_of_a_mission_hold_and_are_known_to_the_controller(folder):
    narrow = {f"t{k}": [-8.0, 8.0] for k in range(4)}
    given = document(controller={"kind": "positioning", "limits": narrow}, seconds=60.0)
    mission = mission_of(given, folder)
    told = scores(run(mission))
    assert all(-8.0 <= one["least"] and one["largest"] <= 8.0 for one in told["orders"].values())
    control = controller_of(mission, 0.25)
    effector = next(one for one in control.effectors if one.channel == "t0")
    assert float(effector.values[-1]) == 8.0
    with pytest.raises(UserError, match="cannot be positioned"):
        nothing = {f"t{k}": [-1e-9, 1e-9] for k in range(3)}
        run(mission_of(document(controller={"kind": "positioning", "limits": nothing}), folder))


def test_scores_and_controller_have_one_reference(folder):
    mission = mission_of(document(), folder)
    control = controller_of(mission, 0.25)
    t = np.linspace(0.0, 25.0, 11)
    places = [reference(control.times, control.poses, jnp.asarray(at))[0] for at in t]
    np.testing.assert_allclose(np.stack(held_poses(mission, t), 1), np.stack(places), atol=1e-12)
    found = run(mission)
    assert list(tracking_errors(mission, found.true)) == ["position", "heading"]


def test_a_battery_of_poses_sums_up_distances(folder):
    (folder / "battery.toml").write_text("runs = 3\nseed = 1\n[vessel]\nmass = [120.0, 180.0]\n")
    (folder / "short.toml").write_text(tomli_w.dumps(document(seconds=10.0)))
    found = run_battery(folder / "short.toml", folder / "battery.toml")
    table = found.to_frame()
    assert len(table) == 3 and min(table["position_rms"]) > 0
    assert "position_rms" in str(found.numbers)


def test_the_page_shows_how_far_off_the_poses_she_is(folder):
    (folder / "mission.toml").write_text(tomli_w.dumps(document()))
    page = diffsea.run_mission(folder / "mission.toml").html()
    assert "off the pose (m)" in page and "Distance from the pose by" in page
    assert '"poses"' in page


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"step": [{"time": 0.0, "x": 1.0, "y": 0.0}]}, "heading"),
        ({"step": [{"time": 0.0, "x": 1.0, "y": 0.0, "heading": 0.0, "speed": 1.0}]}, "speed"),
        ({"controller": {"kind": "positioning", "position": 0.0}}, "position = 0"),
        ({"controller": {"kind": "positioning", "speed": 1.0}}, "speed"),
        ({"vessel": {"name": "otter"}}, "cannot be positioned"),
    ],
)
def test_what_cannot_be_is_refused(folder, changes, said):
    with pytest.raises(UserError, match=said):
        run(mission_of(document(**changes), folder))
