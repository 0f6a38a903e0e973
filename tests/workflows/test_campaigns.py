"""Campaigns: every trial to both sides with its numbers, verdicts, log, and what failed."""

import json
import math
import re

import numpy as np
import pytest
from tests.boats import BOAT

import diffsea
from diffsea.cli import main
from diffsea.metrics.ittc import approach_verdict
from diffsea.report.pages.campaign import campaign_page
from diffsea.scales import HARD_OVER
from diffsea.workflows.campaigns import CampaignResult, CampaignTrial


pytestmark = [pytest.mark.slow, pytest.mark.compiles]

# Port and starboard thrust as 1.2 to 0.8 at the same order, so that both sides differ.
UNEVEN = BOAT + '\n[[effect]]\nname = "thrust-asymmetry"\nratio = -0.2\n'
ALONE = BOAT[: BOAT.index("[[thruster]]")] + (
    '[[thruster]]\nname = "screw"\nx = -1.9\nmax_force = 400.0\nmin_force = -300.0\n'
)
TRIALS = ("turning-circle", "zigzag:10/10")


def file_of(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("boat") / "boat.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def uneven(tmp_path_factory):
    return file_of(tmp_path_factory, UNEVEN)


@pytest.fixture(scope="module")
def found(uneven):
    return diffsea.campaign(uneven, TRIALS, speed=1.2)


def test_each_trial_is_that_of_the_command_to_its_side(uneven, found):
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        alone = diffsea.trial(uneven, "turning-circle", side=sign, speed=1.2).metrics
        told = found.record["trials"]["turning-circle-35"][side]
        assert told["side"] == side
        for name in ("advance", "tactical_diameter", "peak_yaw_rate", "advance_over_L"):
            assert told[name] == pytest.approx(alone[name])
        assert told["imo"].keys() == alone["imo"].keys()


def test_both_sides_are_compared_as_repeats(found):
    sides = found.record["trials"]["turning-circle-35"]
    both = found.record["repeats"]["turning-circle-35"]["tactical_diameter"]
    values = [sides[side]["tactical_diameter"] for side in ("starboard", "port")]
    assert abs(values[0] - values[1]) > 0.01 * values[0]
    assert both["mean"] == pytest.approx(np.mean(values))
    assert both["starboard_less_port"] == pytest.approx(values[0] - values[1])
    # Student's t of one degree of freedom, 12.706, times |difference| / 2.
    assert both["half_width"] == pytest.approx(12.706 * abs(values[0] - values[1]) / 2, rel=1e-4)


def test_a_criterion_is_met_where_both_sides_meet_it(found):
    def one(side, value):
        verdict = "pass" if value <= 4.5 else "fail"
        item = {"value": value, "limit": 4.5, "unit": "L", "criterion": "5.3.1"}
        return CampaignTrial("circle", side, {"imo": {"advance": item | {"verdict": verdict}}})

    for port, told in ((4.4, "pass"), (4.6, "fail")):
        record = CampaignResult(found.vessel, (one("starboard", 4.0), one("port", port))).record
        (row,) = record["criteria"]
        assert row["values"] == {"starboard": 4.0, "port": port}
        assert row["verdict"] == record["verdict"] == told
    assert CampaignResult(found.vessel, ()).record["verdict"] == "not judged"


def test_the_log_has_the_derived_quantities_of_a_pair_of_thrusters(found):
    one = next(one for one in found.trials if (one.name, one.side) == ("zigzag-10-10", "port"))
    log = one.log
    port, starboard = log["T_port"], log["T_starboard"]
    np.testing.assert_allclose(
        log["delta_exec"], HARD_OVER * (port - starboard) / (port + starboard), atol=1e-9
    )
    # At y = -0.9 and 0.9 m; a push ahead on the port side turns to starboard.
    np.testing.assert_allclose(log["tau_z"], 0.9 * (1.2 * port - 0.8 * starboard), atol=1e-9)
    assert log["t"][0] < 0 < log["t"][-1]
    at_onset = np.argmin(np.abs(log["t"]))
    assert log["psi_relative"][at_onset] == pytest.approx(0.0, abs=1e-3)
    assert np.max(np.abs(log["r_calc"] - log["r"])) < 0.05 * np.max(np.abs(log["r"]))
    assert np.all(np.abs(log["psi_wrapped"]) <= math.pi)
    assert log["delta_cmd"][log["t"] > 0][5] == pytest.approx(-math.radians(10))


def test_every_trial_is_traced(found):
    for one in found.trials:
        assert one.metrics["approach"]["verdict"] == "steady"
        names = [check["name"] for check in one.metrics["checks"]]
        assert names[:3] == ["actuation", "yaw-rate", "time-step"]


def test_approaches_are_judged_by_the_ittcs_limits(found):
    for one in found.trials:
        ittc, u = (
            one.metrics["approach"]["ittc"],
            one.run.u[one.run.t < one.metrics["execute_time"]],
        )
        assert ittc["verdict"] == "pass"
        assert ittc["speed"] == pytest.approx(u[-20:].mean(), rel=2e-3)
        assert ittc["least_speed"] == pytest.approx(0.9 * 1.2)
    assert all(row["ITTC"] == "pass" for row in found.rows())


def test_a_table_of_criteria_has_the_sides_that_were_run(found):
    row = {"trial": "zigzag-20-20", "criterion": "5.3.3.3", "number": "overshoot_1"}
    row |= {"limit": 0.4, "unit": "rad", "verdict": "pass"}
    for sides in (("starboard",), ("port",), ("starboard", "port"), ("ahead",)):
        rows = [row | {"values": dict.fromkeys(sides, 1.0)}]
        page = campaign_page(found.record | {"criteria": rows}, [], {})
        table = page[page.index("Criteria of IMO") :]
        head = re.findall(r"<th[^>]*>([^<]+)</th>", table[: table.index("</thead>")])
        assert head[3 : 3 + len(sides)] == list(sides) and head[3 + len(sides)] == "limit"
        assert table[: table.index("</table>")].count("57.3") == len(sides)


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "wanted", "verdict"),
    [
        (0.91, math.radians(0.17), 1.0, "pass"),
        (0.89, math.radians(0.17), 1.0, "fail"),
        (0.91, math.radians(0.19), 1.0, "fail"),
        (0.1, 0.0, None, "pass"),
        (math.nan, 0.0, None, "pass"),
        (math.nan, 0.0, 1.0, "unknown"),
        (1.0, math.nan, 1.0, "unknown"),
    ],
)
def test_the_ittcs_limits(speed, yaw_rate, wanted, verdict):
    assert approach_verdict(speed, yaw_rate, wanted)["verdict"] == verdict


def test_a_trial_that_fails_is_a_row_that_says_why_and_the_others_go_on(
    tmp_path_factory, tmp_path, capsys
):
    boat = file_of(tmp_path_factory, ALONE)
    words = ["--trials", "zigzag", "stopping", "--speed", "1.2", "--json", "-o", str(tmp_path)]
    assert main(["campaign", str(boat), *words]) == 0
    printed = capsys.readouterr()
    told = json.loads(printed.out)
    assert told == json.loads((tmp_path / "campaign.json").read_text())
    for side in ("starboard", "port"):
        assert "cannot be steered" in told["trials"]["zigzag-20-20"][side]["failed"]
    assert told["trials"]["stopping"]["ahead"]["track_reach"] > 0
    assert [row["number"] for row in told["criteria"]] == ["track_reach"]
    page = (tmp_path / "campaign.html").read_text()
    assert "1 of 3 trials done" in page and "cannot be steered" in page
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {
        "campaign.json", "campaign.html", "stopping-ahead.csv", "stopping-ahead-log.csv"
    }  # fmt: skip
    assert "zigzag-20-20 starboard" in printed.err


def test_the_page_has_what_the_record_has(found):
    page = found.html()
    for text in ("Trials of boat", "turning-circle-35", "MSC.137(76) 5.3.1", "duty-cycle of port"):
        assert text in page
