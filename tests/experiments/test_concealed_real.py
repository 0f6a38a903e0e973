# pyright: reportArgumentType=false
"""Injections into real recordings are what they say; retellings tell the same; cases are fair."""

import ast
import copy
import json
import math
import re

from experiments.concealed_real import (
    cases,
    facts,
    features,
    injections,
    judging,
    results,
    retellings,
    run,
    score,
    sensor_injections,
    sets,
)
from experiments.concealed_real.injections import DROPPED, INJECTIONS, injected, undone
from experiments.concealed_real.material import MOTION, Material

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest
from tests.oracle import sensors, simulator
from tests.paths import DATA, ORACLE, ROOT

import diffsea


FOLDER = ROOT / "experiments" / "concealed_real"
GENERATOR = (
    *("material", "sensor_injections", "order_injections", "injections", "features", "cases"),
    "retellings",
)
real = pytest.mark.skipif(not DATA.is_dir(), reason=f"no real recordings in {DATA}")

STEP, ROWS = 0.1, 241
USV = simulator.load(ORACLE / "usv.toml")
SHIP = simulator.load(ORACLE / "ship.toml")
COLUMNS = ["cmd_port", "cmd_starboard"]
SIDES = {"cmd_port": -1.0, "cmd_starboard": 1.0}


@pytest.mark.parametrize(("part", "columns"), [("first_look", 5), ("unchanged", 4)])
def test_what_the_page_says_of_real_sets_is_what_was_found(part, columns):
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in text.splitlines()]
    told = {row[0]: row for row in rows if len(row) == columns}
    lines = results.read(part, FOLDER / "results").values()
    assert lines
    for line in lines:
        _, verdict, named, ahead, *_ = told[line["id"]]
        assert verdict == line["verdict"], line["id"]
        assert named == (", ".join(results.names(line)) or "nothing"), line["id"]
        errors = [line["free"][model]["20"] for model in ("nominal", "diagnosed")]
        errors = [f"{one.get('position', one['u']):#.2g}".rstrip(".") for one in errors]
        assert ahead == " -> ".join(dict.fromkeys(errors)), line["id"]


def test_what_the_page_says_of_cases_run_again_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    unchanged = results.read("unchanged", FOLDER / "results")
    before = results.read("injected", FOLDER / "results")
    again = results.read("injected_again", FOLDER / "results")
    wrong = {True: [], False: []}  # by whether it was before
    for key, line in again.items():
        of_set = unchanged[line["case"]["set"]]
        had = bool(judging.judge(before[key], of_set).wrong)
        wrong[had].append(bool(judging.judge(line, of_set).wrong))
        assert line["revision"] != before[key]["revision"]
    told = (
        f"of the {len(wrong[True])} with a wrong name {sum(wrong[True])} have one still, and of "
        f"the {len(wrong[False])} others {sum(wrong[False])} have got one"
    )
    assert told in " ".join(text.split()) and f"Of these cases {len(again)} have been" in text


def test_what_the_page_says_of_another_revision_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    unchanged = results.read("unchanged", FOLDER / "results")
    again = results.read("again", FOLDER / "results")
    found = [judging.compare_again(line, unchanged[name]) for name, line in again.items()]
    assert set(again) == set(unchanged)
    assert {one["revision"] for one in again.values()}.isdisjoint(
        one["revision"] for one in unchanged.values()
    )
    same, apart = sum(one.same_names for one in found), max(one.apart for one in found)
    told = (
        f"the same names in {same} of {len(found)} sets, sizes within {apart:.2g} standard errors"
    )
    assert told in " ".join(text.split())


def test_another_revision_that_says_otherwise_is_not_the_same():
    unchanged = results.read("unchanged", FOLDER / "results")["kcs"]
    other = copy.deepcopy(unchanged)
    assert judging.compare_again(other, unchanged).holds
    delay = other["effects"][0]["parameters"]["delay"]
    delay["value"] += 0.2 * delay["std"]
    assert not judging.compare_again(other, unchanged).holds
    other["effects"] = unchanged["effects"][1:]
    assert not judging.compare_again(other, unchanged).holds


@real
def test_what_the_page_says_of_facts_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in text.splitlines()]
    told = {row[0]: row[1] for row in rows if len(row) == 3}
    every = []
    for line in results.read("facts", FOLDER / "results").values():
        held = [one for one in facts.judge(line["id"], line).values() if one is not None]
        assert told[line["id"]] == f"{sum(held)} of {len(held)}", line["id"]
        every += held
    assert f"**{sum(every)} of {len(every)} hold**" in text


def test_what_the_page_says_of_shifted_orders_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    found = json.loads((FOLDER / "results" / "shifted_orders.json").read_text(encoding="utf-8"))
    worse = {(one["delay"], one["lag"]): one["worse"] for one in found["shifts"]}
    best = min(worse, key=lambda shift: worse[shift])
    assert best[1] == 0 and f"fit the motion best {best[0]:g} s late" in text
    assert f"At 0.6 s twice the log likelihood is {worse[0.6, 0.0]} less" in text
    assert f"besides, {worse[0.6, 0.5]} to {worse[0.6, 1.3]} less" in text
    shares = [100 * found["repeated"][f"{run}.csv"] for run in ("nlp1", "maneuvering1")]
    told = f"{shares[0]:.1f} % (`nlp1`) and {shares[1]:.1f} % (`maneuvering1`)"
    assert told in " ".join(text.split())
    kcs = {one["delay"]: one["worse"] for one in found["kcs"]}
    told = f"twice the log likelihood {kcs[0.2] - kcs[0.0]:.1f} less ([`shifted_orders.json`]"
    assert told in " ".join(text.split())


@real
def test_what_the_page_says_of_injected_cases_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    unchanged = results.read("unchanged", FOLDER / "results")
    lines = results.read("injected", FOLDER / "results").values()
    outcomes = [judging.judge(line, unchanged[line["case"]["set"]]) for line in lines]
    effects = [one for one in outcomes if one.kind == "effect"]
    large = [one for one in effects if one.limits is not None and one.limits >= 8]
    covered = [hit for one in effects if one.named for hit in one.covered.values()]
    told = {
        "effects named besides what the unchanged runs give": [one.besides for one in effects],
        "the same, at eight limits or more": [one.besides for one in large],
        "a wrong name": [bool(one.wrong) for one in outcomes],
        "intervals that hold the injected size": covered,
    }
    for name, flags in told.items():
        assert f"| {name} | {sum(flags)} of {len(flags)} |" in text
    section = text[text.index("## Injected into real runs") :].partition("\n\nNot named")[2]
    missed = [f"{one.limits:.1f}" for one in effects if not one.besides]
    assert sorted(re.findall(r"\d+\.\d", section.partition("\n\n")[0])) == sorted(missed)
    bound = binomtest(0, len(outcomes)).proportion_ci(method="wilson").high
    assert f"by {100 * bound:.0f} %" in section
    sized = [(one.stated, one.besides) for one in effects if one.stated is not None]
    above, below = (
        [named for size, named in sized if (size >= 4) is large] for large in (True, False)
    )
    told = f"By them {sum(above)} of {len(above)} effects of four limits or more were named, and "
    told += f"{sum(below)} of {len(below)} smaller ones"
    ratios = [one.limits / one.stated for one in effects if one.stated and one.limits]
    told = f"{min(ratios):.1f} to {max(ratios):.1f} times what they were. {told}"
    assert told in " ".join(section.split())


@real
def test_what_the_page_says_of_sizes_of_the_boats_own_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    folder = FOLDER / "results"
    unchanged, lines = results.read("unchanged", folder), results.read("injected", folder)
    rows = json.loads((folder / "own_sizes.json").read_text(encoding="utf-8"))
    judged = {}
    for line in lines.values():
        hits = judging.judge(line, unchanged[line["case"]["set"]]).covered
        judged |= {(line["id"], number): hit for number, hit in hits.items()}
    assert {(row["id"], row["number"]) for row in rows} >= judged.keys()
    missed = [row for row in rows if judged.get((row["id"], row["number"])) is False]
    alone = [row for row in missed if row["name"] not in ("current", "wind")]
    own = [row for row in alone if row["own"] is not None]
    off = [abs(row["found"] - row["injected"] - row["own"]) / row["std"] for row in own]
    told = f"missed in {sum(one <= judging.Z90 for one in off)} of these {len(missed)} sizes"
    assert told in " ".join(text.split())
    for row in missed:
        assert f"| {row['id']} | {row['number']} | {row['injected']:.3g} |" in text


@real
def test_what_the_page_says_of_retellings_is_what_was_found():
    text = (ROOT / "docs" / "when-to-believe-a-diagnosis.md").read_text(encoding="utf-8")
    unchanged = results.read("unchanged", FOLDER / "results")
    lines = results.read("told", FOLDER / "results").values()
    assert lines
    for one in (judging.compare(line, unchanged[line["set"]]) for line in lines):
        holds = "yes" if one.holds else "**no**"
        assert f"| {one.id} | {holds} | {one.apart:.2g} | {100 * one.misfit:.2g} % |" in text


# Independence


def test_generator_imports_nothing_of_the_tool():
    for name in GENERATOR:
        tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                found = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                found = [f"{node.module}.{alias.name}" for alias in node.names]
            else:
                continue
            for module in found:
                assert module.split(".")[0] not in ("diffsea", "jax", "importlib", "tests"), name
                if module.startswith("experiments"):
                    assert module.split(".")[2] in GENERATOR, module


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
    moved = np.maximum(t - 1.0, 0.0)
    return pd.DataFrame({"t": t, "cmd_port": 90 + 60 * np.sin(0.7 * moved),
                         "cmd_starboard": 80 - 50 * np.sin(0.5 * moved)})  # fmt: skip


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
    seen = apart(effect, plain)
    assert seen > 1e-4
    # Velocities have kinks where orders step, which a spline between rows rounds off.
    between_rows = key.startswith(("late", "clock"))
    assert apart(INJECTIONS[key].apply(plain, settings), effect) < (0.1 * seen if between_rows
                                                                    else 1e-9)  # fmt: skip
    if between_rows:
        smooth = simulated(direct(USV), ramps())
        effect = simulated(direct(USV), ramps(), {name: values})
        told = INJECTIONS[key].apply(smooth, settings)
        assert apart(told, effect) < 0.02 * apart(smooth, effect)


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
    assert apart(effect, before) < 0.1 * without


def test_the_number_of_a_scale_is_what_the_catalogue_calls_it():
    """Recorded is (1 + scale) times what was executed."""
    run, settings = pd.DataFrame({"exec_a": [1.0, -2.0]}), {"columns": ["exec_a"], "side": -1.0}
    one, settings = INJECTIONS["feedback-scale"], settings | {"size": 0.2}
    told = one.apply(run, settings)["exec_a"]
    assert list(told) == pytest.approx(list((1 + one.numbers(settings)["scale"]) * run["exec_a"]))


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


def came_back(key, known, before, told, back):
    """All of a run but what was lost at its ends, and rows that splines cannot give back."""
    between_rows = key.startswith("late") or key == "clock-drift"
    for column in before:
        a, b, changed = (run[column].to_numpy()[10:-10] for run in (before, back, told))
        sampled = np.isfinite(a)
        rows = sampled & np.isfinite(b)
        assert np.isfinite(b).any() and rows.sum() > 0.5 * sampled.sum(), (key, column)
        # What scatters from row to row does not come back whole from between rows.
        off = np.abs(a - changed)  # nothing, where a slower sensor's samples lie in other rows
        moved = np.nanquantile(off, 0.95) if np.isfinite(off).any() else 0.0
        loose = 0.05 * moved + 3 * known["scatter"].get(column, 0.0) if between_rows else 0.0
        close = 1e-9 * max(known["largest"][column], 1.0)
        assert np.quantile(np.abs(a - b)[rows], 0.95) <= loose + close, (key, column)


@real
@pytest.mark.parametrize("name", list(sets.SETS))
def test_undoing_an_injection_gives_the_recording_back(name):
    material = sets.SETS[name].load()
    known, rng, tried = features.features(material), np.random.default_rng(1), set()
    for key, injection in INJECTIONS.items():
        if injection.undo is None:
            continue
        for settings in some_settings(rng, key, known):
            tried.add(key)
            told = injected(material, key, settings)
            back = undone(told, key, settings)
            assert any(len(run.compare(told.runs[n])) for n, run in material.runs.items()), key
            first = list(material.train)[0]
            came_back(key, known, *(each.train[first] for each in (material, told, back)))
    assert len(tried) >= (5 if name == "kingfisher" else 12)


def test_latencies_of_whole_rows_come_back_exactly(plain):
    late = {"size": 3 * STEP, "columns": ["x", "y"]}
    there = INJECTIONS["late-positions"].apply(plain, late)
    assert np.allclose(there["x"].to_numpy()[3:], plain["x"].to_numpy()[:-3], atol=1e-9)
    back = sensor_injections.early_channels(there, late)
    assert np.allclose(back["x"].to_numpy()[:-4], plain["x"].to_numpy()[:-4], atol=1e-9)


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


@real
def test_a_mirrored_ferry_with_azimuth_thrusters_moves_as_its_mirror(tmp_path):
    whole = sets.SETS["milliampere-orders"].load()
    short = whole.train["maneuvering1.csv"].iloc[:400].reset_index(drop=True)
    # The receiver gives no yaw rate: the run is replayed from the one of its headings.
    short = short.assign(r=np.gradient(short["psi"], short["t"]))
    material = Material(whole.document, {"a.csv": short}, {})
    moved = []
    for name, told in (("plain", material), ("mirror", retellings.mirrored(material))):
        vessel, (path,), _ = told.write(tmp_path / name)
        run_ = diffsea.read_recording(path)
        moved.append(sets.table_of(diffsea.replay(diffsea.read_vessel(vessel).vessel, run_)))
    mirror = retellings.mirrored(Material(whole.document, {"a.csv": moved[0]}, {})).train["a.csv"]
    assert apart(moved[1], mirror) < 1e-8
    assert apart(moved[0], mirror) > 0.1


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


def test_a_subset_is_of_all_quick_sets(plain):
    seconds = {"one": 30.0, "other": 300.0, "third": 50.0}
    all_sets = {name: frozen(plain) | {"seconds": s} for name, s in seconds.items()}
    few = cases.subset(cases.draw_cases(all_sets, 200, 5), seconds)
    assert [sum(case["set"] == name for case in few) for name in seconds] == [10, 0, 10]


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


# Results and scores


def line(case_id="a", revision="1", **more):
    """A line of results, of a diagnosis that names nothing."""
    empty = {"effects": [], "audit": [], "where": [], "verdict": "consistent", "seconds": 10.0,
             "fit": {"nominal": {"train": 1.0, "test": 1.1}}}  # fmt: skip
    return {"id": case_id, "revision": revision} | empty | more


def effect(name, std=0.1, **values):
    """An entry of `effects`."""
    parameters = {key: {"value": value, "std": std} for key, value in values.items()}
    return {"name": name, "parameters": parameters}


def as_case(injection, limits=9.0, **settings):
    """A case of one set."""
    case = {"id": f"a-{injection}", "set": "hsva", "injection": injection, "limit": 1.0}
    return case | {"settings": {"size": 0.3, **settings}, "limits": limits}


def frozen_of(shortest=100.0, limits=()):
    """What unchanged runs freeze: a little of it, and these limits."""
    features_ = {"shortest": shortest, "scatter": {}, "step": 0.1}
    return {"features": features_, "document": {"hull": {}}, "limits": list(limits)}


def judged(injection, *effects, before=(), audit=(), limits=9.0, stated=(), **settings):
    """A case with what was said, beside unchanged runs that give `before` and state limits."""
    said = line(case=as_case(injection, limits, **settings), effects=list(effects),
                audit=list(audit), verdict="explained")  # fmt: skip
    unchanged = line(effects=[one if isinstance(one, dict) else effect(one) for one in before],
                     frozen=frozen_of(limits=stated))  # fmt: skip
    return judging.judge(said, unchanged)


def test_results_grow_and_a_line_that_was_cut_off_is_left_out(tmp_path):
    results.append("facts", line("one", seconds=1.23456789), tmp_path)
    with results.path_of("facts", tmp_path).open("a") as file:
        file.write('{"id": "two", "rev')
    results.append("facts", line("three", value=math.inf), tmp_path)
    results.append("facts", line("one", seconds=2.0), tmp_path)
    found = results.read("facts", tmp_path)
    assert list(found) == ["one", "three"]
    assert found["one"]["seconds"] == 2.0 and found["three"]["value"] is None


def test_work_goes_on_where_it_stopped_and_keeps_revisions_apart(tmp_path):
    args = lambda *given: run.options().parse_args([*given, "--out", str(tmp_path)])
    made = []

    def job(key):
        return key, "kcs", lambda: made.append(key) or line(verdict="consistent")

    jobs = [job("a"), job("b")]
    run.work("facts", jobs[:1], args(), "1")
    run.work("facts", jobs, args(), "1")
    assert made == ["a", "b"]
    with pytest.raises(SystemExit, match="--redo"):
        run.work("facts", jobs, args(), "2")
    run.work("facts", jobs, args("--any-revision"), "2")
    assert made == ["a", "b"]
    run.work("facts", jobs, args("--redo"), "2")
    assert made == ["a", "b", "a", "b"]
    assert {one["revision"] for one in results.read("facts", tmp_path).values()} == {"2"}


def test_names_of_the_unchanged_runs_do_not_count():
    flow = effect("current", speed=0.31, direction=3.1)
    right = judged("current", flow, effect("wind", speed=2.0), before=("wind",), angle=-3.1)
    assert right.named and right.besides and not right.wrong
    assert right.covered == {"speed": True, "direction": True}
    assert right.errors["speed"] == pytest.approx(0.01 / 0.3)
    assert right.errors["direction"] == pytest.approx(2 * math.pi - 6.2)
    known = judged("current", flow, before=(flow,), angle=-3.1)
    assert known.named and not known.besides and not known.wrong and not known.errors
    other = judged(
        "current", flow, before=(effect("current", speed=0.9, direction=1.0),), angle=3.1
    )
    assert other.besides
    late = effect("sensor-latency", delay=0.3) | {"channels": ["psi"]}
    early = effect("sensor-latency", delay=0.3) | {"channels": ["x", "y"]}
    place = {"channels": ["psi"], "columns": ["psi"]}
    assert judged("late-heading", late, early, before=(early,), **place).besides
    assert not judged("late-heading", late, before=(late,), **place).besides
    assert judged("current", flow, before=("wind",), angle=-3.1).lost == ("wind",)
    wrong = judged("current", effect("wind", speed=2.0), angle=1.0)
    assert wrong.wrong == ("wind",) and not wrong.named


def test_a_size_is_told_in_the_limits_stated_beside_it_too():
    limit = {"name": "gyro-bias", "parameter": "bias", "limit": 0.06}
    assert judged("gyro-bias", stated=[limit], side=1.0).stated == pytest.approx(5.0)
    none = limit | {"limit": None}
    assert judged("gyro-bias", stated=[none], side=1.0).stated is None
    assert judged("without-coupling", limits=3.0).stated is None


def test_place_onset_and_audit_are_judged():
    bias = {"columns": ["cmd_rudder"], "side": 1.0}
    for actuator, hit in (("rudder", True), ("propeller", False)):
        said = effect("actuator-bias", bias=0.3) | {"actuators": [actuator]}
        assert judged("order-bias", said, **bias).where is hit
    step = {"columns": ["cmd_port"], "side": -1.0, "time": 50.0}
    for time, hit in ((54.0, True), (56.0, False)):
        one = judged("thrust-step", effect("thrust-change", time=time, factor=-0.3), **step)
        assert one.onset is hit and one.errors == {"factor": 0.0}
    swap = judged("exchange", audit=[{"kind": "swapped-actuators"}], columns=["a", "b"])
    assert swap.kind == "label" and swap.audited and not swap.wrong


def test_what_no_entry_describes_must_stay_without_a_name():
    shaken = {"columns": ["cmd_rudder"], "time": 9.0}
    quiet = [judged("restless-order", **shaken), judged("thinned", rows=2)]
    loud = judged("restless-order", effect("wave-force", bias=1.0), **shaken)
    assert [one.kind for one in quiet] == ["outside", "harmless"]
    found = score.rates([*quiet, loud])
    kept = found["outside the catalogue: without a name"]
    assert (kept["hits"], kept["n"]) == (1, 2) and found["harmless: no name"]["hits"] == 1
    assert found["named"]["n"] == 0


def test_a_retelling_is_the_same_or_is_not():
    frozen_ = frozen_of(shortest=1.0)
    was = line("hsva", effects=[effect("current", speed=0.3, direction=1.0)], frozen=frozen_)
    turned = effect("current", speed=0.305, direction=1.0 + retellings.TURN)
    same = judging.compare(line("hsva:turned", set="hsva", effects=[turned]), was)
    assert same.holds and same.apart == pytest.approx(0.05) and same.misfit == 0.0
    unturned = line("hsva:turned", set="hsva", effects=was["effects"])
    assert not judging.compare(unturned, was).holds
    worse = line("hsva:moved", set="hsva", effects=was["effects"],
                 fit={"nominal": {"train": 1.02, "test": 1.1}})  # fmt: skip
    assert judging.compare(worse, was).misfit == pytest.approx(0.02)
    other = judging.compare(line("hsva:moved", set="hsva"), was)
    assert other.missing == ("current",) and not other.same_names and not other.holds


def test_all_tables_are_written(tmp_path):
    frozen_ = frozen_of(limits=[{"name": "gyro-bias", "parameter": "bias", "limit": 0.1}])
    free = {"nominal": {"5": {"position": 1.0}, "20": {"position": 3.0}, "60": {"position": 9.0}},
            "diagnosed": {"5": {"position": 0.5}, "20": {"position": 4.0},
                          "60": {"position": 9.0}}}  # fmt: skip
    results.append("unchanged", line("hsva", set="hsva", frozen=frozen_, free=free), tmp_path)
    results.append("told", line("hsva:moved", set="hsva"), tmp_path)
    results.append("facts", line("hsva-unchanged", vessel={}), tmp_path)
    large, small = (as_case("gyro-bias", size, side=1.0) for size in (9.0, 1.5))
    named = [effect("gyro-bias", bias=0.35)]
    results.append("injected", line("c", case=large, free=free, effects=named), tmp_path)
    failed = line("d", verdict="failed", error="crashed", case=small)
    results.append("injected", failed, tmp_path)
    score.main(["--out", str(tmp_path)])
    found = json.loads((tmp_path / "scores.json").read_text())
    assert found["power"][0]["named"]["hits"] == 0 and found["power"][3]["named"]["hits"] == 1
    beside = found["power by the limits stated beside"]
    assert [row["named"]["n"] for row in beside] == [0, 0, 2, 0, 0, 0]  # 0.3 over 0.1 in both
    assert found["free"]["5"]["median"] == 0.5 and found["free"]["20"]["worse"]["hits"] == 1
    pages = (tmp_path / "scores.md").read_text()
    assert "| failed | 50 % (9 to 91), 1/2 |" in pages and "hsva:moved" in pages
    assert found["facts that hold"]["hits"] == 1 and found["told otherwise, the same"]["hits"] == 1
