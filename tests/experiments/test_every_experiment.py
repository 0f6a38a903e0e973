"""`make experiments`: every folder takes part, and what it runs is there."""

import importlib.util
import json
import subprocess
import sys

from experiments import every
from experiments.harness import reporting

import pytest
from tests.paths import EXPERIMENTS, ROOT


HERE = EXPERIMENTS

FOLDERS = sorted(path.name for path in HERE.iterdir() if (path / "README.md").exists())
WITH_TABLES = [name for name in FOLDERS if reporting.filled(HERE / name / "README.md")]


def test_every_experiment_has_a_script_and_is_in_the_list():
    listing = (HERE / "README.md").read_text()
    for name in FOLDERS:
        assert (HERE / name / "run.py").exists(), name
        assert f"`{name}`" in listing, name
    assert set(every.COMMANDS) <= set(FOLDERS)
    for name, commands in every.COMMANDS.items():
        for module, *_ in commands:
            assert importlib.util.find_spec(module), (name, module)


@pytest.mark.parametrize("name", WITH_TABLES)
def test_tables_of_a_readme_are_those_of_its_results(name):
    """They are written by one run, and nobody has changed either since."""
    record = json.loads((HERE / name / "results.json").read_text())
    shown = reporting.filled(HERE / name / "README.md")
    if "SECONDS" in shown:
        assert shown.pop("SECONDS") == reporting.how_long(record["seconds"])
    assert shown == record["tables"] and not record["quick"]


@pytest.mark.parametrize("name", WITH_TABLES)
def test_a_comparison_shows_the_numbers_of_its_rows(name):
    record = json.loads((HERE / name / "results.json").read_text())
    keys = [key for key in record["tables"] if key.lower() in ("comparison", "published")]
    assert len(keys) == ("comparison" in record)
    for key in keys:
        lines = record["tables"][key].splitlines()[2:]
        for row, line in zip(record["comparison"], lines, strict=True):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            stated = row["published"] if "published" in row else row["limit"]
            assert cells[0].strip() == row["quantity"]
            assert {reporting.shown(stated), reporting.shown(row["obtained"])} <= set(cells)


def test_a_misspelt_experiment_is_told():
    done = subprocess.run(
        [sys.executable, "-m", "experiments.every", "pythea"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 1 and "pytheas" in done.stderr and "Traceback" not in done.stderr


def test_results_are_written_whole_and_tables_filled_in(tmp_path, capsys):
    home = tmp_path / "made"
    home.mkdir()
    readme = home / "README.md"
    readme.write_text(
        "before\n<!-- begin SECONDS -->\n<!-- end SECONDS -->\n"
        "<!-- begin figures -->\nold\n<!-- end figures -->\nafter\n"
    )
    run = reporting.Experiment(home, home, quick=False, began=0.0)
    rows = [reporting.compared("speed", "m/s", 1.5, 1.52341), reporting.compared("x", "", None, 2)]
    run.write(
        {"comparison": rows, "nothing": float("nan")}, {"figures": reporting.comparison(rows)}
    )
    record = json.loads((home / "results.json").read_text())
    assert record["experiment"] == "made" and record["nothing"] is None
    assert record["comparison"][0]["obtained"] == 1.52341
    text = readme.read_text()
    assert f"took {record['seconds']:.0f} s." in text
    assert text.startswith("before") and text.endswith("after\n") and "old" not in text
    assert "| speed | 1.5 | 1.523 | m/s |  |" in text and "| x | - | 2 |" in text
    with pytest.raises(SystemExit, match="no place for 'other'"):
        run.write({}, {"other": "text"})


def test_limits_of_a_rule_are_not_headed_as_published():
    row = reporting.limited("advance", "L", "at most 4.5", 2.4, "MSC.137(76)")
    head, _, line = reporting.comparison([row]).splitlines()
    assert head == "|  | limit | obtained | unit |  |"
    assert line == "| advance | at most 4.5 | 2.4 | L | MSC.137(76) |"
    with pytest.raises(ValueError):
        reporting.comparison([row, reporting.compared("advance", "L", 2.5, 2.4)])
    for path in HERE.glob("*/results.json"):
        record = json.loads(path.read_text())
        rows = record.get("comparison", []) if isinstance(record, dict) else []
        told = [str(one["published"]) for one in rows if "published" in one]
        assert not [words for words in told if words.startswith("at most")], path
