"""A fit as one page for people: parameters, what is not known, predictions beside the data."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from diffsea.identification.study import Study
from diffsea.report import figures
from diffsea.report.comparison import Comparison, horizon_table, predict
from diffsea.report.page import (
    Html,
    bullets,
    element,
    folded,
    joined,
    page,
    paragraph,
    section,
    table,
    verbatim,
)
from diffsea.report.predictions import predictions
from diffsea.report.quantities import rounded, significant, with_error
from diffsea.report.records import parameter_table, provenance
from diffsea.report.words import capital, effect_lines, error_line, headline_horizon, listed
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


_START, _MODEL = "start", "fitted"


def fit_report(
    study: Study,
    quality: dict[str, float],
    history: Sequence[str],
    runs: Sequence[Comparison],
    data: tuple[Sequence[Trajectory], Sequence[Trajectory]],
    source: dict,
) -> str:
    """The page.

    Arguments:
        quality: normalised misfit of what was fitted and of what was held out.
        history: how the fit converged, one line per step.
        runs: predictions by the vessel file as it was and as fitted, of what was held out where
            there is anything, see `compared`.
        data: recordings that were fitted, none for a sheet of trial numbers, and held out.
        source: what was run on what; shown as it is.
    """
    recordings, test = data
    sections = [
        _summary(study, quality, runs, bool(test)),
        section("parameters", "Parameters of the vessel", parameter_table(study.rows),
                paragraph(verbatim(capital(study.anchor) + "."), "note")),
        _effects(study),
        _open_questions(study),
        _trial_numbers(study),
        _predictions(runs, bool(test)),
        _convergence(study, history),
        provenance(source, [(r, "fitted") for r in recordings] + [(r, "held out") for r in test]),
    ]  # fmt: skip
    subtitle = f"{_count(recordings)} fitted, {_count(test)} held out"
    if not recordings:
        subtitle = "trial numbers fitted"
    return page(f"Fit of {study.vessel_name}", subtitle, [part for part in sections if part])


def compared(
    study: Study, start: Vessel, fitted: Vessel, data: tuple[list[Trajectory], list[Trajectory]]
) -> list[Comparison]:
    """Predictions of what was held out, or else of what was fitted, before and after the fit.

    Where wind and current are each recording's own, those of a run held out are estimated on
    its first part, and the rest is predicted.
    """
    train, test = data
    runs, vessels = study.held_out(test) if test else (train, [fitted] * len(train))
    return [
        Comparison(run, {_START: predict(start, run), _MODEL: predict(vessel, run)})
        for run, vessel in zip(runs, vessels, strict=True)
    ]


def worse(runs: Sequence[Comparison]) -> str:
    """A warning where the fit predicts worse than the vessel file did, else nothing."""
    row = headline_horizon(horizon_table(runs), (_START, _MODEL))
    if row is None:
        return ""
    bad = [
        name
        for name in ("position", "heading")
        if name in row[_MODEL] and row[_MODEL][name] > 1.1 * row[_START][name]
    ]
    if not bad:
        return ""
    return (
        f"{row['seconds']:g} s ahead the fit predicts {listed(bad)} worse than the vessel file as "
        "it was: something is missing in the model or unsound in the data, and the fit makes up "
        "for it with these parameters. See `diffsea audit` and `diffsea diagnose`"
    )


def _count(runs: Sequence[Trajectory]) -> str:
    return "1 recording" if len(runs) == 1 else f"{len(runs)} recordings"


def _summary(
    study: Study, quality: dict[str, float], runs: Sequence[Comparison], held_out: bool
) -> Html:
    rows = study.rows
    weak = [row["name"] for row in rows if row["determined"] < 0.5]
    count = "1 parameter was" if len(rows) == 1 else f"{len(rows)} parameters were"
    lead = f"{count} fitted; the data determine "
    if weak:
        rest = "rests" if len(weak) == 1 else "rest"
        lead += f"all but {len(weak)}: {listed(weak)} {rest} mostly on the vessel file."
    else:
        lead += "all that was fitted."
    row = headline_horizon(horizon_table(runs), (_START, _MODEL))
    where = "on runs held out" if held_out else "on the runs it was fitted to"
    errors = (
        f"{capital(where)}, errors, vessel file -> fit, {error_line(row, (_START, _MODEL))}."
        if row
        else ""
    )
    told = f"Misfits are {significant(quality['train'], 3)} times the noise in what was fitted"
    if "test" in quality:
        told += f" and {significant(quality['test'], 3)} times in what was held out"
    body = joined([paragraph(verbatim(lead), "lead"), paragraph(errors), paragraph(told + ".")])
    if warning := worse(runs):
        body = joined([body, paragraph(verbatim(capital(warning) + "."), "warning")])
    return Html(f'<section id="summary" class="verdict fit">\n{body}\n</section>')


def _effects(study: Study) -> Html:
    lines = [line for name, copies in study.effects.items() for line in effect_lines(name, copies)]
    if not lines:
        return Html("")
    return section("effects", "Effects estimated besides", bullets(map(verbatim, lines)))


def _open_questions(study: Study) -> Html:
    """What the data do not tell, and what to record next."""
    told = [verbatim(capital(sentence) + ".") for sentence in study.identifiability.sentences]
    if study.outliers:
        lost = ", ".join(f"{number} of {name}" for name, number in study.outliers.items())
        told.append(verbatim(f"Lone outliers left out of the fit: {lost}."))
    if study.agreement is not None:
        told.append(verbatim(capital(study.agreement.sentence) + "."))
    if study.next is not None:
        told.append(verbatim(f"To record next: {study.next.sentence}."))
    if not told:
        return Html("")
    return section("open", "What these data leave open", bullets(told))


def _trial_numbers(study: Study) -> Html:
    if study.problem is not None:
        return Html("")
    cells = [
        [
            row["trial"],
            row["number"].replace("_", " "),
            with_error(row["given"], row["std"]),
            rounded(row["fitted"], 0.3 * row["std"]),
            significant((row["fitted"] - row["given"]) / row["std"], 2),
        ]
        for row in study.objective.residuals(study.estimate.coordinates)
    ]
    columns = ["trial", "number", "given", "fitted", "difference / std"]
    title = "Trial numbers in SI units"
    return section("numbers", "Given and fitted", table(columns, cells, title, numeric=(2, 3, 4)))


def _predictions(runs: Sequence[Comparison], held_out: bool) -> Html:
    if not runs:
        return Html("")
    judged = "runs held out" if held_out else "the runs it was fitted to; none were held out"
    parts = predictions(runs, {_START: "vessel file", _MODEL: "fitted"})
    return section("predictions", f"Predictions of {judged}", *parts)


def _convergence(study: Study, history: Sequence[str]) -> Html:
    path = study.estimate.path
    if not history and len(path) < 2:
        return Html("")
    lines = joined(element("div", verbatim(line)) for line in history)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        above = [cost - min(path) for cost in path]
        axes.plot(range(len(path)), above, "o-", color=figures.AFTER)
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set(xlabel="round", ylabel="cost above its minimum")

    parts: list = [figures.picture(draw, "The cost of the fit falling from round to round")]
    return section(
        "convergence", "How it converged", *parts, folded(f"{len(history)} steps", lines)
    )
