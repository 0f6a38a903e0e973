"""Recorded and predicted runs as pictures: seldom sampled channels, orders, arrows, marks."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from diffsea.report.histories import compared_histories, measured_rows
from diffsea.report.pages.trial_marks import mark_crossings, mark_overshoots
from diffsea.report.plots import figure
from diffsea.report.tracks import DrawnFlow, compared_tracks
from diffsea.trajectory import Trajectory


LINE: dict[str, object] = {"color": "#000000"}


@pytest.fixture
def run():
    """A minute at 10 Hz northwards at 1 m/s with two orders; positions each second only."""
    t = np.linspace(0.0, 60.0, 601)
    fixed = np.where(np.arange(601) % 10 == 0, 0.0, np.nan)
    zeros, orders = np.zeros(601), {"port": np.where(t < 30, 1.0, 2.0), "rudder": np.full(601, 0.1)}
    motion = {"x": t + fixed, "y": fixed, "psi": zeros, "u": zeros + 1.0, "v": zeros, "r": zeros}
    return Trajectory(t, **motion, commanded=orders, executed={}, extra={}, valid=zeros == 0.0)


def predicted(run, north):
    return dataclasses.replace(run, x=np.asarray(run.t) * north, y=np.zeros(601))


def traces(drawn) -> list[Any]:
    return list(drawn["data"])


def layout(drawn) -> Any:
    return drawn["layout"]


def lines(drawn, axis):
    return [one for one in traces(drawn) if one.yaxis == axis]


def test_a_seldom_sampled_position_is_drawn_through_its_gaps(run):
    curves = [("measured", run, LINE), ("model", predicted(run, 1.1), LINE)]
    measured, model = traces(compared_tracks(curves, "run", 40))
    assert None not in measured.y and len(measured.y) == 31  # of 61 fixes, every second one
    assert measured.customdata[1] == pytest.approx(2.0) and measured.y[1] == pytest.approx(2.0)
    assert len(model.y) > 20
    rows = measured_rows(run, ("x", "y"), 1000)
    np.testing.assert_allclose(rows["t"], np.arange(61.0))


def test_histories_have_orders_by_unit_and_the_error_of_position(run):
    curves = [("measured", run, LINE), ("model", predicted(run, 1.1), LINE)]
    units = {"port": "N", "rudder": "rad"}
    drawn, names = compared_histories(curves, "run", 1000, units)
    assert names[-3:] == ["error of position", "orders", "orders"]
    count = len(names)
    (error,) = lines(drawn, f"y{count - 2}")
    np.testing.assert_allclose(error.y, 0.1 * np.arange(61.0), atol=1e-3)
    (port,), (rudder,) = lines(drawn, f"y{count - 1}"), lines(drawn, f"y{count}")
    assert port.name == "orders, port" and port.y[0] == 1.0 and port.y[-1] == 2.0
    assert rudder.y[0] == pytest.approx(math.degrees(0.1), abs=0.01)
    titles = [note.text for note in layout(drawn).annotations]
    assert titles[-2].startswith("orders (N): ") and titles[-1].startswith("orders (deg): ")
    alone, names = compared_histories(curves[:1], "run", 1000)
    assert "error of position" not in names


def test_names_of_channels_are_no_markup(run):
    named = dataclasses.replace(run, commanded={"<img src=x>": np.ones(601)})
    drawn, _ = compared_histories([("measured", named, LINE)], "run", 100)
    assert "&lt;img src=x&gt;" in layout(drawn).annotations[-1].text


def test_north_and_flows_are_arrows(run):
    curves = [("measured", run, LINE)]
    notes = compared_tracks(curves, "run", 100, [DrawnFlow("current 0.3 m/s", math.pi / 2)])
    north, arrow, text = layout(notes).annotations
    assert north.text == "N" and north.ax == 0 and north.ay > 0  # from below to the top
    assert arrow.ax < -30 and abs(arrow.ay) < 1e-9  # from the left: it flows to the east
    assert text.text == "current 0.3 m/s"


def test_overshoots_are_marked_at_their_peaks_with_their_limits():
    t = np.linspace(-5.0, 40.0, 451)
    change = np.radians(13.0) * np.sin(2 * np.pi * t / 20.0) * (t > 0)
    metrics = {
        "switching_heading": math.radians(10), "overshoot_1": math.radians(3.0),
        "overshoot_2": math.radians(3.1), "imo": {"overshoot_1": {"limit": math.radians(10)}},
    }  # fmt: skip
    drawn = figure()
    mark_overshoots(drawn, {"t": t, "psi_relative": change}, metrics, "#000000")
    first, second = layout(drawn).annotations
    assert first.text == "overshoot 3.0° (at most 10.0°)" and second.text == "overshoot 3.1°"
    assert (first.x, first.y) == (pytest.approx(5.0), pytest.approx(13.0))
    assert (second.x, second.y) == (pytest.approx(15.0), pytest.approx(-13.0))
    assert sorted(shape.y0 for shape in layout(drawn).shapes) == pytest.approx([-10.0, 10.0])


def test_a_turns_numbers_are_marked_where_the_heading_has_changed_so_far():
    t = np.linspace(-1.0, 40.0, 411)
    change = np.clip(np.radians(10.0) * t, 0.0, None)
    track = (1 - np.cos(change), np.sin(change))
    metrics = {"advance": 1.0, "transfer": 1.0, "tactical_diameter": 2.0}
    drawn = figure()
    mark_crossings(drawn, {"t": t, "psi_relative": change}, metrics, track, "#000000")
    first, second = layout(drawn).annotations
    assert first.text == "advance 1.00 m, transfer 1.00 m"
    assert (first.x, first.y) == (pytest.approx(1.0, abs=0.02), pytest.approx(1.0, abs=0.02))
    assert second.text == "tactical diameter 2.00 m" and second.x == pytest.approx(2.0, abs=0.02)


def test_what_was_executed_without_an_order_is_drawn():
    t = np.arange(0.0, 30.0)
    helm = np.radians(10.0 * np.sign(np.sin(t / 5)))
    nothing = {name: np.zeros(t.size) for name in ("x", "y", "psi", "u", "v", "r")}
    run = Trajectory(
        t, **nothing, commanded={}, executed={"rudder": helm}, extra={},
        valid=np.ones(t.size, bool), name="zigzag",
    )  # fmt: skip
    drawn, names = compared_histories([("measured", run, LINE)], "run", 100)
    assert names[-1] == "executed"
    titles = [note.text for note in drawn.layout.annotations]
    assert any(title.startswith("executed (deg): ") and "rudder" in title for title in titles)
    (line,) = [trace for trace in drawn.data if trace.name == "executed, rudder"]
    assert max(line.y) == pytest.approx(10.0)


def test_the_wind_that_was_recorded_is_drawn_last_without_steps_of_a_turn(run):
    assert "wind" not in compared_histories([("measured", run, LINE)], "run", 1000)[1]
    whole = np.radians(350.0 + 0.05 * np.arange(601))
    rows = np.where(np.arange(601) % 10, np.nan, 1.0)
    extra = {"wind_speed": 6.0 * rows, "wind_direction": (whole % (2 * math.pi)) * rows}
    windy = dataclasses.replace(run, extra=extra)
    curves = [("measured", windy, LINE), ("model", predicted(run, 1.1), LINE)]
    drawn, names = compared_histories(curves, "run", 1000)
    assert names[-2:] == ["wind", "wind from"]
    (speed,), (direction,) = (lines(drawn, f"y{len(names) - k}") for k in (1, 0))
    assert len(speed.x) == 61 and set(speed.y) == {6.0}
    assert np.ptp(direction.y) == pytest.approx(30.0, abs=0.1)
