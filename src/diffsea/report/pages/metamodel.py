"""Metamodels as one page for people: what each group of trials tells, and how well."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import plotly.graph_objects as go

from diffsea.metamodels.fit import Trials
from diffsea.metamodels.validation import TrialPrediction, VesselComparison
from diffsea.report import plots
from diffsea.report.page import Plot, Table, Verbatim, provenance, render
from diffsea.report.quantities import interval, is_known, round_to_error, significant, with_error
from diffsea.report.wording.words import Record
from diffsea.trajectory import Trajectory


SHOWN_TRIALS = 2  # of each group: the one that is predicted worst, and the median
MEANINGS = {
    "a0": "asymmetry of a straight course",
    "a1": "linear damping (positive: stable on course)",
    "a2": "asymmetry of turns",
    "a3": "cubic damping",
    "b": "effect of the rudder",
}


class Modelled(Protocol):
    """What a page needs of a metamodel beside its record."""

    @property
    def trials(self) -> Trials: ...
    @property
    def crossed(self) -> TrialPrediction: ...
    @property
    def against(self) -> VesselComparison | None: ...


@dataclasses.dataclass(frozen=True)
class ModelSection:
    """One metamodel on the page; `averages` is None without zig-zags."""

    title: str
    lead: str
    coefficients: Table
    ideal: Table
    averages: Table | None
    plots: Sequence[Plot]
    trials: Table


def metamodel_report(
    record: Record, headline: str, models: Sequence[Modelled], logs: Sequence[Trajectory]
) -> str:
    """The page.

    Arguments:
        record: the content of metamodel.json.
        headline: in one line.
        models: those of the record, in its order.
    """
    entries = record["metamodels"]
    sections = [
        _section(entry, model, f"group-{k}")
        for k, (entry, model) in enumerate(zip(entries, models, strict=True))
    ]
    excluded = {row["log"]: row["excluded"] for row in record["logs"] if row["excluded"]}
    source = {
        "window": f"{significant(record['window'], 3)} s",
        "interval": f"{significant(record['interval'], 3)} s",
        "settings": record["settings"],
    }
    uses = [(run, "left out" if run.name in excluded else "searched") for run in logs]
    return render(
        "metamodel.html.j2",
        title="Metamodels from service",
        subtitle=headline,
        overview=_overview(entries, record["settings"].get("against")),
        notes=[Verbatim(note) for note in record["notes"]],
        sections=sections,
        provenance=provenance(source, uses),
    )


def _overview(entries: Sequence[Record], vessel: str | None) -> Table:
    """A row for each metamodel, with how well a `vessel` follows where one is judged."""
    rows = []
    for entry in entries:
        crossed = entry["cross_validation"]
        others = crossed["others"]["median"]
        rows.append(
            [
                Verbatim(entry["group"]),
                f"{len(entry['used'])} of {entry['trials']}",
                significant(entry["time_constant"], 3),
                significant(entry["gain"], 3),
                f"{math.degrees(entry['neutral']):.2f}",
                f"{crossed['median']:.0f}",
                f"{others:.0f}" if is_known(others) else "",
            ]
        )
        if entry["against"]:
            rows[-1].append(f"{entry['against']['metamodel']['median']:.0f}")
    columns = [
        "group",
        "trials used",
        "T (s)",
        "K (1/s)",
        "neutral (deg)",
        "cross-validation (%)",
        "trials not used (%)",
    ]
    if vessel:
        columns.append(f"{vessel} by metamodel (%)")
    caption = "Median fit to a trial: 100 % is perfect, 0 % no better than its mean"
    return Table(columns, rows, caption, numeric=range(1, len(columns)))


def _section(entry: Record, model: Modelled, group: str) -> ModelSection:
    """Coefficients, the ideal trial, averages, and what it predicts of trials it did not see."""
    crossed = entry["cross_validation"]
    lead = f"A trial is predicted by the metamodel of the others to {crossed['median']:.0f} %"
    others = crossed["others"]
    if others["trials"]:
        lead += (
            f", and the {others['trials']} trials that were not used to {others['median']:.0f} %"
        )
    coefficients = [
        [Verbatim(name), MEANINGS[name], with_error(row["value"], row["std"]), row["unit"]]
        for name, row in entry["coefficients"].items()
    ]
    columns = ["coefficient", "meaning", "estimate", "unit"]
    caption = "+- is one standard error, from how trials differ"
    averages = _averages(entry["corrected_averages"])
    return ModelSection(
        title=entry["group"],
        lead=f"{lead}.",
        coefficients=Table(columns, coefficients, caption, numeric=(2,)),
        ideal=_ideal(entry["ideal"]),
        averages=averages if averages.rows else None,
        plots=_crossed_plots(entry, model, group),
        trials=_used(entry["used"], crossed["each"], entry["against"]),
    )


def _ideal(sides: Mapping[str, Record]) -> Table:
    """Overshoots of the ideal zig-zag to either side."""
    rows = []
    for side, one in sides.items():
        errors = [*zip(one["overshoots"], one["std"], strict=True)]
        rows.append([side, *(with_error(value, std, "rad") for value, std in errors)])
    first = next(iter(sides.values()))
    angle, heading = (f"{math.degrees(first[key]):.0f}" for key in ("angle", "heading"))
    caption = f"The ideal {angle}/{heading} zig-zag by the metamodel"
    return Table(["first order to", "first overshoot", "second overshoot"], rows, caption)


def _averages(rows: Sequence[Record]) -> Table:
    """Measured overshoots of zig-zags, and corrected for how each was run."""

    def mean(one: Record) -> str:
        if not is_known(one["mean"]):
            return "not known"
        low, high = one["mean"] - one["half_width"], one["mean"] + one["half_width"]
        value = round_to_error(one["mean"], one["half_width"], "rad")
        return f"{value} ({interval((low, high), 'rad')})"

    cells = [
        [
            row["side"],
            str(row["overshoot"]),
            str(row["trials"]),
            mean(row["measured"]),
            mean(row["corrected"]),
        ]
        for row in rows
    ]
    columns = ["first order to", "overshoot", "trials", "average", "corrected average"]
    caption = "Average overshoots (95 % intervals), as run and corrected for how each was run"
    return Table(columns, cells, caption, numeric=(1, 2))


def _used(trials: Sequence[Record], percents: Sequence[float], against: Record | None) -> Table:
    """The trials that a metamodel rests on, and how a vessel that is judged answers each."""
    rows = []
    for k, (one, percent) in enumerate(zip(trials, percents, strict=True)):
        wind = significant(one["side_wind"], 2) if is_known(one["side_wind"]) else ""
        start, end = f"{one['start']:.0f}", f"{one['end']:.0f}"
        rows.append([Verbatim(one["log"]), start, end, wind, f"{percent:.0f}"])
        if against:
            rows[-1] += [f"{against[key]['each'][k]:.0f}" for key in ("metamodel", "measured")]
    columns = ["log", "from (s)", "to (s)", "side wind (m/s)", "predicted by the others (%)"]
    columns += ["vessel by metamodel (%)", "vessel by trial (%)"] if against else []
    return Table(columns, rows, numeric=range(1, len(columns)))


def _crossed_plots(entry: Record, model: Modelled, group: str) -> list[Plot]:
    """Yaw rate and rudder of the trial predicted worst and of the median one."""
    percents = np.asarray(model.crossed.percent)
    order = np.argsort(percents)
    chosen = dict.fromkeys((int(order[len(order) // 2]), int(order[0])))
    out = []
    for k in list(chosen)[:SHOWN_TRIALS]:
        used: dict[str, Any] = entry["used"][k]
        what = f"{used['log']} from {used['start']:.0f} s, {percents[k]:.0f} %"
        caption = "Yaw rate measured (grey) and by the metamodel of the others (blue); rudder below"
        if model.against is not None:
            caption += "; dotted, the vessel that is judged"
        drawn = _trial_plot(model, k, f"{group}-{k}", what)
        out.append(Plot(drawn, f"Yaw rate of {what}", 330, caption))
    return out


def _trial_plot(model: Modelled, k: int, group: str, title: str) -> go.Figure:
    known = np.asarray(model.trials.known[k])
    t = float(model.trials.dt) * np.arange(len(known))[known]
    series = [
        np.asarray(a[k])[known] for a in (model.trials.r, model.crossed.r, model.trials.delta)
    ]
    measured, predicted, rudder = (plots.numbers(np.degrees(one)) for one in series)
    x = plots.numbers(t, plots.TIME_DIGITS)
    drawn = plots.figure(hovermode="x", showlegend=False)
    lines = (
        ("measured", measured, {"color": plots.MEASURED, "width": 3}, "y"),
        ("metamodel", predicted, {"color": plots.DIAGNOSED, "width": 1.5}, "y"),
        ("rudder", rudder, {"color": plots.NOMINAL, "width": 1.5}, "y2"),
    )
    if model.against is not None:
        judged = plots.numbers(np.degrees(model.against.r[k][known]))
        dotted = {"color": plots.DIAGNOSED, "width": 1.5, "dash": "dot"}
        lines = (*lines, ("vessel", judged, dotted, "y"))
    for name, y, line, axis in lines:
        drawn.add_scatter(x=x, y=y, mode="lines", name=name, line=line, xaxis="x", yaxis=axis)
    drawn.update_layout(
        yaxis={"domain": [0.42, 1.0], "title": {"text": "yaw rate (deg/s)"}, "nticks": 6},
        yaxis2={"domain": [0.0, 0.34], "title": {"text": "rudder (deg)"}, "nticks": 4},
        xaxis={"anchor": "y2", "title": {"text": "time (s)"}},
    )
    drawn.add_annotation(plots.heading(title, 1.0))
    return plots.add_time_cursor(drawn, group)
