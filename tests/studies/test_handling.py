"""What a vessel is like to handle, against published numbers and the textbook's criterion."""

import json
import math

import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import varied

from diffsea import read_vessel
from diffsea.cli import main
from diffsea.studies.handling import handling
from diffsea.vessel.files import build


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


@pytest.fixture(scope="module")
def usv():
    return load(str(ORACLE / "usv.toml"))


@pytest.mark.proof
def test_the_mariner_has_the_time_constants_that_are_published():
    """T1 = 118 s and T2 = 7.8 s of the second-order Nomoto model (Chislett and Stroem-Tejsen
    1965; Fossen 2021, section 7.2)."""
    found = handling(read_vessel("mariner").vessel)
    assert found.course_times == pytest.approx((118.0, 7.8), rel=0.01)
    assert found.is_course_stable and found.course_period is None
    assert found.speed == pytest.approx(15 * 1852 / 3600, rel=1e-3)


@pytest.mark.parametrize("moment", [-400.0, 0.0, 400.0, 1200.0, 2500.0])
def test_stability_is_that_of_the_textbook_s_criterion(usv, moment):
    """C = Y_v (N_r - m x_G u) - N_v (Y_r - m u) > 0, all with what acceleration adds."""
    hull = varied(usv, {"N_v": moment, "N_rr": None, "X_uu": None})["hull"]
    found = handling(build({**usv, "hull": hull}))
    u, m = found.speed, hull["mass"]
    munk = (hull["Y_vdot"] - hull["X_udot"]) * u
    criterion = hull["Y_v"] * hull["N_r"] - (moment + munk) * (hull["X_udot"] - m) * u
    assert found.is_course_stable == (criterion > 0)


def test_speed_settles_and_turns_are_run(usv):
    vessel = build(varied(usv, {"X_uu": None}))
    found = handling(vessel)
    assert found.surge_time == pytest.approx((180 + 12) / 52)
    assert found.turning_diameter is not None and 2 < found.turning_diameter / 4.9 < 20
    document = {key: value for key, value in usv.items() if key != "thruster"}
    still = handling(build(document))
    assert still.turning_diameter is None and still.top_speed == math.inf


def test_vessels_are_shown_in_words_and_as_json(capsys):
    assert main(["vessels"]) == 0
    told = capsys.readouterr().out
    assert "kvlcc2" in told and "azimuth thruster: thruster" in told
    assert main(["vessels", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["otter"]["channels"]["port"] == "rev/s"
    assert main(["show", "pytheas"]) == 0
    told = capsys.readouterr().out
    assert "stable on a straight course" in told and "tactical diameter at 35 deg" in told
    assert main(["show", "otter", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["handling"]["course_times"][0] is None  # neutral: no linear damping of sway
    assert shown["parameters"]["mass"] == 80.0 and "crossflow-drag.cd" in shown["parameters"]
    assert main(["show", "oter"]) == 1
    assert "did you mean 'otter'" in capsys.readouterr().err
    assert main(["show", "otter", "-o", "there"]) == 2  # it writes nothing
