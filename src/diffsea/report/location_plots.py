"""Plots of *where* model and recordings differ: maps of z-scores and coloured tracks.

A cell of a map is a test of an unnamed force in one degree of freedom, during a window of
time or in a regime: `force` and `std` (N or N m; positive ahead, to starboard, bow to
starboard) and `z`, their ratio, which is None where the data cannot tell.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from diffsea.report.interactive import (
    GREY,
    INK,
    figure,
    follows_time,
    follows_track,
    numbers,
    smooth,
    stepped,
)
from diffsea.report.quantities import known, significant, typeset, with_error
from diffsea.trajectory import Trajectory


DEGREES = ("surge", "sway", "yaw")
FORCES = {"surge": ("X", "N"), "sway": ("Y", "N"), "yaw": ("N", "N m")}
REACH = 3.0  # colours end at so many thresholds
Cells = Sequence[dict]


@dataclasses.dataclass(frozen=True)
class Colouring:
    """A force along tracks: of one degree of freedom, in `unit`, the colours ending at `limit`."""

    label: str
    unit: str
    limit: float
    values: Mapping[str, np.ndarray]  # by recording, in the rows that are drawn; NaN: not known


def time_map(maps: Mapping[str, Cells], threshold: float, group: str) -> go.Figure:
    """Degree of freedom against time in one run, a row of panels for each model."""
    count = len(maps)
    drawn = figure(margin={"t": 24, "b": 36, "l": 48, "r": 8}, plot_bgcolor=GREY)
    for k, (title, cells) in enumerate(maps.items()):
        edges = _edges(cells)
        middle = 0.5 * (edges[:-1] + edges[1:])
        at = [[_cell(cells, degree, t) for t in middle] for degree in DEGREES]
        drawn.add_trace(_heat(at, numbers(edges, 5), threshold, f"y{k + 1}"))
        top = 1 - k / count
        # Titles stand above their panels.
        drawn.update_layout({f"yaxis{k + 1}": _rows(top - 1 / count, top - 0.13)})
        drawn.add_annotation(_heading(title, top - 0.12))
    drawn.update_layout(
        xaxis={"title": {"text": "time (s)"}, "anchor": f"y{count}", "showgrid": False},
    )
    return follows_time(drawn, group)


def _rows(low: float, high: float) -> dict:
    low = max(low, 0.0)
    return {"domain": [low, high], "autorange": "reversed", "showgrid": False, "fixedrange": True}


def _heading(text: str, y: float) -> dict:
    return {
        "text": text, "x": 0, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left",
        "yanchor": "bottom", "showarrow": False, "font": {"size": 12},
    }  # fmt: skip


def _heat(at: Sequence[Sequence[dict | None]], x: Sequence, threshold: float, row: str) -> go.Trace:
    z = [[_z(cell) for cell in cells] for cells in at]
    return go.Heatmap(
        x=list(x), y=list(DEGREES), z=z, yaxis="y" if row == "y1" else row, xaxis="x",
        zmin=-REACH * threshold, zmax=REACH * threshold, colorscale=stepped(1 / REACH),
        showscale=False, xgap=1, ygap=1, hoverongaps=False,
        text=[[_shown(value, threshold) for value in values] for values in z],
        texttemplate="%{text}", customdata=[[_told(cell) for cell in cells] for cells in at],
        hovertemplate="%{y}: %{customdata}<extra></extra>",
    )  # fmt: skip


def _z(cell: dict | None) -> float | None:
    value = None if cell is None else cell.get("z")
    return round(float(value), 2) if known(value) else None


def _shown(z: float | None, threshold: float) -> str:
    """The number in a cell: only what is significant needs one."""
    return typeset(f"{z:.0f}") if z is not None and abs(z) >= threshold else ""


def _told(cell: dict | None) -> str:
    if cell is None or not known(cell.get("z")):
        return "these data cannot tell"
    force = with_error(cell.get("force"), cell.get("std"), cell.get("unit", ""))
    when = f", {cell['start']:.0f} to {cell['end']:.0f} s" if "start" in cell else ""
    return typeset(f"{force}, z = {significant(cell['z'], 2)}{when}")


def _edges(cells: Cells) -> np.ndarray:
    """Borders of all windows, those of neighbours that all but touch taken as one."""
    borders = np.unique([cell[end] for cell in cells for end in ("start", "end")])
    shortest = min(cell["end"] - cell["start"] for cell in cells)
    return borders[np.append(np.diff(borders) > 0.1 * shortest, True)]


def _cell(cells: Cells, degree: str, t: float) -> dict | None:
    """The strongest test of a degree of freedom at one time."""
    there = [
        cell
        for cell in cells
        if cell["degree_of_freedom"] == degree and cell["start"] <= t <= cell["end"]
    ]
    return max(there, key=lambda cell: abs(_z(cell) or 0.0), default=None)


def regime_map(title: str, cells: Cells, threshold: float) -> go.Figure:
    """Regime against degree of freedom, over all runs."""
    regimes = list(dict.fromkeys(cell["regime"] for cell in cells))
    found = {(cell["regime"], cell["degree_of_freedom"]): cell for cell in cells}
    at = [[found.get((regime, degree)) for degree in DEGREES] for regime in regimes]
    heat = _heat(at, DEGREES, threshold, "y1")
    heat.update(y=[typeset(regime) for regime in regimes])
    heat.update(hovertemplate="%{y}, %{x}: %{customdata}<extra></extra>")
    axes = {"showgrid": False, "fixedrange": True}
    return figure(
        heat, plot_bgcolor=GREY, margin={"t": 48, "b": 8, "l": 8, "r": 8},
        title={"text": title, "font": {"size": 12}, "x": 0, "y": 1, "pad": {"t": 6}},
        xaxis=axes | {"side": "top"}, yaxis=axes | {"autorange": "reversed"},
    )  # fmt: skip


def window_colourings(
    label: str, cells: Cells, runs: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """The force of each window along the tracks, one colouring for each degree of freedom."""
    out = []
    for degree in DEGREES:
        own = [c for c in cells if c["degree_of_freedom"] == degree and known(c.get("force"))]
        if not own:
            continue
        values = {}
        for run in runs:
            here = [cell for cell in own if cell["recording"] == run.name]
            at = [_cell(here, degree, t) for t in rows(run, "t", most)]
            values[run.name] = np.array([np.nan if c is None else c["force"] for c in at], float)
        name, unit = f"{FORCES[degree][0]} ({degree})", FORCES[degree][1]
        limit = max(abs(cell["force"]) for cell in own)
        out.append(Colouring(f"{name}, {label}", unit, limit or 1.0, values))
    return out


def latent_colourings(
    label: str, series: Mapping[str, dict], runs: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """A force estimated at every instant: `t`, `X`, `Y`, `N` by recording."""
    out = []
    for degree in DEGREES:
        symbol, unit = FORCES[degree]
        values = {
            run.name: _sampled(series[run.name], symbol, rows(run, "t", most))
            for run in runs
            if symbol in series.get(run.name, {})
        }
        sizes = [np.nanpercentile(np.abs(v), 99) for v in values.values() if np.isfinite(v).any()]
        if sizes:
            limit = float(max(sizes)) or 1.0
            out.append(Colouring(f"{symbol} ({degree}), {label}", unit, limit, values))
    return out


def _sampled(series: Mapping, symbol: str, t: np.ndarray) -> np.ndarray:
    values = np.array(series[symbol], float)  # None becomes NaN
    return np.interp(t, np.array(series["t"], float), values, left=np.nan, right=np.nan)


def rows(run: Trajectory, channel: str, most: int) -> np.ndarray:
    """A channel's valid rows, thinned evenly to at most so many."""
    values = getattr(run.counted(), channel)
    return values[:: max(1, math.ceil(len(values) / most))]


def coloured_track(
    run: Trajectory, colourings: Sequence[Colouring], group: str, most: int
) -> go.Figure:
    """The measured track, of at most so many points; one colouring at a time is visible."""
    north, east = (numbers(rows(run, channel, most)) for channel in ("x", "y"))
    times = numbers(rows(run, "t", most), 5)
    drawn = figure(
        go.Scatter(
            x=east, y=north, customdata=times, mode="lines", line={"color": "#c3cad2", "width": 3},
            hovertemplate="%{customdata} s<extra></extra>",
        ),
        **track_layout(),
    )  # fmt: skip
    for k, colouring in enumerate(colourings):
        if run.name in colouring.values:
            drawn.add_trace(_marks(run.name, colouring, (east, north, times), k == 0))
    drawn.add_scatter(
        x=east[:1], y=north[:1], mode="markers+text", text=["start"], textposition="top center",
        marker={"color": INK, "size": 8, "symbol": "diamond"}, hoverinfo="skip",
    )  # fmt: skip
    return follows_track(drawn, group, [0], [INK])


def _marks(
    name: str, colouring: Colouring, places: tuple[list, list, list], visible: bool
) -> go.Scatter:
    """Points of a track, coloured, where the force is known."""
    known_rows = np.flatnonzero(np.isfinite(colouring.values[name]))
    east, north, times = ([series[k] for k in known_rows] for series in places)
    bar = {
        "orientation": "h", "thickness": 9, "len": 0.8, "y": -0.16, "yanchor": "top",
        "title": {"text": f"{colouring.label} ({colouring.unit})", "side": "bottom"},
    }  # fmt: skip
    return go.Scatter(
        x=east, y=north, customdata=times, mode="markers", visible=visible,
        meta={"colouring": colouring.label},
        marker={
            "color": numbers(colouring.values[name][known_rows]), "size": 6, "colorbar": bar,
            "cmin": -colouring.limit, "cmax": colouring.limit, "colorscale": smooth(),
        },
        hovertemplate=f"%{{customdata}} s: %{{marker.color}} {colouring.unit}<extra></extra>",
    )  # fmt: skip


def track_layout() -> dict:
    """Axes of a map, north up, both to the same scale."""
    return {
        "showlegend": False, "hovermode": "closest", "margin": {"t": 24, "b": 40, "l": 48, "r": 8},
        "xaxis": {"title": {"text": "east (m)"}},
        "yaxis": {"title": {"text": "north (m)"}, "scaleanchor": "x", "scaleratio": 1},
    }  # fmt: skip
