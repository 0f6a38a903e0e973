"""Recordings as pages: what the audit found, a trial's numbers, segments, one prediction."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from diffsea.metrics.numbers import numbers_of
from diffsea.recordings import Finding
from diffsea.report import plots
from diffsea.report.histories import Curve, compared_histories
from diffsea.report.page import Plot, Section, Table, Verbatim, provenance, render
from diffsea.report.pictures import SEGMENT_COLOURS
from diffsea.report.predictions import (
    PANEL_HEIGHT,
    ComparedRun,
    Prediction,
    prediction_section,
)
from diffsea.report.quantities import for_people, significant, with_error
from diffsea.report.tracks import compared_tracks
from diffsea.report.wording.findings import WEIGHED, cost_words, heaviest_first
from diffsea.report.wording.numbers import number_words
from diffsea.report.wording.words import Record, as_words, capital, count_recordings
from diffsea.segments import Segment
from diffsea.trajectory import Trajectory


DRAWN_ROWS = 1200  # of a run: more cannot be told apart
DRAWN_RUNS = 12  # more would make the page long before it is read
_RECORDED_LINE = {"color": plots.DIAGNOSED, "width": 1.6}
_OUTCOMES = {"pass": "consistent", "fail": "unexplained"}


def run_plots(run: Trajectory, group: str, alternative: str = "") -> list[Plot]:
    """The track of a run, where it has one, and its motion over time, under one cursor."""
    curves: list[Curve] = [("recorded", run.counted(), _RECORDED_LINE)]
    name = alternative or run.name
    drawn = []
    if run.has("x") and run.has("y"):
        tracks = compared_tracks(curves, group, DRAWN_ROWS)
        drawn.append(Plot(tracks, f"Track of {name}, north up.", 420))
    histories, panels = compared_histories(curves, group, DRAWN_ROWS)
    if panels:
        text = f"{capital(', '.join(panels))} of {name} against time."
        drawn.append(Plot(histories, text, PANEL_HEIGHT * len(panels)))
    return drawn


def audit_page(
    found: Sequence[tuple[str, Sequence[Finding]]],
    runs: Mapping[str, Trajectory],
    notes: Sequence[str],
    source: Record,
) -> str:
    """Findings of the audit, by recording.

    Arguments:
        found: name and findings of each recording.
        runs: those that could be read, by name.
        notes: what else is to be said, a paragraph each.
    """
    faulty = [name for name, findings in found if findings]
    lead = f"Nothing was found in {count_recordings(len(found))}."
    if faulty:
        count = sum(len(findings) for _, findings in found)
        lead = (
            f"{count} finding{'s' * (count > 1)} in {len(faulty)} of "
            f"{count_recordings(len(found))}."
        )
    sections = [Section("All findings", tables=[_finding_table(found)])] if faulty else []
    for k, (name, findings) in enumerate(found[:DRAWN_RUNS]):
        messages = [f"{as_words(one.kind)}: {one.message}." for one in findings]
        drawn = run_plots(runs[name], f"run-{k}") if name in runs else []
        sections.append(Section(name, messages or ["Nothing found."], drawn))
    return render(
        "sections.html.j2",
        title="Audit of recordings",
        subtitle=count_recordings(len(found)),
        word="faults" if faulty else "sound",
        tone="ambiguous" if faulty else "consistent",
        lead=lead,
        sentences=[
            "Frames, units, signs, clocks and sensors, by kinematics alone: what a run does not "
            "excite, such as a latency at constant speed, it cannot show.",
            *notes,
        ],
        sections=sections,
        provenance=provenance(source, [(run, "audited") for run in runs.values()]),
    )


def _finding_table(found: Sequence[tuple[str, Sequence[Finding]]]) -> Table:
    rows = []
    for name, findings in found:
        for one in heaviest_first(findings):
            size = with_error(one.value, one.std, one.unit) if math.isfinite(one.value) else ""
            channels = Verbatim(", ".join(one.channels))
            what = Verbatim(name), as_words(one.kind), channels
            rows.append([*what, size, cost_words(one.cost), one.repair or ""])
    head = ["recording", "fault", "channels", "size", "cost in a minute", "repair"]
    return Table(head, rows, f"Of each recording. {WEIGHED}")


def metrics_page(
    found: Mapping[str, Record],
    runs: Mapping[str, Trajectory],
    source: Record,
    length: float | None,
) -> str:
    """Numbers of recorded trials, with the criteria that they are judged by.

    Arguments:
        found: by recording, the content of metrics.json.
        runs: the recordings by name.
        length: of the vessel, m; without one no criterion can be judged.
    """
    criteria = _criteria_table(found)
    failed = sum(row[-1] == "fail" for row in criteria.rows)
    word, lead = "", f"No criterion of IMO MSC.137(76) applies to {count_recordings(len(found))}."
    if length is None:
        lead = "Without the vessel's length no criterion of IMO MSC.137(76) can be judged."
    if criteria.rows:
        word = "fail" if failed else "pass"
        lead = f"{len(criteria.rows) - failed} of {len(criteria.rows)} criteria are met."
    sections = [Section("Criteria", tables=[criteria])] if criteria.rows else []
    sections.append(Section("Numbers", tables=[_number_table(found)]))
    for k, (name, metrics) in enumerate(list(found.items())[:DRAWN_RUNS]):
        trial = ", ".join(filter(None, [metrics["manoeuvre"], metrics.get("side")]))
        sentences = [f"{capital(trial)}.", *(f"{capital(n)}." for n in metrics["notes"])]
        sections.append(Section(name, sentences, run_plots(runs[name], f"run-{k}")))
    return render(
        "sections.html.j2",
        title="Numbers of recorded trials",
        subtitle=count_recordings(len(found)),
        word=word,
        tone=_OUTCOMES.get(word, "fit"),
        lead=lead,
        sentences=[],
        sections=sections,
        provenance=provenance(source, [(run, "measured") for run in runs.values()]),
    )


def _criteria_table(found: Mapping[str, Record]) -> Table:
    rows = []
    for name, metrics in found.items():
        for number, item in metrics["imo"].items():
            value, limit = (for_people(item[key], item["unit"])[0] for key in ("value", "limit"))
            unit = for_people(0.0, item["unit"])[1]
            texts = [significant(value, 3), significant(limit, 3), unit, item["verdict"]]
            rows.append([Verbatim(name), Verbatim(item["criterion"]), number_words(number), *texts])
    columns = ["recording", "criterion", "number", "value", "limit", "unit", "verdict"]
    return Table(columns, rows, "Criteria of IMO MSC.137(76); L is the ship's length", (3, 4))


def _number_table(found: Mapping[str, Record]) -> Table:
    rows = []
    for name, metrics in found.items():
        for one in numbers_of(metrics):
            size, unit = for_people(one.value, one.unit)
            lengths = "" if one.over_length is None else significant(one.over_length, 3)
            told = [number_words(one.name), significant(size, 4), unit, lengths]
            rows.append([Verbatim(name), *told])
    return Table(["recording", "number", "value", "unit", "ship lengths"], rows, numeric=(2, 4))


def segments_page(
    found: Sequence[tuple[Trajectory, Sequence[Segment], Sequence[str]]], source: Record
) -> str:
    """Trials that were found in long recordings.

    Arguments:
        found: each recording with its segments and with notes on it.
    """
    count = sum(len(segments) for _, segments, _ in found)
    sections = []
    for k, (run, segments, notes) in enumerate(found[:DRAWN_RUNS]):
        drawn = run_plots(run, f"run-{k}")
        for one in drawn:
            if one.figure.layout["meta"]["cursor"] == "time":
                _shade(one, segments)
        sentences = [f"{capital(note)}." for note in notes]
        sections.append(Section(run.name, sentences, drawn, [_segment_table(segments)]))
    return render(
        "sections.html.j2",
        title="Trials in recordings",
        subtitle=count_recordings(len(found)),
        word="",
        tone="fit",
        lead=f"{count} segment{'s' * (count != 1)} in {count_recordings(len(found))}.",
        sentences=["Shaded: each segment from its onset, coloured by its kind."],
        sections=sections,
        provenance=provenance(source, [(run, "searched") for run, _, _ in found]),
    )


def _shade(plot: Plot, segments: Sequence[Segment]) -> None:
    """Shade the segments, with a key of their kinds."""
    place = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "line": {"width": 0}}
    for number, one in enumerate(segments):
        fill = {"fillcolor": SEGMENT_COLOURS[one.kind], "opacity": 0.18, "layer": "below"}
        first = all(before.kind != one.kind for before in segments[:number])
        key = {"name": one.kind, "showlegend": first}
        plot.figure.add_shape(x0=one.onset, x1=one.end, **place, **fill, **key)
    plot.figure.update_layout(showlegend=True)
    plot.figure.update_traces(showlegend=False)


def _segment_table(segments: Sequence[Segment]) -> Table:
    def degrees(angle: float, digits: int) -> str:
        return f"{math.degrees(angle):.{digits}f}" if math.isfinite(angle) else ""

    rows = []
    for number, one in enumerate(segments, 1):
        speed = one.approach.speed
        pace = significant(speed, 3) if np.isfinite(speed) else ""
        times = [f"{one.onset:.1f}", f"{one.end:.1f}", one.side or ""]
        turned = [degrees(one.order, 1), degrees(one.heading_change, 0)]
        rows.append([str(number), one.kind, *times, *turned, pace, one.approach.verdict, one.group])
    columns = [
        *("", "kind", "onset (s)", "end (s)", "side", "order (deg)", "turned by (deg)"),
        *("approach (m/s)", "approach is", "repeats of"),
    ]
    return Table(columns, rows, numeric=(2, 3, 5, 6, 7))


def prediction_page(
    recording: Trajectory,
    prediction: Prediction,
    result: Record,
    source: Record,
    units: Mapping[str, str],
) -> str:
    """One run beside what a vessel's model makes of its orders.

    Arguments:
        prediction: the motion that was predicted, with its errors by horizon.
        units: of orders, by channel.
        result: the content of predict.json.
    """
    told = prediction_section(
        [ComparedRun(recording, {"model": prediction}, units)],
        {"model": "predicted"},
        DRAWN_ROWS,
        None,
    )
    errors = result["overall"]
    worst = []
    for name in ("position", "heading", "u"):
        if name in errors and math.isfinite(errors[name]):
            size, unit = for_people(errors[name], result["units"][name])
            worst.append(f"{name} by {significant(size, 2)} {unit}")
    return render(
        "sections.html.j2",
        title=f"{recording.name} predicted by {result['vessel']}",
        subtitle="from the first state and the orders alone; nothing is corrected on the way",
        word="",
        tone="fit",
        lead=f"Over the run the prediction is off in {', in '.join(worst)} (root mean square).",
        sentences=[f"{capital(note)}." for note in result["notes"]],
        sections=[
            Section("Recorded and predicted", plots=[p for one in told.runs for p in one.plots]),
            Section("Errors", tables=[] if told.errors is None else [told.errors]),
        ],
        provenance=provenance(source, [(recording, "predicted")]),
    )
