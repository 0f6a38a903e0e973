"""Priors on their way into a diagnosis: those of the vessel file, and those of --priors."""

import tomllib

import pytest
from tests.boats import BOAT
from tests.runs import random_steps

from diffsea import UserError, write_recording
from diffsea.cli import main
from diffsea.workflows import diagnoses


PRIOR = "[prior]\nX_u = { std = 4.0 }\nN_r = { free = false }\nx_G = { std = 0.1 }\n"


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What a diagnosis by the command line is asked to fit: parameters by name."""
    vessel, run, seen = tmp_path / "boat.toml", tmp_path / "run.csv", {}
    write_recording(random_steps(tomllib.loads(BOAT), 1, 30.0, 0.2), run)

    def search(vessel, runs, test, per_run, free, *rest, **more):
        seen["free"], seen["priors"] = free, rest[-1]
        raise UserError("far enough")

    monkeypatch.setattr(diagnoses, "search_effects", search)

    def ask(prior: str, *words: str) -> dict:
        vessel.write_text(BOAT + prior)
        assert main(["diagnose", str(vessel), str(run), "-o", str(tmp_path / "out"), *words]) == 1
        assert tuple(seen["priors"]) == seen["free"]
        return seen["priors"]

    return ask


def test_a_diagnosis_frees_what_the_vessels_priors_name_with_their_widths(asked):
    plain, stated = asked(""), asked(PRIOR)
    assert "x_G" not in plain and "N_r" in plain
    assert stated.keys() == (plain.keys() | {"x_G"}) - {"N_r"}
    assert stated["X_u"].std == pytest.approx(4.0) and stated["x_G"].std == pytest.approx(0.1)
    assert stated["Y_v"] == plain["Y_v"]


def test_a_file_of_priors_comes_before_the_vessels(asked, tmp_path):
    path = tmp_path / "known.toml"
    path.write_text("[X_u]\nvalue = -50.0\nstd = 2.0\n[N_r]\nspread = 0.1\n")
    found = asked(PRIOR, "--priors", str(path))
    assert (found["X_u"].value, found["X_u"].std) == (-50.0, pytest.approx(2.0))
    assert found["N_r"].spread == 0.1 and found["x_G"].std == pytest.approx(0.1)
    assert "mass" in asked(PRIOR, "--anchor", "thrust")
