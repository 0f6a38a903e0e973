"""Designs for wanted numbers: those of a known design lead back to it."""

import tomllib

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT

from diffsea import UserError, inverse_design
from diffsea.simulation import planning
from diffsea.studies.inverse import APART, MET, designs_for, found_sentence, nearest_starts
from diffsea.vessel.files import build


pytestmark = [pytest.mark.slow, pytest.mark.compiles]

RANGES = {"mass": (120.0, 260.0), "N_r": (-500.0, -150.0)}
ORDERED = {"speed": 1.2, "executes": 2, "step": 0.1}
HIDDEN = {"mass": 171.0, "N_r": -233.0}


def trial_of(**hull):
    document = tomllib.loads(BOAT)
    document["hull"] |= hull
    vessel = build(document)
    plan = planning.plan_trial(vessel, "zigzag", **ORDERED)
    return vessel, plan, planning.run_and_measure(vessel, plan)[1]


@pytest.fixture(scope="module")
def numbers():
    """Two numbers of a design that no sweep has run."""
    found = trial_of(**HIDDEN)[2]
    return {name: float(found[name]) for name in ("overshoot_1", "reach_time")}


@pytest.fixture(scope="module")
def answer(numbers):
    return inverse_design(build(tomllib.loads(BOAT)), "zigzag", RANGES, numbers, 64, **ORDERED)


def test_as_many_numbers_as_parameters_lead_back_to_the_design(answer, numbers):
    best = answer.found[0]
    assert best.off <= MET
    for name, value in HIDDEN.items():
        low, high = RANGES[name]
        assert best.parameters[name] == pytest.approx(value, abs=2e-3 * (high - low))
    assert (answer.swept[list(RANGES)] - pd.Series(HIDDEN)).abs().max(axis=1).min() > 0.5
    assert answer.headline().startswith("1 design has overshoot_1 = ")


def test_one_number_is_met_by_several_designs_each_by_its_own_trial(numbers, answer):
    vessel, plan, _ = trial_of()
    wanted = {"overshoot_1": numbers["overshoot_1"]}
    found = designs_for(vessel, plan, RANGES, wanted, answer.swept)
    assert len(found) > 1
    for one in found:
        own = trial_of(**one.parameters)[2]
        assert float(own["overshoot_1"]) == pytest.approx(wanted["overshoot_1"], rel=MET)
        assert all(low < one.parameters[n] < high for n, (low, high) in RANGES.items())


@pytest.mark.proof
def test_what_no_design_has_is_approached_and_told(numbers, answer):
    vessel, plan, _ = trial_of()
    wanted = {"overshoot_1": 5 * float(answer.swept["overshoot_1"].max())}
    found = designs_for(vessel, plan, RANGES, wanted, answer.swept)
    assert found[0].off > 0.5
    nearest = (answer.swept["overshoot_1"] - wanted["overshoot_1"]).abs().min()
    assert found[0].off * wanted["overshoot_1"] <= nearest + 1e-9
    assert found_sentence(wanted, [found[0].off]).startswith("no design in these ranges has")


def test_starts_are_the_nearest_ones_that_are_apart():
    swept = pd.DataFrame({"mass": np.linspace(120, 260, 141), "N_r": -300.0})
    swept["overshoot_1"] = np.abs(swept["mass"] - 150.0) / 100
    starts = nearest_starts(swept, RANGES, {"overshoot_1": 0.1})
    assert starts[0]["mass"] in (140.0, 160.0)
    masses = [one["mass"] for one in starts]
    gaps = np.abs(np.subtract.outer(masses, masses))[np.triu_indices(len(masses), 1)]
    assert np.all(gaps >= APART * 140 - 1e-9)


def test_what_cannot_be_wanted_is_refused(answer):
    vessel, plan, _ = trial_of()
    with pytest.raises(UserError, match="no number 'overshot_1'; did you mean 'overshoot_1'"):
        designs_for(vessel, plan, RANGES, {"overshot_1": 0.1}, answer.swept)
    with pytest.raises(UserError, match="give the lower number first"):
        designs_for(vessel, plan, {"mass": (2.0, 1.0)}, {"overshoot_1": 0.1}, answer.swept)
    empty = answer.swept.assign(overshoot_1=np.nan)
    with pytest.raises(UserError, match="no design of the sweep has all of overshoot_1"):
        designs_for(vessel, plan, RANGES, {"overshoot_1": 0.1}, empty)
