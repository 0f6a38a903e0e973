"""Runs against what models predict of them, open loop: errors, tables of these, and curves.

A prediction starts in what a filter makes of what came before, or in a measured state where
nothing was fitted, and knows nothing but the orders (or the measured actuation), so that its error
is the model's own; it grows with time, and is told by horizon.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from diffsea.identification.run_models import Motion, RunModel
from diffsea.report import plots
from diffsea.report.histories import Curve, compared_histories
from diffsea.report.page import Plot, RunPlots, Table, Verbatim
from diffsea.report.quantities import is_known
from diffsea.report.tracks import DrawnFlow, compared_tracks
from diffsea.report.wording.horizons import diverged_predictions, two_digits
from diffsea.report.wording.words import capital
from diffsea.simulation.replay import horizon_errors, replay
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


_COUNTS = ("starts", "diverged")  # beside the errors of a horizon
OPEN_RUNS = 4  # of those held out; more would make the page long before it is read
PANEL_HEIGHT = 140  # pixels, of a history
_QUANTITIES = (
    ("position", "position (m)", "m"),
    ("heading", "heading (deg)", "rad"),
    ("u", "u (m/s)", "m/s"),
    ("v", "v (m/s)", "m/s"),
    ("r", "yaw rate (deg/s)", "rad/s"),
)
_MODEL_LINES = (
    {"color": plots.NOMINAL, "width": 1.6, "dash": "dash"},
    {"color": plots.DIAGNOSED, "width": 1.8},
)
_MEASURED_LINE = {"color": plots.MEASURED, "width": 4}

Errors = Mapping[float, Mapping[str, float]]  # by horizon (s), then by quantity


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
    """One run and the predictions of it by model, the result last; `units` are those of orders."""

    recording: Trajectory
    predictions: dict[str, Prediction]
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)


def predict(vessel: Vessel, run: Trajectory, states: Motion | None = None) -> Prediction:
    """One model on one run.

    Arguments:
        states: in which the predictions begin whose errors are told, as of a `RunModel`.

    Raises:
        UserError: the run has no orders for an actuator of the vessel.
    """
    return Prediction(replay(vessel, run), horizon_errors(vessel, run, states=states))


def compare(
    runs: Sequence[Trajectory],
    nominal: Sequence[RunModel],
    diagnosed: Sequence[RunModel] | None = None,
) -> list[ComparedRun]:
    """Two models on every run.

    Arguments:
        nominal: for each run the vessel in the environment of that run.
        diagnosed: likewise with what was named; None where nothing was: both models are one.
    """
    predicted = lambda models: [
        predict(model.vessel, run, model.states) for model, run in zip(models, runs, strict=True)
    ]
    before = predicted(nominal)
    after = before if diagnosed is None else predicted(diagnosed)
    both = zip(runs, before, after, strict=True)
    units = nominal[0].vessel.units if nominal else {}
    return [ComparedRun(run, {"nominal": old, "diagnosed": new}, units) for run, old, new in both]


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

    def without_first_track(self) -> tuple[Plot | None, "PredictionSection"]:
        """The track of the first run, to stand beside a page's first sentence, and the rest."""
        if not self.runs or len(self.runs[0].plots) < 2:
            return None, self
        (track, *histories), name = self.runs[0].plots, self.runs[0].name
        moved = dataclasses.replace(track, caption=f"{name}: recorded and predicted.", height=400)
        rest = [RunPlots(name, histories), *self.runs[1:]]
        return moved, dataclasses.replace(self, runs=rest)


def prediction_section(
    comparisons: Sequence[ComparedRun],
    models: Mapping[str, str],
    most: int,
    worst: int | None,
    flows: Sequence[DrawnFlow] = (),
) -> PredictionSection:
    """What models predict of runs from their first state and their orders alone.

    Arguments:
        models: how each model is called; the last is the result.
        most: rows of a run that are drawn.
        worst: how many runs to draw, those that are predicted worst; all of them if None.
        flows: current and wind that the last model has.
    """
    shown = comparisons if worst is None else worst_predicted(comparisons, list(models), worst)
    drawn = [_run_plots(one, models, f"held-out-{k}", most, flows) for k, one in enumerate(shown)]
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
    """The run that the last model predicts worst, then those that the first one does.

    Predictions that all diverge are the worst, a run that is too short for any the best.
    """

    def final_error(one: ComparedRun, model: str) -> float:
        errors = one.predictions[model].errors
        last = errors[max(errors)] if errors else {}
        if last and last.get("diverged") == last["starts"]:
            return math.inf
        return next((last[name] for name, *_ in _QUANTITIES if name in last), -math.inf)

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


def _run_plots(
    one: ComparedRun, models: Mapping[str, str], group: str, most: int, flows: Sequence[DrawnFlow]
) -> RunPlots:
    """Track and histories of one run, as far as they were measured."""
    name, who = one.recording.name, " and ".join(models.values())
    lines = _MODEL_LINES[-len(models) :]
    curves: list[Curve] = [("measured", one.recording, _MEASURED_LINE)]
    for (model, label), line in zip(models.items(), lines, strict=True):
        curves.append((label, one.predictions[model].run, line))
    drawn = []
    if one.recording.has("x") and one.recording.has("y"):
        text = f"Track of {name}, measured and predicted ({who})."
        drawn.append(Plot(compared_tracks(curves, group, most, flows), text, 460))
    histories, panels = compared_histories(curves, group, most, one.units)
    if panels:
        text = (
            f"{capital(', '.join(panels))} of {name} against time, measured and predicted ({who})."
        )
        drawn.append(Plot(histories, text, PANEL_HEIGHT * len(panels)))
    return RunPlots(name, drawn)
