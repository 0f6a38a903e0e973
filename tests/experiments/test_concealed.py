# pyright: reportArgumentType=false
"""The blind experiment: an independent generator, sealed truth, and scores that count rightly."""

import ast
import json
import math
import subprocess
import sys
from pathlib import Path

from experiments.concealed import (
    baselines,
    draw,
    effects,
    forces,
    limits,
    orders,
    outcomes,
    outside,
    report,
    resolve,
    score,
    sealing,
    sensors,
    terms,
)
from experiments.concealed.actuation import Servo
from experiments.concealed.generate import csv_text, write_case
from experiments.concealed.hulls import HULLS
from experiments.concealed.model import Channel, Sensing, build
from experiments.concealed.simulate import (
    CHANNELS,
    Gusts,
    Inertia,
    Track,
    derivative,
    simulate,
)

import numpy as np
import pytest
from tests.paths import ROOT


pytestmark = pytest.mark.slow


FOLDER = ROOT / "experiments" / "concealed"
USV = HULLS["usv"]


# Independence


def imported(path: Path) -> tuple[set[str], set[Path]]:
    """Names of modules that a file imports, and the files of this experiment among them."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = f"experiments.concealed.{node.module or ''}" if node.level else node.module or ""
            base = base.rstrip(".")
            names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names.add("importlib")
        elif isinstance(node, ast.Name) and node.id == "__import__":
            names.add("importlib")
    mine = {n.removeprefix("experiments.concealed.").split(".")[0] for n in names
            if n.startswith("experiments.concealed.")}  # fmt: skip
    return names, {f for m in mine if (f := FOLDER / f"{m}.py").exists()}


def test_generator_imports_nothing_of_the_tool():
    # What draws cases, limits and extra runs; resolve's own `run` is the blind runner.
    left, seen = {FOLDER / "generate.py", FOLDER / "limits.py", FOLDER / "terms.py"}, set()
    while left:
        path = left.pop()
        seen.add(path)
        names, files = imported(path)
        foreign = {n.split(".")[0] for n in names}
        assert not foreign & {"diffsea", "jax", "equinox", "tests", "importlib", "runpy"}, path.name
        left |= files - seen
    parts = {"simulate", "forces", "actuation", "sensors", "draw", "orders", "outside"}
    assert {p.stem for p in seen} >= {*parts, "effects_hull", "effects_actuators"}


# Physics against closed forms


def still(model, orders_, seconds, u=0.0, psi=0.0, hull=USV, gusts=None):
    """A run with constant orders, no lead: states at its end and the whole track."""
    rows = round(seconds / hull.step) + 1
    policy = lambda k, look: (orders_, 10**9)
    track = simulate(model, policy, rows, hull.step, 0, (0.0, 0.0, psi, u), gusts)
    return track.states[-1], track


def test_terminal_speed():
    model = build(USV.document)
    state, _ = still(model, [100.0, 100.0], 60.0)
    a, b = -model.hull["X_uu"], -model.hull["X_u"]
    speed = (-b + math.sqrt(b * b + 4 * a * 200.0)) / (2 * a)
    assert state[3] == pytest.approx(speed, rel=1e-6)
    assert abs(state[4]) + abs(state[5]) < 1e-9


def test_spin_in_place():
    model = build(USV.document)
    state, _ = still(model, [80.0, -80.0], 60.0)
    a, b, moment = 600.0, 900.0, 2 * 1.03 * 80.0  # port ahead turns to starboard
    rate = (-b + math.sqrt(b * b + 4 * a * moment)) / (2 * a)
    assert state[5] == pytest.approx(rate, rel=1e-6)


def test_steady_turn_balances_with_the_coriolis_matrices_of_the_textbook():
    model = build(USV.document)
    model.hull.update(x_G=0.2, Y_rdot=-30.0, N_vdot=-10.0, Y_r=20.0)
    h = model.hull
    (_, _, _, u, v, r, _), _ = still(model, [150.0, 90.0], 200.0, u=1.0)
    m, xg = h["mass"], h["x_G"]
    rigid = np.array([[0, 0, -m * (xg * r + v)], [0, 0, m * u], [m * (xg * r + v), -m * u, 0]])
    a = h["Y_vdot"] * v + 0.5 * (h["Y_rdot"] + h["N_vdot"]) * r
    b = h["X_udot"] * u
    added = np.array([[0, 0, a], [0, 0, -b], [-a, b, 0]])
    damping = np.array([(h["X_u"] + h["X_uu"] * abs(u)) * u, h["Y_v"] * v + h["Y_r"] * r,
                        (h["N_r"] + h["N_rr"] * abs(r)) * r])  # fmt: skip
    thrust = np.array([240.0, 0.0, 1.03 * 60.0])
    left = (rigid + added) @ [u, v, r] - damping - thrust
    assert np.abs(left).max() < 1e-4 and r > 0.03


def test_without_forces_impulse_and_energy_last():
    model = build(USV.document)
    for name in ("X_u", "X_uu", "Y_v", "N_r", "N_rr"):
        model.hull[name] = 0.0
    model.hull["x_G"] = 0.3
    push = Gusts(0.0, 0.2, np.array([[60.0, 90.0, 80.0]] * 6 + [[0.0] * 3] * 600))
    _, track = still(model, [0.0, 0.0], 60.0, gusts=push)
    after = track.t > 2.0
    i = Inertia(model, 0.0)
    u, v, r = track.states[after, 3:6].T
    energy = 0.5 * (i.m11 * u * u + i.m22 * v * v + 2 * i.m23 * v * r + i.m33 * r * r)
    assert np.ptp(energy) < 1e-5 * energy[0]
    assert np.ptp(track.impulses[after, 3:5], axis=0).max() < 1e-6


def test_unequal_cross_terms_of_added_mass():
    """Acceleration from rest under a sway force: M nu_dot = tau with Y_rdot and N_vdot as given."""
    model = build(USV.document)
    model.hull.update(Y_rdot=-60.0, N_vdot=20.0, Y_v=0.0, N_r=0.0, N_rr=0.0)
    push = Gusts(0.0, 0.2, np.array([[0.0, 30.0, 0.0]] * 5))
    _, track = still(model, [0.0, 0.0], 0.4, gusts=push)
    start = (track.states[1] - track.states[0])[4:6] / (track.t[1] - track.t[0])
    h = model.hull
    M = np.array([[h["mass"] - h["Y_vdot"], 60.0], [-20.0, h["I_z"] - h["N_rdot"]]])
    assert start == pytest.approx(np.linalg.solve(M, [30.0, 0.0]), rel=1e-3)


def test_unequal_cross_terms_grow_in_shallow_water_as_all_added_masses():
    model = build(USV.document)
    model.hull.update(Y_rdot=-60.0, N_vdot=20.0, Y_v=0.0, N_r=0.0, N_rr=0.0)
    model.ratio_of_depth = 0.7
    push = Gusts(0.0, 0.2, np.array([[0.0, 30.0, 0.0]] * 5))
    _, track = still(model, [0.0, 0.0], 0.4, gusts=push)
    start = (track.states[1] - track.states[0])[4:6] / (track.t[1] - track.t[0])
    h, grow = model.hull, 0.3**-0.5
    M = np.array([[h["mass"] - grow * h["Y_vdot"], 60.0 * grow],
                  [-20.0 * grow, h["I_z"] - grow * h["N_rdot"]]])  # fmt: skip
    assert start == pytest.approx(np.linalg.solve(M, [30.0, 0.0]), rel=1e-3)


def test_drift_in_a_current():
    model = build(USV.document)
    model.current = (0.3, -0.2)
    state, track = still(model, [0.0, 0.0], 300.0, psi=0.7)
    speed = (track.states[-1, :2] - track.states[-11, :2]) / (track.t[-1] - track.t[-11])
    assert speed == pytest.approx([0.3, -0.2], abs=1e-4)
    c, s = math.cos(state[2]), math.sin(state[2])
    assert (c * state[3] - s * state[4], s * state[3] + c * state[4]) == pytest.approx(
        (0.3, -0.2), abs=1e-4
    )


def test_a_wind_on_the_bow_turns_it_away_where_the_superstructure_says_so():
    hull, air = USV.document["hull"], (-5.0, -5.0)  # from the starboard bow of a ship to the north
    force = lambda C_N: forces.wind_force(hull, air, (0.7, 0.85, C_N))(0.0, 0.0, 0.0)
    assert force(0.1)[2] < 0 < force(-0.1)[2]
    assert force(0.1)[0] < 0 and force(0.1)[1] < 0
    drawn = effects.catalogue(USV)["wind"].draw(np.random.default_rng(1), USV)
    model = build(USV.document)
    effects.apply(model, USV, "wind", 8.0, drawn)
    assert model.superstructure == tuple(drawn["superstructure"]) != (0.7, 0.85, 0.1)


def test_drift_before_the_wind():
    model = build(USV.document)
    effects.apply(model, USV, "wind", 12.0, {"direction": math.pi})  # from the south
    state, _ = still(model, [0.0, 0.0], 60.0)  # heading north, the wind from astern
    area = USV.document["hull"]["beam"] * USV.document["hull"]["draught"]
    pull = lambda u: 0.5 * 1.225 * area * 0.73 * (12.0 - u) ** 2 - 52.0 * u - 72.0 * u * u
    low, high = 0.0, 2.0
    while high - low > 1e-10:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pull(middle) > 0 else (low, middle)
    assert state[3] == pytest.approx(low, rel=1e-5)


def test_mass_taken_on_keeps_the_velocity():
    model = build(USV.document)
    model.steps.append((1.03, "mass", 200.0))
    _, track = still(model, [0.0, 0.0], 2.0, u=1.0)
    speed = track.states[:, 3]
    slope = np.diff(speed) / np.diff(track.t)
    before, after = slope[track.t[:-1] < 0.95][-1], slope[track.t[:-1] > 1.15][0]
    assert np.abs(np.diff(speed)).max() < 0.1
    assert after / before == pytest.approx(192.0 / 392.0, rel=0.25)


def test_strip_drag_in_pure_sway_and_pure_yaw():
    force = forces.strip_force({"length": 4.0, "draught": 0.3}, 1.1)
    k = 0.5 * 1025.0 * 0.3 * 1.1
    assert force(0.5, 0.0) == pytest.approx((-k * 4.0 * 0.25, 0.0), abs=1e-9)
    y, n = force(0.0, 0.4)
    # fuller amidships: less moment than 2 k r^2 (L/2)^4 / 4 of equal sections
    assert abs(y) < 1e-9 and 0.75 < -n / (k * 0.16 * 2 * 2.0**4 / 4) < 1.0


# Actuators and instruments


def test_servo_lag_slew_delay_dead_band_and_play():
    lag = Servo(Channel(lag=2.0), 0.0)
    lag.order(1.0, 10.0)
    assert lag.value(3.0) == pytest.approx(10.0 * (1 - math.exp(-1.0)))
    slew = Servo(Channel(rate=4.0), 0.0)
    slew.order(0.0, 10.0)
    assert [slew.value(t) for t in (1.0, 2.5, 3.0)] == pytest.approx([4.0, 10.0, 10.0])
    both = Servo(Channel(rate=4.0, lag=1.0), 0.0)
    both.order(0.0, 10.0)  # slews until 4 are left, then decays
    assert both.value(1.5) == pytest.approx(6.0)
    assert both.value(2.5) == pytest.approx(10.0 - 4.0 * math.exp(-1.0))
    late = Servo(Channel(delay=0.7), 1.0)
    late.order(2.0, 5.0)
    assert (late.value(2.69), late.value(2.71)) == (1.0, 5.0)
    assert late.kinks(2.0, 3.0) == [2.7, 2.7]
    dead = Servo(Channel(deadband=2.0, low=-8.0, high=8.0), 0.0)
    for t, (n, y) in enumerate([(1.5, 0.0), (5.0, 3.0), (-3.0, -1.0), (20.0, 8.0)]):
        dead.order(float(t), n)
        assert dead.value(t + 0.5) == y
    play = Servo(Channel(backlash=1.0), 0.0)
    for t, (n, y) in enumerate([(3.0, 2.0), (2.5, 2.0), (0.5, 1.5), (2.0, 1.5), (2.9, 1.9)]):
        play.order(float(t), n)
        assert play.value(t + 0.5) == pytest.approx(y)


def test_late_channel_shows_the_past_and_the_clock_runs_off():
    _, track = still(build(USV.document), [100.0, 60.0], 20.0, u=0.5)
    t = np.arange(20.0, step=0.2)[40:]
    right = sensors.true_readings(track, Sensing(), t)
    late = sensors.true_readings(track, Sensing(latency={"u": 0.6}), t)
    assert late["u"][3:] == pytest.approx(right["u"][:-3], abs=1e-7)
    assert late["v"] == pytest.approx(right["v"])
    clock = sensors.true_readings(track, Sensing(clock_rate=0.02, clock_offset=0.1), t)
    k = np.argmin(np.abs(t - 15.0))  # shows 15 - 0.4 s
    assert clock["x"][k] == pytest.approx(right["x"][k - 2], abs=1e-6)


def test_a_clock_that_gains_reads_what_comes_after_the_last_row():
    model = build(USV.document)
    model.sensing.clock_rate = -0.03
    _, track = still(model, [100.0, 60.0], 20.0, u=0.5)
    _, longer = still(build(USV.document), [100.0, 60.0], 30.0, u=0.5)
    t = np.arange(101) * USV.step
    read = lambda of: sensors.true_readings(of, model.sensing, t)
    for channel, value in read(longer).items():
        assert read(track)[channel] == pytest.approx(value, abs=1e-6), channel
    assert len(track.orders) == 101


def test_instruments_have_their_rate_resolution_and_gaps():
    model = build(USV.document)
    _, track = still(model, [100.0, 60.0], 100.0)
    rng = np.random.default_rng(3)
    found = sensors.record(track, Sensing(), USV.instruments, USV.rows, USV.step, rng)
    assert np.isnan(found["x"][1::2]).all() and np.isfinite(found["x"][::2]).mean() > 0.9
    seen = found["u"][np.isfinite(found["u"])]
    assert seen / 0.005 == pytest.approx(np.round(seen / 0.005), abs=1e-6)
    off = seen - sensors.true_readings(track, Sensing(), found["t"])["u"][np.isfinite(found["u"])]
    core = off[np.abs(off) < 0.2]
    assert 0.9 * 0.04 < core.std() < 1.1 * 0.04


@pytest.mark.parametrize("name", list(HULLS))
def test_every_effect_changes_the_readings_and_none_does_at_zero(name):
    hull = HULLS[name]
    rng = np.random.default_rng(0)
    model = outside.true_model(hull, rng, 0.0)
    policy = orders.full(rng, hull, model.sensing)[0]
    rows = 80

    def readings(m):
        track = simulate(m, policy, rows, hull.step, 10, (1.0, 2.0, 0.4, 0.5 * hull.speed), fine=2)
        return sensors.true_readings(track, m.sensing, np.arange(rows) * hull.step)

    before = readings(model)
    for key, effect in effects.catalogue(hull).items():
        if effect.onset or key.startswith("roll"):
            continue
        changed = model.copy()
        values = effect.put(changed, hull, effect.first, effects.typical_extra(effect, hull))
        assert set(effect.main) <= set(values), key
        after = readings(changed)
        if key not in ("deadband", "backlash", "thrust-saturation"):  # not in every manoeuvre
            assert max(np.abs(after[c] - before[c]).max() for c in before) > 1e-6, key


def test_no_hull_has_an_effect_that_the_tool_holds_impossible_for_it():
    from diffsea import EFFECTS
    from diffsea.vessel import files

    for hull in HULLS.values():
        vessel = files.build(hull.document)
        for key in effects.catalogue(hull):
            variants = [e for n, e in EFFECTS.items() if n.split(":")[0] == key.split(":")[0]]
            exact = [e for e in variants if e.name == key]
            assert any(e.possible(vessel) for e in exact or variants), (hull.name, key)


def test_an_effect_has_one_name_only():
    """N_uv is the Munk moment: drawn as damping it would be called by either name."""
    assert not any("N_uv" in key for hull in HULLS.values() for key in effects.catalogue(hull))


# Cases


CASE = {"id": "c0001", "hull": "usv", "stratum": "single", "seed": 11, "effects": [
    {"key": "current", "limits": 20.0, "size": 0.3, "extra": {"direction": 1.0}}]}  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    (folder / "sealed").mkdir()
    write_case(CASE, folder)
    return folder


def test_an_effect_that_makes_a_run_diverge_is_halved(monkeypatch):
    whole, runs, bad = draw.run, [], {2, 9}

    def diverging(model, *arguments):
        track = whole(model, *arguments)
        runs.append(track)
        if len(runs) in bad:
            track.states[-1] = np.nan
        return track

    monkeypatch.setattr(draw, "run", diverging)
    _, truth = draw.make_case(CASE)
    assert len(runs) == 2 + 6
    for before, after in zip(CASE["effects"], truth["effects"], strict=True):
        assert after["limits"] == 0.5 * before["limits"] and after["size"] == 0.5 * before["size"]
    with pytest.raises(ValueError, match="c0001"):
        draw.make_case(CASE | {"effects": []})


@pytest.mark.parametrize(
    ("channel", "value", "sails"),
    [("u", 2.5, True), ("u", 3.0, False), ("v", -3.0, False), ("phi", 0.9, True),
     ("phi", -1.2, False), ("r", math.nan, False)],
)  # fmt: skip
def test_a_run_that_is_none_of_a_vessel_is_told(channel, value, sails):
    """The tanker's typical speed is 0.55 m/s."""
    states = np.zeros((5, 7))
    states[2, CHANNELS.index(channel)] = value
    track = Track(np.arange(5.0), states, np.zeros((5, 2)), [], np.zeros((5, 3)))
    assert draw._sails(track, HULLS["tanker"]) == sails


def test_a_run_that_turns_for_ever_faster_diverges():
    z = np.array([0.0, 0.0, math.inf, *np.zeros(7)])
    model = build(USV.document)
    servos = {name: Servo(model.channel(name), 0.0) for name in ("port", "starboard")}
    with pytest.raises(ArithmeticError, match="diverges"):
        derivative(model, servos, None, 0.0)[1](z, 0.0)


def test_a_case_follows_from_its_seed(written):
    recordings, truth = draw.make_case(CASE)
    run1 = (written / "cases/c0001/train/run1.csv").read_text(encoding="utf-8")
    assert csv_text(recordings[0]) == run1
    assert truth["named"] == {"current": {"speed": 0.3, "direction": 1.0}}
    other, _ = draw.make_case({**CASE, "seed": 12})
    assert csv_text(other[0]) != run1
    assert len(run1.splitlines()) == USV.rows + 1


def test_what_the_tool_is_shown_has_no_hint(written):
    shown = list((written / "cases").rglob("*"))
    text = " ".join(str(p.relative_to(written)) for p in shown)
    vessel = (written / "cases/c0001/vessel.toml").read_text(encoding="utf-8")
    assert "current" not in text + vessel and "effect" not in vessel
    names = [p.name for p in sorted(shown) if p.suffix == ".csv"]
    assert sorted(names) == [f"run{k}.csv" for k in range(1, 7)]


def test_true_derivatives_are_a_quarter_off_and_anchors_exact():
    ratios = []
    for seed in range(60):
        model = outside.true_model(USV, np.random.default_rng(seed))
        given = USV.document["hull"]
        assert model.hull["mass"] == given["mass"] and model.hull["length"] == given["length"]
        ratios += [math.log(model.hull[k] / given[k]) for k in ("X_u", "Y_v", "N_r", "Y_vdot")]
    assert 0.17 < np.std(ratios) < 0.3 and abs(np.mean(ratios)) < 0.06


@pytest.mark.skipif(not draw.LIMITS.exists(), reason="limits.json is not there yet")
def test_plan_is_balanced_and_sets_share_nothing():
    plans = {s: draw.plan(s, 400, 5) for s in ("develop", "scored")}
    for cases in plans.values():
        sizes = [e["limits"] for c in cases for e in c["effects"] if c["stratum"] == "single"]
        assert min(sizes) > 0.4 and max(sizes) <= draw.MOST
        # Log-uniform from 1 to 30 has 0.39 of it; less where large sizes are not plausible.
        assert 0.2 < np.mean(np.array(sizes) > 8.0) < 0.6
        assert {c["stratum"] for c in cases} == set(draw.SHARES)
        named = {e["key"] for c in cases for e in c["effects"]}
        assert len({k.split(":")[0] for k in named}) >= 27
    assert not {c["hull"] for c in plans["develop"]} & {c["hull"] for c in plans["scored"]}
    small = draw.subset(plans["scored"], 40)
    assert len(small) == 40 and len({c["stratum"] for c in small}) == len(draw.SHARES)
    assert draw.plan("develop", 400, 5) == plans["develop"]


def test_sets_beside_the_scored_one():
    three = draw.plan("triples", 24, 5)
    names = [{e["key"].split(":")[0] for e in c["effects"]} for c in three]
    assert all(len(n) == 3 for n in names) and len(set.union(*names)) > 15
    standard = draw.plan("standard", 24, 5)
    assert all(len(c["effects"]) == 1 for c in standard)
    hulls = {c["hull"] for c in draw.plan("scored", 24, 5)}
    assert {c["hull"] for c in three} == {c["hull"] for c in standard} == hulls


def test_several_effects_and_those_of_standard_trials_are_of_a_good_size():
    least_of = {"pair": 4.0, "triple": 4.0, "standard": 8.0, "alike": 4.0, "short": 4.0}
    for seed, name in enumerate(("develop", "scored", "triples", "standard", "alike", "short"), 5):
        cases = draw.plan(name, 400, seed)
        for stratum, least in least_of.items():
            found = [e["limits"] for c in cases if c["stratum"] == stratum for e in c["effects"]]
            assert all(least - 1e-3 <= x <= draw.MOST for x in found), (name, stratum)


def test_a_benign_cubic_is_a_twentieth_at_twice_the_typical_yaw_rate():
    seen = set()
    for hull in (HULLS["catamaran"], HULLS["skiff"], HULLS["launch"]):
        for seed in range(30):
            model, top = build(hull.document), 2.0 * hull.yaw
            done = outside.benign(model, hull, np.random.default_rng(seed))
            seen |= set(done)
            linear = model.hull["N_r"] + model.hull.get("N_rr", 0.0) * top
            assert 0.0 <= done.get("cubic", 0.0) / linear * top**2 <= 0.05 + 1e-9
            # There is no exponent to change where drag has no quadratic part.
            assert "power" not in done or "X_uu" in model.hull
    assert seen == {"cubic", "coupling", "bend", "power"}


def test_standard_trials_are_zigzags_and_circles():
    model = outside.true_model(USV, np.random.default_rng(1))
    found = orders.RUN_SETS["standard"](np.random.default_rng(2), USV, model.sensing)
    assert [type(p) for p in found] == 3 * [orders.Zigzag, orders.Table]
    assert len({tuple(p.stages) for p in found[::2]}) == 3


def test_runs_of_one_kind_are_of_one_kind_and_the_kinds_differ():
    kinds = set()
    for seed in range(12):
        model = outside.true_model(USV, np.random.default_rng(seed))
        found = orders.RUN_SETS["alike"](np.random.default_rng(seed), USV, model.sensing)
        assert len(found) == 6 and len({type(policy) for policy in found}) == 1
        kinds.add((type(found[0]), len(getattr(found[0], "rows", ()))))
    assert len(kinds) >= 3


def test_detection_limit_of_a_gyro_bias_is_near_its_floor():
    """White noise alone would give 3 sigma / sqrt(n); gusts and nuisances cannot make it less."""
    gyro = USV.instruments["gyro"]
    std = math.hypot(gyro.std, gyro.quantum / math.sqrt(12.0))
    floor = 3.0 * std / math.sqrt(4 * USV.rows)
    found = limits.detection_limits(USV, lambda m: None, ("gyro-bias",))["gyro-bias"]
    assert 0.93 * floor < found < 1.5 * floor


def test_search_finds_the_aim_of_a_steep_response_and_returns_what_it_evaluated():
    steep = lambda s: 1e3 * max(s - 0.05, 0.0) ** 1.5 + 1e6 * max(s - 0.06, 0.0) ** 4
    for first in (1e-4, 0.02, 0.7):
        size, found = limits.search(steep, first, 0.75, 3.0, 1.01)
        assert found == steep(size) and found == pytest.approx(3.0, rel=0.01)
    size, found = limits.search(lambda s: s, 1e-6, 50.0, 0.15, 1.5)
    assert found == size and 0.1 <= found <= 0.225
    assert limits.search(lambda s: 0.1 * s, 1e-3, 0.5, 3.0, 1.01) == (0.5, pytest.approx(0.05))


def test_detection_limit_of_a_dead_band_is_its_slope_at_zero_wherever_the_search_starts():
    known = draw.limits("skiff")["deadband"]
    found = limits.detection_limits(
        HULLS["skiff"], lambda m: None, ("deadband",), {"deadband": 30 * known}
    )
    assert found["deadband"] == pytest.approx(known, rel=0.03)


def test_detection_limits_are_plausible_sizes():
    for hull in HULLS.values():
        entries, found = effects.catalogue(hull), draw.limits(hull.name)
        assert set(found) <= set(entries) and "thrust-saturation" in draw.available(hull), hull.name
        assert found["thrust-saturation"] < entries["thrust-saturation"].most
    quiet = limits.detection_limits(USV, lambda m: None, ())
    assert quiet == {}


def test_schedule_is_sailed_as_written_and_to_its_end(tmp_path):
    path = tmp_path / "next.csv"
    end = 1.5 * USV.rows * USV.step
    text = f"t,cmd_port,cmd_starboard\n0,100,100\n10.1,50,-20\n{end},50,-20\n"
    path.write_text(text, encoding="utf-8")
    found = resolve.record(CASE, path, None)
    assert found["t"][-1] == pytest.approx(end, abs=USV.step) and end > USV.rows * USV.step
    assert found["cmd_starboard"][50] == 100.0 and found["cmd_starboard"][51] == -20.0
    by_name = resolve.record(CASE, None, "turning-circle")
    assert np.unique(by_name["cmd_port"]).size >= 3


# Sealing


def test_sealed_process_cannot_open_the_truth(tmp_path):
    truth = tmp_path / "sealed"
    truth.mkdir()
    (truth / "c0001.json").write_text("{}", encoding="utf-8")
    (tmp_path / "open.json").write_text("{}", encoding="utf-8")
    (tmp_path / "link.json").symlink_to(truth / "c0001.json")
    program = f"""
import os, sys, pathlib, subprocess
sys.path.insert(0, {str(ROOT)!r})
from experiments.concealed import sealing
os.chdir({str(tmp_path)!r})
sealing.seal(pathlib.Path("sealed"))
open("open.json").close()
ways = [lambda: open("sealed/c0001.json"), lambda: open("link.json"), lambda: os.listdir("sealed"),
        lambda: os.open("sealed/../sealed/c0001.json", os.O_RDONLY),
        lambda: pathlib.Path("sealed/c0001.json").read_text(),
        lambda: os.rename("sealed", "moved"), lambda: os.symlink("sealed", "other"),
        lambda: subprocess.run(["cat", {str(truth / "c0001.json")!r}])]
for k, way in enumerate(ways):
    try:
        way()
    except sealing.TruthIsSealed:
        continue
    print("opened", k)
print("done")
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stdout.split() == ["done"], ran.stdout + ran.stderr


def test_the_worker_is_sealed(tmp_path):
    """A tool that looks for the truth fails on its case; an honest one is recorded."""
    for name in ("c0001", "c0002"):
        (tmp_path / "cases" / name / "train").mkdir(parents=True)
    (tmp_path / "sealed").mkdir()
    (tmp_path / "sealed" / "c0001.json").write_text("secret", encoding="utf-8")
    program = f"""
import sys, types, pathlib
sys.path.insert(0, {str(ROOT)!r})
cli = types.ModuleType("diffsea.cli")
def main(argv):
    if "c0001" in argv[1]:
        print(open({str(tmp_path / "sealed/c0001.json")!r}).read())
    return 0
cli.main = main
sys.modules["diffsea"], sys.modules["diffsea.cli"] = types.ModuleType("diffsea"), cli
from experiments.concealed import run
run.work(0, pathlib.Path({str(tmp_path)!r}), ["c0001", "c0002"],
         {{"tool": {{"source_sha256": "x"}}}}, 1)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    read = lambda n: json.loads((tmp_path / "results" / n / "run.json").read_text("utf-8"))
    assert "TruthIsSealed" in read("c0001")["error"] and "secret" not in ran.stdout
    assert read("c0002")["error"] is None and read("c0002")["status"] == 0


def test_scores_refuse_a_truth_that_was_changed(written):
    was = {k: sealing.manifest(written / k) for k in ("cases", "sealed")}
    (written / "manifest.json").write_text(json.dumps(was), encoding="utf-8")
    score.check_seal(written)
    path = written / "sealed" / "c0001.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("0.3", "0.4"), encoding="utf-8")
    with pytest.raises(SystemExit, match="not what"):
        score.check_seal(written)
    path.write_text(text, encoding="utf-8")


# Scores


def truth(stratum="single", key="current", size=20.0, **named):
    named = named or {key.split(":")[0]: {}}
    return {"id": "c0000", "hull": "usv", "stratum": stratum, "named": named,
            "effects": [{"key": key, "limits": size}] if stratum == "single" else []}  # fmt: skip


def said(verdict, *names, rivals=(), odds=None, **parameters):
    entries = [{"name": n, "parameters": parameters.get(n, {}), "evidence": {"log10_odds": odds},
                "alternatives": list(rivals)} for n in names]  # fmt: skip
    where = [{"degree_of_freedom": "sway"}]
    return {"verdict": verdict, "effects": entries, "where": where, "audit": []}


def one(t, d, seconds=10.0):
    return outcomes.judge(t, d, {"seconds": seconds, "warm": True, "error": None})


def test_a_table_of_cases_is_read_as_it_was_written(tmp_path):
    case = outcomes.Outcome(
        "c0001", "usv", "pair", ["sensor-latency", "mass-change"],
        ["sensor-latency:position", "mass-change"], [11.4, 22.5], "explained",
        ["mass-change", "sensor-latency"], [], [2451.0, None],
    )  # fmt: skip
    report.write(tmp_path, score.score([case], [], []) | {"baselines": None}, [case])
    (read,) = outcomes.read_table(tmp_path / "cases.csv")
    assert read.true == ["sensor-latency", "mass-change"] and read.limits == [11.4, 22.5]
    assert read.named == ["mass-change", "sensor-latency"] and read.log10_odds == [2450.0, None]


def test_wilson_intervals():
    assert score.wilson(0, 10) == pytest.approx((0.0, 0.27753), abs=2e-5)
    assert score.wilson(5, 10) == pytest.approx((0.23659, 0.76341), abs=2e-5)
    assert all(math.isnan(x) for x in score.wilson(0, 0))


def test_names_are_judged():
    right = one(truth(), said("explained", "current"))
    assert right.right and right.top and not right.wrong and right.where
    wrong = one(truth(), said("explained", "wind", rivals=["current"]))
    assert wrong.decided and wrong.wrong and not wrong.right and "current" in wrong.offered
    unsure = one(truth(), said("ambiguous", "wind", rivals=["current"]))
    assert not unsure.decided and not unsure.wrong
    lost = one(truth(), said("ambiguous", "wind", rivals=["wave-force"]))
    assert lost.wrong
    extra = one(truth(), said("explained", "current", "wind"))
    assert extra.top and extra.wrong and not extra.right
    nothing = one(truth(stratum="clean"), said("unexplained", "unexplained"))
    assert not nothing.named and not nothing.wrong
    assert one(truth(), None).verdict == "failed"


def test_parameters_are_judged():
    p = lambda value, std: {"value": value, "std": std}
    true = {"current": {"speed": 0.3, "direction": 3.1}}
    found = {"speed": p(0.33, 0.01), "direction": p(-3.1, 0.06)}
    o = one(truth(**true), said("explained", "current", current=found))
    assert o.errors["current.speed"] == pytest.approx(0.1)
    assert o.angles["current.direction"] == pytest.approx(2 * math.pi - 6.2)
    assert o.covered == {"current.speed": False, "current.direction": True}
    lever = {"lever-arm": {"x": 0.3, "y": 0.4}}
    found = {"x": p(0.3, 0.1), "y": p(0.5, 0.1)}
    o = one(truth(key="lever-arm", **lever), said("explained", "lever-arm", **{"lever-arm": found}))
    assert o.errors["lever-arm.x+y"] == pytest.approx(0.2)
    assert o.where is None  # no force is missing
    step = {"drag-change": {"time": 50.0, "factor": 0.2}}
    for time, hit in ((53.0, True), (57.0, False)):
        found = {"time": p(time, 1.0), "factor": p(0.2, 0.1)}
        o = one(truth(key="drag-change", **step),
                said("explained", "drag-change", **{"drag-change": found}))  # fmt: skip
        assert o.onset is hit


def test_a_name_in_the_wrong_place_is_right_but_not_strictly():
    def strict(hull, key, values, entry):
        t = {**truth(key=key, **{key.split(":")[0]: values}), "hull": hull}
        d = said("explained", key.split(":")[0])
        d["effects"][0] |= entry
        o = one(t, d)
        assert o.right
        return o.strict

    p = {"value": 1.0, "std": 0.1}
    late = {"delay": 1.0, "channels": ["x", "y"]}
    for channels, hit in ((["y", "x"], True), (["psi"], False)):
        entry = {"parameters": {"delay": p}, "channels": channels}
        assert strict("usv", "sensor-latency:position", late, entry) is hit
    for name, hit in (("Y_ur", True), ("N_ur", False)):
        entry = {"parameters": {name: p}}
        assert strict("usv", "speed-dependent-damping:Y_ur", {"Y_ur": 1.0}, entry) is hit
    lag = {"time_constant": 1.0, "actuators": ["port", "starboard"]}
    bias = {"bias": 1.0, "actuators": ["port"]}
    slow = {"parameters": {"time_constant": p}}
    forces = ["port.force", "starboard.force"]
    assert strict("usv", "thrust-lag", lag, slow)  # all channels: not listed
    assert strict("launch", "thrust-lag", lag, slow | {"actuators": forces})
    assert not strict("launch", "thrust-lag", lag, slow | {"actuators": ["port.angle"]})
    assert strict("launch", "actuator-bias", bias, {"parameters": {"bias": p}} | {
        "actuators": ["port.force"]})  # fmt: skip
    assert not strict("usv", "actuator-bias", bias, {"parameters": {"bias": p}})


def test_odds_are_those_of_their_names():
    d = said("explained", "wind", "wind", "current")
    for entry, odds in zip(d["effects"], (9.0, 8.0, 0.5), strict=True):
        entry["evidence"]["log10_odds"] = odds
    o = one(truth(), d)
    assert (o.named, o.log10_odds) == (["wind", "current"], [9.0, 0.5])
    stated = {r["log10_odds_from"]: r["true"]["n"] for r in score.reliability([o])}
    assert stated[None] == 1 and stated[5.0] == 1


def test_confusion_and_errors_by_effect_are_of_single_effects():
    found = {"speed": {"value": 0.33, "std": 0.1}}
    alone = one(truth(current={"speed": 0.3}), said("explained", "current", current=found))
    straight = one(truth(), said("explained", "current"))
    straight.stratum = "uninformative"
    beside = one(truth(current={"speed": 0.3}), said("explained", "current", "wind",
                 current={"speed": {"value": 0.9, "std": 0.1}}))  # fmt: skip
    beside.stratum, beside.limits = "pair", [9.0, 9.0]
    everything = [alone, straight, beside, one(truth("clean"), said("consistent"))]
    assert report.confusion(everything)[2].sum() == 2
    by_effect = score.score(everything, [], [])["by_effect"]
    assert by_effect["current"]["parameter error, median"] == pytest.approx(0.1)


def test_figures_and_files(tmp_path):
    clean = [one(truth("clean"), said("consistent")) for _ in range(9)]
    clean.append(one(truth("clean"), said("explained", "wind", odds=1.5)))
    sizes = (1.5, 3.0, 10.0, 20.0)
    single = [one(truth(size=s), said("explained", "current", odds=4.0)) for s in sizes]
    single.append(one(truth(size=12.0), said("ambiguous", "wind", rivals=["current"])))
    single.append(one(truth(size=1.2), said("consistent")))
    out = [one(truth("outside"), said(*v)) for v in (("unexplained",), ("explained", "wind"))]
    everything = [*clean, *single, *out]
    gains = [{"nominal": 5.0, "true": 1.0, "diagnosed": 2.0}]
    found = score.score(everything, [{"resolved": True}], gains)
    hits = {k: (v["hits"], v["n"]) for k, v in found["rates"].items()}
    assert hits["false alarms, clean"] == (1, 10)
    assert hits["named rightly, of decided, at least 8 limits"] == (2, 2)
    assert hits["named rightly, of all, at least 8 limits"] == (2, 3)
    assert hits["truth in the set offered, of all"] == (5, 6)
    assert hits["wrong name, any case"] == (2, 18)
    assert hits["outside the catalogue: no catalogue name"] == (1, 2)
    assert found["numbers"]["share of the true structure's held-out gain"] == pytest.approx(0.75)
    assert [row["right"]["n"] for row in found["power"]] == [2, 1, 0, 2, 1]
    stated = {r["log10_odds_from"]: r["true"]["hits"] for r in found["reliability"]}
    assert stated[3.0] == 4 and stated[1.0] == 0
    report.write(tmp_path, {**found, "baselines": []}, everything)
    rows, columns, counts = report.confusion(everything)
    assert counts.sum() == 18 and counts[rows.index("current"), columns.index("current")] == 4
    json.loads((tmp_path / "scores.json").read_text(encoding="utf-8"))
    assert "| false alarms, clean | 10 % (2 to 40), 1/10 |" in (tmp_path / "scores.md").read_text()
    failures = (tmp_path / "failures.csv").read_text(encoding="utf-8")
    assert failures.count("wrong name") == 2 and failures.count(",ambiguous,") == 2
    lines = (tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(everything) > len(failures.splitlines())
    (tmp_path / "confusion.png").unlink()
    matrix = (tmp_path / "confusion.csv").read_text()
    (tmp_path / "confusion.csv").unlink()
    score.main(["--table", str(tmp_path / "cases.csv")])
    parts = (tmp_path / "scores.md").read_text().partition("\n\n| size")[2]
    assert (tmp_path / "parts.md").read_text().endswith(parts)
    assert (tmp_path / "confusion.csv").read_text() == matrix
    assert (tmp_path / "confusion.png").stat().st_size > 2000


def test_baselines_find_a_gross_gyro_bias(tmp_path):
    (tmp_path / "sealed").mkdir()
    case = {**CASE, "effects": [{"key": "gyro-bias", "limits": 99.0, "size": 0.02,
                                 "extra": {"side": 1.0}}]}  # fmt: skip
    write_case(case, tmp_path)
    here = tmp_path / "cases" / "c0001"
    problem = terms.regression(here, sorted((here / "train").glob("*.csv"))[:3])
    for name, method in baselines.METHODS.items():
        assert method(problem)[0] == "gyro-bias", name


def test_screened_names_are_those_of_the_catalogue(tmp_path):
    here = tmp_path / "results" / "c0001"
    here.mkdir(parents=True)
    seen = [{"name": "thrust-lag:propulsion", "p_value": 1e-9, "score": 50.0},
            {"name": "current", "p_value": 0.2, "score": 4.0}]  # fmt: skip
    (here / "diagnosis.json").write_text(json.dumps({"screening": seen}), encoding="utf-8")
    assert baselines.screened(tmp_path, "c0001") == ["thrust-lag"]


def test_hard_iron_column_is_what_hard_iron_does_to_the_residual():
    hull, rng = HULLS["catamaran"], np.random.default_rng(3)
    model = outside.true_model(hull, rng, 0.0)
    policy = orders.full(rng, hull, model.sensing)[0]
    track = simulate(model, policy, 251, hull.step, 75, (0.0, 0.0, 0.3, 0.8))
    t = np.arange(251) * hull.step

    def parts(amplitude):
        sensing = Sensing(iron_amplitude=amplitude, iron_phase=0.7)
        d = {"t": t, **sensors.true_readings(track, sensing, t)}
        d |= {f"cmd_{n}": track.orders[:, i] for i, n in enumerate(track.labels)}
        return terms._run(build(hull.document), d)

    (before, _, found), (after, _, _) = parts(0.0), parts(1e-3)
    change = (after - before)[:3].ravel()
    column = found["hard-iron"][:3].reshape(-1, 2)
    left = change - column @ np.linalg.lstsq(column, change, rcond=None)[0]
    assert left @ left < 1e-3 * (change @ change)


def test_what_a_nuisance_mimics_has_a_limit_of_three_prior_deviations_at_least():
    # A Munk moment is N_uv by another name: no record shows it below what N_uv may be off.
    for hull in HULLS.values():
        lift = hull.document["hull"].get("N_uv")
        if lift is not None:
            limit = draw.limits(hull.name)["munk-moment"]
            assert limit > 0.99 * limits.SIGMA * outside.SPREAD * abs(lift), hull.name
    assert draw.limits("craft")["munk-moment"] == pytest.approx(9.75, rel=0.01)


def test_the_figures_since_laws_are_asked_as_one_are_those_of_the_results():
    folder = Path(score.__file__).parent
    page = (folder / "README.md").read_text(encoding="utf-8")
    told = page[page.index("**Since laws") : page.index("**Winds on superstructures")]
    results = json.loads((folder / "results" / "laws.json").read_text(encoding="utf-8"))
    assert results["revision"] in told and f"balanced part of {results['cases']}" in told
    for name in (
        "named rightly, of decided",
        "named rightly, of all",
        "pairs: both named, nothing else",
        "wrong name, any case",
        "false alarms, clean",
        "false alarms, benign misfit",
        "90 % intervals that hold the truth",
    ):
        found = results["rates"][name]
        assert f"{found['hits']}/{found['n']}" in told, name


def test_the_figures_of_few_runs_are_those_of_the_results():
    folder = Path(score.__file__).parent
    page = (folder / "README.md").read_text(encoding="utf-8")
    told = page[page.index("**One manoeuvre alone") : page.index("**Winds on superstructures")]
    results = json.loads((folder / "results" / "few_runs.json").read_text(encoding="utf-8"))
    assert results["revision"] in told
    for name, figures in results["sets"].items():
        assert f"`{name}`" in told and f"{figures['cases']} cases" in told
        row = next(line for line in told.splitlines() if line.startswith(f"| `{name}`"))
        for rate, found in figures["rates"].items():
            assert f"{found['hits']}/{found['n']}" in row, (name, rate)
