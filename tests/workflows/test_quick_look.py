"""What a quick look leaves out of a fit and a diagnosis, and that it says so."""

import dataclasses
import json
import math
import tomllib

import numpy as np
import pytest
from tests.boats import BOAT
from tests.runs import random_steps

from diffsea import UserError, read_vessel, write_recording
from diffsea.cli import main
from diffsea.diagnosis.selection import FULL_EFFORT
from diffsea.recordings import thin
from diffsea.report.wording.caveats import incomplete_sentence
from diffsea.workflows import diagnoses, quick


@pytest.fixture
def run():
    """A minute of random thrusts, new ones every four seconds."""
    return random_steps(tomllib.loads(BOAT), 1, 60.0, 0.1)


def test_thinned_rows_are_those_that_were_measured_and_orders_stay_where_they_were(run):
    few = thin(run, 0.65)
    steps = np.diff(few.t)
    assert len(few.t) < 0.3 * len(run.t) and steps.max() <= 0.7 + 1e-9
    rows = np.searchsorted(run.t, few.t - 1e-9)
    np.testing.assert_array_equal(few.psi, np.asarray(run.psi)[rows])
    changed = run.t[1:][np.diff(run.commanded["port"]) != 0]
    assert len(changed) > 10 and set(changed) <= set(few.t)
    assert "left out" in few.provenance[-1]


def test_a_run_without_anything_to_thin_stays_as_it_is(run):
    assert thin(run, 0.1).provenance == run.provenance and len(thin(run, 0.1).t) == len(run.t)
    swept = {"port": 100 + np.arange(len(run.t)) % 2.0, "starboard": run.commanded["starboard"]}
    busy = dataclasses.replace(run, commanded=swept)
    assert len(thin(busy, 5.0).t) == len(run.t)


def test_a_quick_diagnosis_searches_less_in_thinner_data(run, tmp_path, monkeypatch):
    seen = {}

    def search(vessel, runs, *rest, effort, **others):
        seen["rows"], seen["effort"] = len(runs[0].t), effort
        raise UserError("far enough")

    monkeypatch.setattr(diagnoses, "search_effects", search)
    (tmp_path / "boat.toml").write_text(BOAT)
    write_recording(run, tmp_path / "run.csv")
    words = ["diagnose", str(tmp_path / "boat.toml"), str(tmp_path / "run.csv")]
    words += ["-o", str(tmp_path / "out")]
    assert main(words) == 1
    assert seen == {"rows": len(run.t), "effort": FULL_EFFORT}
    assert main([*words, "--quick"]) == 1
    apart = quick.interval(read_vessel(tmp_path / "boat.toml").vessel)
    assert apart == pytest.approx(0.5 * math.sqrt(4.0 / 9.81), rel=1e-3)
    assert seen["rows"] == len(thin(run, apart).t) < len(run.t)
    assert seen["effort"].effects == 1 and not seen["effort"].insists


def test_a_quick_look_has_no_manoeuvre_to_write(tmp_path, capsys):
    words = ["diagnose", "otter", "a.csv", "--quick", "--next-manoeuvre", str(tmp_path / "n.csv")]
    assert main([*words, "-o", str(tmp_path / "out")]) == 1
    assert "--quick looks for no manoeuvre" in capsys.readouterr().err


def test_what_was_not_done_is_said():
    cut_short = {"complete": False, "left_out": []}
    told = incomplete_sentence(cut_short | {"not_done": list(quick.of_diagnosis("3 of 9"))})
    assert told.startswith("A quick look. Not done: 3 of 9; ") and "--quick" in told
    assert "time was over" in incomplete_sentence(cut_short)


@pytest.mark.slow
def test_a_quick_fit_says_what_it_has_not_done(run, tmp_path, capsys):
    (tmp_path / "boat.toml").write_text(BOAT)
    write_recording(run, tmp_path / "run.csv")
    out = tmp_path / "out"
    words = ["fit", str(tmp_path / "boat.toml"), str(tmp_path / "run.csv"), "--free", "N_r,X_u"]
    assert main([*words, "--quick", "-o", str(out)]) == 0
    record = json.loads((out / "fit.json").read_text())
    samples, *others = record["not_done"]
    assert "samples" in samples and others == list(quick.of_fit(""))
    assert record["next_manoeuvre"] is None
    assert not any(row["profiled"] for row in record["parameters"].values())
    said = "A quick look. Not done: "
    told = " ".join(capsys.readouterr().out.split())
    assert said in told and said in (out / "report.html").read_text()
