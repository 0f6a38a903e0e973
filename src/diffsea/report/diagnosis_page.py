"""A diagnosis as one page for people: verdict, where, what, how large, before and after."""

from collections.abc import Sequence

from diffsea.diagnosis.locate import DEGREES, Cell
from diffsea.diagnosis.select import ALPHA, Diagnosis
from diffsea.report import figures
from diffsea.report import text as words
from diffsea.report.comparison import Comparison, compare, horizon_table, own_environment
from diffsea.report.page import (
    Content,
    Html,
    bullets,
    element,
    folded,
    grid,
    joined,
    page,
    paragraph,
    section,
    table,
    verbatim,
)
from diffsea.report.quantities import known, probability, significant, with_error
from diffsea.report.records import parameter_table, provenance
from diffsea.vessel.base import Vessel


_SHOWN_RUNS = 2
_ROWS = 12
_PLACES = 5
_HORIZON_COLUMNS = (
    ("position", "position (m)", "m"), ("heading", "heading (deg)", "rad"),
    ("u", "u (m/s)", "m/s"), ("v", "v (m/s)", "m/s"), ("r", "yaw rate (deg/s)", "rad/s"),
)  # fmt: skip
_MEANING = {
    "consistent": "consistent: nothing is missing",
    "explained": "explained: the missing effect has a name",
    "ambiguous": "ambiguous: several effects would explain it",
    "unexplained": "unexplained: something is missing that has no name here",
}


def diagnosis_report(
    summary: dict, diagnosis: Diagnosis, nominal: Vessel, diagnosed: Vessel, source: dict
) -> str:
    """The page.

    Arguments:
        summary: the content of diagnosis.json.
        nominal: the nominal model with its own fitted derivatives.
        diagnosed: the model with the effects found.
        source: what was run on what: file names, hashes, settings; shown as it is.
    """
    runs = compare(diagnosis, nominal, diagnosed)
    held_out = summary.get("held_out", {})
    summary = summary | {"held_out": held_out | {"horizons": horizon_table(runs)}}
    sections = [
        _verdict(summary),
        _audit(summary),
        _where(summary, diagnosis),
        _what(summary),
        _before_and_after(summary, runs, own_environment(diagnosis)),
        _parameters(summary),
        _next(summary, diagnosis),
        _provenance(summary, diagnosis, source),
    ]
    return page(f"Diagnosis of {nominal.name}", _subtitle(diagnosis), sections)


def _subtitle(diagnosis: Diagnosis) -> str:
    data = diagnosis.split
    count = len(data.recordings)
    runs = "1 recording" if count == 1 else f"{count} recordings"
    if data.by_time:
        return f"{runs}, the last part of each held out"
    return f"{runs}, {len(data.held_out)} more held out"


def _verdict(summary: dict) -> Html:
    verdict = summary["verdict"]
    body = joined(
        [
            paragraph(_MEANING.get(verdict, verdict), "word"),
            paragraph(words.finding(summary), "lead"),
            paragraph(words.held_out_change(summary)),
            paragraph(words.remaining(summary), "note"),
        ]
    )
    tone = verdict if verdict in _MEANING else "explained"
    return Html(f'<section id="verdict" class="verdict {tone}">\n{body}\n</section>')


def _audit(summary: dict) -> Html:
    records = summary["audit"]
    if not records:
        text = "The audit found no fault in the recordings: clocks, frames, signs, units and "
        return section("audit", "Are the data sound?", paragraph(text + "sensors agree."))
    rows = [
        [
            words.title(record["kind"]),
            verbatim(record["recording"]),
            with_error(record.get("value"), record.get("std"), record.get("unit", ""))
            if known(record.get("value")) else "",
            _message(record),
        ]
        for record in records
    ]  # fmt: skip
    return section(
        "audit",
        "Are the data sound?",
        paragraph("Faults that the recordings show by themselves, before any model is blamed."),
        table(["fault", "recording", "size", "what was seen"], rows, "Findings of the audit"),
    )


def _message(record: dict) -> Html:
    repair = record.get("repair", "")
    advice = paragraph(verbatim(f"Repair: {repair}"), "note") if repair else ""
    return Html(f"{verbatim(record['message'])}{advice}")


def _where(summary: dict, diagnosis: Diagnosis) -> Html:
    heading = "Where do model and recordings differ?"
    maps = _maps(diagnosis)
    if not summary["where"]:
        text = "No window of time and no regime stands out: the maps stay white."
        return section("where", heading, paragraph(text), maps)
    rows = [
        [
            cell["degree_of_freedom"],
            verbatim("all runs" if cell["recording"] == "all" else cell["recording"]),
            "whole run" if cell["recording"] == "all"
            else f"{cell['start']:.0f} to {cell['end']:.0f} s",
            verbatim(cell["regime"]),
            f"{significant(cell['force_rms'], 2)} {cell['unit']}",
            probability(cell["p_value"]),
        ]
        for cell in summary["where"][:_ROWS]
    ]  # fmt: skip
    columns = ["motion", "recording", "when", "regime", "force missing", "p"]
    text = (
        "An unnamed force is added to the nominal model in one window of time or one regime. "
        "Where that improves the fit significantly, the model lacks something there."
    )
    return section(
        "where",
        heading,
        paragraph(text),
        maps,
        _strongest_track(summary, diagnosis),
        table(columns, rows, "Strongest places, nominal model", numeric=(4, 5)),
    )


def _maps(diagnosis: Diagnosis) -> Html:
    names = [run.name for run in diagnosis.split.recordings]
    states = [("Nominal model", diagnosis.before)]
    if diagnosis.effects:
        states.append(("With the effects found", diagnosis.after))
    drawn = []
    for title, cells in states:
        drawn.append(figures.time_map(cells, names, f"{title}: by time", _told(title, cells)))
    for title, cells in states:
        if any(cell.run is None for cell in cells):
            text = _told(title, cells, regimes=True)
            drawn.append(figures.regime_map(cells, f"{title}: by regime", text))
    note = (
        "White: nothing significant. The darker, the surer that a force is missing; p is "
        "corrected for the number of places tested."
    )
    return joined([grid(drawn), paragraph(note, "note")])


def _told(title: str, cells: Sequence[Cell], regimes: bool = False) -> str:
    """What a map shows, in words."""
    kind = "regimes" if regimes else "windows of time"
    shown = [cell for cell in cells if (cell.run is None) == regimes]
    counts = []
    for degree, name in enumerate(DEGREES):
        own = [cell for cell in shown if cell.degree == degree]
        hits = sum(cell.p_value * len(cells) < ALPHA for cell in own)
        counts.append(f"{name} {hits} of {len(own)}")
    return f"{title}, significant {kind}: {', '.join(counts)}."


def _strongest_track(summary: dict, diagnosis: Diagnosis) -> Html:
    """The track of the run with the strongest mismatch, its windows marked."""
    cells = [c for c in diagnosis.before if c.run is not None]
    flagged = [c for c in cells if c.p_value * len(diagnosis.before) < ALPHA]
    if not flagged:
        return Html("")
    number = min(flagged, key=lambda cell: cell.p_value).run
    run = diagnosis.split.recordings[number]
    if not (run.has("x") and run.has("y")):
        return Html("")
    windows = sorted({(c.start, c.end) for c in flagged if c.run == number})
    return grid([figures.flagged_track(run, windows, f"Strongest in {run.name}")])


def _what(summary: dict) -> Html:
    found = words.accepted(summary)
    parts: list[Content] = []
    if not found:
        parts.append(paragraph("No effect of the catalogue was added to the model."))
    for group in words.grouped(found):
        parts.append(_effect(group))
    parts.append(_ranking(summary))
    return section("what", "What is missing, and how large is it?", *parts)


def _effect(group: list[dict]) -> Html:
    first = group[0]
    evidence = first["evidence"]
    rows = [
        [
            *([verbatim(effect["recording"])] if "recording" in effect else []),
            name.replace("_", " ") + words.direction_note(effect, name),
            with_error(entry["value"], entry.get("std"), entry.get("unit", "")),
        ]
        for effect in group
        for name, entry in effect["parameters"].items()
    ]
    columns = [*(["recording"] if "recording" in first else []), "parameter", "estimate"]
    channels = f" of {', '.join(first['channels'])}" if first.get("channels") else ""
    lines = [
        f"Score {significant(evidence['score'], 3)}, p = {probability(evidence['p_value'])}; "
        f"it removes {100 * evidence['cost_drop']:.0f} % of the squared prediction errors."
    ]
    gain = evidence.get("held_out_gain")
    if known(gain):
        std = evidence.get("held_out_gain_std")
        lines.append(f"Held-out gain in -2 log likelihood: {with_error(gain, std)}.")
    rivals = [words.title(name) for name in first.get("alternatives", [])]
    lines.append(
        f"The same data support nearly as well: {words.listed(rivals, 'or')}."
        if rivals else "Nothing else in the catalogue explains the data nearly as well."
    )  # fmt: skip
    return joined(
        [element("h3", words.title(first["name"]) + channels), table(columns, rows), bullets(lines)]
    )


def _ranking(summary: dict) -> Html:
    screening = summary.get("screening", [])
    rows = [_ranked(row) for row in screening]
    if not rows:
        return Html("")
    columns = ["candidate", "score", "p", "BIC gain", "held-out gain", "possible"]
    text = (
        "Every entry of the catalogue that this vessel could have, against the nominal model. "
        "The strongest were fitted; a BIC gain above 10 and a held-out gain above two standard "
        "errors are needed."
    )
    note = paragraph(text, "note")
    ranking = table(columns, rows[:_ROWS], "Candidates", numeric=(1, 2, 3, 4))
    rest = table(columns, rows[_ROWS:], numeric=(1, 2, 3, 4))
    more = folded(f"{len(rows) - _ROWS} weaker candidates", rest) if rows[_ROWS:] else ""
    return joined([element("h3", "Ranking of candidates"), note, ranking, more])


def _ranked(row: dict) -> list[Content]:
    name, _, variant = row["name"].partition(":")
    label = words.title(name) + (f" ({variant.replace('_', ' ')})" if variant else "")
    score = [label, significant(row["score"], 3), probability(row["p_value"])]
    if "bic" not in row:
        return [*score, "not fitted", "", ""]
    gain = with_error(row["held_out_gain"], row["held_out_gain_std"])
    return [*score, significant(row["bic"], 3), gain, "yes" if row["possible"] else "no"]


def _before_and_after(summary: dict, runs: list[Comparison], own: bool) -> Html:
    held_out = summary["held_out"]
    rows = [_horizon(row) for row in held_out["horizons"]]
    used = [k for k, _ in enumerate(_HORIZON_COLUMNS) if any(row[k + 2] for row in rows)]
    columns = ["seconds ahead", "starts", *(_HORIZON_COLUMNS[k][1] for k in used)]
    rows = [[*row[:2], *(row[k + 2] for k in used)] for row in rows]
    note = (
        "The models predict each run from its first measured state and its orders alone; "
        "nothing is corrected on the way, so that errors grow with time."
    )
    parts: list[Content] = [paragraph(note)]
    if own:
        text = (
            "Wind or current differ from run to run: on a held-out run they are estimated "
            "on that run itself, everything else stays as found."
        )
        parts.append(paragraph(text))
    if rows:
        title = "Prediction errors on held-out runs (root mean square), nominal -> diagnosed"
        parts.append(table(columns, rows, title, numeric=range(len(columns))))
    for run in _telling(runs):
        parts += [element("h3", verbatim(run.recording.name)), _panels(run)]
    if len(runs) > _SHOWN_RUNS:
        parts.append(paragraph("Shown are the runs that either model predicts worst.", "note"))
        parts.append(folded("Errors of every held-out run", _by_run(runs)))
    return section("before-and-after", "Before and after, on runs held out", *parts)


def _horizon(row: dict) -> list[str]:
    cells = []
    for name, _, si in _HORIZON_COLUMNS:
        old, new = row["nominal"].get(name), row["diagnosed"].get(name)
        one, other = words.rounded_pair(old, new, si)
        both = known(old) and known(new)
        cells.append(f"{one.split()[0]} -> {other.split()[0]}" if both else "")
    return [f"{row['seconds']:g}", str(row["starts"]), *cells]


def _final_error(errors: dict[float, dict[str, float]]) -> float:
    if not errors:
        return 0.0
    last = errors[max(errors)]
    return last.get("position", last.get("heading", 0.0))


def _telling(runs: list[Comparison]) -> list[Comparison]:
    """The runs that the nominal and that the diagnosed model predict worst."""
    ranked = [
        *sorted(runs, key=lambda run: -_final_error(run.diagnosed_errors))[:1],
        *sorted(runs, key=lambda run: -_final_error(run.nominal_errors)),
    ]
    chosen: list[Comparison] = []
    for run in ranked:
        if not any(run is other for other in chosen):
            chosen.append(run)
    return chosen[:_SHOWN_RUNS]


def _panels(run: Comparison) -> Html:
    lines = [
        figures.measured(run.recording),
        figures.Line("nominal", figures.BEFORE, run.nominal, "--"),
        figures.Line("diagnosed", figures.AFTER, run.diagnosed),
    ]
    return grid(figures.panels(lines, run.recording))


def _by_run(runs: list[Comparison]) -> Html:
    rows = []
    for run in runs:
        for horizon in run.nominal_errors:
            old, new = run.nominal_errors[horizon], run.diagnosed_errors[horizon]
            pooled = {"seconds": horizon, "starts": old["starts"], "nominal": old, "diagnosed": new}
            rows.append([verbatim(run.recording.name), *_horizon(pooled)])
    columns = ["run", "seconds ahead", "starts", *(label for _, label, _ in _HORIZON_COLUMNS)]
    return table(columns, rows, numeric=range(1, len(columns)))


def _parameters(summary: dict) -> Html:
    rows = summary.get("parameters", [])
    heading = "Parameters of the vessel"
    if not rows:
        return section("parameters", heading, paragraph("No parameter of the vessel was fitted."))
    return section("parameters", heading, parameter_table(rows))


def _next(summary: dict, diagnosis: Diagnosis) -> Html:
    proposal = summary.get("next_experiment")
    remaining = words.remaining(summary)
    cells = [c for c in diagnosis.after if c.p_value * len(diagnosis.after) < ALPHA]
    cells = sorted(cells, key=lambda cell: cell.p_value)[:_PLACES]
    places = [_cell_in_words(diagnosis, cell) for cell in cells]
    text = (
        f"Next experiment: {words.next_line(summary)}." if proposal
        else "No further experiment is proposed."
    )  # fmt: skip
    return section(
        "remains",
        "What remains, and what to do next",
        paragraph(remaining),
        bullets(places) if places else "",
        paragraph(text),
    )


def _cell_in_words(diagnosis: Diagnosis, cell: Cell) -> str:
    name = DEGREES[cell.degree]
    force = with_error(cell.force, cell.std, "N m" if cell.degree == 2 else "N")
    if cell.run is None:
        return f"{name}, {cell.regime}: {force}"
    run = diagnosis.split.recordings[cell.run].name
    return f"{name}, {run} from {cell.start:.0f} to {cell.end:.0f} s: {force}"


def _provenance(summary: dict, diagnosis: Diagnosis, source: dict) -> Html:
    data = diagnosis.split
    runs = [(run, "fitted") for run in data.recordings]
    runs += [] if data.by_time else [(run, "held out") for run in data.held_out]
    return provenance(source, runs)
