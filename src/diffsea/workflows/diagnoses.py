"""From recordings to what a vessel's model leaves out."""

import dataclasses
import html
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from diffsea.budget import time_budget
from diffsea.diagnosis.experiment import Experiment, next_experiment
from diffsea.diagnosis.record import nominal_document, summary, vessel_document
from diffsea.diagnosis.selection import FULL_EFFORT, Deadline, Effort
from diffsea.diagnosis.verdict import Diagnosis
from diffsea.diagnosis.verdict import diagnose as search_effects
from diffsea.identification.run_models import held_out_models
from diffsea.identification.study import (
    with_priors,
)
from diffsea.parameters import Parameter
from diffsea.progress import Progress, Remark, counted, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.recordings.conditioning import in_sequence, on_one_clock, share_a_calendar
from diffsea.report.diagnosis import diagnosis_report
from diffsea.report.predictions import ComparedRun, compare, horizon_table
from diffsea.report.wording.terminal import verdict_text
from diffsea.simulation.order_units import unit_findings, with_usable_actuation
from diffsea.vessel.files import (
    VesselFile,
    build,
    require_writable,
)
from diffsea.workflows import quick as look
from diffsea.workflows.audits import Recording, Tabulated, as_used_recordings, audit
from diffsea.workflows.inputs import as_vessel_file, provenance, with_same_feedback


@dataclasses.dataclass(frozen=True, repr=False)
class DiagnosisResult(Tabulated):
    """What a vessel's model leaves out.

    `record` is the content of diagnosis.json; `nominal` and `diagnosed` are the vessel as fitted
    before and after what was found; `experiment` is the manoeuvre that would tell more; `in_order`
    says whether the recordings were put on one clock.
    """

    record: dict[str, Any]
    diagnosis: Diagnosis
    nominal: VesselFile
    diagnosed: VesselFile
    predicted: list[ComparedRun]
    experiment: Experiment | None
    in_order: bool = False

    @property
    def verdict(self) -> str:
        """`consistent`, `explained`, `ambiguous`, `unexplained` or `insufficient`."""
        return self.record["verdict"]

    def headline(self) -> str:
        return f"diagnosis of {self.nominal.vessel.name}: {self.verdict}"

    def rows(self) -> list[dict[str, Any]]:
        return [
            {
                "effect": effect["name"],
                "parameter": name,
                "value": entry["value"],
                "+-": entry["std"],
                "unit": entry["unit"],
            }
            for effect in self.record["effects"]
            for name, entry in effect["parameters"].items()
        ]

    def notes(self) -> list[str]:
        return verdict_text(self.record).splitlines()

    def _notes_html(self) -> str:
        """The verdict in lines, as a terminal has it: they are broken and aligned already."""
        return f"<pre>{html.escape(verdict_text(self.record))}</pre>"

    def html(self) -> str:
        """The report as one self-contained page."""
        name, source = self.nominal.vessel.name, self.record["source"]
        return diagnosis_report(self.record, name, self.diagnosis.split, self.predicted, source)


def diagnose(
    vessel: VesselFile | str | pathlib.Path,
    recordings: Recording | Iterable[Recording],
    test: Recording | Iterable[Recording] = (),
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    per_recording: bool = False,
    free: Sequence[str] | None = None,
    bootstrap: int = 0,
    progress: Progress = no_progress,
    seconds: float = math.inf,
    priors: Mapping[str, Parameter | None] | None = None,
    anchor: str = "mass",
    quick: bool = False,
    budget: float = math.inf,
    keep_idle: bool = False,
    one_after_another: bool = False,
    reference: Recording | Iterable[Recording] = (),
) -> DiagnosisResult:
    """Find the physics that a vessel's model leaves out, as `diffsea diagnose` does.

    Arguments:
        recordings: what is fitted.
        test: recordings held out for judging; parts of the others where none are given.
        per_recording: whether wind and current are each recording's own.
        free: parameters that are fitted besides; the hull's derivatives and those with a prior if
            None.
        bootstrap: judge chance by so many simulated and refitted data sets (100 or more).
        seconds: after which no further step of the search is begun; the record then says that it
            is not complete.
        priors: as for `fit`.
        anchor: as for `fit`.
        quick: whether to leave out what `quick` says; the record then names it under `not_done`.
        budget: seconds, after which no further step of any stage is begun: fits end where they
            are, and what was found is judged and told, with what was left out.
        keep_idle: as for `fit`.
        one_after_another: whether the recordings, and then those held out, were made in this order:
            they share one clock then, and a change in one of them stays in those after it. The
            vessel is returned as it was in the end. Recordings that all say when they were made
            share that clock without it.
        reference: recordings of the vessel as she was before whatever is searched: what they tell
            of her parameters is known beforehand, and something may have changed since.

    Raises:
        UserError: recordings that cannot be read or do not suit the vessel.
    """
    with time_budget(budget) as left:
        deadline = Deadline(seconds)
        file = as_vessel_file(vessel)
        runs, held_out, earlier = (
            with_usable_actuation(
                file.vessel, as_used_recordings(some, mapping, keep_idle, progress), progress
            )
            for some in (recordings, test, reference)
        )
        whole = [*runs, *held_out]
        in_order = one_after_another or share_a_calendar(whole)
        if in_order:
            whole = in_sequence(whole) if one_after_another else on_one_clock(whole)
            runs, held_out = whole[: len(runs)], whole[len(runs) :]
            begin = (f"{run.name} at {run.t[0]:.6g} s" for run in whole)
            how = "one after another" if one_after_another else "by the times of their files"
            progress(Remark(f"{how} on one clock: {', '.join(begin)}"))
        progress(f"checking {counted(len(runs) + len(held_out), 'recording')} for faults")
        audited = list(audit([*runs, *held_out]))
        audited += [one for run in (*runs, *held_out) for one in unit_findings(file.vessel, run)]
        findings = [finding.as_dict() for finding in audited]
        runs, held_out, earlier = with_same_feedback(file.vessel, progress, runs, held_out, earlier)
        not_done: tuple[str, ...] = ()
        if quick:
            whole = [*runs, *held_out]
            runs, held_out, earlier = (
                look.thinned(file.vessel, some) for some in (runs, held_out, earlier)
            )
            not_done = look.of_diagnosis(look.left_out(file.vessel, whole, [*runs, *held_out]))
        names = None if free is None else tuple(free)
        parameters = with_priors(file.vessel, names, file.priors | dict(priors or {}), anchor)
        require_writable(file.document, [parameter.name for parameter in parameters])
        found = search_effects(
            file.vessel,
            runs,
            held_out,
            per_recording,
            tuple(one.name for one in parameters),
            progress,
            bootstrap,
            audited,
            deadline,
            {one.name: one for one in parameters},
            effort=Effort(look.NAMES, insists=False) if quick else FULL_EFFORT,
            reference=earlier,
        )
        experiment = None
        if not quick and not left.skips("the manoeuvre to record next"):
            progress("looking for the manoeuvre that would tell more")
            experiment = next_experiment(found)
        progress("comparing predictions")
        documents = (
            nominal_document(file.document, found),
            vessel_document(file.document, found, in_the_end=in_order),
        )
        nominal, diagnosed = (VesselFile(build(one), one, file.path) for one in documents)
        predicted = []
        if not left.skips("free predictions"):
            before = held_out_models(found.split, found.nominal)
            after = held_out_models(found.split, found.final) if found.names else None
            predicted = compare(found.split.held_out, before, after)
        proposal = None if experiment is None else experiment.as_dict()
        source = provenance(file, runs, held_out, earlier)
        record = summary(found, findings, horizon_table(predicted), proposal, source)
        complete = record["complete"] and not left.left_out
        record |= {"complete": complete, "left_out": list(left.left_out)}
        record |= {"not_done": list(not_done)} if not_done else {}
        return DiagnosisResult(record, found, nominal, diagnosed, predicted, experiment, in_order)
