"""From recordings to a fitted vessel, and to what a vessel's model leaves out."""

import dataclasses
import html
import importlib.metadata
import itertools
import math
import pathlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from diffsea.budget import left_out_sentence, time_budget
from diffsea.diagnosis.experiment import Experiment, next_experiment
from diffsea.diagnosis.record import nominal_document, summary, vessel_document
from diffsea.diagnosis.selection import FULL_EFFORT, Deadline, Effort
from diffsea.diagnosis.verdict import Diagnosis
from diffsea.diagnosis.verdict import diagnose as search_effects
from diffsea.errors import UserError
from diffsea.identification.free_predictions import free_errors
from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
    is_trial_table,
    read_trial_table,
)
from diffsea.identification.run_models import held_out_models
from diffsea.identification.study import (
    FitSettings,
    Study,
    free_parameters,
    identify,
    with_priors,
)
from diffsea.identification.sufficiency import FitVerdict
from diffsea.parameters import Parameter
from diffsea.progress import Progress, Remark, counted, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.recordings.auditing.actuators import stale_feedback
from diffsea.recordings.conditioning import in_sequence, on_one_clock, share_a_calendar
from diffsea.report.diagnosis import diagnosis_report
from diffsea.report.fit import compare_fit
from diffsea.report.predictions import ComparedRun, compare, horizon_table
from diffsea.report.wording.caveats import side_sentences
from diffsea.report.wording.terminal import verdict_text
from diffsea.simulation.actuation import how_actuated, with_common_feedback
from diffsea.simulation.order_units import order_doubts, require_order_units, unit_findings
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import (
    VesselFile,
    build,
    read_vessel,
    require_writable,
    updated_document,
)
from diffsea.workflows import quick as look
from diffsea.workflows.audits import Recording, Tabulated, as_used_recordings, audit


def as_vessel_file(given: VesselFile | str | pathlib.Path) -> VesselFile:
    """A vessel file as it is, or read. Raises `UserError` as `read_vessel` does."""
    return given if isinstance(given, VesselFile) else read_vessel(given)


class FittedData(NamedTuple):
    """What a fit is given: recordings and trials of sheets to fit, and recordings held out."""

    recordings: list[Trajectory]
    trials: list[MeasuredTrial]
    test: list[Trajectory]


def fitted_data(
    vessel: Vessel,
    data: Recording | MeasuredTrial | Iterable[Recording | MeasuredTrial],
    test: Recording | Iterable[Recording] = (),
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    keep_idle: bool = False,
    progress: Progress = no_progress,
) -> FittedData:
    """Recordings and sheets told apart, and read where they are files.

    Arguments:
        keep_idle: whether idle stretches of logs stay in.

    Raises:
        UserError: a file that cannot be read, or a test where there is nothing to judge by it.
    """
    given = [data] if isinstance(data, Recording | MeasuredTrial) else list(data)
    trials: list[MeasuredTrial] = []
    runs: list[Recording] = []
    for one in given:
        if isinstance(one, MeasuredTrial):
            trials.append(one)
        elif isinstance(one, str | pathlib.Path) and is_trial_table(one):
            trials += read_trial_table(one, vessel)
        else:
            runs.append(one)
    tests: list[Recording] = [test] if isinstance(test, Recording) else list(test)
    check_held_out(tests, bool(runs))
    fitted, held_out = (
        as_used_recordings(some, mapping, keep_idle, progress) for some in (runs, tests)
    )
    return FittedData(fitted, trials, held_out)


def _with_same_feedback(
    vessel: Vessel, progress: Progress, *several: list[Trajectory]
) -> list[list[Trajectory]]:
    """All lists with the measured actuation that all runs have, which says what is left out."""
    whole = [run for some in several for run in some]
    stale = {channel for run in whole for channel in stale_feedback(run)}
    common, notes = with_common_feedback(vessel, whole, stale)
    for note in notes:
        progress(note)
    rest = iter(common)
    return [list(itertools.islice(rest, len(some))) for some in several]


def check_held_out(test: Sequence[Recording], recorded: bool) -> None:
    """Refuse sheets among what is held out, and a test where no recordings are fitted.

    Raises:
        UserError: as said.
    """
    for one in test:
        if isinstance(one, str | pathlib.Path) and is_trial_table(one):
            raise UserError(f"--test takes recordings, and {one} is a sheet of trial numbers")
    if test and not recorded:
        raise UserError("--test takes recordings, and a fit to trial numbers has none to hold out")


@dataclasses.dataclass(frozen=True, repr=False)
class FitResult(Tabulated):
    """A fitted vessel.

    `study` has estimates, intervals, identifiability and the manoeuvre to record next; `misfit` is
    the normalised misfit (1 = noise level) of what was fitted and of runs held out; `predicted` are
    free predictions of runs held out, or else of those fitted, before and after the fit; `verdict`
    says whether something is missing from the model; `left_out` names what there was no time for.
    """

    study: Study
    fitted: VesselFile
    misfit: dict[str, float]
    predicted: list[ComparedRun]
    verdict: FitVerdict
    data: FittedData
    objective: str
    not_done: tuple[str, ...] = ()  # by a quick look
    left_out: tuple[str, ...] = ()  # for want of time

    @property
    def free(self) -> dict[str, dict[str, float]]:
        """Errors of free predictions by the fit (SI units), by horizon (s) and quantity."""
        return free_errors(horizon_table(self.predicted), "fitted")

    @property
    def missing(self) -> bool:
        """Whether the model does not describe the data."""
        return self.verdict.missing

    def headline(self) -> str:
        misfit = ", ".join(f"{name} {value:.2f}" for name, value in self.misfit.items())
        return f"fit of {self.study.vessel_name}: normalised misfit (1 = noise level) {misfit}"

    def rows(self) -> list[dict[str, Any]]:
        return [
            {
                "symbol": row["name"],
                "name": row["meaning"],
                "unit": row["unit"],
                "start": row["start"],
                "estimate": row["value"],
                "+-": row["std"],
                "90 % interval": "{:.4g} to {:.4g}".format(*row["interval"]),
            }
            for row in self.study.rows
        ]

    def notes(self) -> list[str]:
        following = [] if self.study.next is None else [f"next: {self.study.next.sentence}"]
        sources = [] if self.study.sources is None else self.study.sources.sentences
        sides = side_sentences(self.study.side_records)
        told = [self.study.anchor, *self.study.identifiability.sentences, *sides]
        told += [*sources, *following]
        told += [left_out_sentence(self.left_out)] if self.left_out else []
        return [*told, self.verdict.sentence]


def fit(
    vessel: VesselFile | str | pathlib.Path,
    data: Recording | MeasuredTrial | Iterable[Recording | MeasuredTrial],
    test: Recording | Iterable[Recording] = (),
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    objective: str | None = None,
    free: Sequence[str] | None = None,
    anchor: str = "mass",
    priors: Mapping[str, Parameter | None] | None = None,
    starts: int | None = None,
    effects: Sequence[str] = (),
    per_recording: bool = False,
    progress: Progress = no_progress,
    profiles: Sequence[str] | None = None,
    quick: bool = False,
    budget: float = math.inf,
    keep_idle: bool = False,
) -> FitResult:
    """Identify a vessel's parameters as `diffsea fit` does.

    Arguments:
        data: recordings, sheets of trial numbers (paths of TOML files, or what
            `read_trial_table` returns), or both: then one fit of both.
        test: recordings held out to judge the fit by.
        objective: `innovation` (default), `free-run`, or `trial-numbers` (default for sheets
            alone).
        free: parameters to estimate; the hull's derivatives and added masses if None.
        anchor: `mass` or `thrust`: what fixes the common factor of mass, drag and thrust.
        priors: of parameters that have another than the vessel file's own, or the usual one; None
            keeps a number fixed.
        starts: how many starts, the first at the prior mean and the others drawn from the priors;
            one if None, and eight more where that fit leaves something missing.
        effects: names of the catalogue to estimate besides.
        per_recording: whether wind and current are each recording's own.
        profiles: parameters whose intervals come from the profile likelihood; those whose
            likelihood is asymmetric if None.
        quick: whether to leave out what `quick` says, and name it in `not_done`.
        budget: seconds, after which no further step is begun but judging what was found; the
            result then says what was left out.
        keep_idle: whether idle stretches of logs that are read here stay in.

    Raises:
        UserError: an unknown parameter, objective, anchor or effect, or data that do not suit.
    """
    with time_budget(budget) as left:
        file = as_vessel_file(vessel)
        given = fitted_data(file.vessel, data, test, mapping, keep_idle, progress)
        require_order_units(file.vessel, [*given.recordings, *given.test])
        not_done: tuple[str, ...] = ()
        if quick:
            whole = [*given.recordings, *given.test]
            given = given._replace(
                recordings=look.thinned(file.vessel, given.recordings),
                test=look.thinned(file.vessel, given.test),
            )
            samples = look.left_out(file.vessel, whole, [*given.recordings, *given.test])
            not_done, profiles, starts = look.of_fit(samples), profiles or (), starts or 1
        objective = objective or ("innovation" if given.recordings else "trial-numbers")
        settings = FitSettings(
            objective,
            None if free is None else tuple(free),
            anchor,
            file.priors | dict(priors or {}),
            starts,
            None if profiles is None else tuple(profiles),
            tuple(effects),
            per_recording,
            proposes=not quick,
        )
        require_writable(file.document, [p.name for p in free_parameters(file.vessel, settings)])
        sheets = f"{counted(len(given.trials), 'trial')} of sheets" if given.trials else ""
        runs = counted(len(given.recordings), "recording") if given.recordings else ""
        told = " and ".join(filter(None, (runs, sheets)))
        same = _with_same_feedback(file.vessel, progress, given.recordings, given.test)
        given = given._replace(recordings=same[0], test=same[1])
        whole = [*given.recordings, *given.test]
        measured = [c for c, how in how_actuated(file.vessel, whole).items() if how == "measured"]
        for run in whole:
            for doubt in order_doubts(file.vessel, run, measured):
                progress(Remark(f"{run.name}: {doubt}"))
        progress(f"fitting {told}, {len(given.test)} held out")
        study = identify(file.vessel, [*given.recordings, *given.trials], settings, progress)
        source = f"{', '.join(study.values)} fitted to {told}"
        document = updated_document(file.document, study.values, study.effect_tables, source)
        fitted = VesselFile(build(document), document, file.path)
        progress("predicting and judging")
        runs = given.recordings, given.test
        predicted = []
        if not left.skips("free predictions"):
            predicted = compare_fit(study, file.vessel, fitted.vessel, runs)
        verdict, quality = study.verdict(*runs), study.quality(given.test)
        judged = study, fitted, quality, predicted, verdict
        return FitResult(*judged, given, objective, not_done, left.left_out)


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


def provenance(
    file: VesselFile,
    runs: Sequence[Trajectory],
    test: Sequence[Trajectory],
    reference: Sequence[Trajectory] = (),
) -> dict[str, Any]:
    """What was run on what: vessel, recordings, where actuation came from, versions."""
    versions = {n: importlib.metadata.version(n) for n in ("diffsea", "jax", "optimistix")}
    return {
        "vessel": file.path,
        "recordings": {run.name: list(run.provenance) for run in [*runs, *test, *reference]},
        "actuation": {
            use: how_actuated(file.vessel, list(some))
            for use, some in (("fitted", runs), ("held out", test), ("reference", reference))
            if some
        },
        "versions": versions,
        "python": sys.version.split()[0],
    }


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
            as_used_recordings(some, mapping, keep_idle, progress)
            for some in (recordings, test, reference)
        )
        require_order_units(file.vessel, [*runs, *held_out, *earlier])
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
        runs, held_out, earlier = _with_same_feedback(
            file.vessel, progress, runs, held_out, earlier
        )
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
