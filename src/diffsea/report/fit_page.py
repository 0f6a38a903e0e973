"""A fit as one page for people: parameters, and predictions beside what was measured."""

from collections.abc import Sequence

from diffsea.report.comparison import Comparison, horizon_table, predict
from diffsea.report.page import Html, element, folded, joined, page, paragraph, section, verbatim
from diffsea.report.predictions import predictions
from diffsea.report.records import parameter_table, provenance
from diffsea.report.text import capital, error_line, headline_horizon, listed
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel


_MODEL = "fitted"


def fit_report(
    table: Sequence[dict],
    history: Sequence[str],
    vessel: Vessel,
    recordings: Sequence[Trajectory],
    test: Sequence[Trajectory],
    source: dict,
) -> str:
    """The page.

    Arguments:
        table: one row per parameter, as `physical_table` makes them.
        history: how the fit converged, one line per round.
        vessel: with the fitted parameters.
        recordings: what was fitted.
        test: what was held out; predictions are judged on it where there is any.
        source: what was run on what; shown as it is.
    """
    shown = test or recordings
    runs = [Comparison(run, {_MODEL: predict(vessel, run)}) for run in shown]
    judged = "runs held out" if test else "the runs it was fitted to; none were held out"
    sections = [
        _summary(table, runs, bool(test)),
        section("parameters", "Parameters of the vessel", parameter_table(table)),
        section(
            "predictions", f"Predictions of {judged}", *predictions(runs, {_MODEL: "predicted"})
        ),
        _convergence(history),
        provenance(source, [(r, "fitted") for r in recordings] + [(r, "held out") for r in test]),
    ]
    subtitle = f"{_count(recordings)} fitted, {_count(test)} held out"
    return page(f"Fit of {vessel.name}", subtitle, sections)


def _count(runs: Sequence[Trajectory]) -> str:
    return "1 recording" if len(runs) == 1 else f"{len(runs)} recordings"


def _summary(table: Sequence[dict], runs: Sequence[Comparison], held_out: bool) -> Html:
    weak = [row["name"] for row in table if row["determined"] < 0.5]
    count = "1 parameter was" if len(table) == 1 else f"{len(table)} parameters were"
    lead = f"{count} fitted; the recordings determine "
    if weak:
        rest = "rests" if len(weak) == 1 else "rest"
        lead += f"all but {len(weak)}: {listed(weak)} {rest} mostly on the vessel file."
    else:
        lead += "all that was fitted."
    row = headline_horizon(horizon_table(runs), (_MODEL,))
    where = "on runs held out" if held_out else "on the runs it was fitted to"
    errors = f"{capital(where)}, errors {error_line(row, (_MODEL,))}." if row else ""
    body = joined([paragraph(verbatim(lead), "lead"), paragraph(errors)])
    return Html(f'<section id="summary" class="verdict fit">\n{body}\n</section>')


def _convergence(history: Sequence[str]) -> Html:
    if not history:
        return Html("")
    lines = joined(element("div", verbatim(line)) for line in history)
    return section("convergence", "How it converged", folded(f"{len(history)} rounds", lines))
