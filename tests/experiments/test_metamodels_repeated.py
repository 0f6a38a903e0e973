# pyright: reportArgumentType=false
"""Real repeats of zig-zags: which they are, what is predicted of them, and how far off it is."""

import csv
import dataclasses
import json
import math

from experiments.metamodels import recorded, repeated, tables
from experiments.metamodels.averaging import as_run
from experiments.metamodels.recorded import Real

import jax.numpy as jnp
import numpy as np
import pytest
from tests.paths import DATA, EXPERIMENTS

from diffsea.metamodels.ideal_zigzag import Zigzag, ideal_zigzag
from diffsea.metamodels.norrbin import Norrbin


pytestmark = pytest.mark.experiment

real = pytest.mark.skipif(
    not (DATA / "kvlcc2_hsva").is_dir() or not (DATA / "esso_osaka").is_dir(),
    reason=f"no recordings of KVLCC2 and Esso Osaka in {DATA}",
)
HOME = EXPERIMENTS / "metamodels"
RAD = math.pi / 180
LOPSIDED = Norrbin(-2e-4, 0.04, 0.1, 90.0, 6e-3)
RATE = 5 * RAD


def _named(name: str, angle: float, marks: tuple[float, float], side: float = 1.0) -> Real:
    """A trial of which only the orders matter; angles in deg."""
    nothing = np.zeros(3)
    return Real(name, 0.5, nothing, nothing, nothing, nothing, angle * RAD,
                np.array(marks) * RAD, nothing[:2], side)  # fmt: skip


def _sailed(model: Norrbin, side: float, angle: float = 20.0) -> Real:
    """A zig-zag that a Norrbin model sailed, rudder and reversals at 20 deg."""
    dt = 0.5
    wanted = Zigzag(angle * RAD, 20 * RAD, side, RATE, seconds=250.0, step=0.1, executes=5)
    run = ideal_zigzag(model, wanted)
    switches = np.asarray(run.switch_times)
    t = np.arange(0.0, switches[3], dt)
    delta, r, psi = (np.interp(t, run.t, a) for a in (run.delta, run.r, run.psi))
    return Real(
        f"side {side:g}", dt, delta, r, psi, np.append(0.0, switches[:3]), angle * RAD,
        np.full(2, 20 * RAD), np.asarray(run.overshoots)[:2], side,
    )  # fmt: skip


def test_repeats_have_their_angle_and_both_reversals_within_two_degrees_whatever_the_side():
    trials = [
        _named("a", 20.0, (20.8, 20.5)),
        _named("other side", 20.2, (20.7, 18.6), -1.0),
        _named("reversed elsewhere", 20.0, (10.0, 20.5)),
        _named("second reversal 2.1 deg off", 20.0, (20.8, 22.6)),
        _named("other rudder", 17.9, (20.8, 20.5)),
    ]
    assert repeated.pairs(trials) == [(0, 1)]
    assert repeated.apart(trials[0], trials[1]) == pytest.approx(1.9 * RAD)
    told = repeated._apart(trials)
    assert told == pytest.approx({"repeats, at most": 1.9, "others, at least": 2.1})


def test_errors_are_root_mean_squares():
    def answer(overshoots, times, psi) -> repeated.Answer:
        return repeated.Answer(
            np.array(overshoots) * RAD, np.array(times), np.array(psi, float) * RAD
        )

    truth = answer((5.0, 9.0), (10.0, 40.0), (0, 10, 20, 5))
    found = answer((6.0, 7.0), (11.0, 38.0), (2, 8, 22, 90))
    assert repeated.errors(truth, found, 3) == pytest.approx({
        "overshoots_deg": math.sqrt((1 + 4) / 2),
        "times_percent": math.sqrt((10**2 + 5**2) / 2),
        "heading_deg": 2.0,
    })  # fmt: skip
    nothing = repeated.Answer(truth.overshoots, repeated.NOTHING, np.array([]))
    errors = repeated.errors(truth, nothing, 3)
    assert errors["overshoots_deg"] == 0
    assert math.isnan(errors["times_percent"]) and math.isnan(errors["heading_deg"])


def test_what_was_measured_is_turned_to_starboard_and_begins_at_the_first_execute():
    # Heading falls by 2 deg/s from 3 s on; executes at 3, 8 and 20 s.
    t = 0.5 * np.arange(60)
    psi = -2 * RAD * np.maximum(t - 3, 0)
    trial = Real("port", 0.5, psi, psi, psi, np.array([3.0, 8.0, 20.0, 27.0]), 0.1,
                 np.zeros(2), np.array([5.0, 9.0]) * RAD, -1.0)  # fmt: skip
    found = repeated.measured(trial)
    np.testing.assert_allclose(found.times, (5.0, 12.0))
    np.testing.assert_allclose(found.psi[:5], np.array([0, 1, 2, 3, 4]) * RAD, atol=1e-12)
    np.testing.assert_allclose(np.degrees(found.overshoots), (5.0, 9.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_overshoots_of_a_trial_as_run_count_from_its_reversals(side):
    # 1 deg/s until 10 s, -1 deg/s from 12 to 30 s, 1 deg/s again from 34 s: the heading peaks
    # 0.5 deg beyond that at 10 s, and 1 deg beyond that at 30 s.
    t = np.arange(0.0, 45.0, 0.5)
    r = side * RAD * np.interp(t, (10.0, 12.0, 30.0, 34.0), (1.0, -1.0, -1.0, 1.0))
    found = as_run(jnp.asarray(r), jnp.array([10.0, 30.0]), side, 0.5)
    np.testing.assert_allclose(np.degrees(found), (0.5, 1.0), atol=1e-6)


def test_of_a_ship_that_is_a_norrbin_model_metamodels_know_the_other_side_and_averages_do_not():
    trials = [_sailed(LOPSIDED, 1.0), _sailed(LOPSIDED, -1.0), _sailed(LOPSIDED, 1.0, 30.0)]
    assert repeated.pairs(trials) == [(0, 1)]
    out = repeated.compared_with_averaging(trials, RATE)
    assert [(row["name"], row["repeat"]) for row in out["trials"]] == [
        ("side 1", "side -1"), ("side -1", "side 1"),
    ]  # fmt: skip
    sides = np.degrees([trial.overshoots for trial in trials[:2]])
    apart = math.sqrt(np.mean((sides[0] - sides[1]) ** 2))
    assert apart > 1
    for row in out["trials"]:
        off = {name: said["errors"] for name, said in row["methods"].items()}
        assert off["average"]["overshoots_deg"] == pytest.approx(apart)
        for method in repeated.METHODS[1:]:
            assert off[method]["overshoots_deg"] < 0.05, method
        for method in (*repeated.METHODS[3:], repeated.ITSELF):
            assert off[method]["times_percent"] < 0.5 and off[method]["heading_deg"] < 0.2, method
        assert off["average"]["heading_deg"] > 1
        assert off[repeated.INTEGRATED]["overshoots_deg"] < 0.05
    assert out["errors"]["average"]["overshoots_deg"] == pytest.approx(apart)


def test_what_the_kept_trial_did_is_used_in_no_prediction_of_it():
    trials = [_sailed(LOPSIDED, 1.0), _sailed(LOPSIDED, -1.0), _sailed(LOPSIDED, 1.0, 30.0)]
    other = dataclasses.replace(trials[0], r=0.8 * trials[0].r, overshoots=np.ones(2))
    one, two = (repeated.answers([kept, *trials[1:]], 0, 1, RATE) for kept in (trials[0], other))
    for method in repeated.METHODS:
        for name in ("overshoots", "times", "psi"):
            np.testing.assert_array_equal(getattr(one[method], name), getattr(two[method], name))
    for check in (repeated.ITSELF, repeated.INTEGRATED):
        assert np.max(np.abs(one[check].overshoots - two[check].overshoots)) > 0.5 * RAD


def _by_hand(file: str) -> tuple[list[float], list[float]]:
    """Seconds of the first three executes, and headings (deg) turned at the two reversals."""
    path = DATA / "esso_osaka" / "recordings" / file
    with path.open() as opened:
        rows = list(csv.DictReader(opened))
    t, psi, delta = (
        [float(row[name]) for row in rows]
        for name in ("t [s]", "psi_hat [rad]", "delta_rudder [rad]")
    )
    full = [abs(d) > 0.3 for d in delta]  # 20 deg are 0.35 rad
    first = full.index(True)
    second = next(k for k in range(first, len(t)) if delta[k] * delta[first] < 0)
    third = next(k for k in range(second, len(t)) if delta[k] * delta[second] < 0)
    start = next(k for k in range(len(t)) if t[k] >= t[first] - 3.0)
    turned = [
        math.degrees(abs(math.remainder(psi[k] - psi[start], 2 * math.pi))) for k in (second, third)
    ]
    return [t[k] for k in (first, second, third)], turned


@real
@pytest.mark.parametrize(("time", "side"), [("13_04_24", 1.0), ("14_03_39", -1.0)])
def test_a_recorded_trial_is_read_as_by_hand(time, side):
    name = f"zigzag_31-Jul-2020_{time}"
    trial = {one.name: one for one in recorded.esso_osaka()}[name]
    at, turned = _by_hand(f"{name}.csv")
    assert trial.side == side
    # The trial's clock runs faster by its speed over 0.25 m/s; rows are 0.1 s apart.
    times = np.diff(trial.executes[:3]) * 0.25 / trial.speed
    np.testing.assert_allclose(times, np.diff(at), atol=0.2)
    np.testing.assert_allclose(np.degrees(np.abs(trial.marks)), turned, atol=0.6)


@real
def test_the_real_repeats_are_the_two_that_were_ordered_alike():
    sets = recorded.read(print)
    names = {
        key: [(trials[i].name, trials[k].name) for i, k in repeated.pairs(trials)]
        for key, (trials, _) in sets.items()
    }
    assert names == {
        "kvlcc2": [("HSVA_CPMC_KVLCC2_Z_10_10_P", "HSVA_CPMC_KVLCC2_Z_10_10_S")],
        "esso_osaka": [("zigzag_31-Jul-2020_13_04_24", "zigzag_31-Jul-2020_14_03_39")],
    }


def test_without_recordings_there_is_nothing_to_compare(monkeypatch, tmp_path):
    monkeypatch.setattr(recorded, "DATA", tmp_path)
    told = []
    sets = recorded.read(told.append)
    assert sets == {} and len(told) == 2
    assert repeated.study(sets) == {} and tables._real({}, {}) == {}


def test_the_page_has_the_tables_of_the_results():
    results = json.loads((HOME / "results.json").read_text())
    page = (HOME / "README.md").read_text(encoding="utf-8")
    for key, text in tables.tables(results).items():
        assert f"<!-- begin {key} -->\n{text}\n<!-- end {key} -->" in page, key
    assert f" took {results['seconds']:.0f} s." in page
