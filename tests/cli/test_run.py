"""`diffsea run`: the missions that ship, what they write, and missions that cannot be read."""

import json
import re
import tomllib

import pandas as pd
import pytest
from tests.paths import ROOT

import diffsea
from diffsea.cli import main
from diffsea.missions.document import CONTROLLERS


pytestmark = pytest.mark.usefixtures("own_cache")

# These two take as long as all the others.
LONGEST = ("survey_that_learns", "unberthing")
MISSIONS = [
    pytest.param(path, marks=[pytest.mark.proof] if path.stem in LONGEST else [], id=path.stem)
    for path in sorted((ROOT / "examples" / "missions").glob("*.toml"))
]


@pytest.mark.parametrize("mission", MISSIONS)
def test_every_mission_that_ships_runs_to_its_end(mission, tmp_path, capsys):
    assert main(["run", str(mission), "--json", "-o", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "run.json").read_text())
    assert told["outcome"] == "completed" and told["time"] > 0
    if "waypoints" in told:
        assert 0 < told["path_error"]["rms"] < told["path_error"]["largest"]
        reached = [point["reached"] for point in told["waypoints"]]
        assert sum(reached) >= len(reached) - 1
    recorded = diffsea.read_recording(tmp_path / "recording.csv")
    assert recorded.t[-1] == pytest.approx(told["time"]) and set(recorded.commanded) == set(
        told["orders"]
    )
    page = (tmp_path / "run.html").read_text()
    assert f"<h1>{told['mission']}</h1>" in page and "Orders against limits" in page
    assert ("believes in another vessel" in page) == bool(told["model_differs"])
    sensors = "[sensors]" in mission.read_text()
    assert (tmp_path / "truth.csv").exists() == sensors


def test_a_mission_runs_from_a_script_and_prints_its_numbers():
    result = diffsea.run_mission(ROOT / "examples" / "missions" / "waypoints_in_a_swell.toml")
    text = repr(result)
    assert "path error, rms" in text and "waypoint 3, reached, closest" in text
    assert result.numbers["vessel"] == "pytheas"


GOOD = """
[vessel]
name = "otter"

[controller]
kind = "line-of-sight"
limits = { port = [-6.0, 12.0] }

[[waypoint]]
x = 0.0
y = 0.0

[[waypoint]]
x = 30.0
y = 0.0
"""
BAD = {
    "unknown-table": (GOOD + "[wether]\n", "unknown key 'wether' in the file"),
    "unknown-key": (
        GOOD.replace('sight"', 'sight"\nlookahed = 3.0'),
        "unknown key 'lookahed' in [controller] of kind 'line-of-sight'; did you mean 'lookahead'",
    ),
    "unknown-kind": (GOOD.replace("line-of-sight", "line-of-site"), "did you mean 'line-of-sight'"),
    "waypoint-without-number": (GOOD + "[[waypoint]]\nx = 3.0\n", "[[waypoint]] 3: y is missing"),
    "waypoint-of-text": (GOOD.replace("x = 30.0", 'x = "far"'), "[[waypoint]] 2: x = 'far' is not"),
    "waypoint-twice": (GOOD.replace("x = 30.0", "x = 0.0"), "2 is where the one before is"),
    "one-waypoint": (GOOD[: GOOD.rindex("[[way")], "follows [[waypoint]] tables, two or more"),
    "vessel": (GOOD.replace('"otter"', '"oter"'), "no vessel 'oter' ships; did you mean 'otter'?"),
    "no-vessel": (GOOD.replace('name = "otter"', ""), "the name of a shipped vessel or a file"),
    "vessel-file": (GOOD.replace('name = "otter"', 'file = "none.toml"'), "no such vessel file"),
    "limits-turned": (GOOD.replace("[-6.0, 12.0]", "[12.0, -6.0]"), "turn them round"),
    "limits-beyond": (GOOD.replace("[-6.0, 12.0]", "[20.0, 30.0]"), "outside what the actuator"),
    "limits-none": (GOOD.replace("[-6.0, 12.0]", "12.0"), "is not [lowest, highest]"),
    "limits-channel": (GOOD.replace("port =", "prt ="), "unknown key 'prt' in [controller] limits"),
    "steps": (GOOD + "[[step]]\ntime = 0.0\nheading = 0.0\nspeed = 1.0\n", "and no [[step]]"),
    "speed": (GOOD.replace('sight"', 'sight"\nspeed = 30.0'), "does not reach 30 m/s"),
    "model": (GOOD + '[model]\nname = "pytheas"\n', "[model] is ordered by thruster.angle (rad)"),
    "parameter": (
        GOOD.replace('"otter"', '"otter"\nparameters = { X_w = 1.0 }'),
        "no parameter 'X_w'",
    ),
    "impossible-vessel": (
        GOOD.replace('"otter"', '"otter"\nparameters = { mass = -1.0 }'),
        "must be positive",
    ),
    "seed": ("seed = 1.5\n" + GOOD, "seed = 1.5 is not a whole number"),
    "period": ("period = 0.0\n" + GOOD, "period = 0 must be positive"),
    "too-long": ("seconds = 1e9\n" + GOOD, "are too many: take a longer time_step"),
    "sensors": (GOOD + "[sensors]\nheading = -0.1\n", "[sensors]: heading = -0.1 is negative"),
    "weather-times": (
        GOOD + "[weather]\ncurrent = [{speed = 0.1, direction = 0}, {speed = 0, direction = 1}]\n",
        "[weather] current: time is missing",
    ),
    "not-toml": ("[vessel\n", "not valid TOML"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_mission_that_cannot_be_run_says_why_and_leaves_nothing(kind, tmp_path, capsys):
    text, message = BAD[kind]
    (tmp_path / "mission.toml").write_text(text)
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "mission.toml"), "-o", str(out)]) == 1
    printed = capsys.readouterr()
    assert message in printed.err and "this is a bug" not in printed.err
    assert "mission.toml" in printed.err or kind in ("speed", "too-long")
    assert printed.out == "" and not out.exists()


def test_a_mission_that_is_not_there_is_told(tmp_path, capsys):
    assert main(["run", str(tmp_path / "none.toml"), "-o", str(tmp_path / "out")]) == 1
    assert "cannot read the mission" in capsys.readouterr().err


def test_a_run_that_diverges_says_what_to_try(tmp_path, capsys):
    text = """
seconds = 60.0
vessel = { name = "otter", parameters = { X_u = 900.0 } }
controller = { kind = "orders" }
step = [{ time = 0.0, orders = { port = 9.0, starboard = 9.0 } }]
"""
    (tmp_path / "mission.toml").write_text(text)
    assert main(["run", str(tmp_path / "mission.toml"), "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "the run diverged" in told and "Try a time_step below 0.02" in told


def test_a_battery_is_a_table_and_shares_of_its_runs(tmp_path, capsys):
    (tmp_path / "mission.toml").write_text(GOOD)
    battery = tmp_path / "battery.toml"
    battery.write_text("runs = 2\n[vessel]\nmass = [70.0, 90.0]\n")
    out = tmp_path / "out"
    words = ["run", str(tmp_path / "mission.toml"), "--battery", str(battery), "-o", str(out)]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((out / "run.json").read_text()) and told["runs"] == 2
    table = pd.read_csv(out / "battery.csv")
    assert list(table["seed"]) == [0, 1] and table["mass"].between(70, 90).all()
    page = (out / "run.html").read_text()
    assert "2 of 2 runs were finished" in page and "turned further from the path" in page
    assert {path.name for path in out.iterdir()} == {"run.json", "battery.csv", "run.html"}
    battery.write_text("runs = 2\n[vessl]\n")
    assert main([*words[:-1], str(tmp_path / "none")]) == 1
    assert "battery.toml: unknown key 'vessl'" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_the_mission_of_the_documentation_runs():
    page = (ROOT / "docs" / "missions.md").read_text()
    text = page[page.index("```toml") + 7 : page.index("```\n", page.index("```toml") + 7)]
    result = diffsea.run_mission(tomllib.loads(text))
    assert result.numbers["vessel"] == "otter" and "mass" in result.numbers["model_differs"]
    kinds = page[page.index("| `kind` |") : page.index("`heading` takes")]
    assert re.findall(r"^\| `([a-z-]+)` \| ", kinds, re.MULTILINE) == ["kind", *CONTROLLERS]


def test_a_mission_that_passes_a_waypoint_by_is_not_called_completed(tmp_path):
    """Line of sight goes on once a waypoint is abeam, however far away."""
    shipped = (ROOT / "examples" / "missions" / "survey_in_a_tide.toml").read_text()
    mission, out = tmp_path / "mission.toml", tmp_path / "out"
    mission.write_text(re.sub(r"radius = [\d.]+", "radius = 0.05", shipped))
    assert main(["run", str(mission), "-o", str(out)]) == 0
    told = json.loads((out / "run.json").read_text())
    missed = sum(not point["reached"] for point in told["waypoints"])
    assert told["outcome"] == "completed" and missed > 0
    assert f'<p class="word">ended, {missed} missed</p>' in (out / "run.html").read_text()


SHORT = (
    GOOD
    + """
[start]
u = 0.8
"""
)


def test_a_grid_writes_a_row_for_each_combination(tmp_path, capsys):
    mission = tmp_path / "mission.toml"
    mission.write_text(SHORT)
    words = ["run", str(mission), "--grid", "lookahead=3:9:3", "heading.gain=1:3:2"]
    assert main([*words, "--json", "-o", str(tmp_path / "out")]) == 0
    told = json.loads(capsys.readouterr().out)
    table = pd.read_csv(tmp_path / "out" / "grid.csv")
    assert len(table) == told["designs"] == 6
    assert told["parameters"]["controller.lookahead"] == {"from": 3.0, "to": 9.0}
    assert told["best"]["path_rms"] == pytest.approx(table["path_rms"].min())
    assert told["as_it_stands"]["path_rms"] > 0
    page = (tmp_path / "out" / "run.html").read_text()
    assert "Best runs" in page and "Smallest path rms of completed runs" in page


@pytest.mark.proof
def test_tuning_writes_the_mission_that_it_ran(tmp_path, capsys):
    mission, out = tmp_path / "mission.toml", tmp_path / "out"
    mission.write_text(SHORT)
    words = ["run", str(mission), "--tune", "lookahead=0.5:4", "--starts", "1", "-o", str(out)]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    tuned = told["tuning"]["numbers"]["controller.lookahead"]
    assert (tuned["from"], tuned["to"]) == (0.5, 4.0) and 0.5 < tuned["after"] <= 4.0
    written = tomllib.loads((out / "mission.toml").read_text())
    assert written["controller"]["lookahead"] == tuned["after"]
    assert main(["run", str(out / "mission.toml"), "--json", "-o", str(tmp_path / "again")]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["path_error"]["rms"] == pytest.approx(told["path_error"]["rms"], rel=1e-6)
    assert "What was tuned" in (out / "run.html").read_text()


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (["--grid", "lookahed=3:9:3"], 1, "did you mean 'lookahead'"),
        (["--grid", "gain=1:3:2"], 1, "may be any of controller.heading.gain"),
        (["--grid", "lookahead=3:9"], 2, "not of the form NAME=FROM:TO:COUNT"),
        (["--tune", "lookahead=9:3"], 1, "give the lower number first"),
        (["--tune", "lookahead=3:9:4"], 2, "not of the form NAME=FROM:TO"),
        (["--grid", "lookahead=3:9:3", "--tune", "lookahead=3:9"], 2, "not allowed with"),
        (["--judge", "other.toml"], 2, "--judge belongs to --tune"),
        (["--tune", "lookahead=3:9", "--effort", "-1"], 2, "is negative"),
        (["--tune", "lookahead=3:9", "--judge", "none.toml"], 1, "none.toml"),
    ],
)
def test_grids_and_tunings_that_cannot_be_are_refused(words, status, told, tmp_path, capsys):
    mission = tmp_path / "mission.toml"
    mission.write_text(SHORT)
    assert main(["run", str(mission), *words, "-o", str(tmp_path / "out")]) == status
    assert told in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_defaults_of_a_tuning_are_those_of_the_library():
    from diffsea.cli.studies import running
    from diffsea.missions.studies import tuning

    assert (running.STARTS, running.EFFORT) == (tuning.STARTS, tuning.EFFORT)
