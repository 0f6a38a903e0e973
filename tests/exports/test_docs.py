"""The commands of docs/exports.md run, and its figures are those of the code."""

import shlex
from importlib.util import find_spec

import pytest
from tests.paths import ROOT

from diffsea.cli import main
from diffsea.exports.ardupilot import LARGEST_CHANGE
from diffsea.exports.gazebo import PROPELLER_SHARE
from diffsea.exports.mss import ARRIVAL
from diffsea.exports.planar_model import LONGEST_STEP


PAGE = (ROOT / "docs" / "exports.md").read_text(encoding="utf-8")
COMMANDS = [line.strip() for line in PAGE.splitlines() if line.startswith("    diffsea export ")]
ON_SHIPPED = [line for line in COMMANDS if "|" not in line and "out/fit" not in line]


@pytest.mark.parametrize("command", ON_SHIPPED)
def test_a_command_of_the_page_does_what_the_page_says(command, tmp_path, monkeypatch, capsys):
    if "--to fmu" in command and find_spec("pythonfmu3") is None:
        pytest.skip("PythonFMU3 is not installed")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    status = main(shlex.split(command)[1:])
    if command == "diffsea export otter --to gazebo":
        expected = "cannot express: the cross-flow drag; the lag of 'port'; "
        assert status == 1 and expected in capsys.readouterr().err
        assert expected[:-1] in PAGE
        assert not (tmp_path / "out").exists()
    else:
        assert status == 0
        (written,) = (tmp_path / "out" / "export").iterdir()
        assert written.suffix in (".sdf", ".param", ".fmu", ".m", ".mcap", ".parquet")


def test_figures_of_the_page_are_those_of_the_code():
    assert len(ON_SHIPPED) >= 5
    assert ARRIVAL == 0.05 and "comes to rest over 0.05 s" in PAGE
    assert LONGEST_STEP == 0.05 and "at most 0.05 s" in PAGE
    assert LARGEST_CHANGE == 0.2 and "more than a fifth" in PAGE
    assert PROPELLER_SHARE == 1e-3 and "A thousandth of the mass" in PAGE
