"""Batteries: what is drawn, that each run is the mission with it, and how misfortunes count."""

import dataclasses
import math

import pytest
from tests.paths import ROOT

from diffsea import UserError
from diffsea.missions import (
    Battery,
    BatteryRun,
    battery_scores,
    mission_of,
    read_battery,
    run,
    run_battery,
    scores,
)
from diffsea.missions.studies.battery import battery_of


OTTER = {
    "vessel": {"name": "otter"},
    "controller": {"kind": "line-of-sight", "speed": 1.0, "radius": 3.0},
    "waypoint": [{"x": 0.0, "y": 0.0}, {"x": 20.0, "y": 0.0}],
    "sensors": {"heading": 0.01},
}
ASKED = {"runs": 3, "seed": 4, "vessel": {"mass": [70.0, 90.0]},
         "weather": {"current_speed": [0.1, 0.2], "current_direction": [1.0, 2.0]}}  # fmt: skip


@pytest.fixture(scope="module")
def mission():
    return mission_of(OTTER)


@pytest.fixture(scope="module")
def found(mission):
    return run_battery(mission, battery_of(ASKED))


def test_each_run_is_the_mission_with_what_was_drawn_for_it(found):
    assert [row["seed"] for row in found.table] == [4, 5, 6]
    for row in found.table:
        assert 70 <= row["mass"] <= 90 and 0.1 <= row["current_speed"] <= 0.2
        flow = {"speed": row["current_speed"], "direction": row["current_direction"]}
        vessel = {"name": "otter", "parameters": {"mass": row["mass"]}}
        alone = OTTER | {
            "vessel": vessel, "model": {"name": "otter"}, "weather": {"current": flow},
            "seed": row["seed"],
        }  # fmt: skip
        told = scores(run(mission_of(alone)))
        assert row["path_rms"] == pytest.approx(told["path_error"]["rms"], rel=1e-6)
        assert row["time"] == told["time"] and row["outcome"] == told["outcome"] == "completed"
    assert len({row["mass"] for row in found.table}) == 3


def test_the_same_battery_draws_the_same(mission, found):
    again = run_battery(mission, battery_of(ASKED))
    assert again.table == found.table


def test_shares_have_wilsons_intervals(mission):
    good = {"outcome": "completed", "time": 1.0, "missed": 0, "limit_events": 0,
            "wrong_way_events": 0}  # fmt: skip
    table = [dict(good) for _ in range(20)]
    for row in table[:3]:
        row["missed"] = 2
    table[0] |= {"wrong_way_events": 1, "limit_events": 7}
    table[5] = {"outcome": "failed", "why": "the run diverged"}
    table[6]["outcome"] = "time-limit"
    shares = battery_scores(BatteryRun(mission, (), tuple(table)))["shares"]
    hits = {"not_finished": 2, "waypoint_missed": 3, "at_limit": 1, "wrong_way": 1}
    assert {name: one["runs"] for name, one in shares.items()} == hits
    z, n = 1.959963984540054, 20
    for name, k in hits.items():
        p = k / n
        middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        assert shares[name]["interval"] == pytest.approx([middle - half, middle + half])


def test_a_run_that_diverges_is_a_row_that_says_so(mission):
    steps = {"vessel": {"name": "otter"}, "seconds": 60.0, "controller": {"kind": "orders"},
             "step": [{"time": 0.0, "orders": {"port": 9.0, "starboard": 9.0}}]}  # fmt: skip
    asked = Battery(2, {"X_u": (900.0, 901.0)}, {})
    told = battery_scores(run_battery(mission_of(steps), asked))
    assert told["shares"]["not_finished"]["runs"] == 2
    assert all("the run diverged" in row["why"] for row in told["table"])
    assert set(told["shares"]) == {"not_finished", "at_limit"} and told["numbers"] == {}


def test_the_battery_that_ships_is_read_and_fits_its_mission():
    asked = read_battery(ROOT / "examples" / "missions" / "batteries" / "tides_and_loads.toml")
    short = dataclasses.replace(asked, runs=1)
    assert run_battery(mission_of(OTTER), short).table[0]["outcome"] == "completed"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"runs": 0}, "runs = 0 is not a whole number from 1"),
        ({"runs": None}, "runs = None is not a whole number"),
        ({"vessels": {}}, "unknown key 'vessels' in the file; did you mean 'vessel'"),
        ({"vessel": {"mass": [90.0, 70.0]}}, "turn them round"),
        ({"vessel": {"mass": 90.0}}, "is not [from, to]"),
        ({"weather": {"curent_speed": [0.0, 1.0]}}, "did you mean 'current_speed'"),
        ({"weather": {"gusts": [-1.0, 1.0]}}, "gusts is from -1: it cannot be negative"),
        ({"vessel": 3}, "write [vessel] as a table"),
    ],
)
def test_a_battery_that_is_none_is_refused(change, message):
    with pytest.raises(UserError) as told:
        battery_of(ASKED | change)
    assert message in str(told.value)


def test_a_number_that_the_vessel_does_not_have_is_refused(mission):
    with pytest.raises(UserError, match="no parameter 'mas'; did you mean 'mass'"):
        run_battery(mission, Battery(1, {"mas": (1.0, 2.0)}, {}))
    with pytest.raises(UserError, match="mass = -1 must be positive"):
        run_battery(mission, Battery(1, {"mass": (-1.0, -1.0)}, {}))
