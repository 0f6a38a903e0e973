"""Input that cannot be used: every command says what is wrong, and leaves nothing behind.

A new command joins by a line in `COMMANDS`.
"""

import pathlib

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT
from tests.paths import ROOT

from diffsea.cli import main
from diffsea.errors import nearest_of
from diffsea.progress import counted


TRIAL = ["--manoeuvre", "zigzag"]
MISSION = ROOT / "examples" / "missions" / "waypoints_in_a_swell.toml"
# Words after the command, of a vessel and a recording.
COMMANDS = {
    "trial": lambda vessel, recording: [vessel, *TRIAL],
    "campaign": lambda vessel, recording: [vessel, "--trials", "zigzag"],
    "sensitivity": lambda vessel, recording: [vessel, *TRIAL],
    "sweep": lambda vessel, recording: [vessel, *TRIAL, "--grid", "mass=1:2:2"],
    "run": lambda vessel, recording: [str(MISSION)],
    "metrics": lambda vessel, recording: [recording],
    "audit": lambda vessel, recording: [recording],
    "predict": lambda vessel, recording: [vessel, recording],
    "fit": lambda vessel, recording: [vessel, recording],
    "diagnose": lambda vessel, recording: [vessel, recording],
    "online": lambda vessel, recording: [vessel, recording],
    "metamodel": lambda vessel, recording: [recording],
    "fleet": lambda vessel, recording: [manifest(vessel, recording)],
    "segment": lambda vessel, recording: [recording],
    "export": lambda vessel, recording: [vessel, "--to", "mss"],
}


def manifest(vessel, recording):
    """A manifest of one recording, beside it."""
    path = pathlib.Path(vessel).with_name("fleet.csv")
    path.write_text(f"boat,vessel,recording\nfirst,{vessel},{recording}\n")
    return str(path)


OF_TRIALS = ("trial", "sensitivity", "sweep")
OF_VESSELS = (
    *("trial", "campaign", "sensitivity", "sweep"),
    *("predict", "fit", "diagnose", "online", "export"),
)
OF_RECORDINGS = (
    *("metrics", "audit", "predict", "fit", "diagnose"),
    *("online", "metamodel", "segment"),
)
OF_ORDERS = ("predict", "fit", "diagnose", "online")

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture
def ends(tmp_path, capsys):
    """Run a command and return its status and message, having checked that nothing is left."""

    def run(command, vessel=None, recording=None, *more, output=None):
        boat, good = tmp_path / "boat.toml", tmp_path / "good.csv"
        boat.write_text(BOAT)
        good.write_text(csv())
        out = tmp_path / "results" / "here" if output is None else output
        words = COMMANDS[command](str(vessel or boat), str(recording or good))
        status = main([command, *words, *map(str, more), "-o", str(out)])
        printed = capsys.readouterr()
        assert printed.out == "" and "Traceback" not in printed.err
        assert "this is a bug" not in printed.err
        assert not (tmp_path / "results").exists()
        return status, printed.err

    return run


def table(rows=40):
    t = np.arange(rows) * 0.5
    motion = {"t": t, "x": t, "y": 0 * t, "psi": 0.05 * t, "u": 1 + 0 * t, "v": 0 * t}
    orders = {"cmd_port": 50.0 + t, "cmd_starboard": 50.0 - t}
    return pd.DataFrame({**motion, "r": 0.05 + 0 * t, **orders})


def csv(**changes):
    """A good recording as text, with some cells (row, value) changed by column."""
    frame = table().astype(object)
    for column, (row, value) in changes.items():
        frame.loc[row, column] = value
    return frame.to_csv(index=False)


def columns(*names):
    return table()[list(names)].to_csv(index=False)


RECORDINGS = {
    "empty": (b"", "is empty"),
    "only a header": (b"t,x,y,psi\n", "usable row"),
    "one sample": (table(1).to_csv(index=False).encode(), "1 usable row"),
    "bytes with zeros": (bytes(range(256)) * 8, "is not text"),
    "bytes that are no text": (b"t,x\n" + bytes(range(128, 256)) * 4, "not utf-8 text"),
    "no time": (columns("x", "y", "psi").encode(), "no column 't'"),
    "no motion": (columns("t", "cmd_port").encode(), "no motion channel"),
    "foreign columns": (b"time,lat,lon\n0,1,2\n1,1,2\n", "mapping"),
    "text in a cell": (csv(u=(7, "fast")).encode(), "line 9, column 'u': 'fast' is not a number"),
    "infinite": (csv(x=(3, "inf")).encode(), "line 5, column 'x': the value is infinite"),
    "time backwards": (csv(t=(20, 3.0)).encode(), "time runs backwards"),
    "time missing": (csv(t=(20, np.nan)).encode(), "line 22: the time is missing"),
    "nothing but gaps": (b"t,psi\n0,\n1,\n2,\n", "no finite value"),
}


@pytest.mark.parametrize("command", OF_RECORDINGS)
@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_recording_that_cannot_be_read(command, kind, ends, tmp_path):
    content, message = RECORDINGS[kind]
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    status, told = ends(command, recording=path)
    assert status == 1 and told.splitlines()[-1].startswith("diffsea: error: ")
    assert message in told and "bad.csv" in told


@pytest.mark.parametrize("command", sorted({*OF_RECORDINGS} - {"audit"}))
def test_a_table_of_another_program_is_sent_to_check(command, ends, tmp_path):
    """The audit proposes a mapping itself."""
    path = tmp_path / "bad.csv"
    path.write_bytes(RECORDINGS["foreign columns"][0])
    assert "`diffsea check" in ends(command, recording=path)[1]


@pytest.mark.parametrize("command", OF_RECORDINGS)
def test_a_recording_that_is_not_there(command, ends, tmp_path):
    status, told = ends(command, recording=tmp_path / "goood.csv")
    assert status == 1 and "there is no recording" in told and "did you mean 'good.csv'" in told
    status, told = ends(command, recording=tmp_path)
    assert status == 1 and "is a folder" in told


@pytest.mark.parametrize("command", OF_RECORDINGS)
def test_a_broken_parquet_file(command, ends, tmp_path):
    path = tmp_path / "bad.parquet"
    table().to_parquet(path)
    path.write_bytes(path.read_bytes()[:500])
    status, told = ends(command, recording=path)
    assert status == 1 and "cannot be read as Parquet" in told


MAPPINGS = {
    "no TOML": ("[columns", "is not valid TOML"),
    "no time": ('[columns]\npsi = "psi"', "no channel t"),
    "unknown unit": ('[columns]\nt = { column = "t", unit = "sec" }', "unknown unit 'sec'"),
    "absent column": ('[columns]\nt = "t"\npsi = "yaw"', "no column 'yaw'"),
}


@pytest.mark.parametrize("command", OF_RECORDINGS)
@pytest.mark.parametrize("kind", MAPPINGS)
def test_a_mapping_that_cannot_be_used(command, kind, ends, tmp_path):
    content, message = MAPPINGS[kind]
    path = tmp_path / "map.toml"
    path.write_text(content)
    status, told = ends(command, None, None, "--mapping", path)
    assert status == 1 and message in told and "map.toml" in told


@pytest.mark.parametrize("command", OF_RECORDINGS)
def test_a_mapping_that_is_not_there(command, ends, tmp_path):
    status, told = ends(command, None, None, "--mapping", tmp_path / "none.toml")
    assert status == 1 and "cannot read the mapping" in told


@pytest.mark.parametrize("command", OF_ORDERS)
def test_a_recording_without_the_vessels_orders(command, ends, tmp_path):
    path = tmp_path / "other.csv"
    path.write_text(csv().replace("cmd_starboard", "cmd_right"))
    status, told = ends(command, recording=path)
    assert status == 1 and "'starboard' has neither" in told and "--mapping" in told


def changed(old, new):
    assert old in BOAT
    return BOAT.replace(old, new)


VESSELS = {
    "no TOML": ("[hull", "not valid TOML"),
    "empty": ("", "there is no [hull] table"),
    "no mass": (changed("mass = 200.0\n", ""), "mass is missing"),
    "negative mass": (changed("mass = 200.0", "mass = -200.0"), "must be positive"),
    "negative inertia": (changed("N_rdot = -120.0", "N_rdot = 500.0"), "not positive definite"),
    "not a number": (changed("X_u = -40.0", "X_u = nan"), "not a finite number"),
    "text": (changed("length = 4.0", 'length = "4 m"'), "not a finite number"),
    "unknown key": (changed("draught = 0.2", "drought = 0.2"), "did you mean 'draught'"),
    "unknown effect": (BOAT + '[[effect]]\nname = "curent"\n', "did you mean 'current'"),
    "limits crossed": (changed("max_force = 400.0", "max_force = -400.0"), "not below its upper"),
}


@pytest.mark.parametrize("command", OF_VESSELS)
@pytest.mark.parametrize("kind", VESSELS)
def test_a_vessel_that_is_impossible(command, kind, ends, tmp_path):
    content, message = VESSELS[kind]
    path = tmp_path / "bad.toml"
    path.write_text(content)
    status, told = ends(command, vessel=path)
    assert status == 1 and message in told and "bad.toml" in told


@pytest.mark.parametrize("command", OF_VESSELS)
def test_a_vessel_that_is_not_there(command, ends, tmp_path):
    status, told = ends(command, vessel="kvlc2")
    assert status == 1 and "no such vessel file; did you mean 'kvlcc2'" in told
    (tmp_path / "bad.toml").write_bytes(bytes(range(256)))
    status, told = ends(command, vessel=tmp_path / "bad.toml")
    assert status == 1 and "not a text file" in told


@pytest.mark.parametrize("command", OF_TRIALS)
def test_a_vessel_that_cannot_be_steered(command, ends, tmp_path):
    path = tmp_path / "barge.toml"
    path.write_text(BOAT[: BOAT.index("[[thruster]]")])
    status, told = ends(command, vessel=path)
    assert status == 1 and "cannot be steered" in told


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_written(command, ends, tmp_path):
    (tmp_path / "file").write_text("in the way")
    status, told = ends(command, output=tmp_path / "file" / "out")
    assert status == 1 and "cannot write into" in told and "-o" in told
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.parametrize("command", OF_TRIALS)
def test_an_unknown_manoeuvre_is_bad_usage(command, ends):
    status, told = ends(command, None, None, "--manoeuvre", "zigzak")
    assert status == 2 and "no manoeuvre 'zigzak' (did you mean 'zigzag'?)" in told
    assert "turning-circle" in told


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("zigzak:20/20", "no manoeuvre 'zigzak'; did you mean 'zigzag'?"),
        ("turning-circle:35/10", "too many angles: write for example turning-circle:35"),
        ("zigzag:ten", "the angles are numbers, in deg"),
        ("zigzag:0/10", "above zero and at most 180 deg"),
    ],
)
def test_a_trial_of_a_campaign_that_is_none_is_bad_usage(text, message, ends):
    status, told = ends("campaign", None, None, "--trials", text)
    assert status == 2 and message in told


def test_a_campaign_without_any_result_says_why(ends, tmp_path):
    (tmp_path / "barge.toml").write_text(BOAT[: BOAT.index("[[thruster]]")])
    status, told = ends("campaign", tmp_path / "barge.toml")
    assert status == 1 and "no trial of 'boat' has a result" in told and "cannot be steered" in told


def test_a_trial_named_twice_in_a_campaign_is_refused(ends):
    status, told = ends("campaign", None, None, "--trials", "zigzag", "zigzag:20/20")
    assert status == 1 and "zigzag-20-20 is named twice" in told


def test_an_unknown_recorded_manoeuvre_is_bad_usage(ends):
    status, told = ends("metrics", None, None, "--manoeuvre", "turning-circles")
    assert status == 2 and "did you mean 'turning-circle'?" in told


NUMBERS = {
    "--angle": ("-20", "0", "abc", "270"),
    "--heading": ("-20", "nan"),
    "--speed": ("-1", "0", "inf"),
    "--thrust": ("-5",),
    "--seconds": ("-1", "0"),
    "--step": ("-0.1", "0"),
    "--executes": ("-1", "0", "1.5"),
}


@pytest.mark.parametrize("command", OF_TRIALS)
@pytest.mark.parametrize("option", NUMBERS)
def test_impossible_numbers_are_bad_usage(command, option, ends):
    for value in NUMBERS[option]:
        status, told = ends(command, None, None, option, value)
        assert status == 2 and f"argument {option}" in told and value.lstrip("-") in told


@pytest.mark.parametrize("option", ["--length", "--scale"])
def test_impossible_sizes_are_bad_usage(option, ends):
    assert ends("metrics", None, None, option, "-3")[0] == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_unknown_options_and_missing_arguments_are_bad_usage(command, ends, capsys):
    assert ends(command, None, None, "--sped", "3")[0] == 2
    assert main([command]) == 2
    assert "usage: diffsea" in capsys.readouterr().err


@pytest.mark.parametrize("command", ("sensitivity", "fit"))
def test_unknown_parameters_are_told_with_the_nearest(command, ends):
    option = {"sensitivity": "--parameters", "fit": "--free"}[command]
    status, told = ends(command, None, None, option, "X_u,N_rrr_")
    assert status == 1 and "no parameter 'N_rrr_'" in told and "did you mean 'N_rr'" in told


def test_of_many_parameters_the_nearest_are_listed_and_what_lists_all(capsys):
    assert main(["sensitivity", "otter", *TRIAL, "--parameters", "mas"]) == 1
    said = capsys.readouterr().err
    assert "did you mean 'mass'? Nearest are mass, " in said
    assert len(said.partition("Nearest are ")[2].partition(";")[0].split(", ")) == 8
    assert said.endswith("; `diffsea show VESSEL --json` lists all\n")


def test_of_few_names_all_are_told():
    assert (
        nearest_of("mas", ["mass", "beam"], "a page")
        == "; did you mean 'mass'? There is mass, beam"
    )
    assert nearest_of("q", ["mass", "beam"], "a page") == "; there is mass, beam"


@pytest.mark.parametrize(("number", "words"), [(0, "0 logs"), (1, "1 log"), (2, "2 logs")])
def test_one_is_counted_as_one(number, words):
    assert counted(number, "log") == words


def test_an_unknown_swept_parameter_is_told_with_the_nearest(ends):
    status, told = ends("sweep", None, None, "maas=1:2:2")  # one more axis of the grid
    assert status == 1 and "did you mean 'mass'" in told


EXCESSIVE = {
    "--step": ("1e-9", "take a longer step"),
    "--speed": ("1e-9", "take a longer step"),
    "--executes": ("1000", "at most 100"),
}


@pytest.mark.parametrize("command", OF_TRIALS)
@pytest.mark.parametrize("option", EXCESSIVE)
def test_what_would_never_end_is_refused(command, option, ends):
    value, message = EXCESSIVE[option]
    status, told = ends(command, None, None, option, value)
    assert status == 1 and message in told


@pytest.mark.parametrize(
    "words", [("--grid", "mass=1:2:9999999999999"), ("--sample", "9999999999999", "mass=1:2")]
)
def test_too_many_designs_are_refused(words, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["sweep", "wamv", *TRIAL, *words, "-o", str(out)]) == 1
    assert "designs are too many" in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--objective", "freerun"], "no objective 'freerun'"),
        (["--priors", "none.toml"], "cannot read priors"),
        (["--objective", "trial-numbers"], "fitted to sheets"),
        (["--effects", "wnd"], "unknown effect 'wnd'; did you mean 'wind'"),
        (["--free", "X_u", "--profile", "N_r"], "N_r cannot be profiled"),
    ],
)
def test_mistakes_in_the_options_of_a_fit_are_told(ends, options, told):
    status, message = ends("fit", None, None, *options)
    assert status in (1, 2) and told in message


@pytest.mark.parametrize(("place", "told"), [("", "is a folder"), ("none/a.csv", "is no folder")])
def test_a_manoeuvre_that_cannot_be_written_is_told_before_any_work(ends, tmp_path, place, told):
    status, message = ends("diagnose", None, None, "--next-manoeuvre", str(tmp_path / place))
    assert status == 1 and f"--next-manoeuvre: {tmp_path}" in message
    assert told in message and "auditing" not in message
