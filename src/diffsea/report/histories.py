"""Motion and orders of runs against time, each channel at its own instants.

A channel that is seldom sampled is drawn through the rows between, and what a model predicts of the
position by how far off it is.
"""

import html
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.channels import steers
from diffsea.report import plots
from diffsea.trajectory import Trajectory


MARGIN = 0.06  # of a panel's range, above and below its curves
ORDER_COLOURS = ("#cc79a7", "#e69f00", "#56b4e9", "#8a96a3")
_PANELS = (
    ("psi", "heading (deg)", math.degrees(1.0)),
    ("r", "yaw rate (deg/s)", math.degrees(1.0)),
    ("u", "speed ahead u (m/s)", 1.0),
    ("v", "speed to starboard v (m/s)", 1.0),
)
_WIND = (
    ("wind_speed", "wind (m/s)", 1.0),
    ("wind_direction", "wind from (deg)", math.degrees(1.0)),
)
_ANGLES = {"rad": ("deg", math.degrees(1.0))}  # how orders are shown, by their unit

Rows = dict[str, Float[np.ndarray, "row"]]
Curve = tuple[str, Trajectory, dict[str, object]]  # name, run and line
Line = tuple[str, Float[np.ndarray, "_"], Float[np.ndarray, "_"], dict[str, object]]


class Panel(NamedTuple):
    """One of the pictures that stand below one another."""

    name: str
    title: str
    lines: list[Line]
    bounded: bool = False  # whether the first line sets the range


def measured_rows(run: Trajectory, channels: Sequence[str], most: int) -> Rows:
    """Times and channels in the rows that have all of these, thinned evenly to at most `most`."""
    counted = run.counted()
    found = {name: np.asarray(getattr(counted, name), float) for name in ("t", *channels)}
    has = np.flatnonzero(np.all([np.isfinite(series) for series in found.values()], axis=0))
    chosen = has[plots.evenly(len(has), most)]
    return {name: series[chosen] for name, series in found.items()}


def compared_histories(
    curves: Sequence[Curve], group: str, most: int, units: Mapping[str, str] | None = None
) -> tuple[go.Figure, list[str]]:
    """Heading, yaw rate and speeds against time as far as recorded, how far off the position of
    each prediction is, orders and wind; with the names of the panels.

    Arguments: as of `compared_tracks`; `units` of orders by channel. Angles are in degrees,
    headings without steps of a turn.
    """
    panels = [*_motion_panels(curves, most), *_distance_panel(curves, most)]
    panels += [*_order_panels(curves[0][1], most, units or {}), *_wind_panels(curves[0], most)]
    margin = {"t": 24, "b": 36, "l": 48, "r": 8}
    drawn = plots.figure(hovermode="x", margin=margin, showlegend=False)
    for k, (_, title, lines, bounded) in enumerate(panels):
        axis = f"y{k + 1}" if k else "y"
        for name, t, series, line in lines:
            x, y = plots.numbers(t, plots.TIME_DIGITS), plots.numbers(series)
            drawn.add_scatter(x=x, y=y, mode="lines", name=name, line=line, xaxis="x", yaxis=axis)
        domain = plots.panel_of(k, len(panels), MARGIN * min(1.0, 4 / len(panels)))
        shape: dict[str, object] = {"domain": domain, "nticks": 5}
        if bounded:
            shape["range"] = axis_range([series for _, _, series, _ in lines])
        drawn.update_layout({f"yaxis{k + 1}": shape})
        drawn.add_annotation(plots.heading(title, domain[1]))
    last = f"y{len(panels)}" if len(panels) > 1 else "y"
    drawn.update_layout(xaxis={"title": {"text": "time (s)"}, "anchor": last})
    return plots.add_time_cursor(drawn, group), [panel.name for panel in panels]


def _motion_panels(curves: Sequence[Curve], most: int) -> list[Panel]:
    panels: list[Panel] = []
    for channel, title, scale in _PANELS:
        if not curves[0][1].has(channel):
            continue
        rows = [measured_rows(run, (channel,), most) for _, run, _ in curves]
        series = [(one["t"], one[channel] * scale) for one in rows]
        if channel == "psi":
            series = on_one_turn(series)
        lines = [(name, *one, line) for (name, _, line), one in zip(curves, series, strict=True)]
        panels.append(Panel(title.split(" (")[0], title, lines, bounded=True))
    return panels


def _distance_panel(curves: Sequence[Curve], most: int) -> list[Panel]:
    """How far off the recorded position each prediction is, at the times of the recording."""
    (_, recorded, _), *predicted = curves
    if not predicted or not (recorded.has("x") and recorded.has("y")):
        return []
    fixes = measured_rows(recorded, ("x", "y"), most)
    lines: list[Line] = []
    for name, run, line in predicted:
        rows = measured_rows(run, ("x", "y"), len(run.t))
        if not len(rows["t"]):
            continue
        within = fixes["t"] <= rows["t"][-1]
        t = fixes["t"][within]
        off = [np.interp(t, rows["t"], rows[c]) - fixes[c][within] for c in ("x", "y")]
        lines.append((name, t, np.hypot(*off), line))
    return [Panel("error of position", "error of position (m)", lines)] if lines else []


def _order_panels(run: Trajectory, most: int, units: Mapping[str, str]) -> list[Panel]:
    """What was ordered, and below it in dots what was executed, a panel for each unit.

    What was executed without an order on record has a panel, too.
    """
    counted, panels = run.counted(), []
    channels = list(dict.fromkeys([*counted.commanded, *counted.executed]))
    colours = dict(zip(channels, ORDER_COLOURS * len(channels), strict=False))
    unit_of = {c: units.get(c, "rad" if steers(c) else "") for c in channels}
    for unit in dict.fromkeys(unit_of.values()):
        shown, scale = _ANGLES.get(unit, (unit, 1.0))
        lines: list[Line] = []
        for channel, colour in colours.items():
            if unit_of[channel] != unit:
                continue
            looks = {"orders": {"shape": "hv", "width": 1.5}, "executed": {"dash": "dot"}}
            given = {"orders": counted.commanded, "executed": counted.executed}
            for what, series in given.items():
                if channel not in series:
                    continue
                has = np.flatnonzero(np.isfinite(series[channel]))
                chosen = has[plots.evenly(len(has), most)]
                line = {"color": colour, **looks[what]}
                values = series[channel][chosen] * scale
                lines.append((f"{what}, {channel}", counted.t[chosen], values, line))
        names = [
            f'<span style="color:{colour}">{html.escape(channel)}</span>'
            for channel, colour in colours.items()
            if unit_of[channel] == unit
        ]
        in_unit = f" ({shown})" if shown else ""
        ordered = any(unit_of[channel] == unit for channel in counted.commanded)
        what = "orders" if ordered else "executed"
        panels.append(Panel(what, f"{what}{in_unit}: {', '.join(names)}", lines))
    return panels


def _wind_panels(recorded: Curve, most: int) -> list[Panel]:
    """Speed and direction of the true wind, where it was recorded."""
    name, run, line = recorded
    counted, panels = run.counted(), []
    for channel, title, scale in _WIND:
        series = np.asarray(counted.extra.get(channel, np.zeros(0)), float) * scale
        has = np.flatnonzero(np.isfinite(series))
        if not len(has):
            continue
        chosen = has[plots.evenly(len(has), most)]
        shown = counted.t[chosen], series[chosen]
        ((t, values),) = on_one_turn([shown]) if channel == "wind_direction" else (shown,)
        panels.append(Panel(title.split(" (")[0], title, [(name, t, values, line)], bounded=True))
    return panels


def on_one_turn(
    headings: Sequence[tuple[Float[np.ndarray, "_"], Float[np.ndarray, "_"]]],
) -> list[tuple[Float[np.ndarray, "_"], Float[np.ndarray, "_"]]]:
    """Times and headings in degrees without steps, all on the turn of the first one."""
    out: list[tuple[np.ndarray, np.ndarray]] = []
    for t, psi in headings:
        whole = np.unwrap(psi, period=360.0)
        if out and len(t) and len(out[0][0]):
            first = max(t[0], out[0][0][0])
            apart = np.interp(first, t, whole) - np.interp(first, *out[0])
            whole = whole - 360.0 * np.round(apart / 360.0)
        out.append((t, whole))
    return out


def axis_range(series: Sequence[Float[np.ndarray, "_"]], room: float | None = None) -> list[float]:
    """Range of the first series with a margin, and of the others while within `room` of it.

    `room` is the range of the first one if None; NaN counts for nothing.
    """
    finite = [s[np.isfinite(s)] for s in series]
    finite = [s for s in finite if s.size] or [np.zeros(1)]
    low, high = float(finite[0].min()), float(finite[0].max())
    room = max(high - low if room is None else room, 1e-6)
    first, last = low - room, high + room
    for values in finite[1:]:
        low = min(low, max(float(values.min()), first))
        high = max(high, min(float(values.max()), last))
    margin = MARGIN * max(high - low, 1e-6)
    return [low - margin, high + margin]
