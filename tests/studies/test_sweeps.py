"""Sweeps against the same designs run one by one, and designs that cannot be run."""

import contextlib
import io
import json
import tomllib

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT

from diffsea import UserError, read_vessel
from diffsea.cli import main
from diffsea.report.pictures import save_map
from diffsea.simulation import planning
from diffsea.studies import sweep
from diffsea.vessel.files import build


ORDERED = ["--manoeuvre", "zigzag", "--executes", "2", "--step", "0.1"]
# The last mass makes the inertia negative; the last damping makes the yaw rate explode.
# With the larger inertia the boat needs more than twice the time.
GRID = ["speed=1.0:1.4:2", "mass=-190:230:3", "N_r=-300:60000:2", "I_z=300:3000:2"]
AXES = ["speed", "mass", "N_r", "I_z"]

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache"), pytest.mark.compiles]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "boat.toml").write_text(BOAT)
    words = ["sweep", str(folder / "boat.toml"), *ORDERED, "--grid", *GRID]
    told = io.StringIO()
    with contextlib.redirect_stderr(told):
        assert main([*words, "-o", str(folder / "out")]) == 0
    table = pd.read_parquet(folder / "out" / "sweep.parquet")
    return table, json.loads((folder / "out" / "sweep.json").read_text()), told.getvalue()


def single(speed, **hull):
    """The numbers of one design, by the code of `diffsea trial`."""
    document = tomllib.loads(BOAT)
    document["hull"] |= hull
    vessel = build(document)
    plan = planning.plan_trial(vessel, "zigzag", speed=speed, executes=2, step=0.1)
    trial, numbers = planning.run_and_measure(vessel, plan)
    return planning.summarise_trial(vessel, plan, trial, numbers)


def test_a_grid_has_every_combination_once(swept):
    table, summary, _ = swept
    assert len(table) == summary["designs"] == 24
    assert not table[AXES].duplicated().any()
    assert sorted(set(table["mass"])) == [-190.0, 20.0, 230.0]
    units = {name: axis["unit"] for name, axis in summary["parameters"].items()}
    assert units == {"speed": "m/s", "mass": "kg", "N_r": "N m / (rad/s)", "I_z": "kg m^2"}


def test_every_design_has_the_numbers_of_its_own_trial(swept):
    """The last of them ran twice, the second time for longer."""
    table = swept[0].set_index(AXES)
    assert "4 designs not done in that time: run again" in swept[2]
    for speed, mass, I_z in ((1.0, 20.0, 300.0), (1.4, 230.0, 300.0), (1.0, 230.0, 3000.0)):
        row, alone = table.loc[(speed, mass, -300.0, I_z)], single(speed, mass=mass, I_z=I_z)
        assert row["outcome"] == "completed" == alone["outcome"]
        for name in ("overshoot_1", "initial_turning_distance", "peak_yaw_rate", "reach_time"):
            assert row[name] == pytest.approx(alone[name], rel=1e-9), name
        assert row["approach_speed"] == pytest.approx(speed, rel=1e-6)
        assert row["imo_overshoot_1"] == alone["imo"]["overshoot_1"]["verdict"]


def test_a_design_that_fails_spoils_only_its_row(swept):
    table, summary, _ = swept
    impossible, wild = table["mass"] < 0, (table["mass"] > 0) & (table["N_r"] > 0)
    assert (table["outcome"][impossible] == "impossible").all()
    assert (table["outcome"][wild] == "diverged").all()
    failed = table[impossible | wild]
    assert failed[["overshoot_1", "approach_speed", "imo_overshoot_1"]].isna().all(axis=None)
    good = table[~impossible & ~wild]
    assert (good["outcome"] == "completed").all() and good["overshoot_1"].notna().all()
    assert summary["outcomes"] == {"impossible": 8, "diverged": 8, "completed": 8}
    assert summary["metrics"]["overshoot_1"]["designs"] == 8


@pytest.mark.proof
def test_designs_of_a_vessel_that_cannot_do_the_trial_are_run_for_its_time_only_where_they_must():
    """Its own yaw is unstable: nothing tells beforehand how long the others take."""
    document = tomllib.loads(BOAT)
    document["hull"]["N_r"] = 60000.0
    vessel = build(document)
    plan = planning.plan_trial(vessel, "zigzag", speed=1.2, executes=2, step=0.1)
    told = []
    designs = sweep.Designs(("N_r",), np.array([[-300.0], [60000.0], [-600.0]]))
    table = sweep.sweep(vessel, plan, designs, told.append).table
    assert list(table["outcome"]) == ["completed", "diverged", "completed"]
    assert not told
    for row, N_r in ((0, -300.0), (2, -600.0)):
        alone = single(1.2, N_r=N_r)
        assert table["overshoot_1"].iloc[row] == pytest.approx(alone["overshoot_1"], rel=1e-9)


def test_a_map_leaves_failed_designs_white(tmp_path):
    names, values = sweep.grid({"mass": (1.0, 3.0, 3), "x_G": (0.0, 1.0, 4)})
    table = pd.DataFrame(values, columns=list(names))
    table["overshoot_1"] = np.where(table["mass"] > 2, np.nan, table["mass"] + table["x_G"])
    table["imo_overshoot_1"] = np.where(table["x_G"] > 0.5, "fail", "pass")
    table["approach_speed"] = 1.0
    save_map(table, ("mass", "x_G"), tmp_path / "map.png", "designs")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_a_sample_covers_its_ranges_evenly_and_repeats_with_its_seed():
    axes = {"mass": (100.0, 200.0), "x_G": (-0.5, 0.5)}
    names, values = sweep.sample(axes, 20, seed=3)
    assert names == ("mass", "x_G") and values.shape == (20, 2)
    for k, (low, high) in enumerate(axes.values()):
        assert sorted(((values[:, k] - low) / (high - low) * 20).astype(int)) == list(range(20))
    np.testing.assert_array_equal(values, sweep.sample(axes, 20, seed=3).values)
    assert not np.array_equal(values, sweep.sample(axes, 20, seed=4).values)


@pytest.mark.parametrize(
    ("vessel", "names", "message"),
    [
        ("wamv", ["maas"], "did you mean 'mass'"),
        ("kvlcc2", ["scaling.length"], "no parameter 'scaling.length'"),
        ("wamv", ["speed", "thrust"], "not both"),
        ("mariner", ["thrust"], "no propulsion"),
    ],
)
def test_names_that_cannot_be_swept_are_told(vessel, names, message):
    with pytest.raises(UserError, match=message):
        sweep.check_names(read_vessel(vessel).vessel, names)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "either --grid or --sample"),
        (["--grid", "mass=1:2:3", "--sample", "3", "mass=1:2"], "either --grid or --sample"),
        (["--grid", "mass=1:2"], "NAME=FROM:TO:COUNT"),
        (["--grid", "mass=1:x:3"], "'x' is not a number"),
        (["--grid", "mass=1:2:0"], "whole number above zero"),
        (["--grid", "mass=1:2:3", "mass=1:2:3"], "given twice"),
        (["--grid", "mass=1:2:3", "--grid", "x_G=0:1:3"], "give all values after one --grid"),
        (["--sample", "3"], "then NAME=FROM:TO"),
        (["--sample", "mass=1:2", "3"], "NAME=FROM:TO"),
        (["--grid", "speed=1:2:2", "--speed", "1"], "speed is swept"),
    ],
)
def test_bad_usage_of_designs_is_told(tmp_path, capsys, words, message):
    out = tmp_path / "out"
    assert main(["sweep", "wamv", "--manoeuvre", "zigzag", *words, "-o", str(out)]) == 2
    assert message in capsys.readouterr().err and not out.exists()


LOOKED_FOR = ["--sample", "16", "mass=150:230", "N_r=-400:-200", "--speed", "1.2"]


@pytest.mark.proof
def test_a_sweep_finds_what_it_is_to_look_for(tmp_path, capsys):
    (tmp_path / "boat.toml").write_text(BOAT)
    words = ["sweep", str(tmp_path / "boat.toml"), *ORDERED, *LOOKED_FOR, "--front", "overshoot_1"]
    words += ["initial_turning_distance", "--wanted", "overshoot_1=0.2", "-o", str(tmp_path / "o")]
    assert main(words) == 0
    told = capsys.readouterr().out
    summary = json.loads((tmp_path / "o" / "sweep.json").read_text())
    front = pd.read_csv(tmp_path / "o" / "front.csv")
    swept = pd.read_parquet(tmp_path / "o" / "sweep.parquet")
    assert 1 <= len(front) == summary["front"]["designs"] < 16
    least = [np.min(table["overshoot_1"].to_numpy(float)) for table in (front, swept)]
    assert least[0] == pytest.approx(least[1])
    assert f"{len(front)} designs no other beats in: least overshoot_1" in told
    assert summary["inverse"]["wanted"] == {"overshoot_1": 0.2}
    found = summary["inverse"]["designs"]
    assert all(set(one) == {"parameters", "metrics", "off", "steps"} for one in found)
    assert "overshoot_1 = 0.2" in told and "off by" in told
    page = (tmp_path / "o" / "sweep.html").read_text()
    assert "Designs that no other beats" in page and "Designs that are wanted" in page


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--wanted", "overshoot_1"], "not of the form NAME=VALUE"),
        (["--wanted", "overshoot_1=0.1", "overshoot_1=0.2"], "--wanted has a number twice"),
        (["--front", "overshoot_1:best"], "write overshoot_1:least or overshoot_1:most"),
        (["--front", "overshoot_1", "--shard", "1/2"], "a shard has no results"),
        (["--front", "mass", "overshot_1"], "no number 'overshot_1'; did you mean 'overshoot_1'"),
        (["--wanted", "tactical_diameter=50"], "no number 'tactical_diameter'"),
    ],
)
def test_what_cannot_be_looked_for_is_refused(words, message, tmp_path, capsys):
    (tmp_path / "boat.toml").write_text(BOAT)
    command = ["sweep", str(tmp_path / "boat.toml"), *ORDERED, *LOOKED_FOR, *words]
    try:
        status = main([*command, "-o", str(tmp_path / "o")])
    except SystemExit as left:
        status = left.code
    assert status in (1, 2) and message in capsys.readouterr().err
    assert [one.name for one in tmp_path.iterdir()] == ["boat.toml"]  # nothing was run
