"""Fits and diagnoses whose time ends, at once and at one question after the other."""

import json
import os
import shutil
import time

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT, CROSS_FLOW

from diffsea.budget import Budget, current_budget, in_this_context, time_budget
from diffsea.cli import main
from diffsea.cli.outputs import json_text


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A boat, a stiff and a wild one, and noisy runs of one with more drag in the cross-flow."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "boat.toml").write_text(BOAT)
    (folder / "stiff.toml").write_text(BOAT.replace("Y_v = -80.0", "Y_v = -8e6"))
    (folder / "wild.toml").write_text(BOAT.replace("N_r = -300.0", "N_r = 30000.0"))
    (folder / "true.toml").write_text(BOAT + CROSS_FLOW)
    rng = np.random.default_rng(1)
    for side in ("port", "starboard"):
        words = ["--manoeuvre", "zigzag", "--executes", "3", "--step", "0.1", "--side", side]
        assert main(["trial", str(folder / "true.toml"), *words, "-o", str(folder / side)]) == 0
        run = pd.read_csv(folder / side / "recording.csv").iloc[::5]
        for name, noise in {"x": 0.05, "y": 0.05, "psi": 5e-3, "u": 0.02, "r": 5e-3}.items():
            run[name] += noise * rng.standard_normal(len(run))
        run.drop(columns="v").to_csv(folder / f"{side}.csv", index=False)
    return folder


def done(job, data, out, *words, boat="boat"):
    """Status, record and report of a fit or a diagnosis of the runs."""
    runs = [str(data / "port.csv"), "--test", str(data / "starboard.csv")]
    inputs = [str(data / f"{boat}.toml"), *runs, "--free", "X_u,Y_v,N_r"]
    status = main([job, *inputs, "-o", str(out), *words])
    name = {"fit": "fit.json", "diagnose": "diagnosis.json"}[job]
    if status:
        return status, {}, ""
    return status, json.loads((out / name).read_text()), (out / "report.html").read_text()


@pytest.mark.parametrize("job", ["fit", pytest.param("diagnose", marks=pytest.mark.proof)])
def test_a_budget_that_is_spent_at_once_ends_with_what_was_left_out(job, data, tmp_path, capsys):
    status, record, report = done(job, data, tmp_path, "--budget", "0.001")
    assert status == 0 and record["complete"] is False
    assert {"rounds of a fit", "free predictions"} <= set(record["left_out"])
    assert "The time was over" in capsys.readouterr().out and "The time was over" in report
    assert (tmp_path / "vessel.toml").exists()


@pytest.mark.parametrize("job", ["fit", pytest.param("diagnose", marks=pytest.mark.proof)])
def test_wherever_the_time_ends_there_is_a_result_that_says_so(job, data, tmp_path, monkeypatch):
    asked, last = [0], [np.inf]

    def is_over(budget):
        asked[0] += 1
        return asked[0] > last[0]

    monkeypatch.setattr(Budget, "is_over", property(is_over))
    status, record, _ = done(job, data, tmp_path / "whole")
    assert status == 0 and record["complete"] is True and record["left_out"] == []
    assert "out of time" not in json_text(record)
    number = asked[0]
    for share in (0.0, 0.3, 0.6, 0.8, 0.99):
        asked[0], last[0] = 0, int(share * number)
        status, record, _ = done(job, data, tmp_path / str(share))
        assert status == 0 and record["complete"] is False and record["left_out"], share


@pytest.mark.parametrize("boat", ["stiff", "wild"])
@pytest.mark.parametrize("job", ["fit", pytest.param("diagnose", marks=pytest.mark.proof)])
def test_a_stiff_or_a_wild_vessel_ends_soon_after_its_budget(job, boat, data, tmp_path, capsys):
    began = time.monotonic()
    status, record, _ = done(job, data, tmp_path, "--budget", "5", boat=boat)
    assert time.monotonic() - began < 150  # mostly compiling
    told = capsys.readouterr().err
    assert (status == 0 and record["complete"] is False) or "diverges" in told


def test_a_fit_that_is_interrupted_goes_on_from_its_fits(data, tmp_path, capsys, monkeypatch):
    """Interrupted while it predicts, and begun again: the results are those of one left alone."""

    def stop(*args):
        raise KeyboardInterrupt

    names = "fit.json", "vessel.toml", "report.html"
    assert done("fit", data, tmp_path / "alone")[0] == 0
    assert [one.name for one in tmp_path.iterdir()] == ["alone"]
    out, parts = tmp_path / "out", tmp_path / "fits"
    with monkeypatch.context() as patch:
        old = tmp_path / "old"
        old.mkdir()
        (old / "another boat's").touch()
        os.utime(old / "another boat's", (1e9, 1e9))
        patch.setattr("diffsea.cli.options.read_vessel", stop)
        assert done("fit", data, out, "--parts", str(old))[0] == 130
        assert capsys.readouterr().err.endswith("nothing was written\n")
    shutil.rmtree(old)
    with monkeypatch.context() as patch:
        patch.setattr("diffsea.workflows.fits.compare_fit", stop)
        assert done("fit", data, out, "--parts", str(parts))[0] == 130
    assert list(parts.iterdir()) and not out.exists()
    assert f"kept in {parts}: the same command goes on" in capsys.readouterr().err
    assert done("fit", data, out, "--parts", str(parts))[0] == 0
    assert f"taken from {parts}" in capsys.readouterr().err
    assert not parts.exists()
    for name in names:
        assert (out / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


@pytest.mark.proof
def test_minutes_name_what_they_leave_out(data, tmp_path):
    status, record, _ = done("diagnose", data, tmp_path, "--minutes", "1e-6")
    assert status == 0 and record["complete"] is False and record["left_out"]
    assert "rounds of a fit" not in record["left_out"]  # what was begun was ended


def test_threads_have_the_budget_of_who_starts_them_and_nobody_else_has_any():
    import threading

    found = []
    with time_budget(-1.0) as left:
        work = in_this_context(lambda: found.append(current_budget().skips("a thing")))
        for target in (work, lambda: found.append(current_budget().skips("another"))):
            thread = threading.Thread(target=target)
            thread.start()
            thread.join()
        assert left.left_out == ("a thing",) and left.skips("a thing")
    assert found == [True, False] and not current_budget().is_over
