"""Runs against what models predict of them, open loop: errors, tables of these, and curves.

A prediction starts at the first measured state and knows nothing but the orders (or the measured
actuation), so that its error is the model's own; it grows with time, and is told by horizon.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.report import plots
from diffsea.report.page import Plot, RunPlots, Table, Verbatim
from diffsea.report.quantities import is_known
from diffsea.report.words import diverged_predictions, two_digits
from diffsea.simulation.replay import horizon_errors, replay
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


_COUNTS = ("starts", "diverged")  # beside the errors of a horizon
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
    {"color": plots.NOMINAL, "width": 1.6, "dash": "dash"},
    {"color": plots.DIAGNOSED, "width": 1.8},
)
_MEASURED_LINE = {"color": plots.MEASURED, "width": 4}

Errors = Mapping[float, Mapping[str, float]]  # by horizon (s), then by quantity
Curve = tuple[str, Trajectory, dict[str, object]]  # name, run and line


class Prediction(NamedTuple):
    """What one model makes of a run from its first state and its orders.

    Attributes:
        run: the predicted motion at the times of the recording.
        errors: root mean square by horizon (s) and quantity (m, rad, m/s, rad/s), over `starts`
            starts along the run.
    """

    run: Trajectory
    errors: Errors


@dataclasses.dataclass(frozen=True)
class ComparedRun:
    """One run and the predictions of it by model, the result last."""

    recording: Trajectory
    predictions: dict[str, Prediction]


def predict(vessel: Vessel, run: Trajectory) -> Prediction:
    """One model on one run.

    Raises:
        UserError: the run has no orders for an actuator of the vessel.
    """
    return Prediction(replay(vessel, run), horizon_errors(vessel, run))


def compare(
    runs: Sequence[Trajectory],
    nominal: Sequence[Vessel],
    diagnosed: Sequence[Vessel] | None = None,
) -> list[ComparedRun]:
    """Two models on every run.

    Arguments:
        nominal: for each run the vessel in the environment of that run.
        diagnosed: likewise with what was named; None where nothing was: both models are one.
    """
    before = [predict(vessel, run) for vessel, run in zip(nominal, runs, strict=True)]
    after = before
    if diagnosed is not None:
        after = [predict(vessel, run) for vessel, run in zip(diagnosed, runs, strict=True)]
    both = zip(runs, before, after, strict=True)
    return [ComparedRun(run, {"nominal": old, "diagnosed": new}) for run, old, new in both]


def horizon_table(comparisons: Sequence[ComparedRun]) -> list[dict[str, Any]]:
    """Errors of every model at each horizon, root mean square over all starts of all runs.

    **Returns:** for each horizon `seconds`, `starts` (how many predictions), and by model the
    errors by quantity, as they stand in diagnosis.json and fit.json, with `diverged` where any
    did: the errors are those of the others.
    """
    models = list(comparisons[0].predictions) if comparisons else []
    horizons = {h for one in comparisons for p in one.predictions.values() for h in p.errors}
    rows = []
    for horizon in sorted(horizons):
        row: dict[str, Any] = {"seconds": horizon}
        for model in models:
            errors = [one.predictions[model].errors for one in comparisons]
            given = [by_horizon[horizon] for by_horizon in errors if horizon in by_horizon]
            row.setdefault("starts", sum(int(one["starts"]) for one in given))
            names = dict.fromkeys(name for one in given for name in one if name not in _COUNTS)
            row[model] = {name: _pooled_error(given, name) for name in names}
            if diverged := sum(int(one.get("diverged", 0)) for one in given):
                row[model]["diverged"] = diverged
        rows.append(row)
    return rows


def _pooled_error(errors: Sequence[Mapping[str, float]], name: str) -> float:
    """Root mean square over all starts of the runs that have the quantity."""
    given = [one for one in errors if name in one]
    weights = [one["starts"] - one.get("diverged", 0) for one in given]
    squares = [one[name] ** 2 for one in given]
    return math.sqrt(np.average(squares, weights=weights))


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
    more_runs: Sequence[RunPlots]
    left_out: bool


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
    rows = [_error_row(row, models) for row in horizon_table(comparisons)]
    used = [k for k, _ in enumerate(_QUANTITIES) if any(row[k + 2] for row in rows)]
    columns = ["seconds ahead", "predictions", *(_QUANTITIES[k][1] for k in used)]
    kept = [[*row[:2], *(row[k + 2] for k in used)] for row in rows]
    change = f", {' -> '.join(models.values())}" if len(models) > 1 else ""
    caption = f"Errors of the prediction so many seconds ahead (root mean square){change}"
    by_run = [
        [Verbatim(one.recording.name), *_error_row(row, models)]
        for one in comparisons
        for row in horizon_table([one])
    ]
    all_columns = ["run", *columns[:2], *(label for _, label, _ in _QUANTITIES)]
    several = len(comparisons) > 1
    return PredictionSection(
        Table(columns, kept, caption, range(len(columns))) if rows else None,
        Table(all_columns, by_run, numeric=range(1, len(all_columns))) if several else None,
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


def _error_row(row: dict[str, Any], models: Mapping[str, str]) -> list[str]:
    """Seconds ahead, number of predictions, then `before -> after` of every quantity."""
    cells = []
    for name, _, unit in _QUANTITIES:
        values = [row[model].get(name) for model in models]
        texts = [two_digits(value, unit).split()[0] for value in values if is_known(value)]
        cells.append(" -> ".join(texts))
    diverged = diverged_predictions(row, list(models))
    return [f"{row['seconds']:g}", str(row["starts"]) + diverged, *cells]


def _run_plots(one: ComparedRun, models: Mapping[str, str], group: str, most: int) -> RunPlots:
    """Track and histories of one run, as far as they were measured."""
    name, who = one.recording.name, " and ".join(models.values())
    lines = _MODEL_LINES[-len(models) :]
    curves: list[Curve] = [("measured", one.recording, _MEASURED_LINE)]
    for (model, label), line in zip(models.items(), lines, strict=True):
        curves.append((label, one.predictions[model].run, line))
    drawn = []
    if one.recording.has("x") and one.recording.has("y"):
        text = f"Track of {name}, measured and predicted ({who})."
        drawn.append(Plot(compared_tracks(curves, group, most), text, 460))
    if any(one.recording.has(channel) for channel, _, _ in _PANELS):
        text = f"Heading, yaw rate and speeds of {name}, measured and predicted ({who})."
        drawn.append(Plot(compared_histories(curves, group, most), text, 560))
    return RunPlots(name, drawn)


def compared_tracks(curves: Sequence[Curve], group: str, most: int) -> go.Figure:
    """Tracks from above, north up; the axes leave out what strays far from the measured one.

    Arguments:
        curves: what was measured, then each prediction, the result last.
        group: of plots that share a cursor.
        most: points of a track.
    """
    drawn = plots.figure(**plots.TRACK_LAYOUT | {"showlegend": True})
    north, east = ([plots.thin_rows(run, c, most) for _, run, _ in curves] for c in ("x", "y"))
    room = max(float(np.nanmax(series[0]) - np.nanmin(series[0])) for series in (north, east))
    for k, (name, run, line) in enumerate(curves):
        times = plots.numbers(plots.thin_rows(run, "t", most), plots.TIME_DIGITS)
        x, y = plots.numbers(east[k]), plots.numbers(north[k])
        drawn.add_scatter(x=x, y=y, customdata=times, mode="lines", name=name, line=line)
    drawn.update_traces(hovertemplate="%{customdata} s: %{x} m east, %{y} m north")
    drawn.update_xaxes(range=_axis_range(east, room))
    drawn.update_yaxes(range=_axis_range(north, room))
    colours = [str(line["color"]) for _, _, line in curves]
    return plots.add_track_markers(drawn, group, range(len(curves)), colours)


def compared_histories(curves: Sequence[Curve], group: str, most: int) -> go.Figure:
    """Heading, yaw rate and speeds against time, measured beside predicted, as far as measured.

    Arguments: as of `compared_tracks`. Angles are in degrees, headings without steps of a turn.
    """
    panels = [panel for panel in _PANELS if curves[0][1].has(panel[0])]
    margin = {"t": 24, "b": 36, "l": 48, "r": 8}
    drawn = plots.figure(hovermode="x", margin=margin, showlegend=False)
    for k, (channel, title, scale) in enumerate(panels):
        values = [plots.thin_rows(run, channel, most) * scale for _, run, _ in curves]
        if channel == "psi":
            values = on_one_turn(values)
        axis = f"y{k + 1}" if k else "y"
        for (name, run, line), series in zip(curves, values, strict=True):
            x = plots.numbers(plots.thin_rows(run, "t", most), plots.TIME_DIGITS)
            y = plots.numbers(series)
            drawn.add_scatter(x=x, y=y, mode="lines", name=name, line=line, xaxis="x", yaxis=axis)
        domain = plots.panel_of(k, len(panels), MARGIN)
        shape = {"domain": domain, "nticks": 5, "range": _axis_range(values)}
        drawn.update_layout({f"yaxis{k + 1}": shape})
        drawn.add_annotation(plots.heading(title, domain[1]))
    drawn.update_layout(xaxis={"title": {"text": "time (s)"}, "anchor": f"y{len(panels)}"})
    return plots.add_time_cursor(drawn, group)


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
