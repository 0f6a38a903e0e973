"""The virtual sea trials: the quick run, and the pieces against closed forms and scipy."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.experiment_runs import modules, quick_run
from tests.paths import ROOT

from diffsea import Trajectory, read_vessel


pytestmark = pytest.mark.experiment


FOLDER = ROOT / "experiments" / "virtual_sea_trials"
MODULES = ("published", "vessel", "trials", "diameter", "asymmetry", "fit")


@pytest.fixture(scope="module")
def parts():
    """The experiment's modules."""
    found = modules("virtual_sea_trials", *(f"marus_{name}" for name in MODULES))
    return {name: found[f"marus_{name}"] for name in MODULES}


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """results.json of the quick variant, and its folder."""
    out = tmp_path_factory.mktemp("virtual_sea_trials")
    return quick_run("virtual_sea_trials", out) | {"folder": out}


# -- the quick run ---------------------------------------------------------------------------


@pytest.mark.proof
def test_every_cell_of_the_tables_stands_beside_what_was_obtained(results, parts):
    rows = {row["quantity"]: row for row in results["comparison"]}
    for run in parts["published"].RUNS:
        for number, value in run.numbers.items():
            row = rows[f"{run.title}: {number.replace('_', ' ')}"]
            assert row["published"] == value and row["obtained"] is not None
    assert len(rows) == len(results["comparison"])
    assert rows["circle to port: IMO MSC.137(76)"]["obtained"] == "pass"


def test_the_rating_gives_the_published_speed_at_85_per_cent(results):
    """Steady speed of a drag of first and second power, by its quadratic's root."""
    rows = {row["quantity"]: row for row in results["comparison"]}
    rating = rows["largest continuous thrust, both thrusters"]
    hull = read_vessel("marus_usv").document["hull"]
    speed = np.roots([-hull["X_uu"], -hull["X_u"], -0.85 * rating["obtained"]]).max()
    assert speed == pytest.approx(0.9235, abs=1e-6)
    assert rating["published"] is None and rating["note"].startswith("assumed: ")
    start = rows["start of the trials"]
    assert start["obtained"] == pytest.approx(121, abs=0.5) and start["note"].startswith("set: ")


def test_trials_repeat_and_are_reversed_as_often_port_first_as_starboard_first(results):
    campaign = results["campaign"]
    assert results["repeated"] == 0.0
    for actuators in ("at once", "real"):
        counted = {name: run["reversals"] for name, run in campaign[actuators].items()}
        assert counted == {name: 2 if name.startswith("zigzag") else 0 for name in counted}


def test_the_shipped_vessel_turns_as_published(results):
    """The vessel is even: the mean of both sides is what it can meet."""
    rows = {row["quantity"]: row for row in results["comparison"]}
    for number in ("advance", "transfer", "tactical diameter", "steady turning diameter"):
        both = [rows[f"circle to {side}: {number}"] for side in ("port", "starboard")]
        published = np.mean([row["published"] for row in both])
        assert np.mean([row["obtained"] for row in both]) == pytest.approx(published, rel=0.03)
    for angle, rate in ((10, 4.05), (20, 5.78)):
        row = rows[f"zig-zag {angle}/{angle}, port first: peak yaw rate"]
        assert row["obtained"] == pytest.approx(rate, rel=0.06)
        for ordinal in (1, 2):
            row = rows[f"zig-zag {angle}/{angle}, port first: overshoot {ordinal}"]
            assert 0.1 < row["obtained"] < 1.0


def test_the_steady_circle_is_wider_than_the_tactical_one(results):
    rows = {row["quantity"]: row for row in results["comparison"]}
    steady = rows["circle to starboard: steady turning diameter"]["obtained"]
    assert steady > rows["circle to starboard: tactical diameter"]["obtained"]


def test_onsets_are_those_of_the_executed_steering(results):
    for set_ in results["campaign"].values():
        for name, one in set_.items():
            assert one["onset"] == pytest.approx(one["segment_onset"], abs=0.3), name
    at_once, real = results["campaign"]["at once"], results["campaign"]["real"]
    for name in at_once:
        assert real[name]["onset"] >= at_once[name]["onset"]


def test_actuators_that_lag_are_seen_in_the_log(results):
    at_once, real = results["campaign"]["at once"], results["campaign"]["real"]
    for name in at_once:
        assert at_once[name]["realisation"]["low"] == pytest.approx(1.0)
        if name.startswith("zigzag"):
            assert real[name]["checks"]["actuation"]["verdict"] == "doubtful"
            assert real[name]["realisation"]["low"] < 0.5
            assert (
                real[name]["numbers"]["overshoot_1"] > 2 * at_once[name]["numbers"]["overshoot_1"]
            )
    saturated = real["circle-port"]["checks"]["duty-cycle of starboard"]
    assert saturated["verdict"] == "doubtful" and "at a limit" in saturated["why"]


def test_the_data_set_is_ready_to_identify(results):
    folder = results["folder"] / "logs"
    told = json.loads((folder / "segments.json").read_text())
    assert len(told["recordings"]) == 6
    for entry in told["recordings"]:
        segment = entry["segments"][0]
        assert (folder / segment["file"]).exists() and segment["checks"]
        log = np.genfromtxt(folder / entry["log"], delimiter=",", names=True)
        assert {"psi_relative", "delta_cmd", "delta_exec", "tau_z", "r_calc"} <= set(
            log.dtype.names or ()
        )
        at_onset = np.interp(0.0, log["t"], log["psi_relative"])
        assert abs(at_onset) < 1e-6
        before = log["delta_exec"][log["t"] < -0.5]
        assert np.max(np.abs(before)) < math.radians(2)


# -- the pieces ------------------------------------------------------------------------------


def _log(**series) -> Trajectory:
    t = series.pop("t")
    motion = {name: np.asarray(series.pop(name, np.zeros(t.size))) for name in "xy"}
    motion |= {k: np.asarray(series.pop(k, np.zeros(t.size))) for k in ("psi", "u", "v", "r")}
    return Trajectory(t=t, **motion, **series, extra={}, valid=np.ones(t.size, bool))


def test_there_are_24_cells_and_20_independent_figures(parts):
    runs = parts["published"].RUNS
    assert sum(len(run.numbers) for run in runs) == 20
    cells = sum(4 for run in runs)  # four columns of figures in either table
    assert cells == 24


def test_rudder_equivalent_is_positive_to_starboard_and_zero_at_rest(parts):
    port, starboard = np.array([10.0, 20.0, 15.0, 0.0]), np.array([10.0, 0.0, 5.0, 0.0])
    angle = parts["trials"].rudder_equivalent({"port": port, "starboard": starboard})
    np.testing.assert_allclose(np.degrees(angle), [0.0, 35.0, 17.5, 0.0], atol=1e-12)


def test_onset_realisation_and_approach_follow_their_equations(parts):
    t = np.arange(0.0, 30.0, 0.1)
    order = np.where(t < 20, 0.0, 10.0)
    lagging = np.where(t < 20, 0.0, 10.0 * (1 - np.exp(-(t - 20) / 0.5)))
    u = 0.83 + 0.01 * np.sin(2 * np.pi * t)
    log = _log(
        t=t, u=u, v=np.zeros(t.size), r=0.002 * np.cos(t),
        commanded={"port": 20.0 + order, "starboard": 20.0 - order},
        executed={"port": 20.0 + lagging, "starboard": 20.0 - lagging},
    )  # fmt: skip
    start = parts["trials"].onset(log)
    # 35 deg times 10 (1 - exp(-s / 0.5)) / 20 passes 1 deg at s = 0.0294 s.
    assert start == pytest.approx(20.1, abs=1e-9)
    ratio = parts["trials"].realisation(log, 20.1)
    assert ratio["high"] == pytest.approx(1.0, abs=1e-3)
    later = np.arange(0.1, 10.0 - 1e-9, 0.1)
    assert ratio["low"] == pytest.approx(np.quantile(1 - np.exp(-later / 0.5), 0.02), rel=1e-6)
    window = parts["trials"].approach_window(log, 20.0)
    assert window["speed"] == pytest.approx(0.83, abs=1e-4)
    assert window["speed_std"] == pytest.approx(0.01 / math.sqrt(2), rel=0.02)
    assert window["yaw_rate"] == pytest.approx(math.degrees(0.002), rel=1e-3)
    assert window["verdict"] == "pass"


def test_a_slow_or_yawing_approach_fails(parts):
    t = np.arange(0.0, 30.0, 0.1)
    still = np.zeros(t.size)
    slow = _log(t=t, u=still + 0.7, commanded={}, executed={})
    yawing = _log(t=t, u=still + 0.83, r=still + math.radians(0.2), commanded={}, executed={})
    for log in (slow, yawing):
        assert parts["trials"].approach_window(log, 20.0)["verdict"] == "fail"


def test_yaw_rates_of_one_motion_agree(parts):
    t = np.arange(0.0, 20.0, 0.02)
    log = _log(t=t, psi=0.3 * np.sin(t), r=0.3 * np.cos(t), commanded={}, executed={})
    told = parts["trials"].yaw_consistency(log)
    assert told["correlation"] > 0.99999 and told["rms"] < 0.01
    late = _log(t=t, psi=0.3 * np.sin(t - 0.3), r=0.3 * np.cos(t), commanded={}, executed={})
    assert parts["trials"].yaw_consistency(late)["rms"] > 1.0


def test_drag_is_the_polynomial_of_speed(parts):
    hull = parts["vessel"].HULL
    assert parts["vessel"].drag_at(hull, 0.8) == pytest.approx(100 * 0.8 + 50 * 0.64)


def test_the_least_drift_is_the_angle_whose_cosine_is_the_ratio(parts):
    run = parts["published"].RUNS[0]
    assert math.degrees(parts["diameter"].least_drift(run)) == pytest.approx(13.3, abs=0.1)


def test_the_zigzags_need_a_speed_that_the_circles_can_have(parts):
    told = parts["diameter"].feasibility()
    assert told["exponent"] == pytest.approx(0.513, abs=1e-3)
    rate = 5.78 * 1.75 ** told["exponent"]
    assert told["rate"] == pytest.approx(rate)
    assert told["speed"] == pytest.approx(math.radians(rate) * 3.608 * 2.952 / 2, rel=1e-6)
    assert 0.1 < told["loss"] < 0.2


@pytest.mark.parametrize("beta", [0.0, 0.2, 0.4])
def test_steady_from_the_start_the_tactical_diameter_is_that_times_the_cosine(beta):
    """The integral of the module's docstring, by an integrator of its own."""
    radius, speed = 5.0, 0.7
    rate = speed / radius

    def motion(psi, _):
        return [speed / rate * math.cos(psi - beta), speed / rate * math.sin(psi - beta)]

    end = solve_ivp(motion, (0.0, math.pi), [0.0, 0.0], rtol=1e-10).y[:, -1]
    assert end[1] == pytest.approx(2 * radius * math.cos(beta), rel=1e-7)


def test_shares_follow_the_evidence(parts):
    one = parts["asymmetry"].Candidate("a", None, {}, drop=30.0, evidence=26.0)
    other = dataclasses.replace(one, name="b", evidence=26.0 - 2 * math.log(10))
    assert one.log10_odds - other.log10_odds == pytest.approx(1.0)
    shares = parts["asymmetry"].shares([one, other])
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["a"] / shares["b"] == pytest.approx(10.0)
    assert parts["asymmetry"].rivals([one, other]) == ["b"]


def test_misfits_hold_the_rounding_of_the_last_digit(parts):
    published = parts["published"]
    assert published.rounding("advance") == pytest.approx(0.001 / math.sqrt(12))
    assert published.rounding("overshoot_2") == pytest.approx(0.01 / math.sqrt(12))
    assert published.in_si("peak_yaw_rate") == pytest.approx(math.pi / 180)
    sheet = parts["fit"].sheet_of(
        published.RUNS[0], parts["vessel"].start(), dict.fromkeys(parts["fit"].CLASSES, 1e-9)
    )
    np.testing.assert_allclose(sheet.stds, 0.001 / math.sqrt(12) * published.LENGTH, rtol=1e-6)
    assert sheet.plan.side == -1.0 and sheet.plan.speed == 0.8265
