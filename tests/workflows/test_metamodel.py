# pyright: reportArgumentType=false
"""`diffsea metamodel` on a ship that is a Norrbin model exactly, sailed by a simulator of its own.

The simulator is a Runge-Kutta recursion in NumPy and shares no code with the library. Winds push
each log about, an autopilot turns the ship, compass and gyro are noisy.
"""

import json
import math

import jax
import numpy as np
import pandas as pd
import pytest

import diffsea
from diffsea.cli import main
from diffsea.metamodels.fit import Trials, identify
from diffsea.metamodels.ideal_zigzag import Zigzag as Ideal
from diffsea.metamodels.norrbin import Norrbin
from diffsea.metamodels.validation import predict_trials


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


TRUE = {"a0": -5e-5, "a1": 0.022, "a2": 0.2, "a3": 120.0, "b": 2.0e-3}
SPEED, STEP, ROW = 7.0, 0.25, 1.0  # m/s; s, of the simulation and of the logs
RUDDER_RATE = math.radians(2.5)
WINDOW = 90.0
SIDES = {"starboard": 1.0, "port": -1.0}


def rate_of_turn(r, delta, moment=0.0):
    """dr/dt of Norrbin's equation."""
    a0, a1, a2, a3, b = TRUE.values()
    return b * delta + moment - (a0 + a1 * r + a2 * r**2 + a3 * r**3)


def sail(order, seconds, wind=0.0, seed=None):
    """Rows of a run: t, x, y, psi, r, delta; `order(t, psi, r)` gives the ordered angle.

    `wind` is a steady moment as the rudder angle (rad) that would balance it.
    """
    psi = r = x = y = 0.0
    delta = TRUE["a0"] / TRUE["b"]
    rows, moment = [], wind * TRUE["b"]
    for k in range(int(seconds / STEP) + 1):
        t = k * STEP
        if k % round(ROW / STEP) == 0:
            rows.append((t, x, y, psi, r, delta))
        change = np.clip(order(t, psi, r) - delta, -RUDDER_RATE * STEP, RUDDER_RATE * STEP)
        angles = delta, delta + 0.5 * change, delta + change
        k1 = rate_of_turn(r, angles[0], moment)
        k2 = rate_of_turn(r + 0.5 * STEP * k1, angles[1], moment)
        k3 = rate_of_turn(r + 0.5 * STEP * k2, angles[1], moment)
        k4 = rate_of_turn(r + STEP * k3, angles[2], moment)
        new = r + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        psi, r, delta = psi + 0.5 * STEP * (r + new), new, angles[2]
        x, y = x + SPEED * STEP * math.cos(psi), y + SPEED * STEP * math.sin(psi)
    table = np.array(rows)
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal(table.shape)
        table = table + noise * [0, 1.0, 1.0, math.radians(0.1), math.radians(0.01), 0]
    return pd.DataFrame(table, columns=["t", "x", "y", "psi", "r", "exec_rudder"])


def passage(seed):
    """A passage by autopilot with two course changes, and the wind that was logged."""
    rng = np.random.default_rng(seed)
    turns = [(150.0, math.radians(25)), (180.0 + 90, math.radians(-30)), (620.0, math.radians(-35))]
    wind = rng.normal()

    def order(t, psi, r):
        course = sum(size for start, size in turns if t >= start)
        wanted = 0.7 * (course - psi) - 15.0 * r + TRUE["a0"] / TRUE["b"]
        return float(np.clip(wanted, math.radians(-8), math.radians(8)))

    log = sail(order, 900.0, 0.15 * math.radians(1.0) * wind, seed)
    log["u"], log["v"] = SPEED, 0.0
    log["wind_speed"], log["wind_direction"] = 8 * abs(wind), log["psi"] + math.pi / 2
    return log


class Zigzag:
    """Orders of a zig-zag: the angle, the heading of its reversals, and how late they come."""

    def __init__(self, angle, heading, side, late=0.0):
        self.angle, self.heading, self.late = angle, heading, late
        self.sense, self.passed = side, None

    def __call__(self, t, psi, r):
        if t < 60:
            return TRUE["a0"] / TRUE["b"]
        if self.passed is None and self.sense * psi >= self.heading:
            self.passed = t
        if self.passed is not None and t >= self.passed + self.late:
            self.sense, self.passed = -self.sense, None
        return self.sense * self.angle


def ideal_overshoots(angle, heading, side):
    """First and second overshoot (rad) of the zig-zag as it should be run."""
    run = sail(Zigzag(angle, heading, side), 600.0)
    psi, turning = side * run["psi"].to_numpy(), side * run["r"].to_numpy()
    under_way = run["t"].to_numpy()[:-1] > 60
    peak = np.flatnonzero(under_way & (turning[:-1] > 0) & (turning[1:] <= 0))[0] + 1
    dip = peak + np.flatnonzero((turning[peak:-1] < 0) & (turning[peak + 1 :] >= 0))[0] + 1
    return psi[peak] - heading, -psi[dip] - heading


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(14):
        log = passage(seed)
        if seed == 5:
            log["r"] = 0.0  # a dead gyro
        log.to_csv(folder / f"day{seed:02d}.csv", index=False)
    return sorted(folder.glob("*.csv"))


@pytest.fixture(scope="module")
def written(logs, tmp_path_factory):
    """Content of metamodel.json and the page."""
    folder = tmp_path_factory.mktemp("metamodel")
    words = ["metamodel", *map(str, logs), "--window", str(WINDOW), "-o", str(folder)]
    asked = ["--angle", "10", "--heading", "10", "--rudder-rate", "2.5", "--most", "8"]
    assert main([*words, *asked]) == 0
    page = (folder / "metamodel.html").read_text(encoding="utf-8")
    return json.loads((folder / "metamodel.json").read_text()), page


@pytest.mark.proof
def test_a_log_with_a_dead_gyro_is_left_out_and_said_so(written):
    found, page = written
    by_log = {row["log"]: row for row in found["logs"]}
    assert by_log["day05.csv"]["excluded"] and by_log["day05.csv"]["trials"] == 0
    assert [name for name, row in by_log.items() if row["excluded"]] == ["day05.csv"]
    assert all(row["trials"] == 2 for name, row in by_log.items() if name != "day05.csv")
    assert "left out: day05.csv" in page


def test_turns_are_grouped_by_place(written):
    found, _ = written
    assert found["groups"] == {"turns at place 1": 13, "turns at place 2": 13}


def test_the_calmest_trials_are_used(written):
    found, _ = written
    winds = [abs(np.random.default_rng(seed).normal()) * 8 for seed in range(14) if seed != 5]
    for model in found["metamodels"]:
        used = [one["side_wind"] for one in model["used"]]
        assert sorted(used) == pytest.approx(sorted(winds)[:8], rel=0.02)


def test_the_metamodel_is_the_ship_within_its_errors(written):
    found, _ = written
    model = both_sided(found)
    for name in ("a0", "a1", "b"):
        row = model["coefficients"][name]
        assert abs(row["value"] - TRUE[name]) < 3.5 * row["std"], name
    assert model["neutral"] == pytest.approx(TRUE["a0"] / TRUE["b"], abs=math.radians(0.15))
    assert model["gain"] == pytest.approx(TRUE["b"] / TRUE["a1"], rel=0.15)
    assert model["converged"] and model["cross_validation"]["median"] > 90
    assert model["cross_validation"]["others"]["trials"] == 5


def both_sided(found):
    """The metamodel of the place with turns to either side."""
    return max(found["metamodels"], key=lambda one: one["cross_validation"]["median"])


def test_the_ideal_zigzag_is_the_ships(written):
    found, _ = written
    ten = math.radians(10.0)
    for side, sign in SIDES.items():
        truth = ideal_overshoots(ten, ten, sign)
        asked = both_sided(found)["ideal"][side]
        assert asked["angle"] == pytest.approx(ten)
        assert asked["overshoots"] == pytest.approx(truth, abs=math.radians(0.7))


def test_the_page_has_every_group_and_draws_trials_that_it_did_not_see(written):
    found, page = written
    assert page.count('class="metamodel"') == 2
    for model in found["metamodels"]:
        worst = min(model["cross_validation"]["each"])
        assert f"{worst:.0f} %" in page


@pytest.fixture(scope="module")
def zigzags():
    """Eight 10/10 zig-zags to either side, reversed late, the angle off by up to 5 %."""
    rng, ten, out = np.random.default_rng(3), math.radians(10.0), []
    for k in range(8):
        order = Zigzag(ten * (1 + rng.uniform(-0.05, 0.05)), ten, (-1) ** k, rng.uniform(1, 4))
        log = sail(order, 420.0, math.radians(0.05) * rng.normal(), seed=100 + k)
        out.append(log.assign(u=SPEED, v=0.0))
    return out


def test_the_corrected_average_takes_out_late_orders(zigzags):
    ten = math.radians(10.0)
    wanted = diffsea.metamodel(zigzags, window=WINDOW).models[0].asked["starboard"]
    assert wanted.heading > ten  # as it was run: late
    found = diffsea.metamodel(
        zigzags, window=WINDOW, zigzag=Ideal(ten, ten, rate_limit=RUDDER_RATE)
    )
    (model,) = found.models
    assert model.group.startswith("zigzag 10 deg") and len(model.averages) == 4
    assert model.cross_validation > 95
    truth = {side: ideal_overshoots(ten, ten, sign) for side, sign in SIDES.items()}
    off = lambda one, mean: abs(mean[0] - truth[one.side][one.number - 1])
    corrected = [off(one, one.corrected) for one in model.averages]
    assert max(corrected) < math.radians(0.25)
    assert max(corrected) < 0.5 * max(off(one, one.measured) for one in model.averages)


def test_a_trial_is_predicted_by_the_metamodel_of_the_others_alone(zigzags):
    (model,) = diffsea.metamodel(zigzags, window=WINDOW).models
    rows = lambda trials, kept: Trials(trials.dt, *(a[kept] for a in jax.tree.leaves(trials)[1:]))
    of_others = identify(rows(model.trials, slice(1, None))).model
    alone = rows(model.trials, slice(0, 1))
    by_others = float(predict_trials(of_others, alone).percent[0])
    by_all = float(predict_trials(model.fit.model, alone).percent[0])
    assert float(model.crossed.percent[0]) == pytest.approx(by_others, abs=1e-3)
    assert abs(by_all - by_others) > 1e-2


@pytest.mark.proof
def test_a_vessel_is_judged_by_the_metamodel_under_the_same_rudder(logs, tmp_path):
    """The ship herself follows it best; one whose rudder does two thirds is told."""
    ship = Norrbin(**TRUE).vessel(100.0, SPEED)
    weaker = Norrbin(**TRUE | {"b": 2 / 3 * TRUE["b"]}).vessel(100.0, SPEED)
    told = [
        diffsea.metamodel(logs, window=WINDOW, most=8, against=vessel) for vessel in (ship, weaker)
    ]
    for one, other in zip(*(found.models for found in told), strict=True):
        assert one.against is not None and other.against is not None
        assert np.median(one.against.of_metamodel) > 85 > np.median(other.against.of_metamodel) + 20
        # The winds of the trials are in neither: they part vessel and trial, not the two models.
        assert np.median(one.against.of_measured) < np.median(one.against.of_metamodel)
        each = sail_again(one)
        measured = np.asarray(one.against.r)[:, : each.shape[1]]
        assert np.abs(measured - each).max() < 1e-3 * np.abs(each).max() + math.radians(0.01)
    found = told[0]
    record = found.record()["metamodels"][0]["against"]
    assert record["metamodel"]["median"] == pytest.approx(
        np.median(found.models[0].against.of_metamodel)
    )
    page = found.html()
    assert "norrbin by metamodel (%)" in page and "the vessel that is judged" in page
    assert any("norrbin follows the metamodel to" in note for note in found.notes())


@pytest.mark.proof
def test_logs_without_names_are_told_apart(logs):
    """Of DataFrames every trial is simulated under its own rudder."""
    ship, some = Norrbin(**TRUE).vessel(100.0, SPEED), logs[:5]
    named, nameless = (
        diffsea.metamodel(given, window=WINDOW, against=ship).models
        for given in (some, [pd.read_csv(path) for path in some])
    )
    for one, other in zip(named, nameless, strict=True):
        np.testing.assert_allclose(other.against.r, one.against.r)
    assert len({trial.log for trial in nameless[0].used}) == len(nameless[0].used)


def sail_again(model):
    """Yaw rates under the recorded rudder of each trial from its first one, without wind."""
    logs = {f"day{seed:02d}.csv": passage(seed) for seed in range(14)}
    rows, count = [], min(len(one.t) for one in model.used)
    for trial in model.used:
        log = logs[trial.log]
        first = int(np.searchsorted(log["t"], trial.start))
        t0, r = float(log["t"][first]), float(log["r"][first])
        times = np.arange(0.0, trial.end - t0 + ROW, STEP)
        delta = np.interp(t0 + times, log["t"], log["exec_rudder"])
        rates = [r]
        for now, then in zip(delta[:-1], delta[1:], strict=True):
            middle = 0.5 * (now + then)
            k1 = rate_of_turn(r, now)
            k2 = rate_of_turn(r + 0.5 * STEP * k1, middle)
            k3 = rate_of_turn(r + 0.5 * STEP * k2, middle)
            k4 = rate_of_turn(r + STEP * k3, then)
            r = r + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            rates.append(r)
        rows.append(np.interp(trial.start + trial.t[:count], t0 + times, rates))
    return np.stack(rows)


def test_trials_that_are_followed_worst_are_dropped(zigzags, tmp_path):
    bad = zigzags[2].assign(r=1.4 * zigzags[2]["r"])  # a gyro out of scale
    spoilt = []
    for k, log in enumerate([*zigzags[:2], bad, *zigzags[3:]]):
        spoilt.append(tmp_path / f"zigzag{k}.csv")
        log.to_csv(spoilt[-1], index=False)
    (whole,) = diffsea.metamodel(spoilt, window=WINDOW).models
    (one,) = diffsea.metamodel(spoilt, window=WINDOW, drop=1).models
    assert [trial.start for trial in one.dropped] and len(one.used) == len(whole.used) - 1
    assert one.dropped[0].log == "zigzag2.csv" and one.dropped[0] in one.others
    assert "zigzag2.csv" not in [trial.log for trial in one.used]
    assert len(one.percent_of_others) == len(whole.percent_of_others) + 1
    assert one.cross_validation > whole.cross_validation
    assert abs(float(one.fit.model.b) - TRUE["b"]) < abs(float(whole.fit.model.b) - TRUE["b"])
    assert one.as_dict()["dropped"][0]["log"] == one.dropped[0].log


def test_too_few_trials_are_told(logs, zigzags):
    with pytest.raises(diffsea.UserError, match="no group has the 4 trials"):
        diffsea.metamodel(zigzags[:2], window=WINDOW)
    with pytest.raises(diffsea.UserError, match="none of the 1 logs can be used"):
        diffsea.metamodel(logs[5])
    with pytest.raises(diffsea.UserError, match="needs 4 trials"):
        diffsea.metamodel(zigzags, most=3)
    with pytest.raises(diffsea.UserError, match="not 6 less 3 dropped"):
        diffsea.metamodel(zigzags, most=6, drop=3)
    with pytest.raises(diffsea.UserError, match="4 trials that a metamodel needs and 5 to drop"):
        diffsea.metamodel(zigzags, window=WINDOW, drop=5)
    # A vessel with an actuator of which the logs say nothing.
    with pytest.raises(diffsea.UserError, match="propeller"):
        diffsea.metamodel(zigzags, window=WINDOW, against="kvlcc2")


def test_a_heading_without_an_angle_is_bad_usage(logs, tmp_path, capsys):
    words = ["metamodel", str(logs[0]), "--heading", "10", "-o", str(tmp_path / "out")]
    assert main(words) == 2 and "go with --angle" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
