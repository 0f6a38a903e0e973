"""The diagnosis names what the oracle concealed, and nothing where it hid nothing."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT
from tests.oracle import make_recordings

from diffsea import read_recording
from diffsea.diagnosis.experiment import commands, next_experiment
from diffsea.diagnosis.record import summary, vessel_document
from diffsea.diagnosis.verdict import diagnose
from diffsea.identification.holdout import held_out_coordinates
from diffsea.vessel.effects import catalogue_name
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


RUNS = ("random-fast", "zigzag-slow", "random-slow")


@pytest.fixture(scope="module")
def document() -> dict:
    return DOCUMENT


def _diagnosed(document, folder, effects: dict):
    make_recordings.produce(folder, document, 5, effects, seconds=50.0, runs=RUNS)
    runs = {path.stem: read_recording(path) for path in sorted(folder.glob("*.csv"))}
    test = [runs.pop("random-slow")]
    return diagnose(build(document), list(runs.values()), test)


@pytest.fixture(scope="module")
def current(document, tmp_path_factory):
    hidden = {"current": {"speed": 0.3, "direction": 2.0}}
    return _diagnosed(document, tmp_path_factory.mktemp("current"), hidden)


def test_a_concealed_current_is_named_and_sized(current):
    record = summary(current, [])
    assert record["verdict"] == "explained"
    assert [effect["name"] for effect in record["effects"]] == ["current"]
    parameters = record["effects"][0]["parameters"]
    assert parameters["speed"]["value"] == pytest.approx(0.3, rel=0.1)
    assert parameters["direction"]["value"] == pytest.approx(2.0, abs=0.15)


# What programs that know nothing of the code read: keys, and the keys or types within.
NUMBER, TEXT, LIST = (int, float, type(None)), str, list
WHERE = {
    "degree_of_freedom": TEXT, "recording": TEXT, "start": NUMBER, "end": NUMBER, "regime": TEXT,
    "force_rms": NUMBER, "unit": TEXT, "p_value": NUMBER,
}  # fmt: skip
EFFECT = {
    "name": TEXT,
    "parameters": {"speed": {"value": NUMBER, "std": NUMBER, "unit": TEXT}},
    "evidence": {"score": NUMBER, "p_value": NUMBER, "cost_drop": NUMBER},
    "alternatives": LIST,
}
MISFIT = {"train": NUMBER, "test": NUMBER}
CONTRACT = {
    "format": int, "verdict": TEXT, "audit": LIST, "where": [WHERE], "effects": [EFFECT],
    "fit": {"nominal": MISFIT, "diagnosed": MISFIT},
    "next_experiment": {"manoeuvre": TEXT, "why": TEXT},
}  # fmt: skip


def lacking(contract, record, place="diagnosis.json"):
    """Where a record does not keep a contract."""
    if isinstance(contract, dict):
        keys = [f"{place}.{key}" for key in contract if key not in record]
        within = [
            (contract[key], record[key], f"{place}.{key}") for key in contract if key in record
        ]
        return keys + [fault for one in within for fault in lacking(*one)]
    if isinstance(contract, list):
        assert record, f"{place} is empty, so nothing of it is checked"
        return [fault for one in record for fault in lacking(contract[0], one, f"{place}[]")]
    return [] if isinstance(record, contract) else [f"{place} is {type(record).__name__}"]


def test_the_record_keeps_the_contract_of_its_file(current):
    proposal = {"manoeuvre": "zigzag", "why": "separates one from another"}
    horizons = [{"seconds": 5.0, "starts": 3, "nominal": {}, "diagnosed": {}}]
    record = summary(current, [], horizons, proposal, {"vessel": "usv"})
    assert lacking(CONTRACT, record) == []
    assert record["format"] == 1 and record["source"] == {"vessel": "usv"}
    assert record["held_out"]["horizons"] == horizons
    assert record["held_out"]["kind"] == "recordings"
    broken = record | {"verdict": 3, "effects": [{**record["effects"][0], "name": None}]}
    del broken["where"]
    faults = ["where", "verdict is int", "effects[].name is NoneType"]
    assert lacking(CONTRACT, broken) == [f"diagnosis.json.{fault}" for fault in faults]


def test_candidates_of_one_name_are_told_apart(current):
    rows = summary(current, [])["candidates"]
    keys = ("name", "variant", "channels", "actuators", "degrees_of_freedom")
    kinds = [str([row.get(key) for key in keys]) for row in rows]
    assert len(kinds) == len(set(kinds)) > len({row["name"] for row in rows})


def test_the_named_effect_improves_held_out_runs(current):
    fit = summary(current, [])["fit"]
    assert fit["diagnosed"]["test"] < 0.8 * fit["nominal"]["test"]
    assert fit["diagnosed"]["train"] == pytest.approx(1.0, abs=0.15)


def test_the_vessel_file_holds_the_effect(current, document):
    vessel = build(vessel_document(document, current))
    flow = np.hypot(float(vessel.environment.current_north), float(vessel.environment.current_east))
    assert flow == pytest.approx(0.3, rel=0.1)


@pytest.mark.proof
def test_the_manoeuvre_that_separates_rivals_stays_within_the_vessels_limits(current):
    (accepted,) = current.effects
    best = accepted.hypothesis
    wind = next(one for one in accepted.short_list.hypotheses if one.effect != "current")
    near = dataclasses.replace(
        best, effect=wind.effect, estimate=wind.estimate, candidate=wind.candidate
    )
    listed = dataclasses.replace(accepted.short_list, hypotheses=(best, near))
    rivals = (catalogue_name(wind.effect),)
    doubtful = dataclasses.replace(
        current, effects=(dataclasses.replace(accepted, short_list=listed),), verdict="ambiguous"
    )
    assert doubtful.effects[0].rivals == rivals
    assert next_experiment(current) is None
    experiment = next_experiment(doubtful)
    assert experiment is not None
    assert experiment.evidence[experiment.manoeuvre] == max(experiment.evidence.values()) > 0
    assert rivals[0] in experiment.why
    sequence = commands(current.split.train, current.final, experiment)
    assert sequence["t"][-1] == pytest.approx(experiment.seconds)
    for channel, servo in current.split.train.base.servos.items():
        series = sequence[f"cmd_{channel}"]
        assert np.all((series >= float(servo.lower)) & (series <= float(servo.upper)))


@pytest.mark.proof
def test_each_recording_can_have_a_current_of_its_own(document, tmp_path):
    directions = {"random-fast": 2.0, "zigzag-slow": 4.5, "random-slow": 0.5}
    runs = []
    for name, direction in directions.items():
        hidden = {"current": {"speed": 0.3, "direction": direction}}
        make_recordings.produce(tmp_path, document, 5, hidden, seconds=60.0, runs=(name,))
        runs.append(read_recording(tmp_path / f"{name}.csv"))
    found = diagnose(build(document), runs[:2], runs[2:], per_run=True)
    record = summary(found, [])
    assert record["verdict"] == "explained"
    named = {effect["recording"]: effect["parameters"] for effect in record["effects"]}
    assert set(named) == {"random-fast.csv", "zigzag-slow.csv"}
    for name, parameters in named.items():
        truth = directions[name.removesuffix(".csv")]
        assert parameters["speed"]["value"] == pytest.approx(0.3, rel=0.1)
        assert parameters["direction"]["value"] == pytest.approx(truth, abs=0.15)
    # The held-out run's own current is read off its head; what is judged is the rest.
    coordinates = held_out_coordinates(found.split, found.final)
    north, east = found.split.test.layout.physical("current", coordinates)[0]
    assert (north, east) == pytest.approx((0.3 * np.cos(0.5), 0.3 * np.sin(0.5)), abs=0.06)
    assert found.split.held_out[0].t[0] > 23.0
    assert "first part" in record["held_out"]["how"]


@pytest.mark.proof
def test_a_current_of_one_run_is_not_taken_for_one_of_all(document, tmp_path):
    hidden = {"current": {"speed": 0.3, "direction": 2.0}}
    runs = []
    for name, effects in (("random-fast", hidden), ("zigzag-slow", {}), ("random-slow", {})):
        make_recordings.produce(tmp_path, document, 5, effects, seconds=50.0, runs=(name,))
        runs.append(read_recording(tmp_path / f"{name}.csv"))
    found = diagnose(build(document), runs[:2], runs[2:])
    assert found.verdict == "unexplained"
    assert "current" not in found.names


def test_nothing_is_found_where_nothing_is_hidden(document, tmp_path_factory):
    found = _diagnosed(document, tmp_path_factory.mktemp("clean"), {})
    assert found.verdict == "consistent"
    assert found.names == ()
