"""What models predict of runs, as tables of errors and as panels of curves."""

from collections.abc import Mapping, Sequence

from diffsea.report import figures
from diffsea.report import words as words
from diffsea.report.comparison import Comparison, horizon_table
from diffsea.report.page import Content, Html, element, folded, grid, paragraph, table, verbatim
from diffsea.report.quantities import known


_SHOWN_RUNS = 2
_QUANTITIES = (
    ("position", "position (m)", "m"), ("heading", "heading (deg)", "rad"),
    ("u", "u (m/s)", "m/s"), ("v", "v (m/s)", "m/s"), ("r", "yaw rate (deg/s)", "rad/s"),
)  # fmt: skip
_LOOKS = ((figures.BEFORE, "--"), (figures.AFTER, "-"))


def predictions(runs: Sequence[Comparison], models: Mapping[str, str]) -> list[Content]:
    """Tables and panels; `models` says how each model is called, the last is the result."""
    parts = error_tables(runs, models)
    shown = _telling(runs, list(models)) if runs else []
    if len(runs) > len(shown):
        parts.append(paragraph("Below: the runs that are predicted worst.", "note"))
    for run in shown:
        parts += [element("h3", verbatim(run.recording.name)), _panels(run, models)]
    return parts


def error_tables(runs: Sequence[Comparison], models: Mapping[str, str]) -> list[Content]:
    """Errors at each horizon, of all runs together and, folded, of every run."""
    if not runs:
        return [paragraph("There was nothing to predict.")]
    note = (
        "The model predicts each run from its first measured state and its orders alone; "
        "nothing is corrected on the way, so that errors grow with time."
    )
    parts: list[Content] = [paragraph(note), _errors(horizon_table(runs), models)]
    if len(runs) > 1:
        parts.append(folded("Errors of every run", _by_run(runs, models)))
    return parts


def _title(models: Mapping[str, str]) -> str:
    names = " -> ".join(models.values())
    change = f", {names}" if len(models) > 1 else ""
    return f"Errors of the prediction so many seconds ahead (root mean square){change}"


def _errors(rows: Sequence[dict], models: Mapping[str, str]) -> Html:
    if not rows:
        return paragraph("The runs are too short for predictions 5 s ahead.")
    cells = [_row(row, models) for row in rows]
    used = [k for k, _ in enumerate(_QUANTITIES) if any(row[k + 2] for row in cells)]
    columns = ["seconds ahead", "predictions", *(_QUANTITIES[k][1] for k in used)]
    kept = [[*row[:2], *(row[k + 2] for k in used)] for row in cells]
    return table(columns, kept, _title(models), numeric=range(len(columns)))


def _row(row: dict, models: Mapping[str, str]) -> list[str]:
    cells = []
    for name, _, unit in _QUANTITIES:
        values = [row[model].get(name) for model in models]
        texts = [words.two_digits(value, unit).split()[0] for value in values if known(value)]
        cells.append(" -> ".join(texts))
    return [f"{row['seconds']:g}", str(row["starts"]), *cells]


def _by_run(runs: Sequence[Comparison], models: Mapping[str, str]) -> Html:
    rows = [
        [verbatim(run.recording.name), *_row(row, models)]
        for run in runs
        for row in horizon_table([run])
    ]
    columns = ["run", "seconds ahead", "predictions", *(label for _, label, _ in _QUANTITIES)]
    return table(columns, rows, numeric=range(1, len(columns)))


def _telling(runs: Sequence[Comparison], models: Sequence[str]) -> list[Comparison]:
    """The runs that the last model and that the first one predict worst."""
    worst = max(runs, key=lambda run: _final_error(run, models[-1]))
    others = [run for run in runs if run is not worst]
    others.sort(key=lambda run: -_final_error(run, models[0]))
    return [worst, *others][:_SHOWN_RUNS]


def _final_error(run: Comparison, model: str) -> float:
    errors = run.predictions[model].errors
    last = errors[max(errors)] if errors else {}
    return last.get("position", last.get("heading", 0.0))


def _panels(run: Comparison, models: Mapping[str, str]) -> Html:
    looks = _LOOKS[-len(models) :]
    lines = [figures.measured(run.recording)]
    for (model, label), (colour, style) in zip(models.items(), looks, strict=True):
        lines.append(figures.Line(label, colour, run.predictions[model].run, style))
    return grid(figures.panels(lines, run.recording))
