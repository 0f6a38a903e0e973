"""From recordings to a fitted vessel, and to what a vessel's model leaves out."""

import dataclasses
import importlib.metadata
import pathlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from diffsea.diagnosis.experiment import Experiment, next_experiment
from diffsea.diagnosis.record import nominal_document, summary, vessel_document
from diffsea.diagnosis.search import Diagnosis
from diffsea.diagnosis.search import diagnose as search_effects
from diffsea.identification.estimates import Progress, no_progress
from diffsea.identification.objectives.trial_numbers import MeasuredTrial
from diffsea.identification.study import FitSettings, Study, identify
from diffsea.parameters import Parameter
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.report.diagnosis import diagnosis_report
from diffsea.report.predictions import ComparedRun, compare, horizon_table
from diffsea.report.words import verdict_text
from diffsea.simulation.actuation import how_actuated
from diffsea.trajectory import Trajectory
from diffsea.vessel.files import VesselFile, build, read_vessel, updated_document
from diffsea.workflows.audits import Recording, Tabulated, as_recording, as_recordings, audit


def as_vessel_file(given: VesselFile | str | pathlib.Path) -> VesselFile:
    """A vessel file as it is, or read. Raises `UserError` as `read_vessel` does."""
    return given if isinstance(given, VesselFile) else read_vessel(given)


@dataclasses.dataclass(frozen=True, repr=False)
class FitResult(Tabulated):
    """A fitted vessel.

    `study` has estimates, intervals, identifiability and the manoeuvre to record next; `misfit` is
    the normalised misfit (1 = noise level) of what was fitted and of runs held out.
    """

    study: Study
    fitted: VesselFile
    misfit: dict[str, float]

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
        return [self.study.anchor, *self.study.identifiability.sentences, *following]


def fit(
    vessel: VesselFile | str | pathlib.Path,
    data: Recording | Iterable[Recording] | Sequence[MeasuredTrial],
    test: Recording | Iterable[Recording] = (),
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    objective: str | None = None,
    free: Sequence[str] | None = None,
    anchor: str = "mass",
    priors: Mapping[str, Parameter | None] | None = None,
    starts: int = 1,
    effects: Sequence[str] = (),
    per_recording: bool = False,
    progress: Progress = no_progress,
) -> FitResult:
    """Identify a vessel's parameters as `diffsea fit` does.

    Arguments:
        data: recordings, or trial-number tables.
        test: recordings held out to judge the fit by.
        objective: `innovation` (default), `free-run`, or `trial-numbers` (default for tables).
        free: parameters to estimate; the hull's derivatives and added masses if None.
        anchor: `mass` or `thrust`: what fixes the common factor of mass, drag and thrust.
        priors: of parameters that have another than the usual one; None keeps a number fixed.
        starts: how many starts are drawn from the priors.
        effects: names of the catalogue to estimate besides.
        per_recording: whether wind and current are each recording's own.

    Raises:
        UserError: an unknown parameter, objective, anchor or effect, or data that do not suit.
    """
    file = as_vessel_file(vessel)
    several = [data] if isinstance(data, Recording) else data
    fitted = [
        one if isinstance(one, MeasuredTrial) else as_recording(one, mapping) for one in several
    ]
    tables = bool(fitted) and all(isinstance(one, MeasuredTrial) for one in fitted)
    settings = FitSettings(
        objective or ("trial-numbers" if tables else "innovation"),
        None if free is None else tuple(free),
        anchor,
        dict(priors or {}),
        starts,
        effects=tuple(effects),
        per_recording=per_recording,
    )
    study = identify(file.vessel, fitted, settings, progress)
    document = updated_document(file.document, study.values, study.effect_tables)
    quality = study.quality(as_recordings(test, mapping))
    return FitResult(study, VesselFile(build(document), document, file.path), quality)


@dataclasses.dataclass(frozen=True, repr=False)
class DiagnosisResult(Tabulated):
    """What a vessel's model leaves out.

    `record` is the content of diagnosis.json; `nominal` and `diagnosed` are the vessel as fitted
    before and after what was found; `experiment` is the manoeuvre that would tell more.
    """

    record: dict[str, Any]
    diagnosis: Diagnosis
    nominal: VesselFile
    diagnosed: VesselFile
    predicted: list[ComparedRun]
    experiment: Experiment | None

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

    def html(self) -> str:
        """The report as one self-contained page."""
        name, source = self.nominal.vessel.name, self.record["source"]
        return diagnosis_report(self.record, name, self.diagnosis.split, self.predicted, source)


def provenance(
    file: VesselFile, runs: Sequence[Trajectory], test: Sequence[Trajectory]
) -> dict[str, Any]:
    """What was run on what: vessel, recordings, where actuation came from, versions."""
    versions = {n: importlib.metadata.version(n) for n in ("diffsea", "jax", "optimistix")}
    return {
        "vessel": file.path,
        "recordings": {run.name: list(run.provenance) for run in [*runs, *test]},
        "actuation": {
            use: how_actuated(file.vessel, list(some))
            for use, some in (("fitted", runs), ("held out", test))
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
) -> DiagnosisResult:
    """Find the physics that a vessel's model leaves out, as `diffsea diagnose` does.

    Arguments:
        recordings: what is fitted.
        test: recordings held out for judging; parts of the others where none are given.
        per_recording: whether wind and current are each recording's own.
        free: parameters that are fitted besides; the hull's derivatives if None.
        bootstrap: judge chance by so many simulated and refitted data sets (100 or more).

    Raises:
        UserError: recordings that cannot be read or do not suit the vessel.
    """
    file = as_vessel_file(vessel)
    runs, held_out = as_recordings(recordings, mapping), as_recordings(test, mapping)
    progress(f"auditing {len(runs) + len(held_out)} recordings")
    audited = list(audit([*runs, *held_out]))
    findings = [finding.as_dict() for finding in audited]
    names = None if free is None else tuple(free)
    found = search_effects(
        file.vessel, runs, held_out, per_recording, names, progress, bootstrap, audited
    )
    progress("looking for the manoeuvre that would tell more")
    experiment = next_experiment(found)
    progress("comparing predictions")
    documents = nominal_document(file.document, found), vessel_document(file.document, found)
    nominal, diagnosed = (VesselFile(build(one), one, file.path) for one in documents)
    predicted = compare(found.split, found.final, found.names, nominal.vessel, diagnosed.vessel)
    proposal = None if experiment is None else experiment.as_dict()
    source = provenance(file, runs, held_out)
    record = summary(found, findings, horizon_table(predicted), proposal, source)
    return DiagnosisResult(record, found, nominal, diagnosed, predicted, experiment)
