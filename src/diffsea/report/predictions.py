"""What models predict of runs, for both pages: tables of errors, and curves beside the measured."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.report.comparison import ComparedRun, horizon_table
from diffsea.report.page import Plot, RunPlots, Table, Verbatim
from diffsea.report.plots import (
    DIAGNOSED,
    MEASURED,
    NOMINAL,
    TIME_DIGITS,
    TRACK_LAYOUT,
    add_time_cursor,
    add_track_markers,
    figure,
    heading,
    numbers,
    panel_of,
    thin_rows,
)
from diffsea.report.quantities import is_known
from diffsea.report.words import two_digits
from diffsea.trajectory import Trajectory


OPEN_RUNS = 4  # of those held out; more would make the page long before it is read
MARGIN = 0.06  # of a panel's range, above and below its curves
_QUANTITIES = (
    ("position", "position (m)", "m"),
    ("heading", "heading (deg)", "rad"),
    ("u", "u (m/s)", "m/s"),
    ("v", "v (m/s)", "m/s"),
    ("r", "yaw rate (deg/s)", "rad/s"),
)
_PANELS = (
    ("psi", "heading (deg)", math.degrees(1.0)),
    ("r", "yaw rate (deg/s)", math.degrees(1.0)),
    ("u", "speed ahead u (m/s)", 1.0),
    ("v", "speed to starboard v (m/s)", 1.0),
)
_MODEL_LINES = (
    {"color": NOMINAL, "width": 1.6, "dash": "dash"},
    {"color": DIAGNOSED, "width": 1.8},
)
_MEASURED_LINE = {"color": MEASURED, "width": 4}


@dataclasses.dataclass(frozen=True)
class PredictionSection:
    """Errors and curves of open-loop predictions.

    Attributes:
        errors: of all runs together at each horizon; None where the runs are too short.
        errors_by_run: None for a single run.
        runs: drawn at once.
        more_runs: folded away.
        left_out: whether there are runs that are not drawn at all.
    """

    errors: Table | None
    errors_by_run: Table | None
    runs: Sequence[RunPlots]
    more_runs: Sequence[RunPlots] = ()
    left_out: bool = False


def prediction_section(
    comparisons: Sequence[ComparedRun], models: Mapping[str, str], most: int, worst: int | None
) -> PredictionSection:
    """What models predict of runs from their first state and their orders alone.

    Arguments:
        models: how each model is called; the last is the result.
        most: rows of a run that are drawn.
        worst: how many runs to draw, those that are predicted worst; all of them if None.
    """
    shown = comparisons if worst is None else worst_predicted(comparisons, list(models), worst)
    drawn = [_run_plots(one, models, f"held-out-{k}", most) for k, one in enumerate(shown)]
    return PredictionSection(
        _error_table(comparisons, models),
        _error_table_by_run(comparisons, models) if len(comparisons) > 1 else None,
        drawn[:OPEN_RUNS],
        drawn[OPEN_RUNS:],
        len(shown) < len(comparisons),
    )


def worst_predicted(
    comparisons: Sequence[ComparedRun], models: Sequence[str], count: int
) -> list[ComparedRun]:
    """The run that the last model predicts worst, then those that the first one does."""

    def final_error(one: ComparedRun, model: str) -> float:
        errors = one.predictions[model].errors
        last = errors[max(errors)] if errors else {}
        return last.get("position", last.get("heading", 0.0))

    if not comparisons:
        return []
    worst = max(comparisons, key=lambda one: final_error(one, models[-1]))
    others = [one for one in comparisons if one is not worst]
    others.sort(key=lambda one: -final_error(one, models[0]))
    return [worst, *others][:count]


def _error_table(comparisons: Sequence[ComparedRun], models: Mapping[str, str]) -> Table | None:
    """Errors of all runs together by horizon, of the quantities that any run has."""
    rows = [_error_row(row, models) for row in horizon_table(comparisons)]
    if not rows:
        return None
    used = [k for k, _ in enumerate(_QUANTITIES) if any(row[k + 2] for row in rows)]
    columns = ["seconds ahead", "predictions", *(_QUANTITIES[k][1] for k in used)]
    kept = [[*row[:2], *(row[k + 2] for k in used)] for row in rows]
    change = f", {' -> '.join(models.values())}" if len(models) > 1 else ""
    caption = f"Errors of the prediction so many seconds ahead (root mean square){change}"
    return Table(columns, kept, caption, range(len(columns)))


def _error_table_by_run(comparisons: Sequence[ComparedRun], models: Mapping[str, str]) -> Table:
    rows = [
        [Verbatim(one.recording.name), *_error_row(row, models)]
        for one in comparisons
        for row in horizon_table([one])
    ]
    columns = ["run", "seconds ahead", "predictions", *(label for _, label, _ in _QUANTITIES)]
    return Table(columns, rows, numeric=range(1, len(columns)))


def _error_row(row: dict[str, Any], models: Mapping[str, str]) -> list[str]:
    """Seconds ahead, number of predictions, then `before -> after` of every quantity."""
    cells = []
    for name, _, unit in _QUANTITIES:
        values = [row[model].get(name) for model in models]
        texts = [two_digits(value, unit).split()[0] for value in values if is_known(value)]
        cells.append(" -> ".join(texts))
    return [f"{row['seconds']:g}", str(row["starts"]), *cells]


def _run_plots(one: ComparedRun, models: Mapping[str, str], group: str, most: int) -> RunPlots:
    """Track and histories of one run, as far as they were measured."""
    name, who = one.recording.name, " and ".join(models.values())
    plots = []
    if one.recording.has("x") and one.recording.has("y"):
        text = f"Track of {name}, measured and predicted ({who})."
        plots.append(Plot(compared_tracks(one, models, group, most), text, 460))
    if any(one.recording.has(channel) for channel, _, _ in _PANELS):
        text = f"Heading, yaw rate and speeds of {name}, measured and predicted ({who})."
        plots.append(Plot(compared_histories(one, models, group, most), text, 560))
    return RunPlots(name, plots)


def _curves(
    one: ComparedRun, models: Mapping[str, str]
) -> list[tuple[str, Trajectory, dict[str, object]]]:
    """Name, run and line of what was measured and of each prediction, the result last."""
    lines = _MODEL_LINES[-len(models) :]
    predicted = [
        (label, one.predictions[model].run, line)
        for (model, label), line in zip(models.items(), lines, strict=True)
    ]
    return [("measured", one.recording, _MEASURED_LINE), *predicted]


def compared_tracks(
    one: ComparedRun, models: Mapping[str, str], group: str, most: int
) -> go.Figure:
    """Tracks from above, measured beside predicted, each of at most `most` points."""
    curves = _curves(one, models)
    drawn = figure(**TRACK_LAYOUT | {"showlegend": True})
    north, east = ([thin_rows(run, c, most) for _, run, _ in curves] for c in ("x", "y"))
    room = max(float(np.nanmax(series[0]) - np.nanmin(series[0])) for series in (north, east))
    hover = "%{customdata} s: %{x} m east, %{y} m north"
    for k, (name, run, line) in enumerate(curves):
        x, y, times = numbers(east[k]), numbers(north[k]), thin_rows(run, "t", most)
        drawn.add_scatter(
            x=x, y=y, customdata=numbers(times, TIME_DIGITS), mode="lines", name=name, line=line
        )
    drawn.update_traces(hovertemplate=hover)
    drawn.update_xaxes(range=_axis_range(east, room))
    drawn.update_yaxes(range=_axis_range(north, room))
    colours = [str(line["color"]) for _, _, line in curves]
    return add_track_markers(drawn, group, range(len(curves)), colours)


def compared_histories(
    one: ComparedRun, models: Mapping[str, str], group: str, most: int
) -> go.Figure:
    """Heading, yaw rate and speeds against time, measured beside predicted, as far as measured."""
    curves = _curves(one, models)
    panels = [panel for panel in _PANELS if one.recording.has(panel[0])]
    drawn = figure(hovermode="x", margin={"t": 24, "b": 36, "l": 48, "r": 8}, showlegend=False)
    for k, (channel, title, scale) in enumerate(panels):
        values = [thin_rows(run, channel, most) * scale for _, run, _ in curves]
        if channel == "psi":
            values = on_one_turn(values)
        axis = f"y{k + 1}" if k else "y"
        for (name, run, line), series in zip(curves, values, strict=True):
            x, y = numbers(thin_rows(run, "t", most), TIME_DIGITS), numbers(series)
            drawn.add_scatter(x=x, y=y, mode="lines", name=name, line=line, xaxis="x", yaxis=axis)
        domain = panel_of(k, len(panels), MARGIN)
        shape = {"domain": domain, "nticks": 5, "range": _axis_range(values)}
        drawn.update_layout({f"yaxis{k + 1}": shape}).add_annotation(heading(title, domain[1]))
    drawn.update_layout(xaxis={"title": {"text": "time (s)"}, "anchor": f"y{len(panels)}"})
    return add_time_cursor(drawn, group)


def on_one_turn(headings: Sequence[Float[np.ndarray, "row"]]) -> list[Float[np.ndarray, "row"]]:
    """Headings in degrees without steps, all on the turn of the first one."""
    out: list[np.ndarray] = []
    for psi in headings:
        finite = np.isfinite(psi)
        whole = psi.copy()
        whole[finite] = np.unwrap(psi[finite], period=360.0)
        if out and finite.any():
            both = finite & np.isfinite(out[0])
            first = int(np.argmax(both))
            whole -= 360.0 * np.round((whole[first] - out[0][first]) / 360.0) if both.any() else 0.0
        out.append(whole)
    return out


def _axis_range(
    series: Sequence[Float[np.ndarray, "row"]], room: float | None = None
) -> list[float]:
    """Range of the first series with a margin, and of the others while within `room` of it."""
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
