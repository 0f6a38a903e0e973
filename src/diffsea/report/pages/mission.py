"""A mission as one page: the track beside the path, errors, orders against limits, weather."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from diffsea.identification.online.closed_spans import closed_spans
from diffsea.missions import MissionRun
from diffsea.missions.performance import held_poses, held_values, tracking_errors
from diffsea.report import plots
from diffsea.report.page import Plot, RunPlots, Table, Verbatim, provenance, render
from diffsea.report.pages.online import estimate_plot, trust_plot
from diffsea.report.quantities import for_people, round_to_error, significant, with_error
from diffsea.report.wording.words import Record, capital
from diffsea.trajectory import Outcome, Samples


DRAWN_ROWS = 1500  # of a run: more cannot be told apart
_DEGREES = math.degrees(1.0)
_PATH_LINE = {"color": plots.MEASURED, "width": 2, "dash": "dash"}
_TRUE_LINE = {"color": plots.DIAGNOSED, "width": 1.8}
_SEEN_LINE = {"color": plots.MEASURED, "width": 1}
_WANTED_LINE = {"color": plots.MEASURED, "width": 1.5, "dash": "dash", "shape": "hv"}
_ORDER_LINE = {"color": plots.NOMINAL, "width": 1.4, "shape": "hv"}
_LIMIT_LINE = {"color": plots.INK, "width": 1, "dash": "dot"}

Panel = tuple[str, Sequence[tuple[str, Samples, dict[str, Any]]]]  # heading, and its curves


def mission_page(run: MissionRun, numbers: Record) -> str:
    """The page.

    Arguments:
        numbers: the content of run.json.
    """
    mission, outcome = run.mission, run.outcome
    missed = sum(not point["reached"] for point in numbers.get("waypoints", []))
    believed = ", which believes in another vessel" if numbers["model_differs"] else ""
    return render(
        "mission.html.j2",
        title=mission.name,
        subtitle=f"{mission.vessel.name} under {mission.controller.kind}{believed}",
        completed=outcome is Outcome.COMPLETED and not missed,
        word=_verdict(outcome, missed),
        lead=f"{capital(run.sentence)}, after {significant(numbers['time'], 4)} s "
        f"and {significant(numbers['distance'], 4)} m.",
        errors=error_sentences(numbers),
        runs=[run_plots(run, "run")],
        waypoints=_waypoint_table(numbers["waypoints"]) if "waypoints" in numbers else None,
        orders=order_table(numbers["orders"]),
        estimator=_estimator_part(run, numbers),
        provenance=provenance(
            source_of_run(run, numbers), [(run.recorded, "simulated, as the sensors show it")]
        ),
    )


def _estimator_part(run: MissionRun, numbers: Record) -> Record | None:
    """Sentence, table and plots of the online estimator; None without one."""
    found, told = run.estimates, numbers.get("estimator")
    if found is None or told is None:
        return None
    model, closed = run.mission.model, closed_spans(found)
    kept = plots.evenly(len(found.t), DRAWN_ROWS)
    rows = []
    for name, one in told["estimates"].items():
        true = "" if one["vessel"] is None else round_to_error(one["vessel"], one["std"])
        told_values = [round_to_error(one["model"], one["std"]), true]
        told_values.append(with_error(one["value"], one["std"]))
        told_values.append(round_to_error(one["passed"], one["std"]))
        rows.append([Verbatim(name), *told_values, one["unit"]])
    columns = ["symbol", "model", "vessel", "last estimate", "passed by the gate", "unit"]
    use = "works with what passes the gate" if told["adapt"] else "takes nothing of it"
    return {
        "sentence": f"The gate was open for {100 * told['open']:.0f} % of the time; trust is "
        f"{told['trust']['last']:.2f} at the end. The controller {use}.",
        "table": Table(columns, rows, "+- is one standard error", numeric=(1, 2, 3, 4)),
        "trust": Plot(trust_plot(found, closed, kept), "Trust over time", 230),
        "plots": [
            Plot(
                estimate_plot(name, model, found, closed, kept),
                f"{name} over time",
                180,
            )
            for name in found.estimate
        ],
    }


def _verdict(outcome: Outcome, missed: int) -> str:
    """One or two words on how a mission went, of which so many waypoints were missed."""
    if outcome is not Outcome.COMPLETED:
        return "not completed"
    return f"ended, {missed} missed" if missed else "completed"


def error_sentences(numbers: Record) -> list[str]:
    named = (
        ("path_error", "Distance from the path", "m"),
        ("position_error", "Distance from the pose", "m"),
        ("heading_error", "Heading", "rad"),
        ("speed_error", "Speed", "m/s"),
    )
    sentences = []
    for key, what, unit in named:
        if key in numbers:
            rms, largest = (round_to_error(numbers[key][n], None, unit) for n in ("rms", "largest"))
            off = "" if key in ("path_error", "position_error") else " off"
            sentences.append(f"{what}{off} by {rms} root mean square, {largest} at most.")
    points = numbers.get("waypoints", [])
    if points:
        reached = sum(point["reached"] for point in points)
        sentences.append(f"{reached} of {len(points)} waypoints were reached.")
    busy = {c: o["at_limit"] for c, o in numbers["orders"].items() if o["at_limit"] > 0}
    if busy:
        shares = ", ".join(f"{c} {significant(100 * share, 2)} %" for c, share in busy.items())
        sentences.append(f"Orders were at a limit for a share of the time: {shares}.")
    return sentences


def source_of_run(run: MissionRun, numbers: Record) -> Record:
    mission, made = run.mission, run.setup
    told = lambda value: "none" if value is None else significant(value, 4)
    differs = {
        name: f"{told(both['model'])} in place of {told(both['vessel'])}"
        for name, both in numbers["model_differs"].items()
    }
    source = {
        "vessel": mission.vessel.name,
        "model": mission.model.name,
        "controller": mission.controller.kind,
        "period": f"{made.times.period:g} s",
        "time step": f"{made.times.time_step:g} s",
        "seed": mission.seed,
    }
    source |= {"the model differs in": differs} if differs else {}
    return source | ({"numbers from": mission.vessel.source} if mission.vessel.source else {})


def _waypoint_table(points: Sequence[Record]) -> Table:
    planned = any("planned_time" in point for point in points)
    rows = []
    for number, point in enumerate(points, start=1):
        place = f"{point['x']:.4g}, {point['y']:.4g}"
        reached = "yes" if point["reached"] else "no"
        nearest = significant(point["closest_approach"], 3)
        row = [str(number), place, reached, significant(point["time"], 4), nearest]
        if planned:
            late = point.get("time_error")
            row.append("" if late is None else f"{late:+.1f}")
        rows.append(row)
    columns = ["waypoint", "north, east (m)", "reached", "time (s)", "closest approach (m)"]
    columns += ["late (s)"] if planned else []
    return Table(columns, rows, numeric=range(3, len(columns)))


def order_table(orders: Record) -> Table:
    rows = []
    for channel, one in orders.items():
        scale, unit = for_people(1.0, one["unit"])

        def cell(key: str, one: Record = one, scale: float = scale) -> str:
            return significant(scale * one[key], 3) if math.isfinite(one[key]) else "none"

        extent = f"{cell('least')} to {cell('largest')}"
        bounds = [cell("lower"), cell("upper")]
        limits = "none" if bounds == ["none", "none"] else " to ".join(bounds)
        share, events = f"{100 * one['at_limit']:.1f} %", str(one["limit_events"])
        rates = [cell("largest_rate"), cell("rate_limit")]
        rows.append([Verbatim(channel), unit, extent, limits, share, events, *rates])
    columns = [
        "order",
        "unit",
        "ordered",
        "limits",
        "at a limit",
        "times reached",
        "fastest change (per s)",
        "actuator's rate limit (per s)",
    ]
    return Table(columns, rows, numeric=range(2, len(columns)))


def run_plots(run: MissionRun, group: str) -> RunPlots:
    """Track and histories of a run, under the cursor of a group."""
    name = run.mission.name
    track = Plot(_track(run, group), f"Track of {name} beside its path.", 520)
    panels = [*_motion_panels(run), *_order_panels(run), *_weather_panels(run)]
    text = f"Errors, motion, orders (executed over ordered) and weather of {name} over time."
    return RunPlots(
        "Track and histories", [track, Plot(_panels(run, panels, group), text, 130 * len(panels))]
    )


def _track(run: MissionRun, group: str) -> go.Figure:
    """What the sensors showed, the true track, and the path with its waypoints; north up."""
    drawn = plots.figure(**plots.TRACK_LAYOUT | {"showlegend": True})
    curves = [("as measured", run.recorded, _SEEN_LINE)] if run.mission.sensors else []
    curves.append(("track", run.true, _TRUE_LINE))
    for name, motion, line in curves:
        north, east, t = (plots.thin_rows(motion, c, DRAWN_ROWS) for c in ("x", "y", "t"))
        times = plots.numbers(t, plots.TIME_DIGITS)
        drawn.add_scatter(
            x=plots.numbers(east),
            y=plots.numbers(north),
            customdata=times,
            mode="lines",
            name=name,
            line=line,
            hovertemplate="%{customdata} s: %{x} m east, %{y} m north",
        )
    posed = run.mission.controller.kind == "positioning"
    points = run.mission.steps if posed else run.mission.waypoints
    if points:
        marker = {"color": "#fff", "size": 8, "line": {"color": plots.MEASURED, "width": 2}}
        drawn.add_scatter(
            x=[one.y for one in points],
            y=[one.x for one in points],
            mode="lines+markers",
            name="poses" if posed else "path",
            line=_PATH_LINE,
            marker=marker,
            hovertemplate=f"{'pose' if posed else 'waypoint'}: %{{x}} m east, %{{y}} m north",
            hoverinfo="skip",
        )
    colours = [str(line["color"]) for _, _, line in curves]
    return plots.add_track_markers(drawn, group, range(len(curves)), colours)


def _motion_panels(run: MissionRun) -> list[Panel]:
    """Path error or heading asked for, heading and speed; what the sensors showed in grey."""
    mission, true, panels = run.mission, run.true, []
    if mission.waypoints:
        off = np.asarray(tracking_errors(mission, true)["path"])
        panels.append(("off the path, to starboard (m)", [("off the path", off, _TRUE_LINE)]))
    poses = held_poses(mission, true.t) if mission.controller.kind == "positioning" else None
    if poses is not None:
        off = np.asarray(tracking_errors(mission, true)["position"])
        panels.append(("off the pose (m)", [("off the pose", off, _TRUE_LINE)]))
    for channel, title, scale, wanted in (
        ("psi", "heading (deg)", _DEGREES, "heading"),
        ("u", "speed ahead u (m/s)", 1.0, "speed"),
    ):
        curves = [(channel, getattr(true, channel) * scale, _TRUE_LINE)]
        if mission.sensors is not None:
            curves.insert(0, ("as measured", getattr(run.recorded, channel) * scale, _SEEN_LINE))
        if mission.controller.kind == "course":
            asked = np.asarray(held_values(mission, true.t, wanted)) * scale
            curves.append(("asked for", asked, _WANTED_LINE))
        if poses is not None and wanted == "heading":
            curves.append(("asked for", np.asarray(poses[2]) * scale, _WANTED_LINE))
        panels.append((title, curves))
    return panels


def _order_panels(run: MissionRun) -> list[Panel]:
    """Orders, what was executed of them, and their limits."""
    panels = []
    for channel, orders in run.true.commanded.items():
        scale, unit = for_people(1.0, run.mission.vessel.units[channel])
        curves = [
            ("ordered", orders * scale, _ORDER_LINE),
            ("executed", run.true.executed[channel] * scale, _TRUE_LINE),
        ]
        for end in run.limits(channel):
            if math.isfinite(end):
                curves.append(("limit", np.full(len(orders), scale * end), _LIMIT_LINE))
        panels.append((f"{channel} ({unit}), limits dotted", curves))
    return panels


def _weather_panels(run: MissionRun) -> list[Panel]:
    panels, extra = [], run.true.extra
    if "wind_speed" in extra:
        panels.append(("wind (m/s)", [("wind", extra["wind_speed"], _TRUE_LINE)]))
    current = run.setup.weather.current_north, run.setup.weather.current_east
    if not isinstance(current[0], float):
        speed = np.hypot(*(np.asarray(part)[: len(run.true.t)] for part in current))
        panels.append(("current (m/s)", [("current", speed, _TRUE_LINE)]))
    return panels


def _panels(run: MissionRun, panels: Sequence[Panel], group: str) -> go.Figure:
    """Panels one above the other over time, under the cursor of a group."""
    margin = {"t": 24, "b": 36, "l": 48, "r": 8}
    drawn = plots.figure(hovermode="x", margin=margin, showlegend=False)
    rows = plots.evenly(len(run.true.t), DRAWN_ROWS)
    x = plots.numbers(run.true.t[rows], plots.TIME_DIGITS)
    for k, (title, curves) in enumerate(panels):
        axis = f"y{k + 1}" if k else "y"
        for name, values, line in curves:
            y = plots.numbers(values[rows])
            drawn.add_scatter(x=x, y=y, mode="lines", name=name, line=line, xaxis="x", yaxis=axis)
        domain = plots.panel_of(k, len(panels), 0.3 / len(panels))
        drawn.update_layout({f"yaxis{k + 1}": {"domain": domain, "nticks": 4}})
        drawn.add_annotation(plots.heading(title, domain[1]))
    drawn.update_layout(xaxis={"title": {"text": "time (s)"}, "anchor": f"y{len(panels)}"})
    return plots.add_time_cursor(drawn, group)
