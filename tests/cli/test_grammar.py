"""What the command line answers to no word, to a near miss, and what a shell completes."""

import argparse
import json
import pathlib
import re
import subprocess
import sys

from benchmarks.commands import commands
from benchmarks.record import RESULTS

import pytest
from tests.paths import ROOT

from diffsea.cli import identification, main, make_parser, recordings, shipped_names, trial
from diffsea.cli.grammar import GREETING
from diffsea.cli.options import parts_folder
from diffsea.identification.study import OBJECTIVES
from diffsea.metrics import RECORDED_TRIALS
from diffsea.simulation.standard import STANDARD_TRIALS
from diffsea.vessel.files import shipped_vessels


def test_without_a_word_it_greets_with_three_commands_that_parse(capsys):
    assert main([]) == 0
    printed = capsys.readouterr()
    assert printed.out == GREETING and printed.err == ""
    commands = re.findall(r"^  diffsea (.*?)(?:   .*)?$", printed.out, re.MULTILINE)
    assert [line.split()[0] for line in commands] == ["check", "new", "diagnose"]
    for line in commands:
        make_parser().parse_args(line.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["diagnoze"], "there is no command 'diagnoze'; did you mean 'diagnose'?"),
        (["xyzzy"], "there is no command 'xyzzy'; diffsea --help lists them"),
        (["--versoin"], "there is no option '--versoin'; did you mean '--version'?"),
        (["trial", "otter", "--manouvre", "zigzag"], "did you mean '--manoeuvre'?"),
        (["sweep", "otter", "--gird=mass=1:2:3"], "there is no option '--gird'; did you mean"),
        (["trial", "otter", "--man", "zigzag"], "there is no option '--man'"),
        (["fit", "a.toml", "b.csv", "--environment", "sharde"], "did you mean 'shared'?"),
    ],
)
def test_a_near_miss_is_answered_by_what_was_meant(words, message, capsys):
    assert main(words) == 2
    printed = capsys.readouterr()
    assert message in printed.err and printed.out == ""


def test_what_begins_with_a_dash_and_is_no_option_is_left_to_the_command():
    args = make_parser().parse_args(
        ["sweep", "a", "--manoeuvre", "spiral", "--grid", "N_r=-9:-1:2"]
    )
    assert args.grid == [("N_r", (-9.0, -1.0, 2))]
    assert make_parser().parse_args(["check", "--", "--odd"]).logs[0].name == "--odd"
    assert make_parser().parse_args(["check", "a.bin", "--start", "-3"]).start == -3.0


def test_names_written_out_for_the_parser_are_the_librarys():
    assert identification.OBJECTIVES == OBJECTIVES
    assert recordings.RECORDED_TRIALS == tuple(RECORDED_TRIALS)
    assert trial.STANDARD_TRIALS == tuple(STANDARD_TRIALS)
    assert shipped_names() == sorted(shipped_vessels())


def test_the_readme_names_the_default_folders():
    """Results of its commands lie where they lie without `-o`."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    jobs = text[text.index("## The main jobs") : text.index("| also |")]
    named = set(re.findall(r"out/([a-z-]+)/", jobs))
    assert named and " -o " not in jobs
    assert named <= set(re.findall(r"bin/diffsea ([a-z]+)", jobs))
    for name in named:
        assert f"out/{name})" in _help(name)


def test_the_readmes_durations_are_those_that_were_measured():
    figures = json.loads(RESULTS.read_text(encoding="utf-8"))["figures"]
    measured = {one["name"]: one for one in figures}
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = re.findall(r"# [^#]*? \((\d+) (s|min)\):\n    \.venv/bin/diffsea (\w+)", text)
    assert {name for *_, name in told} == set(commands(text))
    for number, unit, name in told:
        figure = measured[f"command-{name}"]
        line = commands(text)[name].removeprefix(".venv/bin/diffsea ")
        assert figure["command"] == " ".join(line.split()), "measure again: make bench"
        assert float(number) * {"s": 1, "min": 60}[unit] == pytest.approx(figure["value"], rel=0.2)


def _help(command):
    done = subprocess.run(
        [sys.executable, "-m", "diffsea", command, "--help"], capture_output=True, text=True
    )
    return " ".join(done.stdout.split())


def completed(*words):
    """What bash completes at the end of some words, by the script that is printed."""
    code = "import sys; from diffsea.cli import main; status = main(['completion', 'bash'])\n"
    code += "assert 'jax' not in sys.modules and 'numpy' not in sys.modules; sys.exit(status)"
    script = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert script.returncode == 0, script.stderr
    spoken = " ".join(f"'{word}'" for word in words)
    code = f"{script.stdout}\nCOMP_WORDS=({spoken}); COMP_CWORD={len(words) - 1}\n"
    code += 'name=$(complete -p diffsea | sed "s/.*-F \\([^ ]*\\) .*/\\1/")\n'
    code += f"$name diffsea '{words[-1]}' '{words[-2]}'; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, cwd=ROOT)
    return done.stdout.split()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no bash")
def test_bash_completes_commands_options_words_vessels_and_files():
    pytest.importorskip("shtab")
    assert completed("diffsea", "dia") == ["diagnose"]
    assert completed("diffsea", "trial", "otter", "--man") == ["--manoeuvre"]
    assert completed("diffsea", "trial", "otter", "--manoeuvre", "zig") == ["zigzag"]
    assert completed("diffsea", "trial", "ott") == ["otter"]
    assert completed("diffsea", "fit", "otter", "READ") == ["README.md"]


def test_completion_without_its_package_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 1
    assert "pip install 'diffsea[completion]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "parts"),
    [("out/boat", "out/boat-parts"), (".", "parts"), ("..", "../parts"), ("/", "/parts")],
)
def test_parts_lie_beside_the_results_and_within_a_folder_without_a_name(given, parts):
    args = argparse.Namespace(output=pathlib.Path(given), parts=None)
    assert parts_folder(args) == pathlib.Path(parts)
    args.parts = pathlib.Path("elsewhere")
    assert parts_folder(args) == pathlib.Path("elsewhere")


def test_what_a_million_designs_took_is_as_measured():
    text = (ROOT / "docs" / "sweeps-and-sensitivities.md").read_text(encoding="utf-8")
    figures = json.loads(RESULTS.read_text(encoding="utf-8"))["figures"]
    one = next(figure for figure in figures if figure["name"] == "scale")
    memory = one["megabytes_of_memory"] / 1e3
    kept = (one["megabytes_of_parts"] + one["megabytes_of_results"]) / 1e3
    hours, more = one["hours_of_planned"], one["gigabytes_of_planned"]
    for told in (
        f"in {one['seconds']:.0f} s on two cores",
        f"{one['value']:.2f} s for a part of 4096, {memory:.1f} GB of memory",
        f"{kept:.2f} GB of parts and results",
        f"are {hours:.1f} h of such a machine and {more:.0f} GB",
    ):
        assert told in " ".join(text.split()), told
