"""A diagnosis as one page for people: verdict, where, what, how large, before and after."""

from collections.abc import Sequence

from diffsea.diagnosis.locate import DEGREES, Cell
from diffsea.diagnosis.select import ALPHA, Diagnosis
from diffsea.report import figures
from diffsea.report import text as words
from diffsea.report.comparison import Comparison, compare, own_environment, with_errors
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
from diffsea.report.predictions import predictions
from diffsea.report.quantities import known, probability, significant, with_error
from diffsea.report.records import parameter_table, provenance
from diffsea.vessel.base import Vessel


_ROWS = 8
_PLACES = 5
_TRACKS = 2
_MEANING = {
    "consistent": "consistent: nothing missing was found",
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
    summary = with_errors(summary, runs)
    sections = [
        _verdict(summary),
        _audit(summary),
        _where(summary, diagnosis),
        _what(summary),
        _before_and_after(diagnosis, runs),
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
            paragraph(_MEANING[verdict], "word"),
            paragraph(words.finding(summary), "lead"),
            paragraph(words.held_out_change(summary)),
            paragraph(words.remaining(summary), "note"),
        ]
    )
    return Html(f'<section id="verdict" class="verdict {verdict}">\n{body}\n</section>')


def _audit(summary: dict) -> Html:
    records = summary["audit"]
    if not records:
        text = (
            "The audit found no fault in the recordings. What a run does not excite, such as a "
            "latency at constant speed, it cannot show."
        )
        return section("audit", "Are the data sound?", paragraph(text))
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
            cell["regime"],
            f"{significant(cell['force_rms'], 2)} {cell['unit']}",
            probability(cell["p_value"]),
        ]
        for cell in summary["where"][:_ROWS]
    ]  # fmt: skip
    columns = ["degree of freedom", "recording", "when", "regime", "force missing", "p"]
    text = (
        "An unnamed force is added to the nominal model in one window of time or one regime. "
        "Where that improves the fit significantly, the model lacks something there."
    )
    return section(
        "where",
        heading,
        paragraph(text),
        maps,
        paragraph(_only_in_regimes(summary)),
        table(columns, rows, "Strongest places (p of each by itself)", numeric=(4, 5)),
        _strongest_tracks(diagnosis),
    )


def _only_in_regimes(summary: dict) -> str:
    """Why windows stay white where regimes do not."""
    if any(cell["recording"] != "all" for cell in summary["where"]):
        return ""
    return (
        "No window of time is long enough to show the mismatch by itself; the regimes, which "
        "gather samples of all runs, do."
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


def _strongest_tracks(diagnosis: Diagnosis) -> Html:
    """The tracks of the runs with the strongest mismatch, their windows marked."""
    tests = len(diagnosis.before)
    flagged = [c for c in diagnosis.before if c.p_value * tests < ALPHA]
    flagged.sort(key=lambda cell: cell.p_value)
    drawn = []
    for number in dict.fromkeys(cell.run for cell in flagged):
        if number is None:
            continue
        run = diagnosis.split.recordings[number]
        if run.has("x") and run.has("y"):
            windows = sorted({(c.start, c.end) for c in flagged if c.run == number})
            drawn.append(figures.flagged_track(run, windows, run.name))
    return grid(drawn[:_TRACKS]) if drawn else Html("")


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
    columns = ["candidate", "score", "p", "BIC gain", "held-out gain", "physical"]
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


def _before_and_after(diagnosis: Diagnosis, runs: list[Comparison]) -> Html:
    parts: list[Content] = []
    if diagnosis.effects:
        models = {"nominal": "nominal", "diagnosed": "diagnosed"}
    else:
        models = {"diagnosed": "predicted"}
        parts.append(paragraph("No effect was added: there is one model, with its fit."))
    if own_environment(diagnosis):
        text = (
            "Wind or current differ from run to run: on a held-out run they are estimated "
            "on that run itself, everything else stays as found."
        )
        parts.append(paragraph(text))
    parts += predictions(runs, models)
    return section("before-and-after", "Before and after, on runs held out", *parts)


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
