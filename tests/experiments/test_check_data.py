"""Where real recordings are looked for, and what is said of those that are there."""

import hashlib
import re
import subprocess
import sys
from pathlib import Path

from experiments import check_data

import pytest
from tests.paths import EXPERIMENTS, ROOT


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two sets of two files each, known by their hashes; `DIFFSEA_DATA` names their folder."""
    lines = []
    for path in ("a/1.csv", "a/2.csv", "b/1.csv", "b/deep/2.csv"):
        file = tmp_path / "data" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(path)
        lines.append(f"{hashlib.sha256(path.encode()).hexdigest()}  {path}\n")
    (tmp_path / "known").write_text("".join(lines))
    monkeypatch.setattr(check_data, "HASHES", tmp_path / "known")
    monkeypatch.setenv("DIFFSEA_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def test_a_whole_folder_is_a_line_for_each_set(folder, capsys):
    assert check_data.main([]) == 0
    assert capsys.readouterr().out == f"{folder}:\na: all 2 files\nb: all 2 files\n"


def test_what_is_missing_or_another_is_named(folder, capsys):
    (folder / "a" / "2.csv").write_text("edited")
    (folder / "b" / "deep" / "2.csv").unlink()
    assert check_data.main([]) == 1
    told = capsys.readouterr().out
    assert "a: 1 of 2 files\n  another file than was used: a/2.csv\n" in told
    assert "b: 1 of 2 files\n  missing: b/deep/2.csv\n" in told and "DATA.md" in told
    assert check_data.main(["c"]) == 2
    assert "no set c; there are a, b" in capsys.readouterr().err


def test_one_set_is_asked_for_alone(folder, capsys):
    (folder / "a" / "1.csv").unlink()
    (folder / "a" / "2.csv").unlink()
    assert check_data.main(["b"]) == 0
    assert check_data.main(["a"]) == 1
    assert "a: missing, all 2 files" in capsys.readouterr().out


def test_the_variable_names_the_folder_for_tests_and_experiments(tmp_path):
    code = (
        "from tests.paths import DATA\nfrom experiments.concealed_real import sets\n"
        "from experiments.harness import real_runs\n"
        "print({DATA, sets.DATA, real_runs.DATA})"
    )
    for chosen, wanted in ((str(tmp_path), tmp_path), ("", ROOT.parent / "shared" / "data")):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env={"PATH": "", "DIFFSEA_DATA": chosen, "PYTHONPATH": str(ROOT / "src")},
        )
        assert done.stdout.strip() == str({wanted}), done.stderr


def test_only_one_place_says_where_recordings_lie():
    """No other code spells the folder beside the repository."""
    spelled = re.compile(r"""shared["'\s]*/["'\s]*data""")
    rooms = (ROOT / room for room in ("src", "tests", "experiments"))
    code = {file for room in rooms for file in room.rglob("*.py")}
    others = code - {EXPERIMENTS / "check_data.py", Path(__file__).resolve()}
    assert [file for file in others if spelled.search(file.read_text(encoding="utf-8"))] == []


def test_the_page_names_each_set_of_the_list_and_no_other():
    known = check_data.known_hashes(check_data.HASHES.read_text(encoding="ascii"))
    page = (EXPERIMENTS / "DATA.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    sets = {path.partition("/")[0] for path in known}
    assert len(known) > 100 and set(named) == sets and len(named) == 2 * len(sets)
    assert all(re.fullmatch(r"[0-9a-f]{64}", digest) for digest in known.values())
