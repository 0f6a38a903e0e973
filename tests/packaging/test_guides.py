"""The guide to a new trial, followed to the letter in a copy of the project."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.paths import ROOT


GUIDE = ROOT / "docs" / "adding-a-trial.md"
SAME_NAMES = """
from diffsea.cli import recordings, trial
from diffsea.metrics import RECORDED_TRIALS
from diffsea.simulation.standard import STANDARD_TRIALS
assert recordings.RECORDED_TRIALS == tuple(RECORDED_TRIALS)
assert trial.STANDARD_TRIALS == tuple(STANDARD_TRIALS)
"""
TABLE = re.compile(r"[A-Z_]+(: [^=]+)? = .*\{$")  # beginning of a table that functions stand before


def changes(guide: str) -> dict[str, list[tuple[str, list[str]]]]:
    """Hunks by file: the name after `@@`, and lines with a mark before each."""
    found = {}
    for block in re.findall(r"```diff\n(.*?)```", guide, re.DOTALL):
        header, *hunks = re.split(r"^@@ ?", block, flags=re.MULTILINE)
        path = re.search(r"^\+\+\+ b/(.*)$", header, re.MULTILINE)
        assert path is not None
        parts = [hunk.split("\n") for hunk in hunks]
        found[path[1]] = [(first, [line for line in lines if line]) for first, *lines in parts]
    return found


def applied(text: str, hunks: list[tuple[str, list[str]]]) -> str:
    """The text with hunks: at their unmarked lines, below the table they name, or before one."""
    lines = text.split("\n")
    for named, hunk in hunks:
        new = [line[1:] for line in hunk]
        old = [line[1:] for line in hunk if line[0] == " "]
        if old:
            at = [k for k in range(len(lines)) if lines[k : k + len(old)] == old]
            assert len(at) == 1, f"{old} is not there once"
            lines[at[0] : at[0] + len(old)] = new
            continue
        begins = [k for k, line in enumerate(lines) if TABLE.match(line) or line == ""]
        if named:
            place = next(k for k in begins if lines[k].startswith(named)) + 1
        else:
            tables = [k for k in begins if TABLE.match(lines[k]) and k > len(lines) // 2]
            place = tables[0] if tables else len(lines)
        lines[place:place] = new if named else [*new, "", ""]
    return "\n".join(lines)


@pytest.mark.proof
def test_a_trial_added_by_the_guide_passes_its_test_and_fails_it_with_a_sign_turned(tmp_path):
    files = changes(GUIDE.read_text(encoding="utf-8"))
    assert sorted(path.split("/")[0] for path in files) == ["src"] * 5 + ["tests"]
    skip = shutil.ignore_patterns("__pycache__", "corpus")
    for folder in ("src", "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for path, hunks in files.items():
        own = tmp_path / path
        own.write_text(applied(own.read_text(encoding="utf-8"), hunks), encoding="utf-8")
    assert tried(tmp_path) == 0
    lines = commands(GUIDE.read_text(encoding="utf-8"))
    for words in [["-c", SAME_NAMES], *(["-m", "diffsea", *line.split()[1:]] for line in lines)]:
        command = [sys.executable, *words]
        subprocess.run(command, cwd=tmp_path, env=environment(tmp_path), check=True, timeout=600)
    standard = tmp_path / "src/diffsea/simulation/standard.py"
    text = standard.read_text(encoding="utf-8")
    assert text.count("furthest - then") == 1
    standard.write_text(text.replace("furthest - then", "then - furthest"), encoding="utf-8")
    assert tried(tmp_path) == 1


def commands(guide: str) -> list[str]:
    """The commands of the guide's last section."""
    lines = guide.split("## 5. Use it")[1].split("\n")
    found = [line.strip() for line in lines if line.startswith("    .venv/bin/diffsea")]
    assert len(found) == 2
    return found


def environment(copy: Path) -> dict[str, str]:
    """That in which the copy is the package."""
    return os.environ | {"PYTHONPATH": f"{copy / 'src'}{os.pathsep}{copy}"}


def tried(copy: Path) -> int:
    """Exit status of pytest with the guide's test: 0 passed, 1 failed, 5 there is none."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0",
               "tests/simulation/test_standard.py", "-k", "course_change"]  # fmt: skip
    ended = subprocess.run(command, cwd=copy, env=environment(copy), check=False, timeout=600)
    return ended.returncode
