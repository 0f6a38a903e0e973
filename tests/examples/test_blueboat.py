# pyright: reportArgumentType=false
"""examples/blueboat: its recordings, mission and script, and that its page says what was found.

    python -m tests.examples.test_blueboat

writes into the page what its commands print today, in some ten minutes.
"""

import json
import math
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import pytest
from examples.blueboat import coefficients, make_mission, make_runs
from tests.cli import test_tutorial
from tests.paths import ROOT

import diffsea
from diffsea.cli import make_parser
from diffsea.vessel.files import build


HOME = ROOT / "examples" / "blueboat"
PAGE = (HOME / "README.md").read_text(encoding="utf-8")
RESULTS = json.loads((HOME / "results.json").read_text(encoding="utf-8"))
LUA, COMPILER = shutil.which("lua5.3"), shutil.which("luac5.3")
TABLES = {
    "coefficients": lambda: coefficients.coefficient_table(RESULTS),
    "alone": lambda: coefficients.share_table(RESULTS["determined"]),
    "judged": lambda: coefficients.judged_table(RESULTS),
    "open": lambda: coefficients.open_questions(RESULTS),
}


def prepare(folder: Path) -> None:
    """Put into a folder what the page has before its first command of the tool."""
    make_runs.main(folder / "out" / "blueboat" / "runs")
    (folder / "examples").symlink_to(ROOT / "examples")


def commands() -> list[list[str]]:
    """The commands of the page, as a shell splits them."""
    found = re.findall(r"^    diffsea (.*)$", PAGE.replace("\\\n", ""), re.MULTILINE)
    return [shlex.split(command, comments=True) for command in found]


# -- the page ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TABLES)
def test_the_page_has_the_tables_of_the_results(name):
    assert f"<!-- begin {name} -->\n{TABLES[name]()}\n<!-- end {name} -->" in PAGE
    assert not RESULTS["quick"]


def test_every_command_of_the_page_can_be_given():
    assert {words[0] for words in commands()} >= {
        "check", "new", "fit", "diagnose", "show", "export",
    }  # fmt: skip
    for words in commands():
        make_parser().parse_args(words)


def test_the_page_fits_as_the_script_does():
    plain, pulled = (words[2:] for words in commands() if words[0] == "new")
    assert plain == [*coefficients.DIMENSIONS]
    assert pulled == [*coefficients.DIMENSIONS, *coefficients.PULLED]
    _, current, last = (words for words in commands() if words[0] == "fit")
    for words, known in ((current, "known.toml"), (last, "pulled.toml")):
        assert words[words.index("--effects") + 1] == ",".join(coefficients.CURRENT)
        assert words[words.index("--priors") + 1] == f"examples/blueboat/{known}"


def test_the_pull_errs_by_what_it_says():
    told = tomllib.loads((HOME / "pulled.toml").read_text(encoding="utf-8"))
    for side, full in make_runs.FULL_THRUST.items():
        prior = told[f"{side}.thrust_curve.full_thrust"]
        assert 0 < abs(prior["value"] / full - 1) < prior["spread"]


@pytest.mark.proof
def test_the_page_shows_what_its_commands_print(tmp_path, monkeypatch):
    monkeypatch.setattr(test_tutorial, "WITHOUT_OUTPUT", ())
    prepare(tmp_path)
    told = zip(PAGE.splitlines(), test_tutorial.renewed(PAGE, tmp_path).splitlines(), strict=True)
    for shown, printed in told:
        assert test_tutorial.words(shown) == test_tutorial.words(printed)


# -- the results -------------------------------------------------------------------------------


def test_what_is_true_is_what_was_recorded_and_differs_from_the_start():
    true = make_runs.truth()
    for name, one in RESULTS["coefficients"].items():
        actual = true["I_z"] - true["N_rdot"] if "I_z" in name else true[name]
        assert one["true"] == pytest.approx(actual), name
        assert one["holds"] == (one["interval"][0] <= actual <= one["interval"][1]), name
    off = [abs(one["start"] / one["true"] - 1) for one in RESULTS["coefficients"].values()]
    assert np.median(off) > 0.2


def test_intervals_hold_as_often_as_they_say():
    holds = [one["holds"] for one in RESULTS["coefficients"].values()]
    assert sum(holds) >= 0.75 * len(holds)  # of 90 % intervals, which are not independent
    current = RESULTS["together"]["effects"]["current"]
    for key, actual in make_runs.CURRENT.items():
        assert abs(current[key]["value"] - actual) < 3 * current[key]["std"], key


def test_a_fit_without_the_current_says_that_something_is_missing():
    without, together = RESULTS["without_current"], RESULTS["together"]
    assert without["missing"] and not together["missing"]
    assert len(without["outside"]) > len(together["outside"])


def test_no_trial_alone_tells_all():
    shares = RESULTS["determined"]
    for trial in coefficients.FOUR:
        assert min(shares[f"{trial} alone"].values()) < coefficients.DETERMINED
    assert shares["turning alone"]["N_rr"] > coefficients.DETERMINED
    assert shares["steady alone"]["X_uu"] > coefficients.DETERMINED


# -- the recordings ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["acceleration", "coasting", "turning"])
def test_recordings_are_what_the_vessel_would_do(name, monkeypatch):
    # Two simulators that share no code: the library replays what the oracle recorded, without
    # gusts and noise.
    monkeypatch.setattr(make_runs, "GUSTS", 0.0)
    monkeypatch.setattr(make_runs, "NOISE", 0.0)
    monkeypatch.setattr(make_runs, "FIXES", 1)
    document = make_runs.true_vessel()
    curve = {"exponent": make_runs.EXPONENT, "astern_ratio": make_runs.ASTERN_RATIO}
    for thruster in document["thruster"]:
        del thruster["max_force"], thruster["min_force"]
        full = make_runs.FULL_THRUST[thruster["name"]]
        thruster |= {"unit": "us", "thrust_curve": curve | {"full_thrust": full}}
    document["effect"] = [{"name": "current", **make_runs.CURRENT}]
    rows = make_runs.recorded(name)
    columns = {c: rows[c] for c in ("x", "y", "psi", "u", "v", "r")}
    run = diffsea.Trajectory(
        rows["t"], **columns, commanded={s: rows[f"cmd_{s}"] for s in make_runs.FULL_THRUST},
        executed={}, extra={}, valid=np.ones(len(rows["t"]), bool),
    )  # fmt: skip
    shown = diffsea.replay(build(document), run)
    for channel, limit in {"x": 0.05, "y": 0.05, "u": 0.01, "v": 0.01, "r": 0.01}.items():
        off = np.asarray(getattr(shown, channel)) - rows[channel]
        assert np.abs(off).max() < limit, channel


def test_recordings_are_the_same_each_time(tmp_path):
    make_runs.main(tmp_path)
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(first) == {f"{name}.csv" for name in make_runs.TRIALS} | {"truth.json"}
    again = make_runs.recorded("acceleration")
    read = diffsea.read_recording(tmp_path / "acceleration.csv")
    np.testing.assert_allclose(np.asarray(read.r), again["r"], atol=1e-9)
    assert sum(map(len, first.values())) < 300_000


# -- mission and script ------------------------------------------------------------------------


def test_the_mission_runs_every_trial_in_its_order():
    text = (HOME / "trials.waypoints").read_text(encoding="utf-8")
    assert text == make_mission.mission(*make_mission.EXAMPLE)
    head, *lines = text.splitlines()
    assert head == "QGC WPL 110"
    items = [line.split("\t") for line in lines]
    assert [item[0] for item in items] == [str(n) for n in range(len(items))]
    assert all(len(item) == 12 for item in items)
    scripted = [item for item in items if item[3] == "42702"]
    assert [int(item[4]) for item in scripted] == list(range(1, len(make_runs.TRIALS) + 1))
    for item, trial in zip(scripted, make_runs.TRIALS.values(), strict=True):
        assert sum(step[0] for step in trial.orders) < int(item[5]) < 256


def test_the_script_has_the_trials_that_are_recorded():
    text = (HOME / "trials.lua").read_text(encoding="utf-8")
    table = text[text.index("local TRIALS") : text.index("local AUTO")]
    found = {}
    for entry in re.findall(r'\{"(\w+)", (\{.*?\}\})\}', table, re.DOTALL):
        steps = re.findall(r"\{([^{}]+)\}", entry[1])
        found[entry[0]] = [tuple(float(n) for n in step.split(",")) for step in steps]
    assert list(found) == list(make_runs.TRIALS)
    for name, trial in make_runs.TRIALS.items():
        assert found[name] == [tuple(map(float, step)) for step in trial.orders], name


@pytest.mark.skipif(COMPILER is None, reason="luac5.3 is not here: apt-get install lua5.3")
def test_the_script_is_lua():
    done = subprocess.run(
        [str(COMPILER), "-p", str(HOME / "trials.lua")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def driven(number: int, *event: str) -> tuple[list[tuple[int, ...]], list[str]]:
    """What the script did: overrides (ms, output, us, timeout), and how it ended."""
    stand_in = ROOT / "tests" / "examples" / "autopilot.lua"
    words = [str(LUA), str(stand_in), str(HOME / "trials.lua"), str(number), *event]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    *lines, last = done.stdout.splitlines()
    return [tuple(int(n) for n in line.split()) for line in lines], last.split()[1:]


needs_lua = pytest.mark.skipif(LUA is None, reason="lua5.3 is not here: apt-get install lua5.3")


@needs_lua
@pytest.mark.parametrize("number", range(1, len(make_runs.TRIALS) + 1))
def test_the_script_orders_what_the_trial_says(number):
    overrides, (mode, *ended) = driven(number)
    trial = list(make_runs.TRIALS.values())[number - 1]
    assert mode == "10" and ended == ["done"]
    begin = overrides[0][0]
    ends = begin + 1000 * np.cumsum([step[0] for step in trial.orders])
    for ms, output, pulse, timeout in overrides:
        if timeout == 0:  # released, when all is over
            assert ms >= ends[-1]
            continue
        _, port, starboard = trial.orders[int(np.searchsorted(ends, ms, side="right"))]
        share = port if output == 2 else starboard
        neutral, ahead, astern = (1500, 1900, 1100) if output == 2 else (1510, 1100, 1900)
        towards = ahead if share >= 0 else astern
        assert pulse == math.floor(neutral + abs(share) * (towards - neutral) + 0.5)
        assert 50 < timeout <= 500
    assert len(overrides) >= 2 * 20 * (ends[-1] - begin) / 1000


@needs_lua
@pytest.mark.parametrize(
    ("event", "mode"), [("mode", "0"), ("disarm", "10"), ("far", "4"), ("lost", "4")]
)
def test_the_script_lets_go_at_once(event, mode):
    overrides, (ended_in, *_) = driven(3, event, "30")
    released = [one for one in overrides if one[3] == 0]
    assert {one[1] for one in released} == {0, 2}  # both outputs
    assert all(30_000 <= one[0] <= 30_100 for one in released)
    assert overrides[-2:] == released  # and nothing afterwards
    assert ended_in == mode


# -- the fit -----------------------------------------------------------------------------------


@pytest.mark.proof
def test_the_fit_is_that_of_the_results(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "examples.blueboat.coefficients", "--quick", "-o", str(tmp_path)],
        capture_output=True, text=True, cwd=ROOT, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    quick = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    for name, one in RESULTS["coefficients"].items():
        assert quick["coefficients"][name]["value"] == pytest.approx(one["value"], rel=0.02), name
    assert quick["without_current"]["missing"] and not quick["together"]["missing"]


if __name__ == "__main__":
    test_tutorial.WITHOUT_OUTPUT = ()
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name))
        renewed = test_tutorial.renewed(PAGE, Path(name))
        (HOME / "README.md").write_text(renewed, encoding="utf-8")
