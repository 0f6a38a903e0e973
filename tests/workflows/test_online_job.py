# pyright: reportArgumentType=false
"""`diffsea online` on runs of the independent simulator, whose derivatives are known."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from tests.oracle import sensors
from tests.oracle.make_recordings import MASSES, gust_scale, perform, perturbed, stream
from tests.oracle.simulator import load
from tests.paths import ORACLE

import diffsea
from diffsea.cli import main
from diffsea.trajectory import MOTION_CHANNELS


pytestmark = pytest.mark.slow


HULL = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")
SECONDS, RATE, SEED = 200.0, 5.0, 2
FAULT = (120.0, 160.0)  # s, in which the compass stands still


@pytest.fixture(scope="module")
def truth():
    """The hull of a boat unlike its file; masses, which set the scale, are those of the file."""
    document = load(str(ORACLE / "usv.toml"))
    true = perturbed(document, stream(SEED, "hull"))
    true["hull"] |= {name: document["hull"][name] for name in MASSES if name in document["hull"]}
    return true


@pytest.fixture(scope="module")
def recording(truth):
    sim = perform(truth, "random-fast", SEED, None, SECONDS, RATE)
    t = np.arange(int(SECONDS * RATE) + 1) / RATE
    seen = sensors.record(sim, t, sensors.suite(), stream(SEED, "noise"), wrapped=False)
    return diffsea.Trajectory(
        t,
        **{c: np.asarray(seen[c]) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(seen[f"cmd_{c}"]) for c in ("port", "starboard")},
        executed={},
        extra={},
        valid=np.ones(len(t), bool),
        name="service.csv",
    )


@pytest.fixture(scope="module")
def noise(truth, tmp_path_factory):
    """The simulator's own gusts and sensor noise, written as a fit writes them."""
    path, speeds, gust = (
        tmp_path_factory.mktemp("fit") / "fit.json",
        ("u", "v", "r"),
        gust_scale(truth),
    )
    scales = {"gust": 1e-3 * gust, "lasting_gust": gust, "gust_memory": [5.0, 5.0, 3.0]}
    record = {name: dict(zip(speeds, map(float, row), strict=True)) for name, row in scales.items()}
    suite = sensors.suite()
    record["sensor"] = {name: float(sensor.noise) for name, sensor in suite.items()}
    path.write_text(json.dumps({"noise": record}))
    return path


@pytest.fixture(scope="module")
def written(recording, noise, tmp_path_factory):
    """Content of online.json and the page of the command."""
    folder = tmp_path_factory.mktemp("online")
    diffsea.write_recording(recording, folder / "service.csv")
    words = ["online", str(ORACLE / "usv.toml"), str(folder / "service.csv"), "-o", str(folder)]
    assert main([*words, "--free", ",".join(HULL), "--noise", str(noise)]) == 0
    page = (folder / "online.html").read_text(encoding="utf-8")
    return json.loads((folder / "online.json").read_text()), page


def test_each_estimate_over_time_has_its_error_and_its_trust(written, recording):
    found, _ = written
    assert found["t"] == pytest.approx(recording.t) and set(found["estimates"]) == set(HULL)
    for estimate in found["estimates"].values():
        assert {len(estimate[key]) for key in ("value", "std", "trust", "passed")} == {
            len(found["t"])
        }
        assert estimate["std"][-1] < 0.7 * estimate["std"][0]
    assert 0 <= min(found["trust"]) and max(found["trust"]) <= 1


def test_estimates_end_at_the_truth_within_their_errors(written, truth):
    found, _ = written
    for name in HULL:
        estimate = found["estimates"][name]
        assert abs(estimate["value"][-1] - truth["hull"][name]) < 3.5 * estimate["std"][-1], name
    yaw = found["estimates"]["N_r"]
    before = abs(yaw["nominal"] - truth["hull"]["N_r"])
    assert found["open"][-1] and abs(yaw["passed"][-1] - truth["hull"]["N_r"]) < 0.5 * before


def test_what_is_passed_was_estimated_before(written):
    """Every number that the gate passed is the vessel file's or an estimate of 15 s ago or more."""
    found, _ = written
    t = np.array(found["t"])
    for estimate in found["estimates"].values():
        value, passed = np.array(estimate["value"]), np.array(estimate["passed"])
        steps = np.flatnonzero(np.diff(passed)) + 1
        assert steps.size > 3
        for row in steps:
            same = np.flatnonzero(np.isclose(value[: row + 1], passed[row], rtol=1e-6))
            assert same.size and t[row] - t[same[0]] >= 14.9


def test_the_page_says_what_the_file_says(written):
    found, page = written
    share = 100 * np.mean(found["open"])
    assert f"The gate was open for {share:.0f} % of the time and is open at the end." in page
    assert all(f"<div>{name}</div>" in page for name in HULL)
    assert page.count('class="plot"') == len(HULL) + 1


def test_a_compass_that_stands_still_closes_the_gate_and_nothing_is_passed(recording, noise):
    during = (recording.t >= FAULT[0]) & (recording.t < FAULT[1])
    psi = np.where(during, recording.psi[during.argmax()], recording.psi)
    frozen = dataclasses.replace(recording, psi=psi)
    found = diffsea.online(ORACLE / "usv.toml", frozen, free=HULL, noise=noise)
    closed = [span for span in found.closed if FAULT[0] <= span.start < FAULT[0] + 10]
    assert len(closed) == 1 and closed[0].end > FAULT[1]
    assert "innovation of heading" in closed[0].reasons[0]
    shut = (found.run.t >= closed[0].start) & (found.run.t < closed[0].end)
    assert all(np.ptp(found.run.handed[name][shut]) == 0 for name in HULL)
    assert str(closed[0]) in repr(found)


def test_least_squares_find_the_same_numbers(recording, truth):
    found = diffsea.online(
        ORACLE / "usv.toml", recording, free=HULL, estimator="least-squares"
    ).record(interval=10.0)
    assert len(found["t"]) == 21
    for name in HULL:
        estimate = found["estimates"][name]
        assert abs(estimate["value"][-1] - truth["hull"][name]) < 4 * estimate["std"][-1], name


def test_what_a_run_known_to_be_sound_shows_is_no_alarm(recording):
    """A compass whose errors last for a second, which the filter does not expect."""

    def swayed(seed):
        errors = np.random.default_rng(seed).normal(0.0, 0.015, len(recording.t))
        lasting = lfilter([1.0], [1.0, -0.8], errors)
        return dataclasses.replace(recording, psi=recording.psi + lasting, name=f"{seed}.csv")

    found = diffsea.online(ORACLE / "usv.toml", swayed(1), free=HULL, sound=[swayed(2), swayed(3)])
    plain = diffsea.online(ORACLE / "usv.toml", swayed(1), free=HULL)
    assert found.settings["calibrated_by"] == ["2.csv", "3.csv"]
    assert not plain.run.open.any() and found.run.open.mean() > 0.5 and found.run.open[-1]


def test_what_cannot_be_estimated_is_told(recording):
    usv = ORACLE / "usv.toml"
    cases: list[tuple[dict[str, Any], str]] = [
        ({"free": ["N_rrr"]}, "no parameter 'N_rrr'"),
        ({"estimator": "kalmann"}, "choose one of kalman, least-squares"),
        ({"noise": usv}, "has no noise as fit.json has it"),
        ({"noise": "nowhere.json"}, "cannot read nowhere.json"),
        ({"memory": 30.0}, "memory does not belong"),
        ({"estimator": "least-squares", "drift": 1e-3}, "drift does not belong"),
    ]
    for more, message in cases:
        with pytest.raises(diffsea.UserError, match=message):
            diffsea.online(usv, recording, **more)


def test_a_setting_of_the_other_estimator_is_bad_usage(tmp_path, capsys):
    words = ["online", "otter", "run.csv", "-o", str(tmp_path / "out")]
    assert main([*words, "--memory", "30"]) == 2
    assert main([*words, "--estimator", "least-squares", "--noise", "fit.json"]) == 2
    told = capsys.readouterr().err
    assert "--memory does not belong" in told and "--noise does not belong" in told
    assert not (tmp_path / "out").exists()
