"""The jobs of the command line, from a script: same defaults, results that print."""

import json
import math

import numpy as np
import pytest
from tests.boats import BOAT
from tests.paths import ROOT

import diffsea
from diffsea.cli import main


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def boat(tmp_path_factory):
    path = tmp_path_factory.mktemp("boat") / "boat.toml"
    path.write_text(BOAT)
    return path


@pytest.fixture(scope="module")
def turn(boat):
    return diffsea.trial(boat, "turning-circle")


def test_a_trial_is_that_of_the_command(boat, turn, tmp_path, capsys):
    assert main(["trial", str(boat), "--manoeuvre", "turning-circle", "-o", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert turn.metrics["tactical_diameter"] == pytest.approx(written["tactical_diameter"])
    assert turn.metrics["imo"].keys() == written["imo"].keys()


def test_results_print_as_tables_in_a_terminal_and_in_a_notebook(turn):
    text, page = repr(turn), turn._repr_html_()
    assert text.startswith("turning-circle of boat: the manoeuvre was completed")
    assert "tactical_diameter" in text and len(text.splitlines()) < 40
    assert "<table" in page and "tactical_diameter" in page


def test_a_recording_is_predicted_by_its_own_vessel(boat, turn):
    found = diffsea.predict(boat, turn.trajectory)
    assert found.errors["position"] < 0.05
    assert "whole run" in repr(found)


def test_a_trial_that_cannot_be_run_says_so(boat):
    with pytest.raises(diffsea.UserError, match="did you mean 'zigzag'"):
        diffsea.trial(boat, "zigzga")


@pytest.mark.proof
def test_derivatives_are_those_of_differences(boat):
    found = diffsea.sensitivities(boat, "turning-circle", parameters=["N_r"])
    base = diffsea.named(diffsea.read_vessel(boat).vessel)["N_r"]
    numbers = []
    for change in (-1.0, 1.0):
        vessel = diffsea.replace(diffsea.read_vessel(boat).vessel, {"N_r": base + change})
        plan = diffsea.trial(vessel, "turning-circle", speed=found_speed(boat))
        numbers.append(plan.metrics["advance"])
    slope = (numbers[1] - numbers[0]) / 2
    assert found.derivatives["advance"]["N_r"] == pytest.approx(slope, rel=1e-3)


def found_speed(boat):
    return diffsea.plan_trial(diffsea.read_vessel(boat).vessel, "turning-circle").speed


def test_a_sweep_is_a_table_of_designs(boat):
    table = diffsea.sweep(boat, "turning-circle", grid={"mass": (180, 220, 3)})
    assert list(table["mass"]) == [180, 200, 220]
    assert np.all(np.diff(table["tactical_diameter"]) != 0)
    with pytest.raises(diffsea.UserError, match="either a grid or a sample"):
        diffsea.sweep(boat, "turning-circle")


@pytest.mark.proof
def test_the_demo_is_fitted_and_diagnosed(tmp_path):
    demo = ROOT / "examples" / "demo"
    runs, held_out = sorted((demo / "recordings").glob("*")), sorted((demo / "held_out").glob("*"))
    fitted = diffsea.fit(demo / "usv.toml", runs[:2], test=held_out[:1])
    assert math.isfinite(fitted.misfit["test"]) and "90 % interval" in repr(fitted)
    diffsea.write_vessel(fitted.fitted, tmp_path / "fitted.toml")
    again = diffsea.read_vessel(tmp_path / "fitted.toml")
    assert diffsea.named(again.vessel)["X_u"] == diffsea.named(fitted.fitted.vessel)["X_u"]
    found = diffsea.diagnose(demo / "usv.toml", runs[:3], test=held_out[:1])
    assert found.verdict == "explained" and "current" in repr(found)
    assert "<html" in found.html() and "<pre>On runs" in found._repr_html_()
