"""A diagnosis as one page for people: verdict, where, what, how large, before and after."""

import dataclasses
from collections.abc import Sequence

from diffsea.identification.holdout import HeldOut, Split
from diffsea.report.evidence import (
    FoundEffect,
    NextExperiment,
    Ranking,
    candidate_ranking,
    found_effects,
    next_experiment_section,
    unseen_table,
)
from diffsea.report.location import LocationSection, location_section
from diffsea.report.page import Provenance, Table, Verbatim, parameter_table, provenance, render
from diffsea.report.predictions import ComparedRun, PredictionSection, prediction_section
from diffsea.report.quantities import is_known, with_error
from diffsea.report.words import (
    Record,
    as_words,
    count_recordings,
    named_effects,
    prediction_sentence,
    remainder_sentence,
    verdict_sentence,
)


PAGE_NUMBERS = 140_000  # in all plots, some six characters each, beside the library's 5 MB
NUMBERS_PER_ROW = (27, 33)  # for a row of a recording, and of a held-out run with two models
LARGEST_RUN, SMALLEST_RUN = 1500, 50  # rows: more cannot be told apart, fewer are no curve


@dataclasses.dataclass(frozen=True)
class DiagnosisPage:
    """What `diagnosis.html.j2` shows.

    Attributes:
        finding, prediction_change, remainder: sentences.
        own_environment: whether wind or current are each recording's own.
        unseen: None where detection limits were not computed.
        faults: how many the audit found; None where there was none.
    """

    title: str
    subtitle: str
    verdict: str
    finding: str
    prediction_change: str
    remainder: str
    location: LocationSection
    effects: Sequence[FoundEffect]
    ranking: Ranking | None
    own_environment: bool
    predictions: PredictionSection
    next: NextExperiment
    unseen: Table | None
    parameters: Table
    faults: int | None
    fault_table: Table
    provenance: Provenance


def diagnosis_report(
    summary: Record, vessel_name: str, split: Split, runs: Sequence[ComparedRun], source: Record
) -> str:
    """The page.

    Arguments:
        summary: the content of diagnosis.json; what it lacks is said not to have been computed.
        split: recordings that were fitted and those held out.
        runs: those held out and what both models predict of them.
        source: what was run on what: file names, hashes, settings; shown as it is.
    """
    recordings, held_out = split.recordings, split.held_out
    by_time = split.kind is HeldOut.LAST_PARTS
    numbers = NUMBERS_PER_ROW[0] * len(recordings) + NUMBERS_PER_ROW[1] * len(held_out)
    most = min(LARGEST_RUN, max(SMALLEST_RUN, PAGE_NUMBERS // max(numbers, 1)))
    kept_back = "the last part of each" if by_time else f"{len(held_out)} more"
    models = {"nominal": "nominal", "diagnosed": "diagnosed"}
    if not named_effects(summary):
        models = {"diagnosed": "predicted"}
    used = [(run, "fitted") for run in recordings]
    used += [] if by_time else [(run, "held out") for run in held_out]
    audit, null = summary.get("audit"), summary.get("null") or {}
    found = []
    for finding in audit or []:
        size = ""
        if is_known(finding.get("value")):
            size = with_error(finding["value"], finding.get("std"), finding.get("unit", ""))
        texts = [Verbatim(finding["message"])]
        if finding.get("repair"):
            texts.append(Verbatim(f"Repair: {finding['repair']}"))
        found.append([as_words(finding["kind"]), Verbatim(finding["recording"]), size, texts])
    columns = ["fault", "recording", "size", "what was seen"]
    method = {}
    if chance := {key: null[key] for key in ("draws", "alpha", "threshold") if key in null}:
        method["significance from simulated data without effects"] = chance
    if "bootstrap" in null:
        method["the same, every simulated data set fitted anew"] = null["bootstrap"]
    page = DiagnosisPage(
        title=f"Diagnosis of {vessel_name}",
        subtitle=f"{count_recordings(len(recordings))}, {kept_back} held out",
        verdict=summary["verdict"],
        finding=verdict_sentence(summary),
        prediction_change=prediction_sentence(summary),
        remainder=remainder_sentence(summary),
        location=location_section(summary, recordings, most),
        effects=found_effects(summary),
        ranking=candidate_ranking(summary),
        own_environment=any("recording" in effect for effect in summary["effects"]),
        predictions=prediction_section(runs, models, most, worst=None),
        next=next_experiment_section(summary),
        unseen=unseen_table(summary),
        parameters=parameter_table(summary.get("parameters", [])),
        faults=None if audit is None else len(audit),
        fault_table=Table(columns, found, "Findings of the audit"),
        provenance=provenance(source | method, used),
    )
    return render("diagnosis.html.j2", page)
