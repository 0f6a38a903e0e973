"""From recordings and sheets of trial numbers to a fitted vessel."""

import dataclasses
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from diffsea.budget import left_out_sentence, time_budget
from diffsea.identification.free_predictions import free_errors
from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
)
from diffsea.identification.study import (
    FitSettings,
    Study,
    free_parameters,
    identify,
)
from diffsea.identification.sufficiency import FitVerdict, unmodelled_disturbances
from diffsea.parameters import Parameter
from diffsea.progress import Progress, Remark, counted, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.report.fit import compare_fit
from diffsea.report.predictions import ComparedRun, horizon_table
from diffsea.report.wording.caveats import side_sentences
from diffsea.simulation.actuation import how_actuated
from diffsea.simulation.order_units import order_doubts, with_usable_actuation
from diffsea.vessel.effects import spoken_name
from diffsea.vessel.files import (
    VesselFile,
    build,
    require_writable,
    updated_document,
)
from diffsea.workflows import quick as look
from diffsea.workflows.audits import Recording, Tabulated
from diffsea.workflows.inputs import FittedData, as_vessel_file, fitted_data, with_same_feedback


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
        usable = (
            with_usable_actuation(file.vessel, some, progress)
            for some in (given.recordings, given.test)
        )
        given = FittedData(next(usable), given.trials, next(usable))
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
        same = with_same_feedback(file.vessel, progress, given.recordings, given.test)
        given = given._replace(recordings=same[0], test=same[1])
        whole = [*given.recordings, *given.test]
        measured = [c for c, how in how_actuated(file.vessel, whole).items() if how == "measured"]
        for run in whole:
            for doubt in order_doubts(file.vessel, run, measured):
                progress(Remark(f"{run.name}: {doubt}"))
        for name in unmodelled_disturbances(file.vessel, whole) if whole else ():
            if name not in effects:
                progress(
                    Remark(f"{spoken_name(name)} was recorded and is left out: --effects {name}")
                )
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
