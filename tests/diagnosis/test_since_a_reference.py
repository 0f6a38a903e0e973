"""What changed since recordings of reference is told from what the vessel file had wrong."""

import dataclasses
import functools

import pytest
from tests.diagnosis.small import DOCUMENT
from tests.runs import random_steps

import diffsea
from diffsea import VesselFile
from diffsea.vessel.files import build


pytestmark = pytest.mark.proof


def since_a_reference(load):
    """A diagnosis of recordings with a load, and two recordings without it."""
    laden = {"mass-change": {"time": -100.0, **load}}
    hidden = {1: {}, 2: {}, 3: laden, 4: laden, 5: laden}
    runs = {
        k: dataclasses.replace(random_steps(DOCUMENT, k, 60.0, 0.2, one), name=f"run {k}")
        for k, one in hidden.items()
    }
    file = VesselFile(build(DOCUMENT), DOCUMENT, "usv.toml")
    diagnosed = functools.partial(diffsea.diagnose, file, [runs[3], runs[4]], [runs[5]], quick=True)
    return diagnosed, [runs[1], runs[2]]


def test_a_load_that_looks_like_added_mass_is_found_beside_recordings_without_it():
    """Alone, the later recordings agree with the vessel file: its derivatives hold the load."""
    load = 0.2 * DOCUMENT["hull"]["mass"]
    diagnosed, reference = since_a_reference({"mass": load})
    alone = diagnosed()
    assert alone.record["verdict"] == "consistent"
    since = diagnosed(reference=reference)
    (effect,) = since.record["effects"]
    assert effect["name"] == "mass-change"
    mass, time = effect["parameters"]["mass"], effect["parameters"]["time"]
    assert abs(mass["value"] - load) < 2 * mass["std"] < 0.2 * load
    assert time["before_recordings"] and time["value"] == 0.0 and time["std"] is None
    assert any("larger from before these recordings on" in line for line in since.notes())
    page = since.html()
    assert "before these recordings" in page
    assert "what changed since 2 recordings of reference" in page
    assert since.record["source"]["reference"] == ["run 1", "run 2"]
    assert "reference" not in alone.record["source"] and "of reference" not in alone.html()
    (table,) = since.diagnosed.document["effect"]
    assert table["mass"] == pytest.approx(mass["value"], rel=1e-3) and "time" not in table


def test_a_load_at_one_end_is_found_with_its_place():
    hull = DOCUMENT["hull"]
    load, x = 0.2 * hull["mass"], -0.22 * hull["length"]
    diagnosed, reference = since_a_reference({"mass": load, "x": x})
    since = diagnosed(reference=reference)
    (effect,) = since.record["effects"]
    assert effect["name"] == "mass-change"
    for key, true in (("mass", load), ("x", x)):
        found = effect["parameters"][key]
        assert abs(found["value"] - true) < 2 * found["std"] < 0.4 * abs(true), key
    assert any("aft of amidships" in line for line in since.notes())
    (table,) = since.diagnosed.document["effect"]
    assert table["x"] == pytest.approx(effect["parameters"]["x"]["value"], rel=1e-3)
