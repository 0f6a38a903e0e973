"""*Where* model and recordings differ: maps of z-scores, tracks coloured by force, a table.

A cell of a map tests an unnamed force in one degree of freedom, during a window of time or in a
regime. It is a record of diagnosis.json with `force` and `std` (N or N m; positive ahead, to
starboard, bow to starboard) and `z`, their ratio, which is None where the data cannot tell.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.report import plots
from diffsea.report.page import Plot, RunPlots, Table, Verbatim, probability_cell
from diffsea.report.quantities import is_known, significant, typeset, with_error
from diffsea.report.wording.words import Record, named_effects
from diffsea.trajectory import Trajectory


FORCES = {"surge": ("X", "N"), "sway": ("Y", "N"), "yaw": ("N", "N m")}
DEGREES = tuple(FORCES)
REACH = 3.0  # colours end at so many thresholds: stronger is beyond doubt anyway
OPEN_RUNS = 6  # with the strongest windows; the others are folded away
LISTED_PLACES = 8  # rows of the table
HEADING_ROOM = 0.13  # of a figure's height, for the title above each panel of a map
TITLE = {"font": {"size": 12}, "x": 0, "y": 1, "pad": {"t": 6}}
NOMINAL_MODEL, DIAGNOSED_MODEL = "nominal model", "diagnosed model"
Cells = Sequence[Record]


@dataclasses.dataclass(frozen=True)
class Colouring:
    """A force along tracks, of one degree of freedom, in `unit`; the colours end at `limit`."""

    label: str
    unit: str
    limit: float
    values: Mapping[str, Float[np.ndarray, "row"]]  # by recording, in drawn rows; NaN: not known


@dataclasses.dataclass(frozen=True)
class LocationSection:
    """What the section *where* shows.

    Attributes:
        threshold: of |z|, as text, beyond which it is significant; colours end at `reach`.
        by_regime: a map for each model that has one.
        colourings: labels of what tracks can be coloured by.
        by_time: runs with the strongest windows; `more_runs` are folded away.
        strongest: windows and regimes of the nominal model, as the summary ranks them.
        gradient: the colours of the maps, as CSS, with `pale` for what is not significant and
            `unknown` for what the data cannot tell.
    """

    threshold: str
    reach: str
    by_regime: Sequence[Plot]
    colourings: Sequence[str]
    by_time: Sequence[RunPlots]
    more_runs: Sequence[RunPlots]
    strongest: Table
    gradient: str = ", ".join(f"{c} {100 * at:.1f}%" for at, c in plots.stepped_scale(1 / REACH))
    pale: str = plots.PALE[1]
    unknown: str = plots.GREY


def location_section(
    summary: Record, recordings: Sequence[Trajectory], most: int
) -> LocationSection:
    """Maps by time and by regime, tracks coloured by force, and the strongest places.

    Arguments:
        summary: the content of diagnosis.json.
        recordings: those that were fitted.
        most: points of a track.
    """
    maps = {NOMINAL_MODEL: summary["map"]}
    maps |= {DIAGNOSED_MODEL: summary["map_after"]} if named_effects(summary) else {}
    threshold = float(summary["map"]["threshold"])
    by_regime = []
    for title, one in maps.items():
        if cells := one["regime"]:
            height = 60 + 24 * len({cell["regime"] for cell in cells})
            text = _alternative(f"By regime, {title}", cells, threshold)
            by_regime.append(Plot(regime_map(title, cells, threshold), text, height))
    windows: dict[str, Cells] = {title: one["time"] for title, one in maps.items()}
    windows = windows if any(windows.values()) else {}
    colourings = _colourings(summary, windows, recordings, most) if windows else []
    strength, drawn = [], []
    for number, run in enumerate(recordings if windows else ()):
        own = {t: [c for c in cells if c["recording"] == run.name] for t, cells in windows.items()}
        own = {title: cells for title, cells in own.items() if cells}
        strength.append(max((_size(c) for cells in own.values() for c in cells), default=0.0))
        drawn.append(_run_plots(run, own, threshold, colourings, f"recording-{number}", most))
    open_runs = sorted(range(len(drawn)), key=lambda k: -strength[k])[:OPEN_RUNS]
    return LocationSection(
        significant(threshold, 2),
        significant(REACH * threshold, 2),
        by_regime,
        [one.label for one in colourings],
        [one for k, one in enumerate(drawn) if k in open_runs],
        [one for k, one in enumerate(drawn) if k not in open_runs],
        _strongest_places(summary),
    )


def _size(cell: Record) -> float:
    """|z| of a test, zero where the data cannot tell."""
    return abs(cell.get("z") or 0.0)


def _alternative(title: str, cells: Cells, threshold: float) -> str:
    """What a map shows, in words."""
    counts = []
    for degree in DEGREES:
        own = [_size(cell) for cell in cells if cell["degree_of_freedom"] == degree]
        counts.append(f"{degree} {sum(z >= threshold for z in own)} of {len(own)}")
    return f"{title}, significant cells: {', '.join(counts)}."


def _run_plots(
    run: Trajectory,
    maps: Mapping[str, Cells],
    threshold: float,
    colourings: Sequence[Colouring],
    group: str,
    most: int,
) -> RunPlots:
    """The map of one run over time, by model, and its track; the cursor joins the two."""
    drawn = []
    if maps:
        texts = [_alternative(f"{run.name}, {t}", cells, threshold) for t, cells in maps.items()]
        height = 70 + 115 * len(maps)
        drawn.append(Plot(time_map(maps, threshold, group), " ".join(texts), height))
    if run.has("x") and run.has("y"):
        text = f"Track of {run.name}, coloured by the force that the model lacks."
        track = coloured_track(run, colourings, group, most)
        drawn.append(Plot(track, text, 420, classes="coloured"))
    return RunPlots(run.name, drawn)


def _strongest_places(summary: Record) -> Table:
    rows = []
    for cell in summary["where"][:LISTED_PLACES]:
        name, when = Verbatim(cell["recording"]), f"{cell['start']:.0f} to {cell['end']:.0f} s"
        if cell["recording"] == "all":
            name, when = Verbatim("all runs"), "whole run"
        force = f"{significant(cell['force_rms'], 2)} {cell['unit']}"
        p = probability_cell(cell["p_value"])
        rows.append([cell["degree_of_freedom"], name, when, cell["regime"], force, p])
    columns = ["degree of freedom", "recording", "when", "regime", "force missing", "p"]
    title = "Strongest places in the nominal model (p of each by itself)"
    return Table(columns, rows, title, numeric=(4, 5))


def time_map(maps: Mapping[str, Cells], threshold: float, group: str) -> go.Figure:
    """Degree of freedom against time in one run, a row of panels for each model.

    Neighbouring windows that all but touch have one border.

    Arguments:
        maps: tests of windows of this run, by the title of the model.
        threshold: of |z|, beyond which a test is significant.
        group: of plots that share a cursor.
    """
    drawn = plots.figure(margin={"t": 24, "b": 36, "l": 48, "r": 8}, plot_bgcolor=plots.GREY)
    rows = {"autorange": "reversed", "showgrid": False, "fixedrange": True}
    for k, (title, cells) in enumerate(maps.items()):
        borders = np.unique([cell[end] for cell in cells for end in ("start", "end")])
        shortest = min(cell["end"] - cell["start"] for cell in cells)
        edges = borders[np.append(np.diff(borders) > 0.1 * shortest, True)]
        middle = 0.5 * (edges[:-1] + edges[1:])
        tests = [[_strongest_test(cells, degree, t) for t in middle] for degree in DEGREES]
        drawn.add_trace(_heatmap(tests, plots.numbers(edges, plots.TIME_DIGITS), threshold, k))
        domain = plots.panel_of(k, len(maps), HEADING_ROOM)
        drawn.update_layout({f"yaxis{k + 1}": rows | {"domain": domain}})
        drawn.add_annotation(plots.heading(title, domain[1] + 0.01), font={"size": 12})
    axis = {"title": {"text": "time (s)"}, "anchor": f"y{len(maps)}", "showgrid": False}
    return plots.add_time_cursor(drawn.update_layout(xaxis=axis), group)


def regime_map(title: str, cells: Cells, threshold: float) -> go.Figure:
    """Regime against degree of freedom, over all runs.

    Arguments:
        cells: tests of regimes; a pair without a test stays empty.
        threshold: of |z|, beyond which a test is significant.
    """
    regimes = list(dict.fromkeys(cell["regime"] for cell in cells))
    found = {(cell["regime"], cell["degree_of_freedom"]): cell for cell in cells}
    tests = [[found.get((regime, degree)) for degree in DEGREES] for regime in regimes]
    heat = _heatmap(tests, DEGREES, threshold, 0)
    heat.update(y=[typeset(regime) for regime in regimes])
    heat.update(hovertemplate="%{y}, %{x}: %{customdata}<extra></extra>")
    axis = {"showgrid": False, "fixedrange": True}
    return plots.figure(
        heat,
        plot_bgcolor=plots.GREY,
        margin={"t": 48, "b": 8, "l": 8, "r": 8},
        title=TITLE | {"text": title},
        xaxis=axis | {"side": "top"},
        yaxis=axis | {"autorange": "reversed"},
    )


def _heatmap(
    tests: Sequence[Sequence[Record | None]], x: Sequence, threshold: float, panel: int
) -> go.Heatmap:
    """Cells coloured by z; only what is significant has its number.

    Arguments:
        tests: a row for each label of the y axis; None where nothing was tested.
        x: labels of columns, or their borders.
        panel: whose axes, counted from zero.
    """

    def number(z: float | None) -> str:
        return typeset(f"{z:.0f}") if z is not None and abs(z) >= threshold else ""

    def pointed_at(cell: Record | None) -> str:
        """The force with its standard error, z and when."""
        if cell is None or not is_known(cell.get("z")):
            return "these data cannot tell"
        force = with_error(cell.get("force"), cell.get("std"), cell.get("unit", ""))
        when = f", {cell['start']:.0f} to {cell['end']:.0f} s" if "start" in cell else ""
        return typeset(f"{force}, z = {significant(cell['z'], 2)}{when}")

    z = [[_rounded_z(cell) for cell in cells] for cells in tests]
    return go.Heatmap(
        x=list(x),
        y=list(DEGREES),
        z=z,
        xaxis="x",
        yaxis=f"y{panel + 1}" if panel else "y",
        zmin=-REACH * threshold,
        zmax=REACH * threshold,
        colorscale=plots.stepped_scale(1 / REACH),
        showscale=False,
        xgap=1,
        ygap=1,
        hoverongaps=False,
        text=[[number(value) for value in values] for values in z],
        texttemplate="%{text}",
        customdata=[[pointed_at(cell) for cell in cells] for cells in tests],
        hovertemplate="%{y}: %{customdata}<extra></extra>",
    )


def _rounded_z(cell: Record | None) -> float | None:
    """z to two decimals, which a colour does not show and a page need not carry."""
    value = None if cell is None else cell.get("z")
    return round(float(value), 2) if is_known(value) else None


def _strongest_test(cells: Cells, degree: str, t: float) -> Record | None:
    """The strongest test of a degree of freedom at one time."""
    own = (cell for cell in cells if cell["degree_of_freedom"] == degree)
    there = (cell for cell in own if cell["start"] <= t <= cell["end"])
    return max(there, key=lambda cell: abs(_rounded_z(cell) or 0.0), default=None)


def _colourings(
    summary: Record, windows: Mapping[str, Cells], recordings: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """What tracks may be coloured by, that with the largest z-score first."""
    located = [run for run in recordings if run.has("x") and run.has("y")]
    latent = summary["residual_force"]
    out: list[Colouring] = []
    for title, cells in windows.items():
        if title == DIAGNOSED_MODEL and latent:
            continue  # what remains at every instant says more than windows do
        own = window_colourings(title, cells, located, most)
        if not out:
            best = max(cells, key=_size, default=None)
            own.sort(key=lambda one: best is None or best["degree_of_freedom"] not in one.label)
        out += own
    return out + latent_colourings("what remains", latent, located, most)


def window_colourings(
    label: str, cells: Cells, runs: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """The force of each window along the tracks, one colouring for each degree of freedom.

    Arguments:
        label: of the model.
        cells: tests of windows; where several overlap, the strongest counts.
        most: points of a track.
    """
    out = []
    for degree, (symbol, unit) in FORCES.items():
        own = [c for c in cells if c["degree_of_freedom"] == degree and is_known(c.get("force"))]
        if not own:
            continue
        values = {}
        for run in runs:
            here = [cell for cell in own if cell["recording"] == run.name]
            tests = [_strongest_test(here, degree, t) for t in plots.thin_rows(run, "t", most)]
            forces = [np.nan if test is None else test["force"] for test in tests]
            values[run.name] = np.array(forces, float)
        limit = max(abs(cell["force"]) for cell in own)
        out.append(Colouring(f"{symbol} ({degree}), {label}", unit, limit or 1.0, values))
    return out


def latent_colourings(
    label: str, series: Mapping[str, Record], runs: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """A force estimated at every instant, the colours ending at its 99th percentile.

    Arguments:
        series: `t` (s), `X`, `Y` (N), `N` (N m) by recording; None where nothing is known.
        most: points of a track.
    """
    out = []
    for degree, (symbol, unit) in FORCES.items():
        values = {}
        for run in runs:
            own = series.get(run.name, {})
            if symbol in own:
                times, forces = np.array(own["t"], float), np.array(own[symbol], float)  # None: NaN
                t = plots.thin_rows(run, "t", most)
                values[run.name] = np.interp(t, times, forces, left=np.nan, right=np.nan)
        sizes = [np.nanpercentile(np.abs(v), 99) for v in values.values() if np.isfinite(v).any()]
        if sizes:
            limit = float(max(sizes)) or 1.0
            out.append(Colouring(f"{symbol} ({degree}), {label}", unit, limit, values))
    return out


def coloured_track(
    run: Trajectory, colourings: Sequence[Colouring], group: str, most: int
) -> go.Figure:
    """The measured track, of at most `most` points; one colouring at a time is visible.

    The script of the page shows another one when it is chosen. Points are coloured where the force
    is known.
    """
    north, east = (plots.numbers(plots.thin_rows(run, c, most)) for c in ("x", "y"))
    times = plots.numbers(plots.thin_rows(run, "t", most), plots.TIME_DIGITS)
    track = go.Scatter(x=east, y=north, customdata=times, mode="lines")
    track.update(
        line={"color": "#c3cad2", "width": 3}, hovertemplate="%{customdata} s<extra></extra>"
    )
    drawn = plots.figure(track, **plots.TRACK_LAYOUT)
    for k, colouring in enumerate(colourings):
        if run.name not in colouring.values:
            continue
        rows = np.flatnonzero(np.isfinite(colouring.values[run.name])).tolist()
        x, y, t = ([series[row] for row in rows] for series in (east, north, times))
        bar = {"orientation": "h", "thickness": 9, "len": 0.8, "y": -0.16, "yanchor": "top"}
        bar["title"] = {"text": f"{colouring.label} ({colouring.unit})", "side": "bottom"}
        marker = {"size": 6, "colorbar": bar, "colorscale": plots.smooth_scale()}
        marker |= {"color": plots.numbers(colouring.values[run.name][rows])}
        marker |= {"cmin": -colouring.limit, "cmax": colouring.limit}
        points = go.Scatter(x=x, y=y, customdata=t, mode="markers", marker=marker, visible=k == 0)
        hover = f"%{{customdata}} s: %{{marker.color}} {colouring.unit}<extra></extra>"
        drawn.add_trace(points.update(meta={"colouring": colouring.label}, hovertemplate=hover))
    marker = {"color": plots.INK, "size": 8, "symbol": "diamond"}
    start = go.Scatter(x=east[:1], y=north[:1], text=["start"], textposition="top center")
    drawn.add_trace(start.update(mode="markers+text", marker=marker, hoverinfo="skip"))
    return plots.add_track_markers(drawn, group, [0], [plots.INK])
