"""A change in one recording that stays, found on the clock that recordings share."""

import dataclasses

import pytest
from tests.diagnosis.small import DOCUMENT
from tests.runs import random_steps

import diffsea
from diffsea import VesselFile
from diffsea.trajectory import ReadReport
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow

SECONDS, STEP = 60.0, 0.2
WEAKER = {"factor": -0.4, "actuators": ["starboard"]}


@pytest.mark.proof
@pytest.mark.parametrize("dated", [False, True])
def test_weed_in_one_propeller_is_found_from_when_it_was_there(dated):
    """The second of three runs, which all begin at zero, loses thrust on one side half way.

    Which came after which is said by an option, or by the files.
    """
    since = (None, 30.0, 0.0)
    hidden = ({} if t is None else {"thrust-change": {"time": t, **WEAKER}} for t in since)
    runs = [
        dataclasses.replace(random_steps(DOCUMENT, k, SECONDS, STEP, one), name=f"run {k}")
        for k, one in enumerate(hidden, start=20)
    ]
    if dated:
        made = (ReadReport(epoch=1_795_000_000.0 + 100.0 * k) for k in range(3))
        runs = [dataclasses.replace(run, read=read) for run, read in zip(runs, made, strict=True)]
    file = VesselFile(build(DOCUMENT), DOCUMENT, "usv.toml")
    found = diffsea.diagnose(file, runs[:2], runs[2:], quick=True, one_after_another=not dated)
    (effect,) = found.record["effects"]
    assert effect["name"] == "thrust-change" and effect["actuators"] == ["starboard"]
    for key, true in (("time", 100.0 + 30.0), ("factor", -0.4)):
        one = effect["parameters"][key]
        assert abs(one["value"] - true) < 4 * one["std"]
    time = effect["parameters"]["time"]
    assert time["std"] < 1.0 and time["recording"] == "run 21"
    assert time["since_start"] == pytest.approx(time["value"] - 100.0)
    assert any("into run 21)" in line for line in found.notes())
    assert "s into run 21" in found.html()
    (table,) = found.diagnosed.document["effect"]
    assert table["actuators"] == ["starboard"] and "time" not in table


@pytest.mark.proof
@pytest.mark.parametrize("ahead", [True, False])
def test_a_drag_that_grows_ahead_alone_is_told_from_one_in_all_directions(ahead):
    """Weed holds the way ahead, and hardly a drift: of two runs, one catches it half way."""
    weed = {"time": 30.0, "factor": 0.8} | ({"degrees_of_freedom": ["surge"]} if ahead else {})
    runs = [
        dataclasses.replace(random_steps(DOCUMENT, k, SECONDS, STEP, one), name=f"run {k}")
        for k, one in ((30, {"drag-change": weed}), (31, {"drag-change": weed}), (32, {}))
    ]
    file = VesselFile(build(DOCUMENT), DOCUMENT, "usv.toml")
    found = diffsea.diagnose(file, runs[:1], runs[1:2], quick=True, reference=runs[2:])
    (effect,) = found.record["effects"]
    assert effect["name"] == "drag-change"
    assert ("degrees_of_freedom" in effect) == ahead
    for key, true in (("time", 30.0), ("factor", 0.8)):
        one = effect["parameters"][key]
        assert abs(one["value"] - true) < 3 * one["std"] < 1.2 * true
    assert any("a drag ahead that is" in line for line in found.notes()) == ahead
    (table,) = found.diagnosed.document["effect"]
    assert (table.get("degrees_of_freedom") == ["surge"]) == ahead
