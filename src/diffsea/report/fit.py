"""A fit as one page for people: parameters, what is not known, predictions beside the data."""

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from diffsea.budget import left_out_sentence
from diffsea.identification.estimates import FitOutcome
from diffsea.identification.run_models import Motion, RunModel
from diffsea.identification.study import Study
from diffsea.identification.sufficiency import FitVerdict
from diffsea.identification.uncertainty.sources import Sources
from diffsea.report.page import Plot, Table, Verbatim, parameter_table, provenance, render
from diffsea.report.plots import DIAGNOSED, figure
from diffsea.report.predictions import ComparedRun, horizon_table, predict, prediction_section
from diffsea.report.quantities import round_to_error, significant, with_error
from diffsea.report.wording import horizons, words
from diffsea.report.wording.caveats import (
    quick_sentence,
    sampling_sentence,
    side_sentences,
    straight_sentence,
)
from diffsea.report.wording.words import Record
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


MODELS = {"start": "vessel file", "fitted": "fitted"}
SHOWN_RUNS = 2  # the two that are predicted worst tell most
DRAWN_ROWS = 1500  # of a run: more cannot be told apart


def fit_report(
    study: Study,
    quality: dict[str, float],
    history: Sequence[str],
    runs: Sequence[ComparedRun],
    data: tuple[Sequence[Trajectory], Sequence[Trajectory]],
    source: Record,
    verdict: FitVerdict,
    not_done: Sequence[str] = (),
    left_out: tuple[str, ...] = (),
) -> str:
    """The page.

    Arguments:
        quality: normalised misfit of what was fitted and of what was held out.
        history: how the fit converged, one line per step.
        runs: predictions by the vessel file as it was and as fitted, of what was held out where
            there is anything, see `compare_fit`.
        data: recordings that were fitted, none for a sheet of trial numbers, and held out.
        source: what was run on what; shown as it is.
        verdict: whether something is missing.
        not_done: what a quick look left out.
        left_out: what there was no time for.
    """
    recordings, test = data
    quick = quick_sentence(not_done)
    with_sheet = bool(study.objective.residuals(study.estimate.coordinates))
    weak = [row["name"] for row in study.rows if row["determined"] < 0.5]
    count, rest = len(study.rows), "rests" if len(weak) == 1 else "rest"
    lead = "1 parameter was" if count == 1 else f"{count} parameters were"
    determined = "all that was fitted."
    if weak:
        determined = (
            f"all but {len(weak)}: {words.enumeration(weak)} {rest} mostly on the vessel file."
        )
    row = horizons.headline_horizon(horizon_table(runs), tuple(MODELS))
    judged = "On runs held out" if test else "On the runs it was fitted to"
    errors = "" if row is None else horizons.horizon_line(row, tuple(MODELS))
    fitted, held_out = (words.count_recordings(len(several)) for several in data)
    worse = worse_warning(runs)
    warnings = [f"{words.capital(worse)}." if worse else "", left_out_sentence(left_out)]
    predictions = prediction_section(runs, MODELS, DRAWN_ROWS, SHOWN_RUNS)
    picture, predictions = predictions.without_first_track()
    return render(
        "fit.html.j2",
        title=f"Fit of {study.vessel_name}",
        subtitle=_subtitle(fitted, held_out, with_sheet) if recordings else "trial numbers fitted",
        lead=f"{lead} fitted; the data determine {determined}",
        errors=f"{judged}, errors, vessel file -> fit, {errors}." if errors else "",
        misfit=significant(quality["train"], 3),
        misfit_held_out=significant(quality["test"], 3) if "test" in quality else "",
        warning=" ".join(filter(None, warnings)),
        verdict=f"{words.capital(verdict.sentence)}.",
        is_missing=verdict.missing,
        parameters=parameter_table(study.rows),
        anchor=words.capital(study.anchor) + ".",
        effects=fitted_effects(study),
        open_questions=[*_open_questions(study), *([quick] if quick else [])],
        sources=None if study.sources is None else source_table(study.sources),
        source_notes=[] if study.sources is None else _source_notes(study.sources),
        trial_numbers=_trial_number_table(study) if with_sheet else None,
        held_out=bool(test),
        picture=picture,
        predictions=predictions,
        convergence=_convergence_plot(study.estimate.path),
        history=history,
        provenance=provenance(
            source, [(r, "fitted") for r in recordings] + [(r, "held out") for r in test]
        ),
    )


def fitted_effects(study: Study) -> list[str]:
    """The effects that were fitted besides, in words."""
    found = [words.effect_lines(*i, study.log10_odds.get(i[0])) for i in study.effects.items()]
    return [line for lines in found for line in lines]


def compare_fit(
    study: Study, start: Vessel, fitted: Vessel, data: tuple[list[Trajectory], list[Trajectory]]
) -> list[ComparedRun]:
    """Predictions of what was held out, or else of what was fitted, before and after the fit.

    Where wind and current are each recording's own, those of a run held out are estimated on
    its first part, and the rest is predicted.
    """
    train, test = data
    if test:
        runs, models = study.held_out(test)
    else:
        runs, models = train, study.fitted_models(fitted, train)
    before = study.start_states(train, test)

    def compared(run: Trajectory, model: RunModel, states: Motion | None) -> ComparedRun:
        found = {
            "start": predict(start, run, states),
            "fitted": predict(model.vessel, run, model.states),
        }
        return ComparedRun(run, found, fitted.units)

    return [compared(*one) for one in zip(runs, models, before, strict=True)]


def worse_warning(runs: Sequence[ComparedRun]) -> str:
    """A warning where the fit predicts worse than the vessel file did, else nothing.

    A fit that makes up for missing physics with its parameters may follow the next sample better
    and yet predict worse.
    """
    row = horizons.headline_horizon(horizon_table(runs), tuple(MODELS))
    if row is None:
        return ""
    worse = horizons.worsened(row, tuple(MODELS))
    if not worse:
        return ""
    ahead, what = f"{row['seconds']:g} s ahead", words.enumeration(worse)
    return (
        f"{ahead} the fit predicts {what} worse than the vessel file as it was: something is "
        "missing in the model or unsound in the data, and the fit makes up for it with these "
        "parameters. See `diffsea audit` and `diffsea diagnose`"
    )


def _subtitle(fitted: str, held_out: str, with_sheet: bool) -> str:
    """What was fitted and held out."""
    sheet = " and trial numbers" if with_sheet else ""
    return f"{fitted}{sheet} fitted, {held_out} held out"


def source_table(found: Sources) -> Table:
    """What recordings and trial numbers each determine of every parameter, and both together."""
    percent = lambda share: f"{100 * share:.0f} %"
    cells = [[Verbatim(name), *map(percent, shares)] for name, *shares in found.rows]
    columns = ["symbol", "recordings alone", "trial numbers alone", "both"]
    return Table(columns, cells, "Share of each estimate that data determine", numeric=(1, 2, 3))


def _source_notes(found: Sources) -> list[str]:
    """What each source adds to the cost, and what it leaves open."""
    parts = (("recordings", found.recordings), ("trial numbers", found.trial_numbers))
    told = [
        f"{name}: squared misfits of {significant(source.cost, 3)} in {source.values} values"
        for name, source in parts
    ]
    told.append(f"prior: squared misfits of {significant(found.prior_cost, 3)}")
    return [f"{words.capital(sentence)}." for sentence in [*told, *found.sentences]]


def _open_questions(study: Study) -> list[str]:
    """What the data do not tell, and what to record next."""
    sentences = list(study.identifiability.sentences)
    if study.estimate.outcome is not FitOutcome.CONVERGED:
        sentences.append(study.estimate.outcome.sentence)
    if study.outliers:
        lost = ", ".join(f"{number} of {name}" for name, number in study.outliers.items())
        sentences.append(f"lone outliers left out of the fit: {lost}")
    if study.objective.one_sample_in:
        sentences.append(sampling_sentence(study.objective.one_sample_in).removesuffix("."))
    if study.problem is not None and (runs := study.problem.dataset.straight_runs):
        sentences.append(straight_sentence(runs).removesuffix("."))
    sentences += [one.removesuffix(".") for one in side_sentences(study.side_records)]
    if study.agreement is not None:
        sentences.append(study.agreement.sentence)
    if study.next is not None:
        sentences.append(f"to record next: {study.next.sentence}")
    return [f"{words.capital(sentence)}." for sentence in sentences]


def _trial_number_table(study: Study) -> Table:
    """Trial numbers as given and as fitted, SI units, and their difference in standard errors."""
    cells = []
    for row in study.objective.residuals(study.estimate.coordinates):
        given, fitted, std = row.given, row.fitted, row.std
        misfit = significant((fitted - given) / std, 2)
        name, estimate = row.number.replace("_", " "), round_to_error(fitted, 0.3 * std)
        cells.append([row.trial, name, with_error(given, std), estimate, misfit])
    columns = ["trial", "number", "given", "fitted", "difference / std"]
    return Table(columns, cells, "Trial numbers in SI units", numeric=(2, 3, 4))


def _convergence_plot(path: Sequence[float]) -> Plot | None:
    """The cost above its minimum after each round, by its logarithm beyond one."""
    rounds = [n for n, cost in enumerate(path) if math.isfinite(cost)]  # a start may diverge
    if len(rounds) < 2:
        return None
    above = np.array([path[n] for n in rounds])
    above -= above.min()
    marks = [0.0, *(10.0**k for k in range(1 + math.ceil(math.log10(1 + above.max()))))]
    line = go.Scatter(x=rounds, y=list(np.log10(1 + above)), customdata=list(above))
    line.update(mode="lines+markers", line={"color": DIAGNOSED})
    line.update(hovertemplate="round %{x}: %{customdata:.4g}<extra></extra>")
    costs = {"tickvals": list(np.log10(1 + np.array(marks))), "ticktext": [f"{m:g}" for m in marks]}
    costs |= {"title": {"text": "cost above its minimum"}}
    drawn = figure(line, xaxis={"title": {"text": "round"}}, yaxis=costs)
    return Plot(drawn, "The cost of the fit falling from round to round", 320)
