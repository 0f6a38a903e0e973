# pyright: reportArgumentType=false
"""Injections into real recordings are what they say; retellings tell the same; cases are fair."""

import ast
import copy
import json
import math

from experiments.concealed_real import cases, facts, features, injections, retellings, sets
from experiments.concealed_real.injections import DROPPED, INJECTIONS, injected, undone
from experiments.concealed_real.material import MOTION, Material

import numpy as np
import pandas as pd
import pytest
from tests.oracle import sensors, simulator
from tests.paths import DATA, ORACLE, ROOT


FOLDER = ROOT / "experiments" / "concealed_real"
GENERATOR = (
    *("material", "sensor_injections", "order_injections", "injections", "features", "cases"),
    "retellings",
)
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real data under ../shared/data are absent")

STEP, ROWS = 0.1, 241
USV = simulator.load(ORACLE / "usv.toml")
SHIP = simulator.load(ORACLE / "ship.toml")
COLUMNS = ["cmd_port", "cmd_starboard"]
SIDES = {"cmd_port": -1.0, "cmd_starboard": 1.0}


# Independence


def test_generator_imports_nothing_of_the_tool():
    for name in GENERATOR:
        tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            found = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            found += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            for module in found:
                assert module.split(".")[0] not in ("diffsea", "jax", "importlib", "tests"), name
                if module.startswith("experiments"):
                    parts = [a.name for a in node.names] if module.count(".") == 1 else []
                    assert {module.rsplit(".", 1)[-1], *parts} <= {*GENERATOR, "concealed_real"}


# A noise-free simulated run so injected is the simulated run with that effect


def simulated(document, table, effects=None, state=(0.0, 0.0, 0.3, 1.0, 0.0, 0.0)):
    """The oracle's run under the orders of a table, as its sensors show it, without noise."""
    names = [c for c in table if c.startswith("cmd_")]
    orders = [
        (t, {c.removeprefix("cmd_"): row[c] for c in names})
        for t, row in zip(table["t"], table.to_dict("records"), strict=True)
    ]
    kept = [orders[0], *(b for a, b in zip(orders, orders[1:], strict=False) if a[1] != b[1])]
    sim = simulator.simulate(document, kept, table["t"].iloc[-1] + 1.0, effects, state)
    return pd.DataFrame(sensors.record(sim, table["t"].to_numpy(), wrapped=False))


def steps():
    """Orders of a twin-thruster boat in steps, none in the first second."""
    t = np.arange(ROWS) * STEP
    rng = np.random.default_rng(3)
    held = np.repeat(rng.uniform(-80.0, 180.0, (2, ROWS // 30 + 1)), 30, axis=1)[:, :ROWS]
    return pd.DataFrame({"t": t, "cmd_port": held[0], "cmd_starboard": held[1]})


def ramps():
    """Orders that move a little in every row."""
    t = np.arange(ROWS) * STEP
    return pd.DataFrame({"t": t, "cmd_port": 90 + 60 * np.sin(0.7 * t),
                         "cmd_starboard": 80 - 50 * np.sin(0.5 * t)})  # fmt: skip


ORDERS = {"columns": COLUMNS}
SENSOR_CASES = {
    "heading-offset": ({"size": 0.1, "side": -1.0}, {"angle": -0.1}),
    "hard-iron": ({"size": 0.1, "angle": 0.7}, {"amplitude": 0.1, "phase": 0.7}),
    "gyro-bias": ({"size": 0.02, "side": 1.0}, {"bias": 0.02}),
    "late-positions": ({"size": 0.23, "columns": ["x", "y"]}, {"delay": 0.23}),
    "late-heading": ({"size": 0.3, "columns": ["psi"]}, {"delay": 0.3, "channels": ["psi"]}),
    "late-velocities": ({"size": 0.17, "columns": ["u", "v"]},
                        {"delay": 0.17, "channels": ["u", "v"]}),
    "late-yaw-rate": ({"size": 0.2, "columns": ["r"]}, {"delay": 0.2, "channels": ["r"]}),
    "lever-arm": ({"size": 0.5, "angle": 0.6},
                  {"x": 0.5 * math.cos(0.6), "y": 0.5 * math.sin(0.6)}),
    "clock-drift": ({"size": 0.01, "side": 1.0}, {"rate": 0.01}),
}  # fmt: skip
ORDER_CASES = {
    "late-orders": ({"rows": 4, "size": 0.4, **ORDERS}, {"delay": 0.4}),
    "dead-band": ({"size": 12.0, **ORDERS}, {"width": 12.0}),
    "play": ({"size": 9.0, **ORDERS}, {"width": 9.0}),
    "order-bias": ({"size": 11.0, "side": -1.0, "columns": ["cmd_port"]},
                   {"bias": -11.0, "actuators": ["port"]}),
    "asymmetry": ({"size": 0.2, "side": 1.0, "sides": SIDES, **ORDERS}, {"ratio": 0.2}),
    "thrust-step": ({"size": 0.3, "side": -1.0, "time": 12.0, **ORDERS},
                    {"factor": -0.3, "time": 12.0}),
}  # fmt: skip


def apart(one, other):
    """Largest difference of the motion, relative to each channel's range, where both have it."""
    worst = 0.0
    for c in MOTION:
        a, b = one[c].to_numpy(), other[c].to_numpy()
        both = np.isfinite(a) & np.isfinite(b)
        assert both.mean() > 0.9
        worst = max(worst, float(np.abs(a - b)[both].max() / np.ptp(b[both])))
    return worst


@pytest.fixture(scope="module")
def plain():
    """A run without any effect, thrusters that answer at once."""
    return simulated(direct(USV), steps())


def direct(document):
    """A vessel whose actuators answer at once and without limits."""
    new = copy.deepcopy(document)
    for part in (*new.get("thruster", []), *new.get("rudder", []), *new.get("propeller", [])):
        for key in ("time_constant", "delay", "rate_limit", "deadband", "max_force", "min_force"):
            part.pop(key, None)
    return new


@pytest.mark.parametrize("key", SENSOR_CASES)
def test_a_sensor_injection_is_the_simulated_effect(plain, key):
    settings, values = SENSOR_CASES[key]
    name = INJECTIONS[key].names[0]
    effect = simulated(direct(USV), steps(), {name: values})
    # Velocities have kinks where orders step, which a spline between rows rounds off.
    kinks = 0.05 if key.startswith(("late", "clock")) else 1e-9
    seen = apart(effect, plain)
    assert seen > 1e-4
    assert apart(INJECTIONS[key].apply(plain, settings), effect) < kinks * seen


def test_an_injected_current_is_the_simulated_current(plain):
    settings = {"size": 0.3, "angle": 2.0}
    north, east = 0.3 * math.cos(2.0), 0.3 * math.sin(2.0)
    c, s = math.cos(0.3), math.sin(0.3)
    start = (0.0, 0.0, 0.3, 1.0 + north * c + east * s, -north * s + east * c, 0.0)
    values = {"speed": 0.3, "direction": 2.0}
    effect = simulated(direct(USV), steps(), {"current": values}, start)
    assert apart(INJECTIONS["current"].apply(plain, settings), effect) < 1e-8


@pytest.mark.parametrize("key", ORDER_CASES)
def test_a_vessel_with_the_fault_moves_as_recorded_under_the_new_orders(plain, key):
    settings, values = ORDER_CASES[key]
    told = INJECTIONS[key].apply(plain, settings)
    assert np.abs(told[COLUMNS] - plain[COLUMNS]).to_numpy().max() > 1.0
    effect = simulated(direct(USV), told, {INJECTIONS[key].names[0]: values})
    late = settings.get("rows", 0)
    assert apart(effect.iloc[late:], plain.iloc[late:]) < 1e-7
    assert apart(simulated(direct(USV), told), plain) > 1e-3


@pytest.mark.parametrize(
    "key, settings, values",
    [
        ("lagging-orders", {"size": 0.8, **ORDERS}, {"time_constant": 0.8}),
        ("loss-with-speed", {"size": 0.1, **ORDERS}, {"slope": 0.1}),
        ("loss-in-turns", {"size": 0.8, **ORDERS}, {"slope": 0.8}),
    ],
)
def test_so_does_one_whose_orders_move_all_the_time(key, settings, values):
    before = simulated(direct(USV), ramps())
    told = INJECTIONS[key].apply(before, settings)
    effect = simulated(direct(USV), told, {INJECTIONS[key].names[0]: values})
    # Within a row the preimage holds and what it stands for does not.
    without = apart(simulated(direct(USV), told), before)
    assert apart(effect, before) < 0.05 * without


# Undoing an injection gives the recording back


def some_settings(rng, key, known):
    """Settings of an injection, drawn as for a case with a limit of a hundredth of the largest."""
    injection = INJECTIONS[key]
    found = []
    for place in injection.places(known):
        settings = dict(place) | injection.extra(rng, known)
        columns = settings.get("columns") or [injection.scales[0][1] if injection.scales else "u"]
        largest = max(known["largest"].get(c, 1.0) for c in columns)
        size = 0.02 * min(largest, 1.0) if not key.startswith("late") else 3 * known["step"]
        size = 0.02 * largest if key in ("dead-band", "play", "order-bias", "restless-order",
                                         "feedback-offset") else size  # fmt: skip
        found.append(settings | {"size": min(size, injection.most(known, place)), "rows": 3})
    return found


@real
@pytest.mark.parametrize("name", list(sets.SETS))
def test_undoing_an_injection_gives_the_recording_back(name):
    whole = sets.SETS[name].load()
    first = next(iter(whole.train))
    material = Material(whole.document, {first: whole.train[first]}, {})
    known, rng, tried = features.features(material), np.random.default_rng(1), set()
    for key, injection in INJECTIONS.items():
        if injection.undo is None:
            continue
        for settings in some_settings(rng, key, known):
            tried.add(key)
            told = injected(material, key, settings)
            changed = material.train[first].compare(told.train[first])
            assert len(changed), key
            back = undone(told, key, settings).train[first]
            before = material.train[first]
            for column in before:
                a, b = (run[column].to_numpy()[10:-10] for run in (before, back))
                known_rows = np.isfinite(b)
                assert known_rows.mean() > 0.5, (key, column)
                # Between rows by splines: what scatters from row to row does not come back whole.
                scatter = known["scatter"].get(column, 0.0)
                loose = 6 * scatter if key == "clock-drift" else 0.0
                close = 1e-9 * max(known["largest"][column], 1.0)
                off = np.abs(a - b)[known_rows]
                assert np.quantile(off, 0.95) <= loose + close, (key, column)
    assert {"thinned", "smoothed", "quantised", "dropouts"}.isdisjoint(tried)
    assert "exchange" in tried or len(COLUMNS) and not injections.twins(known)


def test_latencies_of_whole_rows_come_back_exactly(plain):
    late = {"size": 3 * STEP, "columns": ["x", "y"]}
    there = INJECTIONS["late-positions"].apply(plain, late)
    assert np.allclose(there["x"].to_numpy()[3:], plain["x"].to_numpy()[:-3], atol=1e-12)
    back = INJECTIONS["late-positions"].undo(there, late)
    assert np.allclose(back["x"].to_numpy()[:-3], plain["x"].to_numpy()[:-3], atol=1e-12)


def test_dropped_terms_are_gone_and_nothing_else():
    for key, dropped in DROPPED.items():
        document = sets.document_of("kvlcc2")
        new = injections.without_terms(document, key)
        gone = set(document["hull"]) - set(new["hull"])
        assert gone == set(dropped.terms) & set(document["hull"])
        changed = {k for k, v in new["rudder"][0].items() if document["rudder"][0][k] != v}
        assert changed == {k for k, _ in dropped.rudder}
        assert document == sets.document_of("kvlcc2")


# Told otherwise


def test_a_mirrored_vessel_moves_as_the_mirrored_run():
    for document, table in (
        (direct(USV), steps()),
        (direct(SHIP), ship_orders()),
    ):
        run = simulated(document, table)
        told = retellings.mirrored(Material(document, {"a.csv": run}, {}))
        mirror = told.train["a.csv"]
        again = simulated(told.document, mirror, state=(0.0, 0.0, -0.3, 1.0, 0.0, 0.0))
        assert apart(again, mirror) < 1e-7
        assert apart(run, mirror) > 0.1
        back = retellings.mirrored(told)
        assert back.document == document and apart(back.train["a.csv"], run) < 1e-12


def ship_orders():
    """Rudder to both sides at constant revolutions."""
    t = np.arange(ROWS) * STEP
    names = {kind: SHIP[kind][0]["name"] for kind in ("rudder", "propeller")}
    rudder = 0.3 * np.sign(np.sin(0.5 * t + 0.3)) + 0.05
    return pd.DataFrame({"t": t, f"cmd_{names['rudder']}": rudder,
                         f"cmd_{names['propeller']}": np.full(ROWS, 8.0)})  # fmt: skip


def test_a_turned_and_moved_run_is_the_run_begun_elsewhere(plain):
    told = retellings.retold(Material(direct(USV), {"a.csv": plain}, {}))
    c, s = math.cos(retellings.TURN), math.sin(retellings.TURN)
    heading = 0.3 + retellings.TURN
    again = simulated(direct(USV), steps(), state=(0.0, 0.0, heading, 1.0, 0.0, 0.0))
    assert apart(told["turned"].train["a.csv"], again) < 1e-8
    assert c * plain["x"].iloc[-1] - s * plain["y"].iloc[-1] == pytest.approx(
        told["turned"].train["a.csv"]["x"].iloc[-1]
    )
    moved = told["moved"].train["a.csv"]
    assert np.ptp(moved["x"] - plain["x"]) < 1e-9 and (moved["x"] - plain["x"]).iloc[0] > 100


def test_a_current_that_is_told_is_in_the_vessel_file(plain):
    told = retellings.in_known_current(Material(direct(USV), {"a.csv": plain}, {}))
    (effect,) = told.document["effect"]
    drift = told.train["a.csv"]["x"] - plain["x"]
    assert drift.iloc[-1] == pytest.approx(
        effect["speed"] * math.cos(effect["direction"]) * plain["t"].iloc[-1]
    )


def test_cut_runs_have_all_rows_and_the_order_is_reversed(plain):
    material = Material(direct(USV), {"a.csv": plain, "b.csv": plain}, {"c.csv": plain})
    cut = retellings.cut_in_two(material)
    assert sum(len(run) for run in cut.runs.values()) == 3 * ROWS and len(cut.runs) == 6
    assert list(retellings.reordered(material).train) == ["b.csv", "a.csv"]


def test_what_is_found_is_translated():
    p = lambda value: {"value": value, "std": 0.1}
    flow = {"name": "current", "parameters": {"speed": p(0.3), "direction": p(3.0)}}
    told = retellings.RETELLINGS["turned"].translate(flow, USV)
    assert told["parameters"]["direction"]["value"] == pytest.approx(3.0 + retellings.TURN)
    around = copy.deepcopy(told)
    around["parameters"]["direction"]["value"] -= 2 * math.pi
    assert max(retellings.difference(around, told).values()) < 1e-9
    trim = {"name": "actuator-bias", "actuators": ["rudder"], "parameters": {"bias": p(0.1)}}
    mirrored = retellings.RETELLINGS["mirrored"].translate(trim, sets.document_of("kvlcc2"))
    assert mirrored["parameters"]["bias"]["value"] == -0.1
    step = {"name": "thrust-change", "parameters": {"time": p(50.0), "factor": p(-0.2)}}
    later = retellings.RETELLINGS["later"].translate(step, USV)
    assert later["parameters"]["time"]["value"] == 50.0 + retellings.LATER
    assert step["parameters"]["time"]["value"] == 50.0


# Cases


def frozen(plain):
    """A set's frozen record, with a limit for everything that could have one."""
    known = features.features(Material(USV, {"a.csv": plain}, {}))
    stated = {
        scale for injection in INJECTIONS.values() for scale in injection.scales
        if scale[0] not in ("scatter", "row")
    }  # fmt: skip
    limits = [{"name": n, "parameter": p, "unit": "", "limit": 0.01} for n, p in sorted(stated)]
    limits += [{"name": "actuator-bias", "parameter": "bias", "unit": "N", "limit": None}]
    parameters = [{"name": "X_uu", "value": -60.0, "std": 5.0},
                  {"name": "N_rr", "value": -900.0, "std": 500.0}]  # fmt: skip
    return {"features": known, "limits": limits, "parameters": parameters, "document": USV,
            "seconds": 30.0, "names": []}  # fmt: skip


def test_cases_are_drawn_by_seed_with_sizes_in_limits(plain):
    both = {"one": frozen(plain), "other": frozen(plain) | {"seconds": 300.0}}
    drawn = cases.draw_cases(both, 200, 5)
    assert drawn == cases.draw_cases(both, 200, 5) != cases.draw_cases(both, 200, 6)
    assert len(drawn) == len({case["id"] for case in drawn}) == 200
    sizes = [case["limits"] for case in drawn if case["limits"] and case["limit"]]
    assert min(sizes) >= 0.5 and max(sizes) <= 30.5  # whole rows may be less than a limit
    assert 0.3 < np.mean([size < math.sqrt(30.0) for size in sizes]) < 0.7
    assert {case["set"] for case in drawn[:4]} == {"one", "other"}
    kinds = {case["injection"] for case in drawn}
    assert {"without-X_uu", "current", "restless-order", "asymmetry"} <= kinds
    assert "without-N_rr" not in kinds and "feedback-offset" not in kinds
    json.dumps(drawn)
    for case in drawn:
        told = cases.truth(case)
        assert set(told["numbers"]) <= {"speed", "direction", "angle", "amplitude", "bias",
            "delay", "x", "y", "rate", "time_constant", "width", "ratio", "exponent", "slope",
            "factor", "time"}  # fmt: skip


def test_a_subset_keeps_to_its_time(plain):
    seconds = {"one": 30.0, "other": 300.0}
    both = {name: frozen(plain) | {"seconds": s} for name, s in seconds.items()}
    few = cases.subset(cases.draw_cases(both, 200, 5), seconds)
    assert len(few) == 20 and sum(seconds[case["set"]] for case in few) <= 1000.0


def test_what_is_frozen_stays(tmp_path):
    path = tmp_path / "cases.json"
    cases.freeze(path, {"seed": 1})
    cases.freeze(path, {"seed": 1})
    with pytest.raises(SystemExit, match="frozen"):
        cases.freeze(path, {"seed": 2})


# Facts and sets


@real
def test_every_fact_has_its_recordings():
    for key, fact in facts.FACTS.items():
        material = fact.material()
        assert material.train and (fact.audit_only or material.test), key


@real
def test_orders_of_the_zig_zag_hide_the_rudder():
    run = facts.steering_gear().runs["HSVA_CPMC_KVLCC2_Z_20_10_S.dat"]
    assert "exec_rudder" not in run
    assert set(np.round(np.degrees(run["cmd_rudder"]))) == {-20.0, 0.0, 20.0}


def test_checks_see_names_sizes_and_audits():
    line = {
        "verdict": "explained", "audit": [{"kind": "axes", "recording": "a.csv", "value": 1.0}],
        "effects": [{"name": "actuator-response", "actuators": ["a1.angle"],
                     "parameters": {"delay": {"value": 0.6}}}],
    }  # fmt: skip
    late = lambda low, high, where: facts.within("", ("actuator-response",), "delay", low, high,
                                                 (where,)).holds(line)  # fmt: skip
    assert late(0.5, 0.7, ".angle") and not late(0.5, 0.7, ".force")
    assert not late(0.2, 0.5, ".angle")
    assert facts.audited("axes", ["a"]).holds(line)
    assert not facts.audited("axes", ["a", "b"]).holds(line)
    assert not facts.not_audited("axes", ["a"]).holds(line)
    assert facts.unnamed(("wind",)).holds(line)
    welcome = facts.within("", ("wind",), "speed", 0.0, 1.0, welcome=True)
    assert welcome.holds(line) is None
