"""What is unusual of a vessel, beside those that ship."""

import dataclasses
import json
import tomllib
from importlib.resources import files

import pytest

from diffsea import read_vessel
from diffsea.cli import main
from diffsea.studies.handling import Handling, handling
from diffsea.studies.unusual import (
    FIGURES,
    compute_shipped_figures,
    shipped_figures,
    size_free_figures,
    unusual_figures,
)
from diffsea.vessel.files import build, shipped_vessels


def test_there_are_numbers_of_every_vessel_that_ships():
    stored = shipped_figures()
    assert list(stored) == list(FIGURES)
    named = {name for numbers in stored.values() for name in numbers}
    assert named == set(shipped_vessels())
    otter = read_vessel("otter").vessel.rigid_body
    block = 1026 * otter.length * otter.beam * otter.draught
    assert stored["displacement"]["otter"] == pytest.approx(80 / block, rel=1e-3)


@pytest.mark.slow
def test_numbers_that_are_stored_are_those_of_the_file():
    vessel = read_vessel("pytheas").vessel
    for figure, value in size_free_figures(vessel, handling(vessel)).items():
        assert shipped_figures()[figure]["pytheas"] == pytest.approx(value, rel=2e-3), figure


@pytest.mark.proof
def test_all_numbers_that_are_stored_are_those_of_the_files():
    """Otherwise `python -m diffsea.studies.unusual` writes them anew."""
    fresh = compute_shipped_figures()
    for figure, numbers in shipped_figures().items():
        assert fresh[figure] == pytest.approx(numbers, rel=2e-3, abs=1e-6), figure


def changed(**hull):
    document = tomllib.loads((files("diffsea.vessel.data") / "otter.toml").read_text())
    return build({**document, "hull": {**document["hull"], **hull}})


# How an Otter moves, in m and s.
OTTER = Handling(3.09, 0.886, 1.1, (float("inf"), 0.873), None, 9.74, "")


def test_a_mass_ten_times_too_large_is_unusual():
    assert unusual_figures(changed(), OTTER) == []
    heavy, gyration = unusual_figures(changed(mass=800.0), OTTER)
    most = max(shipped_figures()["displacement"].values())
    ratio = 800 / (1026 * 2.0 * 1.08 * 0.195) / most
    assert heavy.startswith("mass over that of the block L B T of water: 1.85, ")
    assert f"{ratio:.2g} times the most of the vessels that ship, 0.83 (esso_osaka)" in heavy
    assert "radius of gyration over length: 0.0687, 0.45 times the least" in gyration


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"top_speed": 44.3}, "Froude number of the top speed: 10, 11 times the most"),
        ({"turning_diameter": 100.0}, "tactical diameter over length: 50, 7.8 times the most"),
        ({"top_speed": 4.08}, "0.921, 1.03 times the most"),
        ({"surge_time": 0.01}, "time constant of its speed in sqrt(L / g): 0.0221, 0.031 times"),
        ({"course_times": (-0.5, 0.9)}, "fall, times sqrt(L / g): -0.903, 8.4 times the least"),
        ({"top_speed": float("inf"), "turning_diameter": None}, ""),
    ],
)
def test_a_motion_that_no_vessel_has_is_unusual(change, said):
    lines = unusual_figures(changed(), dataclasses.replace(OTTER, **change))
    assert len(lines) == (said != "") and all(said in line for line in lines)


@pytest.mark.slow
def test_show_says_what_is_unusual(tmp_path, capsys):
    text = (files("diffsea.vessel.data") / "otter.toml").read_text()
    (tmp_path / "boat.toml").write_text(text.replace("mass = 80.0", "mass = 800.0"))
    assert main(["show", str(tmp_path / "boat.toml")]) == 0
    assert "\nunusual: mass over that of the block L B T" in capsys.readouterr().out
    assert main(["show", "otter"]) == 0
    assert capsys.readouterr().out.endswith("nothing unusual beside the vessels that ship\n")
    assert main(["show", "otter", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unusual"] == []
