"""The diagnosis names what the oracle concealed, and nothing where it hid nothing."""

import dataclasses

import numpy as np
import pytest
from tests.oracle import make_recordings
from tests.oracle.simulator import load

from diffsea.diagnosis import search
from diffsea.diagnosis.bootstrap import Bootstrap
from diffsea.diagnosis.decision import Accepted
from diffsea.diagnosis.experiment import commands, next_experiment
from diffsea.diagnosis.record import summary, vessel_document
from diffsea.diagnosis.score import Projection
from diffsea.diagnosis.screening import mimicry
from diffsea.diagnosis.search import _verdict, diagnose
from diffsea.identification.holdout import held_out_coordinates
from diffsea.recordings import read_recording
from diffsea.vessel.effects import catalogue_name
from diffsea.vessel.files import build


RUNS = ("random-fast", "zigzag-slow", "random-slow")


@pytest.fixture(scope="module")
def document(request) -> dict:
    return load(str(request.path.parent / "oracle" / "usv.toml"))


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
    keys = ("name", "variant", "channels", "actuators")
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


def test_the_manoeuvre_that_separates_rivals_stays_within_the_vessels_limits(current):
    (accepted,) = current.effects
    wind = next(one for one in accepted.tried if one.effect != "current")
    rivals = (catalogue_name(wind.effect),)
    doubtful = dataclasses.replace(
        current, effects=(dataclasses.replace(accepted, rivals=rivals),), verdict="ambiguous"
    )
    assert next_experiment(current) is None
    experiment = next_experiment(doubtful)
    assert experiment.evidence[experiment.manoeuvre] == max(experiment.evidence.values()) > 0
    assert rivals[0] in experiment.why
    sequence = commands(doubtful, experiment)
    assert sequence["t"][-1] == pytest.approx(experiment.seconds)
    for channel, servo in build_vessel(current).servos.items():
        series = sequence[f"cmd_{channel}"]
        assert np.all((series >= float(servo.lower)) & (series <= float(servo.upper)))


def build_vessel(diagnosis):
    return diagnosis.split.train.base


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


def test_a_current_of_one_run_is_not_taken_for_one_of_all(document, tmp_path):
    hidden = {"current": {"speed": 0.3, "direction": 2.0}}
    runs = []
    for name, effects in (("random-fast", hidden), ("zigzag-slow", {}), ("random-slow", {})):
        make_recordings.produce(tmp_path, document, 5, effects, seconds=50.0, runs=(name,))
        runs.append(read_recording(tmp_path / f"{name}.csv"))
    found = diagnose(build(document), runs[:2], runs[2:])
    assert found.verdict == "unexplained"
    assert "current" not in found.names


def test_what_simulated_data_show_as_often_is_not_named(document, tmp_path, monkeypatch):
    common = Bootstrap(np.linspace(0.0, 1e-30, 200), np.linspace(0.0, 1e-30, 200))
    monkeypatch.setattr(search, "bootstrap", lambda *_: common)
    hidden = {"current": {"speed": 0.3, "direction": 2.0}}
    make_recordings.produce(tmp_path, document, 5, hidden, seconds=50.0, runs=RUNS[:2])
    runs = [read_recording(tmp_path / f"{name}.csv") for name in RUNS[:2]]
    found = diagnose(build(document), runs[:1], runs[1:], draws=200)
    record = summary(found, [])
    assert (record["verdict"], record["effects"]) == ("consistent", [])
    assert record["null"]["p_value"] < 1e-6
    assert record["null"]["bootstrap"] == {"draws": 200, "p_value": 1.0}
    assert record["remainder_p_value"] == 1.0


def test_nothing_is_found_where_nothing_is_hidden(document, tmp_path_factory):
    found = _diagnosed(document, tmp_path_factory.mktemp("clean"), {})
    assert found.verdict == "consistent"
    assert found.names == ()


@pytest.mark.parametrize(
    ("rivals", "left", "verdict"),
    [
        (None, 0.4, "consistent"),
        (None, 1e-5, "unexplained"),
        ((), 0.4, "explained"),
        (("wind",), 0.4, "ambiguous"),
        (("wind",), 1e-5, "unexplained"),  # a name for a part, and a remainder without one
    ],
)
def test_a_verdict_depends_on_names_rivals_and_what_is_left(rivals, left, verdict):
    accepted = () if rivals is None else (Accepted("current", None, rivals),)
    assert _verdict(accepted, left) == verdict


def test_score_has_its_size_under_white_noise_and_sees_a_shift():
    rng = np.random.default_rng(2)
    rows = 400
    columns = rng.normal(size=(6 * rows, 1))
    nuisance = rng.normal(size=(6 * rows, 3))
    run = np.zeros(rows, int)
    values = []
    for _ in range(400):
        projection = Projection(rng.normal(size=6 * rows), nuisance, run)
        values.append(projection.score(projection.efficient(columns)).p_value)
    assert np.mean(np.array(values) < 0.05) == pytest.approx(0.05, abs=0.035)
    shifted = Projection(rng.normal(size=6 * rows) - 0.3 * columns[:, 0], nuisance, run)
    score = shifted.score(shifted.efficient(columns))
    assert score.p_value < 1e-6
    assert score.step[0] == pytest.approx(0.3, abs=0.1)


def test_copies_for_runs_that_a_tape_has_to_spare_are_no_degrees_of_freedom():
    rng = np.random.default_rng(5)
    rows, copies = 100, 4  # of which one belongs to a recording
    columns = np.zeros((6 * rows + copies + 2, copies))
    columns[: 6 * rows, 0] = rng.normal(size=6 * rows)
    columns[6 * rows + 2 :] = np.eye(copies) / 3
    nuisance = np.zeros((len(columns), 2))
    nuisance[: 6 * rows] = rng.normal(size=(6 * rows, 2))
    nuisance[6 * rows : 6 * rows + 2] = np.eye(2)
    residual = np.zeros(len(columns))
    residual[: 6 * rows] = rng.normal(size=6 * rows) - 0.2 * columns[: 6 * rows, 0]
    projection = Projection(residual, nuisance, np.zeros(rows, int))
    E = projection.efficient(columns)
    alone, all_of_them = projection.score(E[:, :1]), projection.score(E)
    assert all_of_them.p_value == pytest.approx(alone.p_value, rel=1e-9)
    assert all_of_them.step == pytest.approx([alone.step[0], 0, 0, 0])
    assert projection.score(E[:, 1:]).p_value == 1.0


def test_what_a_nuisance_can_do_is_not_counted():
    rng = np.random.default_rng(4)
    nuisance = rng.normal(size=(600, 2))
    run = np.zeros(100, int)
    projection = Projection(nuisance @ [5.0, -3.0] + rng.normal(size=600), nuisance, run)
    near = projection.efficient(nuisance[:, :1] + 1e-3 * rng.normal(size=(600, 1)))
    assert mimicry(near, projection.efficient(rng.normal(size=(600, 2)))) < 0.5
    assert projection.score(projection.efficient(rng.normal(size=(600, 1)))).p_value > 1e-3
