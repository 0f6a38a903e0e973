"""A diagnosis as one page for people: verdict, where, what, how large, before and after."""

from collections.abc import Mapping, Sequence

from diffsea.identification.holdout import HeldOut, Split
from diffsea.report import words as words
from diffsea.report.comparison import Comparison
from diffsea.report.comparison_plots import curves, has_history, histories, tracks
from diffsea.report.interactive import HEAD, plot, scripts
from diffsea.report.page import (
    Content,
    Html,
    element,
    folded,
    joined,
    page,
    paragraph,
    section,
    table,
    verbatim,
)
from diffsea.report.predictions import error_tables
from diffsea.report.quantities import known, with_error
from diffsea.report.records import parameter_table, provenance
from diffsea.report.what_sections import next_section, unseen_section, what_section
from diffsea.report.where_section import where_section
from diffsea.trajectory import Trajectory


_MEANING = {
    "consistent": "consistent: nothing missing was found",
    "explained": "explained: the missing effect has a name",
    "ambiguous": "ambiguous: several effects would explain it",
    "unexplained": "unexplained: something is missing that has no name here",
}
_NUMBERS = 140_000  # in the plots of a page, some six characters each, beside the library's 5 MB
_PER_ROW = (27, 33)  # numbers for a row of a recording, and of a held-out run with two models
_MOST = 1500  # rows of a run that a plot can show
_OPEN_RUNS = 4


def diagnosis_report(
    result: dict, vessel_name: str, split: Split, runs: Sequence[Comparison], source: dict
) -> str:
    """The page.

    Arguments:
        result: the content of diagnosis.json; what it lacks is said not to have been computed.
        split: recordings that were fitted and those held out.
        runs: those held out and what both models predict of them.
        source: what was run on what: file names, hashes, settings; shown as it is.
    """
    recordings, held_out = split.recordings, split.held_out
    most = _rows_of_a_run(len(recordings), len(held_out))
    sections = [
        _verdict(result),
        where_section(result, recordings, most),
        what_section(result),
        _held_out(result, runs, most),
        next_section(result),
        unseen_section(result),
        _parameters(result),
        _data(result),
        provenance(source | _method(result), _used(result, recordings, held_out)),
    ]
    title = f"Diagnosis of {vessel_name}"
    return page(title, _subtitle(result, recordings, held_out), sections, HEAD, scripts())


def _rows_of_a_run(recordings: int, held_out: int) -> int:
    numbers = _PER_ROW[0] * recordings + _PER_ROW[1] * held_out
    return min(_MOST, max(50, _NUMBERS // max(numbers, 1)))


def _by_time(result: dict) -> bool:
    return result.get("held_out", {}).get("kind") == HeldOut.LAST_PARTS


def _subtitle(result: dict, recordings: Sequence[Trajectory], held_out: Sequence) -> str:
    count = len(recordings)
    runs = "1 recording" if count == 1 else f"{count} recordings"
    if _by_time(result):
        return f"{runs}, the last part of each held out"
    return f"{runs}, {len(held_out)} more held out"


def _verdict(result: dict) -> Html:
    verdict = result["verdict"]
    faults = len(result.get("audit", []))
    audit = (
        "The recordings themselves show faults; see whether the data are sound before anything "
        "else." if faults else ""
    )  # fmt: skip
    body = joined(
        [
            paragraph(_MEANING[verdict], "word"),
            paragraph(f"{words.finding(result)} {words.held_out_change(result)}", "lead"),
            paragraph(words.remaining(result), "note"),
            Html(f'<p class="warning"><a href="#data">{audit}</a></p>') if audit else "",
        ]
    )
    return Html(f'<section id="verdict" class="verdict {verdict}">\n{body}\n</section>')


def _held_out(result: dict, runs: Sequence[Comparison], most: int) -> Html:
    parts: list[Content] = []
    if words.accepted(result):
        models = {"nominal": "nominal", "diagnosed": "diagnosed"}
    else:
        models = {"diagnosed": "predicted"}
        parts.append(paragraph("No effect was added: there is one model, with its fit."))
    if any("recording" in effect for effect in result["effects"]):
        text = (
            "Wind or current differ from run to run: on a held-out run they are estimated "
            "on that run itself, everything else stays as found."
        )
        parts.append(paragraph(text))
    parts += error_tables(runs, models)
    if runs:
        text = (
            "Point at a plot and a line moves through all plots of the run, a mark along its "
            "tracks. An entry of the legend shows or hides its curves. Drag to zoom, double-click "
            "to go back."
        )
        parts.append(paragraph(text, "note"))
    drawn = [_run(number, run, models, most) for number, run in enumerate(runs)]
    parts += drawn[:_OPEN_RUNS]
    if more := drawn[_OPEN_RUNS:]:
        parts.append(folded(f"{len(more)} more held-out runs", joined(more)))
    return section("held-out", "Does it predict runs that it has not seen?", *parts)


def _run(number: int, run: Comparison, models: Mapping[str, str], most: int) -> Html:
    name, group = run.recording.name, f"held-out-{number}"
    who = " and ".join(models.values())
    shown = curves(run, models)
    drawn = []
    if run.recording.has("x") and run.recording.has("y"):
        text = f"Track of {name}, measured and predicted ({who})."
        drawn.append(plot(tracks(shown, group, most), text, 460))
    if has_history(run.recording):
        text = f"Heading, yaw rate and speeds of {name}, measured and predicted ({who})."
        drawn.append(plot(histories(shown, group, most), text, 560))
    return joined([element("h3", verbatim(name)), Html(f'<div class="run">{joined(drawn)}</div>')])


def _parameters(result: dict) -> Html:
    rows = result.get("parameters", [])
    heading = "Parameters of the vessel"
    if not rows:
        return section("parameters", heading, paragraph("No parameter of the vessel was fitted."))
    return section("parameters", heading, parameter_table(rows))


def _data(result: dict) -> Html:
    records = result.get("audit")
    heading = "Are the data sound?"
    if not records:
        text = (
            "The recordings were not audited." if records is None
            else "The audit found no fault in the recordings. What a run does not excite, such "
            "as a latency at constant speed, it cannot show."
        )  # fmt: skip
        return section("data", heading, paragraph(text))
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
        "data",
        heading,
        paragraph("Faults that the recordings show by themselves, before any model is blamed."),
        table(["fault", "recording", "size", "what was seen"], rows, "Findings of the audit"),
    )


def _message(record: dict) -> Html:
    repair = record.get("repair", "")
    advice = paragraph(verbatim(f"Repair: {repair}"), "note") if repair else ""
    return Html(f"{verbatim(record['message'])}{advice}")


def _method(result: dict) -> dict:
    """How it was decided, for the provenance."""
    null = result.get("null") or {}
    told = {key: null[key] for key in ("draws", "alpha", "threshold") if key in null}
    method = {"significance from simulated data without effects": told} if told else {}
    if "bootstrap" in null:
        method["the same, every simulated data set fitted anew"] = null["bootstrap"]
    return method


def _used(result: dict, recordings: Sequence, held_out: Sequence) -> list:
    fitted = [(run, "fitted") for run in recordings]
    return fitted if _by_time(result) else fitted + [(run, "held out") for run in held_out]
