"""What users have gives the numbers of the experiments, which are written with the library."""

import json
import math

import pytest
from tests.paths import EXPERIMENTS

import diffsea


def results(name):
    return json.loads((EXPERIMENTS / name / "results.json").read_text())


def test_a_mission_file_is_a_trial_of_the_battery():
    found = diffsea.run_mission(EXPERIMENTS / "pytheas" / "D1.toml").numbers
    (trial,) = (one for one in results("pytheas")["battery"] if one["trial"] == "D1")
    assert found["outcome"] == "completed" and trial["library"]["reached"]
    assert found["waypoints"][-1]["time"] == pytest.approx(trial["library"]["time"], abs=0.021)
    closest = found["waypoints"][-1]["closest_approach"]
    assert closest == pytest.approx(trial["library"]["closest"], abs=2e-3)


@pytest.mark.proof
def test_a_campaign_of_the_catalogues_vessel_has_the_numbers_of_the_virtual_sea_trials():
    """Its file has the fitted derivatives rounded to four digits."""
    found = diffsea.campaign("marus_usv", ["turning-circle"], speed=0.8311).record
    circles = found["trials"]["turning-circle-35"]
    campaign = results("virtual_sea_trials")["campaign"]["at once"]
    for side in ("port", "starboard"):
        for name, value in campaign[f"circle-{side}"]["numbers"].items():
            assert circles[side][f"{name}_over_L"] == pytest.approx(value, rel=2e-3), (side, name)
        assert math.isfinite(circles[side]["approach"]["ittc"]["speed"])
        assert circles[side]["approach"]["ittc"]["verdict"] == "pass"
