"""A wind that was measured, on vessels whose file says what it acts on, against the oracle."""

import numpy as np
import pandas as pd
import pytest
from tests.oracle.blown import blown_run, gusty
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import varied

from diffsea import State, read_recording
from diffsea.exports.equations import equations_of
from diffsea.simulation.replay import replay, replay_errors
from diffsea.types import Environment, MeasuredDisturbance
from diffsea.vessel.files import build


USV = load(ORACLE / "usv.toml")
SUPERSTRUCTURE = {"C_X": 0.5, "C_Y": 1.1, "C_N": -0.06, "lateral_area": 1.4, "C_NY": 0.1}
ORDERS = [(0.0, {"port": 90.0, "starboard": 60.0}), (12.0, {"port": 30.0, "starboard": 110.0})]
STEP = 0.5
STILL = {"name": "wind", "speed": 0.0, "direction": 0.0}


@pytest.fixture(scope="module")
def recording():
    wind = gusty(np.random.default_rng(3), 61, (-5.0, 4.0), 3.0, rows_kept=8)
    state = (0.0, 0.0, 0.4, 1.0, 0.0, 0.0)
    return pd.DataFrame(blown_run(USV, SUPERSTRUCTURE, ORDERS, wind, STEP, state))


def vessel(*effects):
    return build(varied(USV, effects=effects))


def errors(model, table):
    run = read_recording(table)
    predicted = replay(model, run)
    return replay_errors(predicted, run), predicted.provenance


@pytest.mark.parametrize("said", [{"name": "wind"}, STILL])
def test_a_replay_moves_in_the_wind_that_was_measured(recording, said):
    missed, notes = errors(vessel(said | SUPERSTRUCTURE), recording)
    assert missed["position"] < 2e-4 and missed["heading"] < 2e-5 and missed["v"] < 1e-4
    assert "in the wind as measured" in notes
    missed, notes = errors(vessel(), recording)
    assert missed["position"] > 1.0
    assert any(note.startswith("not in the wind that was measured") for note in notes)


def test_without_a_measured_wind_the_air_is_still_and_the_replay_says_so(recording):
    for lacking in (["wind_speed"], ["wind_direction"], ["wind_speed", "wind_direction"]):
        table = recording.drop(columns=lacking)
        missed, notes = errors(vessel(STILL | SUPERSTRUCTURE), table)
        assert missed == errors(vessel(), table)[0]
        assert "in still air: no wind was measured" in notes


def test_gaps_of_an_anemometer_are_bridged_by_components(recording):
    """Straight between directions of 350 and 10 deg lies no wind from 180 deg."""
    sparse = recording.copy()
    sparse["wind_speed"] = 6.0
    sparse["wind_direction"] = np.where(np.arange(len(sparse)) % 2, np.radians(350), np.radians(10))
    every_fourth = np.arange(len(sparse)) % 4 != 0
    sparse.loc[every_fourth, ["wind_speed", "wind_direction"]] = np.nan
    held = recording.assign(wind_speed=6.0, wind_direction=np.radians(10))
    model = vessel(STILL | SUPERSTRUCTURE)
    assert errors(model, sparse)[0] == pytest.approx(errors(model, held)[0], rel=1e-9)


def test_a_wind_with_a_speed_is_believed_and_adds_to_one_that_is_measured():
    stated = {"name": "wind", "speed": 3.0, "direction": 1.0}
    model = vessel(stated | SUPERSTRUCTURE)
    blown = MeasuredDisturbance(wind_north=4.0, wind_east=-2.0)
    state, t = State(0.0, 0.0, 0.3, 1.0, 0.2, 0.0), np.zeros(())
    force = lambda one, around: sum((f(state, around, t).stacked for f in one.forces.values()), 0.0)
    calm = dict.fromkeys(("port", "starboard"), 0.0)

    def rate(one, around):
        return np.array(one.acceleration(state, calm, around, t), float)

    around = Environment(disturbance=blown)
    np.testing.assert_array_equal(rate(model, around), rate(model, Environment()))
    both = vessel(STILL | SUPERSTRUCTURE, stated)
    steady = both.environment
    np.testing.assert_allclose(
        rate(both, Environment(wind_north=steady.wind_north, wind_east=steady.wind_east,
                               disturbance=blown)),
        rate(model, Environment(wind_north=steady.wind_north + 4.0,
                                wind_east=steady.wind_east - 2.0)),
        rtol=1e-12,
    )  # fmt: skip
    assert np.all(np.isfinite(force(both, around)))


def test_a_superstructure_in_still_air_is_no_loss_to_an_export():
    assert equations_of(vessel(STILL | SUPERSTRUCTURE)).left_out == ()
