"""Pages of sweeps, sensitivities and recordings: what they say, and of what."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest

from diffsea import Trajectory
from diffsea.recordings import Finding
from diffsea.report.pages.online import parameter_table
from diffsea.report.pages.recordings import audit_page, segments_page
from diffsea.report.pages.sensitivity import sensitivity_page
from diffsea.report.pages.sweep import sweep_page
from diffsea.segments.segments import segments_of
from diffsea.segments.signals import signals_of


SOURCE = {"command": "diffsea sweep", "options": {"manoeuvre": "zigzag"}}
HOSTILE = "<script>alert(1)</script>.csv"


def figures(page: str) -> list[dict]:
    """The figures of a page as Plotly gets them."""
    found = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    return [json.loads(one) for one in found]


def designs(*axes: int) -> tuple[pd.DataFrame, dict]:
    """A grid of masses and drags, an overshoot (rad) that is 1e-3 of the mass, and its summary."""
    names = ("mass", "X_u")[: len(axes)]
    lines = [np.linspace(100.0, 200.0, count) for count in axes]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, len(axes))
    table = pd.DataFrame(points, columns=list(names))
    table["overshoot_1"] = 1e-3 * table["mass"]
    table["imo_overshoot_1"] = np.where(table["mass"] > 150, "fail", "pass")
    table["outcome"] = "completed"
    fails = list(table["imo_overshoot_1"]).count("fail")
    first = dict.fromkeys(names, 100.0)
    ends = {"least_design": first, "most_design": dict.fromkeys(names, 200.0)}
    extent = {"least": 0.1, "median": 0.15, "most": 0.2, "designs": len(table)} | ends
    summary = {
        "vessel": "boat <1>", "manoeuvre": "zigzag", "designs": len(table),
        "parameters": {
            name: {"from": 100.0, "to": 200.0, "unit": unit}
            for name, unit in zip(names, ("kg", "N / (m/s)"), strict=False)
        },
        "outcomes": {"completed": len(table)}, "metrics": {"overshoot_1": extent},
        "imo": {"overshoot_1": {"pass": len(table) - fails, "fail": fails}},
    }  # fmt: skip
    return table, summary


def test_a_grid_over_two_parameters_is_a_map_in_degrees():
    table, summary = designs(3, 4)
    page = sweep_page(table, summary, SOURCE)
    (drawn,) = figures(page)
    heat, crosses = drawn["data"]
    assert heat["type"] == "heatmap" and heat["x"] == [100.0, 150.0, 200.0]
    np.testing.assert_allclose(heat["z"], [np.degrees([0.1, 0.15, 0.2])] * 4, rtol=1e-3)
    assert crosses["x"] == [200.0] * 4
    titles = [drawn["layout"][axis]["title"]["text"] for axis in ("xaxis", "yaxis")]
    assert titles == ["mass (kg)", "X_u (N / (m/s))"]
    assert "8 of 12 meet the criterion" in page and "boat &lt;1&gt;" in page


def test_one_parameter_is_a_line_of_designs():
    table, summary = designs(5)
    (drawn,) = figures(sweep_page(table, summary, SOURCE))
    met, failing = drawn["data"]
    assert met["x"] == [100.0, 125.0, 150.0] and failing["x"] == [175.0, 200.0]
    np.testing.assert_allclose(failing["y"], np.degrees([0.175, 0.2]), rtol=1e-3)


def test_a_number_is_drawn_over_the_parameter_that_orders_it():
    table, summary = designs(3, 4)
    (drawn,) = figures(sweep_page(table.iloc[:-1], summary, SOURCE))
    assert drawn["layout"]["xaxis"]["title"]["text"] == "mass (kg)"


def test_the_strongest_influence_leads_and_stands_on_top():
    relative = {"overshoot_1": {"mass": 0.4, "N_r": -1.5, "N_rr": 1e-6}, "period": {}}
    values = {"overshoot_1": math.radians(5.0), "period": 9.0}
    page = sensitivity_page(relative, values, ("boat", "zigzag"), SOURCE)
    (drawn,) = figures(page)
    assert drawn["data"][0]["y"] == ["mass", "N_r"] and drawn["data"][0]["x"] == [0.4, -1.5]
    assert "One per cent more N_r changes the overshoot 1 by \u22121.5 %" in page


def run(name: str = HOSTILE) -> Trajectory:
    """Two minutes of a circle at 2 m/s, after half a minute straight ahead."""
    t = np.arange(0.0, 120.0, 0.5)
    r = np.where(t > 30, 0.1, 0.0)
    psi = 0.1 * np.maximum(t - 30, 0.0)
    x, y = (np.cumsum(2.0 * 0.5 * f(psi)) for f in (np.cos, np.sin))
    motion = {"x": x, "y": y, "psi": psi, "u": np.full_like(t, 2.0), "v": 0 * t, "r": r}
    orders = {"rudder": np.where(t > 30, -0.3, 0.0)}
    valid = np.ones(len(t), bool)
    given = {"commanded": orders, "executed": {}, "extra": {}, "valid": valid}
    return Trajectory(t, **motion, **given, name=name)


@pytest.mark.parametrize("faulty", [True, False])
def test_an_audit_says_what_was_found_where_and_escapes_names(faulty):
    one, name = run(), HOSTILE
    found = Finding("gyro-bias", 0.02, 0.001, "rad/s", "the rate is off", "subtract it", ("r",))
    page = audit_page([(name, [found] if faulty else [])], {name: one}, [], SOURCE)
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page
    assert ("1.15 \u00b1" in page) == faulty
    assert ("Nothing was found in 1 recording." in page) == (not faulty)
    assert len(figures(page)) == 2


def test_segments_are_shaded_from_their_onsets():
    one = run("circle.csv")
    found = segments_of(signals_of(one, None))
    page = segments_page([(one, found, ["orders count"])], SOURCE)
    shapes = figures(page)[1]["layout"]["shapes"]
    spans = [(s["x0"], s["x1"]) for s in shapes if s["type"] == "rect"]
    assert spans == [(s.onset, s.end) for s in found] and found
    key = [s["name"] for s in shapes if s.get("showlegend")]
    assert sorted(key) == sorted({s.kind for s in found})
    assert "Orders count." in page and found[0].kind in page


@pytest.mark.parametrize(("passed", "shown"), [(-52.0, "-52.0"), (-74.0, "-70")])
def test_what_the_gate_never_touched_is_shown_as_the_vessel_file_has_it(passed, shown):
    row = {
        "symbol": "X_u", "name": "linear damping in surge", "unit": "N / (m/s)",
        "vessel file": -52.0, "last estimate": -80.0, "+-": 20.0, "passed by the gate": passed,
    }  # fmt: skip
    (cells,) = parameter_table([row]).rows
    assert cells[2] == "-52.0" and cells[4] == shown
