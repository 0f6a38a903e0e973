"""The command line as a user meets it: what it prints, what it writes, how it ends."""

import io
import json
import math
import pathlib
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT, SWELL

from diffsea import UserError
from diffsea.cli import identification, main, outputs, recordings, segments
from diffsea.cli.service import fleet, metamodel, online
from diffsea.identification.study import ANCHORS, OBJECTIVES
from diffsea.metamodels.ideal_zigzag import Zigzag
from diffsea.metrics import RECORDED_TRIALS
from diffsea.report.pictures import SEGMENT_COLOURS
from diffsea.segments import SEGMENT_KINDS
from diffsea.simulation.standard import STANDARD_TRIALS
from diffsea.workflows.boat import DEPTHS
from diffsea.workflows.metamodel import MOST
from diffsea.workflows.online import ESTIMATORS


pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def boat(tmp_path_factory):
    path = tmp_path_factory.mktemp("boat") / "boat.toml"
    path.write_text(BOAT)
    return path


@pytest.fixture(scope="module")
def zigzag(boat, tmp_path_factory):
    """Output folder, printed JSON and messages of one trial."""
    folder = tmp_path_factory.mktemp("zigzag")
    out, err = io.StringIO(), io.StringIO()
    patch = pytest.MonkeyPatch()
    patch.setattr(sys, "stdout", out)
    patch.setattr(sys, "stderr", err)
    status = main(
        ["trial", str(boat), "--manoeuvre", "zigzag", "--speed", "1.2", "--side", "port"]
        + ["-o", str(folder), "--json"]
    )
    patch.undo()
    assert status == 0
    return folder, out.getvalue(), err.getvalue()


def run(*words):
    return main([str(word) for word in words])


def test_help_is_quick_and_names_every_command():
    code = (
        "import sys; from diffsea.cli import main; status = main(['--help'])\n"
        "assert 'jax' not in sys.modules and 'numpy' not in sys.modules; sys.exit(status)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for command in ("trial", "metrics", "audit", "fit", "diagnose", "predict", "online"):
        assert f"\n    {command}" in done.stdout
    assert "examples:" in done.stdout and "kvlcc2" in done.stdout


@pytest.mark.parametrize(
    "command",
    ["trial", "metrics", "audit", "predict", "fit", "diagnose", "sensitivity", "sweep"]
    + ["campaign", "run", "online", "metamodel", "fleet"],
)
def test_every_command_helps_with_examples(command, capsys):
    assert run(command, "--help") == 0
    text = capsys.readouterr().out
    assert "examples:" in text and f"diffsea {command} " in text and "--json" in text


def test_version(capsys):
    assert run("--version") == 0
    as_module = [sys.executable, "-m", "diffsea", "--version"]
    assert subprocess.run(as_module, capture_output=True, text=True).stdout.startswith("diffsea ")
    assert capsys.readouterr().out.startswith("diffsea ")


def test_trials_that_the_library_knows_are_named_in_the_help_and_others_refused(capsys):
    for command, library in (
        ("trial", STANDARD_TRIALS),
        ("metrics", RECORDED_TRIALS),
        ("fit", OBJECTIVES),
    ):
        assert run(command, "--help") == 0
        text = " ".join(capsys.readouterr().out.split())
        assert all(name in text for name in library)
    assert run("trial", "otter", "--manoeuvre", "zigzagg") == 2
    assert "did you mean 'zigzag'" in capsys.readouterr().err


def test_a_parser_does_without_jax():
    code = "import sys, diffsea.cli as c; c.main(['--help']); sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def test_names_written_out_for_the_help_are_the_librarys():
    assert identification.ANCHORS == ANCHORS
    assert online.ESTIMATORS == ESTIMATORS
    assert metamodel.MOST == MOST
    assert fleet.DEPTHS == DEPTHS
    assert math.radians(metamodel.RUDDER_RATE) == Zigzag().rate_limit
    assert segments.KINDS == SEGMENT_KINDS == tuple(SEGMENT_COLOURS)


def test_xla_flags_are_set_before_jax_starts_unless_the_user_set_some(tmp_path):
    code = (
        "import os, diffsea.runtime as runtime; runtime.MEASURED_WITH = ''\n"
        "runtime.prepare_jax(); import jax\n"
        "print(os.environ['XLA_FLAGS'], jax.config.jax_enable_x64)"
    )
    env = {"PATH": "", "XDG_CACHE_HOME": "/proc/none"}  # a cache that cannot be written
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert "while_loop_byte_threshold" in done.stdout and "True" in done.stdout, done.stderr
    env["XLA_FLAGS"] = "--xla_cpu_prefer_vector_width=256"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.startswith("--xla_cpu_prefer_vector_width=256 ")


def test_a_jaxlib_whose_options_are_not_known_keeps_its_own():
    code = (
        "import os, diffsea.runtime as runtime; runtime.MEASURED_WITH = '0.1.'\n"
        "runtime.prepare_jax()\n"
        "print(os.environ.get('XLA_FLAGS'))"
    )
    env = {"PATH": "", "XDG_CACHE_HOME": "/proc/none"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout == "None\n", done.stderr


# trial


@pytest.mark.slow
def test_trial_writes_everything_and_prints_its_json_alone(zigzag):
    folder, out, err = zigzag
    names = {"recording.csv", "metrics.json", "trial.html", "track.png", "series.png"}
    assert {path.name for path in folder.iterdir()} == names
    metrics = json.loads(out)
    assert metrics == json.loads((folder / "metrics.json").read_text())
    assert metrics["outcome"] == "completed" and metrics["side"] == "port"
    assert metrics["order_angle"] == pytest.approx(math.radians(20))
    assert metrics["imo"]["overshoot_1"]["verdict"] == "pass"
    assert "time step" in err and "approach at" not in err
    assert (folder / "track.png").read_bytes().startswith(b"\x89PNG")


def test_the_recording_of_a_trial_has_both_kinds_of_actuation(zigzag):
    table = pd.read_csv(zigzag[0] / "recording.csv")
    metrics = json.loads(zigzag[1])
    for column in ("t", "x", "y", "psi", "u", "v", "r", "cmd_port", "exec_port"):
        assert np.isfinite(table[column]).all()
    assert (np.diff(table["t"]) > 0).all()
    # Orders hold from their time stamp: the port thruster slows at the very execute.
    # Rounding may steer a straight approach by next to nothing.
    ordered = (table["cmd_port"] - table["cmd_starboard"]).round(9)
    first = table["t"].to_numpy()[ordered.to_numpy() < 0][0]
    assert first == pytest.approx(metrics["execute_time"], abs=1e-9)
    changes = table["t"][1:][np.diff(np.sign(ordered.to_numpy())) != 0]
    np.testing.assert_allclose(changes, metrics["switch_times"], atol=1e-9)


def test_metrics_of_its_recording_are_those_of_the_trial(zigzag, boat, tmp_path, capsys):
    folder, out, _ = zigzag
    assert run("metrics", folder / "recording.csv", "--vessel", boat, "-o", tmp_path, "--json") == 0
    read, known = json.loads(capsys.readouterr().out), json.loads(out)
    assert read["manoeuvre"] == "zigzag" and read["side"] == "port"
    np.testing.assert_allclose(read["switch_times"], known["switch_times"], rtol=1e-9)
    shared = [name for name, value in known.items() if isinstance(value, float)]
    assert {"overshoot_1", "overshoot_3", "peak_yaw_rate", "approach_speed"} <= set(shared)
    for name in shared:
        assert read[name] == pytest.approx(known[name], rel=1e-6, abs=1e-9), name
    assert read["imo"].keys() == known["imo"].keys()


@pytest.mark.slow
def test_a_thrust_instead_of_a_speed_turns_to_starboard_by_default(boat, tmp_path, capsys):
    status = run("trial", boat, "--manoeuvre", "turning-circle", "--thrust", "150", "-o", tmp_path)
    printed = capsys.readouterr()
    assert status == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    # 150 = 40 u + 60 u^2
    speed = (-40 + math.sqrt(40**2 + 4 * 60 * 150)) / 120
    assert metrics["approach_speed"] == pytest.approx(speed, rel=1e-4)
    assert metrics["side"] == "starboard" and metrics["transfer"] > 0
    assert "tactical_diameter" in printed.out and "pass" in printed.out
    assert "written:" in printed.out and "150 N" in printed.err


@pytest.mark.slow
def test_a_trial_that_diverges_leaves_nothing(boat, tmp_path, capsys):
    folder = tmp_path / "deep" / "out"
    words = ("trial", boat, "--manoeuvre", "turning-circle", "--step", "5", "-o", folder)
    assert run(*words) == 1
    printed = capsys.readouterr()
    assert "diverged" in printed.err and "--step 5" in printed.err
    assert printed.out == "" and not (tmp_path / "deep").exists()


@pytest.mark.slow
def test_an_unsteady_approach_is_told(boat, tmp_path, capsys):
    swell = tmp_path / "swell.toml"
    swell.write_text(BOAT + SWELL)
    words = ("trial", swell, "--manoeuvre", "coasting", "--step", "0.2", "-o", tmp_path / "out")
    assert run(*words) == 1
    assert "never became steady" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--speed", "9"), "does not reach 9 m/s"),
        (("--thrust", "5000"), "more than 'boat' can push"),
    ],
)
def test_an_approach_beyond_the_vessels_power_is_refused(boat, tmp_path, capsys, options, message):
    words = ("trial", boat, "--manoeuvre", "zigzag", *options, "-o", tmp_path / "out")
    assert run(*words) == 1
    assert message in capsys.readouterr().err


# recordings


def test_metrics_of_several_runs_are_kept_by_name(zigzag, tmp_path, capsys):
    first = zigzag[0] / "recording.csv"
    second = tmp_path / "again.csv"
    second.write_text(first.read_text())
    assert run("metrics", first, second, "--length", 4, "-o", tmp_path / "out") == 0
    runs = json.loads((tmp_path / "out" / "metrics.json").read_text())["runs"]
    assert set(runs) == {"recording.csv", "again.csv"}
    page = (tmp_path / "out" / "metrics.html").read_text(encoding="utf-8")
    assert page.count("again.csv") > 2 and "overshoot 1" in page
    assert runs["recording.csv"]["overshoot_1"] == runs["again.csv"]["overshoot_1"]
    assert "overshoot_1" in capsys.readouterr().out


def test_audit_lists_its_findings(zigzag, tmp_path, capsys):
    table = pd.read_csv(zigzag[0] / "recording.csv")
    table["r"] += 0.02
    table.to_csv(tmp_path / "biased.csv", index=False)
    assert run("audit", tmp_path / "biased.csv", "-o", tmp_path / "out", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    (bias,) = [item for item in found if item["kind"] == "gyro-bias"]
    assert "gyro bias" in (tmp_path / "out" / "audit.html").read_text(encoding="utf-8")
    assert bias["recording"] == "biased.csv" and bias["value"] == pytest.approx(0.02, rel=0.05)
    assert run("audit", zigzag[0] / "recording.csv", "-o", tmp_path / "clean") == 0
    assert "nothing found" in capsys.readouterr().out
    assert json.loads((tmp_path / "clean" / "audit.json").read_text()) == []


def test_predicting_a_trial_repeats_it(zigzag, boat, tmp_path, capsys):
    recorded = pd.read_csv(zigzag[0] / "recording.csv")
    assert run("predict", boat, zigzag[0] / "recording.csv", "-o", tmp_path) == 0
    assert "over the whole run" in capsys.readouterr().out
    predicted = pd.read_csv(tmp_path / "predicted.csv")
    assert list(predicted) == list(recorded)
    np.testing.assert_allclose(predicted, recorded, atol=1e-9)
    result = json.loads((tmp_path / "predict.json").read_text())
    assert max(result["overall"].values()) < 1e-9
    assert result["actuation"] == {"port": "measured", "starboard": "measured"}
    assert result["horizons"]["5"]["starts"] >= 2 and result["horizons"]["5"]["position"] < 1e-9
    assert (tmp_path / "prediction.png").exists()
    assert "predicted by" in (tmp_path / "predict.html").read_text(encoding="utf-8")


def test_predicting_reads_foreign_files_and_uses_orders_on_request(zigzag, boat, tmp_path, capsys):
    table = pd.read_csv(zigzag[0] / "recording.csv")
    table = table[["t", "psi", "u", "v", "r", "x", "y", "cmd_port", "cmd_starboard"]]
    table["psi"] = np.degrees(table["psi"])
    table.columns = ["time", "yaw", "u", "v", "r", "x", "y", "left", "right"]
    table.to_csv(tmp_path / "foreign.csv", index=False)
    lines = ["[columns]", 't = "time"', 'psi = { column = "yaw", unit = "deg" }']
    lines += [f'{name} = "{name}"' for name in ("x", "y", "u", "v", "r")]
    lines += ['cmd_port = "left"', 'cmd_starboard = "right"']
    (tmp_path / "map.toml").write_text("\n".join(lines))
    words = ("predict", boat, tmp_path / "foreign.csv", "-o", tmp_path / "out", "--json")
    assert run(*words, "--mapping", tmp_path / "map.toml") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["actuation"]["port"] == "reconstructed"
    assert result["overall"]["position"] < 1e-6


# how it ends


def test_a_bug_is_told_without_a_traceback(monkeypatch, capsys):
    monkeypatch.setattr(recordings, "audit_command", lambda args: 1 / 0)
    assert run("audit", "x.csv") == 1
    printed = capsys.readouterr().err
    assert "this is a bug: ZeroDivisionError: division by zero" in printed
    assert "--debug" in printed and "Traceback" not in printed
    assert run("audit", "x.csv", "--debug") == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_interrupt_ends_with_130(monkeypatch, capsys):
    def interrupted(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(recordings, "audit_command", interrupted)
    assert run("audit", "x.csv") == 130
    assert "interrupted" in capsys.readouterr().err


# outputs


def test_outputs_appear_together_at_the_end(tmp_path):
    folder = tmp_path / "a" / "b"
    with outputs.Outputs(folder) as out:
        out.json("x.json", {"value": math.nan, "list": np.array([1.0, math.inf])})
        out.path("y.txt").write_text("y")
        assert [path.name for path in folder.iterdir() if not path.name.startswith(".")] == []
    assert {path.name for path in folder.iterdir()} == {"x.json", "y.txt"}
    assert json.loads((folder / "x.json").read_text()) == {"value": None, "list": [1.0, None]}


def test_a_failure_leaves_the_folder_as_it_was(tmp_path):
    (tmp_path / "x.json").write_text("old")
    for folder in (tmp_path, tmp_path / "new"):
        with pytest.raises(UserError, match="stop"), outputs.Outputs(folder) as out:
            out.json("x.json", {})
            raise UserError("stop")
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]
    assert (tmp_path / "x.json").read_text() == "old"


def test_a_file_of_another_folder_appears_at_the_end_with_the_others_or_not_at_all(tmp_path):
    asked = tmp_path / "next.csv"
    asked.write_text("old")
    with pytest.raises(UserError, match="stop"), outputs.Outputs(tmp_path / "out") as out:
        out.elsewhere(asked, "--next-manoeuvre").write_text("new")
        raise UserError("stop")
    assert asked.read_text() == "old" and list(tmp_path.iterdir()) == [asked]
    with outputs.Outputs(tmp_path / "out") as out:
        out.elsewhere(asked, "--next-manoeuvre").write_text("new")
        out.elsewhere(tmp_path / "not-needed.csv", "--next-manoeuvre")
        assert asked.read_text() == "old"
    assert asked.read_text() == "new" and out.files == [asked]


def test_commands_that_start_together_may_share_a_new_folder(tmp_path, monkeypatch):
    shared, mkdir = tmp_path / "runs", pathlib.Path.mkdir

    def made_by_another_first(path, *arguments, **options):
        if path == shared:
            mkdir(path)
        mkdir(path, *arguments, **options)

    monkeypatch.setattr(pathlib.Path, "mkdir", made_by_another_first)
    with outputs.Outputs(shared / "one") as out:
        out.json("x.json", {})
    assert (shared / "one" / "x.json").exists()


@pytest.mark.slow
def test_recordings_are_read_audited_and_proposed_for_without_jax(zigzag, tmp_path):
    code = (
        "import pathlib, sys\n"
        "from diffsea.recordings.mapping_proposal import propose_mapping\n"
        "from diffsea.workflows.audits import audit_readable, read_readable\n"
        "native, foreign = map(pathlib.Path, sys.argv[1:])\n"
        "print(audit_readable(read_readable([native])), propose_mapping([foreign]).text)\n"
        "assert not {'jax', 'jaxlib', 'equinox'} & set(sys.modules)"
    )
    native, foreign = zigzag[0] / "recording.csv", tmp_path / "foreign.csv"
    pd.read_csv(native).rename(columns={"t": "time"}).to_csv(foreign)
    words = [sys.executable, "-c", code, native, foreign]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0 and "recording.csv" in done.stdout, done.stderr
    assert '"time"' in done.stdout


def test_a_table_has_numbers_to_the_right():
    text = outputs.table([("mass", "12.5", "kg"), ("x", "-3", "m")], ("name", "value", ""))
    assert text.splitlines() == ["name  value", "mass   12.5  kg", "x        -3  m"]


def test_a_table_is_never_wrapped_coloured_or_read_as_markup(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setenv("FORCE_COLOR", "1")
    text = outputs.table([("[bold]x[/]", "y" * 300)])
    assert text == "[bold]x[/]  " + "y" * 300


SHEET = """
format = 1
[[trial]]
manoeuvre = "zigzag"
angle = 20.0
heading = 20.0
side = "port"
speed = 1.2
[trial.numbers]
overshoot_1 = {{ value = {overshoot_1}, std = 0.02 }}
peak_yaw_rate = {peak_yaw_rate}
"""


@pytest.mark.proof
@pytest.mark.slow
def test_fit_takes_recordings_and_a_sheet_together(boat, zigzag, tmp_path, capsys):
    sheet = tmp_path / "sheet.toml"
    sheet.write_text(SHEET.format(**json.loads(zigzag[1])))
    recording, out = zigzag[0] / "recording.csv", tmp_path / "fit"
    words = ("--free", "N_r,X_u", "--profile", "none", "-o", out)
    assert run("fit", boat, sheet, recording, "--test", recording, *words) == 1
    assert "is named twice" in capsys.readouterr().err
    assert run("fit", boat, recording, "--test", sheet, *words) == 1
    assert "sheet.toml is a sheet of trial numbers" in capsys.readouterr().err
    assert run("fit", boat, recording, sheet, *words) == 0
    told = capsys.readouterr().out
    record = json.loads((out / "fit.json").read_text())
    assert list(record)[:5] == ["format", "complete", "left_out", "free", "missing"]
    assert told.startswith("free predictions of the runs it was fitted to, vessel file -> fitted:")
    assert record["free"]["20"]["position"] == record["predictions"][1]["fitted"]["position"]
    # The recording and the numbers are the vessel's own.
    assert record["missing"] is False and record["missing_evidence"]["reasons"] == []
    assert (
        told.split("written:")[0].strip().endswith("nothing is missing as far as these data tell")
    )
    by_source = record["sources"]
    assert by_source["recordings"]["determined"]["N_r"] > 0.9
    assert 0.5 < by_source["trial_numbers"]["determined"]["N_r"] < 0.99
    squares = 2 * record["fit"]["trial_numbers"] ** 2
    assert by_source["trial_numbers"]["cost"] == pytest.approx(squares)
    assert by_source["trial_numbers"]["values"] == 2
    assert [one["number"] for one in record["trial_numbers"]] == ["overshoot_1", "peak_yaw_rate"]
    assert record["fit"]["trial_numbers"] < 0.3 and record["objective"] == "innovation"
    assert "determined by either alone: " in told
    page = (out / "report.html").read_text()
    assert "What each source tells" in page and "Given and fitted" in page


@pytest.mark.slow
def test_fit_writes_a_vessel_a_report_and_what_the_data_leave_open(boat, zigzag, tmp_path, capsys):
    priors = tmp_path / "priors.toml"
    priors.write_text("[N_r]\nstd = 5.0\n[X_u]\nlower = -90.0\nupper = -20.0\n")
    out = tmp_path / "fit"
    recording = zigzag[0] / "recording.csv"
    status = run(
        "fit", boat, recording, "--free", "N_r,X_u", "--priors", priors, "--profile", "none",
        "--json", "-o", out,
    )  # fmt: skip
    printed = capsys.readouterr()
    assert status == 0, printed.err
    record = json.loads(printed.out)
    assert record == json.loads((out / "fit.json").read_text())
    assert set(record["parameters"]) == {"N_r", "X_u"}
    row = record["parameters"]["X_u"]
    assert -90.0 < row["interval"][0] < row["value"] < row["interval"][1] < -20.0
    assert row["unit"] == "N / (m/s)" and row["meaning"] == "linear damping in surge"
    assert record["path"][-1] <= record["path"][0] and record["objective"] == "innovation"
    assert "anchored by mass" in record["anchor"]
    assert "] fitting 1 recording, 0 held out" in printed.err
    assert (out / "vessel.toml").exists() and "Fit of" in (out / "report.html").read_text()
