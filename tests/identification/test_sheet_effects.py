# pyright: reportArgumentType=false
"""Effects from a sheet of trial numbers: the asymmetry of an independent simulation, its odds."""

import dataclasses
import math

import numpy as np
import pytest
from tests.oracle import trials
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import EFFECTS, UserError, Vessel
from diffsea.budget import time_budget
from diffsea.identification.objectives.trial_numbers import MeasuredTrial, TrialNumbers
from diffsea.identification.study import FitSettings, Study, identify
from diffsea.simulation import planning
from diffsea.vessel.files import build, default_priors


pytestmark = pytest.mark.slow


RATIO, THRUST = 0.07, 200.0
STDS = {"advance": 0.1, "tactical_diameter": 0.15, "peak_yaw_rate": 0.002}
SETTINGS = FitSettings("trial-numbers", ("Y_v", "N_r"), effects=("thrust-asymmetry",), profiles=())


@pytest.fixture(scope="module")
def vessel() -> Vessel:
    """A file that is wrong, and knows of no asymmetry."""
    document = load(str(ORACLE / "usv.toml"))
    hull = document["hull"] | {"Y_v": 1.3 * document["hull"]["Y_v"]}
    return build(document | {"hull": hull | {"N_r": 0.8 * hull["N_r"]}})


def sheet(vessel: Vessel, ratio: float) -> list[MeasuredTrial]:
    """Circles to both sides as the independent simulator has them, read off with errors."""
    document = load(str(ORACLE / "usv.toml"))
    document |= {"effect": [{"name": "thrust-asymmetry", "ratio": ratio}]} if ratio else {}
    rng, found = np.random.default_rng(4), []
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        numbers = trials.circle(document, THRUST, side=side, turns=1.0).metrics
        plan = planning.plan_trial(
            vessel, "turning-circle", math.radians(35), side=sign, thrust=THRUST, keep_speed=False
        )
        values = np.array([numbers[name] for name in STDS])
        stds = np.array(list(STDS.values()))
        found.append(MeasuredTrial(plan, tuple(STDS), values + stds * rng.normal(size=3), stds))
    return found


@pytest.fixture(scope="module")
def uneven(vessel) -> Study:
    return identify(vessel, sheet(vessel, RATIO), SETTINGS)


def test_an_asymmetry_is_sized_and_its_odds_speak_for_it(uneven):
    (found,) = uneven.effects["thrust-asymmetry"]
    assert abs(found["ratio"]["value"] - RATIO) < 3 * found["ratio"]["std"] < 0.5 * RATIO
    assert uneven.log10_odds["thrust-asymmetry"] > 2
    assert uneven.effect_tables[0]["ratio"] == pytest.approx(found["ratio"]["value"])


def test_the_odds_of_an_even_vessel_speak_against_one(vessel):
    even = identify(vessel, sheet(vessel, 0.0), SETTINGS)
    (found,) = even.effects["thrust-asymmetry"]
    assert abs(found["ratio"]["value"]) < 3 * found["ratio"]["std"]
    assert even.log10_odds["thrust-asymmetry"] < 0


@pytest.mark.proof
def test_the_evidence_is_that_of_the_whole_posterior(vessel):
    """The marginal likelihoods, which Laplace's formula is for, summed up on a grid."""
    priors = default_priors(vessel)
    blurred = [
        dataclasses.replace(one, stds=2 * one.stds) for one in sheet(vessel, RATIO)
    ]  # so that the odds are moderate, and the prior has a say
    effect = EFFECTS["thrust-asymmetry"]
    objective = TrialNumbers(vessel, [priors["N_r"]], blurred, [effect])
    fitted = objective.fit(("N_r", "thrust-asymmetry"))
    without = objective.fit(("N_r",))

    def axis(at, std):
        return np.linspace(at - 6 * std, at + 6 * std, 25)

    own = axis(fitted.coordinates[0], fitted.stds[0])
    sizes = axis(fitted.coordinates[1], fitted.stds[1])
    costs = [[objective.cost(np.array([a, b])) for b in sizes] for a in own]
    log_with = np.log(np.trapezoid(np.trapezoid(_weights(costs, fitted), sizes), own))
    alone = axis(without.coordinates[0], without.stds[0])
    costs = [objective.cost(np.array([a, 0.0])) for a in alone]
    log_without = np.log(np.trapezoid(_weights(costs, without), alone))
    spread = objective.spreads[1]
    exact = 2 * (log_with - log_without) - (fitted.deviance - without.deviance)
    exact -= 2 * np.log(math.sqrt(2 * math.pi) * spread)  # of the prior of the effect
    assert objective.evidence(fitted, without, effect) == pytest.approx(exact, abs=0.3)


def _weights(costs, fitted) -> np.ndarray:
    return np.exp(-0.5 * (np.array(costs) - fitted.deviance))


def test_odds_that_there_is_no_time_for_are_not_stated(uneven):
    with time_budget(-1.0) as left:
        assert uneven.objective.log10_odds(uneven.estimate) == {}
    assert "the odds of thrust-asymmetry" in left.left_out


def test_what_belongs_to_recordings_is_refused(vessel):
    wind = dataclasses.replace(SETTINGS, effects=("wind",))
    with pytest.raises(UserError, match="wind belongs to recordings"):
        identify(vessel, sheet(vessel, 0.0), wind)
