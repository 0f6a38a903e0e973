"""A campaign as one page: criteria, numbers to both sides, tracks, approaches and actuation."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.metrics.numbers import TrialNumber, numbers_of
from diffsea.report import plots
from diffsea.report.page import Plot, RunPlots, Table, Verbatim, provenance, render
from diffsea.report.pages.trial_marks import mark_crossings, mark_overshoots
from diffsea.report.quantities import for_people, significant
from diffsea.report.wording.numbers import number_unit, number_words
from diffsea.report.wording.words import Record, capital
from diffsea.trajectory import Samples, Trajectory


DRAWN_ROWS = 1200  # of a run: more cannot be told apart
SIDE_COLOURS = {"starboard": plots.DIAGNOSED, "port": plots.NOMINAL}
_PANELS = (
    ("psi_relative", "change of heading (deg)", math.degrees(1.0)),
    ("delta_exec", "executed steering (deg), order thin", math.degrees(1.0)),
    ("r", "yaw rate (deg/s)", math.degrees(1.0)),
    ("u", "speed ahead u (m/s)", 1.0),
)
_CONDITIONS = ("order_angle", "switching_heading", "execute_time")  # no results of the trial


@dataclasses.dataclass(frozen=True)
class TrialRun:
    """A trial to one side as it is drawn: its run, and its log with time from the onset."""

    trial: str
    side: str
    run: Trajectory
    log: Mapping[str, Samples]
    metrics: Mapping[str, Any]


def campaign_page(record: Record, runs: Sequence[TrialRun], source: Record) -> str:
    """The page.

    Arguments:
        record: the content of campaign.json.
        runs: the trials that have a result.
        source: what was run; shown as it is.
    """
    by_trial: dict[str, list[TrialRun]] = {}
    for one in runs:
        by_trial.setdefault(one.trial, []).append(one)
    entries = [e for sides in record["trials"].values() for e in sides.values()]
    done = sum("failed" not in entry for entry in entries)
    length = f"length {significant(record['length'], 3)} m"
    return render(
        "campaign.html.j2",
        title=f"Trials of {record['vessel']}",
        subtitle=f"{done} of {len(entries)} trials done, {length}",
        lead=_verdict_sentence(record),
        verdict=record["verdict"],
        criteria=_criteria_table(record["criteria"]),
        notes=[f"{capital(note)}." for note in record["notes"]],
        numbers=[_number_table(name, sides) for name, sides in record["trials"].items()],
        runs=[_trial_plots(name, found) for name, found in by_trial.items()],
        approaches=_approach_table(record["trials"]),
        checks=_check_table(record["trials"]),
        provenance=provenance(source, [(one.run, "simulated") for one in runs]),
    )


def _verdict_sentence(record: Record) -> str:
    """What the criteria say, in one sentence."""
    criteria = record["criteria"]
    if not criteria:
        return "No criterion of IMO MSC.137(76) applies to these trials."
    failed = [row for row in criteria if row["verdict"] == "fail"]
    if not failed and len(criteria) == 1:
        return "The one criterion of IMO MSC.137(76) that applies is met."
    if not failed:
        return f"All {len(criteria)} criteria of IMO MSC.137(76) that apply are met."
    names = dict.fromkeys(f"{number_words(row['number'])} ({row['trial']})" for row in failed)
    return (
        f"{len(failed)} of {len(criteria)} criteria of IMO MSC.137(76) that apply "
        f"{'is' if len(failed) == 1 else 'are'} not met: {', '.join(names)}."
    )


def _criteria_table(criteria: Sequence[Record]) -> Table:
    run = {side for row in criteria for side in row["values"]}
    sides = [side for side in SIDE_COLOURS if side in run] or ["ahead"]
    columns = ["trial", "criterion", "number", *sides, "limit", "unit", "verdict"]
    rows = []
    for row in criteria:
        limit, unit = for_people(row["limit"], row["unit"])
        values = [
            significant(for_people(row["values"][side], row["unit"])[0], 3)
            if side in row["values"]
            else ""
            for side in sides
        ]
        if not any(values):  # of a trial that turns to no side
            values[0] = significant(for_people(*_only(row))[0], 3)
        cells = [Verbatim(row["trial"]), Verbatim(row["criterion"]), number_words(row["number"])]
        rows.append([*cells, *values, significant(limit, 3), unit, row["verdict"]])
    return Table(
        columns,
        rows,
        "Criteria of IMO MSC.137(76); L is the ship's length",
        range(3, 4 + len(sides)),
    )


def _only(row: Record) -> tuple[float, str]:
    return next(iter(row["values"].values())), row["unit"]


def _number_table(trial: str, sides: Mapping[str, Record]) -> Table:
    """Numbers of a trial to each side, and over the ship's length where that is a number."""
    found = [{one.name: one for one in numbers_of(metrics)} for metrics in sides.values()]
    names = dict.fromkeys(name for numbers in found for name in numbers if name not in _CONDITIONS)
    rows = []
    for name in names:
        unit = for_people(0.0, number_unit(name))[1]
        rows.append([number_words(name), *(_number_cell(one.get(name)) for one in found), unit])
    columns = ["number", *sides, "unit"]
    return Table(columns, rows, trial, range(1, len(sides) + 1))


def _number_cell(number: TrialNumber | None) -> str:
    if number is None:
        return ""
    text = significant(for_people(number.value, number.unit)[0], 3)
    over = number.over_length
    return text if over is None else f"{text} ({significant(over, 3)} L)"


def _approach_table(trials: Mapping[str, Mapping[str, Record]]) -> Table:
    """How steadily every trial was begun, or why it has no result."""
    rows = []
    for trial, sides in trials.items():
        for side, metrics in sides.items():
            if "failed" in metrics:
                failed = Verbatim(metrics["failed"])
                rows.append([Verbatim(trial), side, "", "", "", "failed", failed])
                continue
            approach, ittc = metrics["approach"], metrics["approach"]["ittc"]
            speed = _with_limit(ittc["speed"], ittc["least_speed"], "m/s", "at least")
            rate = _with_limit(ittc["yaw_rate"], ittc["largest_yaw_rate"], "rad/s", "at most")
            judged = [speed, rate, ittc["verdict"], approach["verdict"], approach["why"]]
            rows.append([Verbatim(trial), side, *judged])
    head = ["trial", "side", "speed, m/s", "largest yaw rate, deg/s", "ITTC", "approach", "why"]
    return Table(head, rows, "Approaches, with what the ITTC asks of them", (2, 3))


def _with_limit(value: float, limit: float | None, unit: str, words: str) -> str:
    told = significant(for_people(value, unit)[0], 3)
    limited = "" if limit is None else f" ({words} {significant(for_people(limit, unit)[0], 3)})"
    return told + limited


def _check_table(trials: Mapping[str, Mapping[str, Record]]) -> Table:
    """Checks from order to motion; those of both sides that say the same stand once."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for trial, sides in trials.items():
        for side, metrics in sides.items():
            for check in metrics.get("checks", ()):
                key = trial, check["name"], check["verdict"], check["why"]
                rows.setdefault(key, []).append(side)
    cells = [
        [Verbatim(trial), ", ".join(sides), Verbatim(name), verdict, why]
        for (trial, name, verdict, why), sides in rows.items()
    ]
    return Table(["trial", "side", "check", "verdict", "why"], cells)


def _trial_plots(trial: str, runs: Sequence[TrialRun]) -> RunPlots:
    """Tracks and histories of a trial to both sides, under one cursor."""
    who = " and ".join(one.side for one in runs)
    track = f"Track of {trial} to {who}, the execute at the origin and the approach upwards."
    series = f"Heading, steering, yaw rate and speed of {trial} to {who} since the onset."
    drawn = [
        Plot(_tracks(runs, trial), track, 460),
        Plot(_histories(runs, trial), series, 560),
    ]
    return RunPlots(trial, drawn)


def _colour(one: TrialRun) -> str:
    return SIDE_COLOURS.get(one.side, plots.DIAGNOSED)


def _tracks(runs: Sequence[TrialRun], group: str) -> go.Figure:
    """Tracks in the axes of the approach: ahead upwards, to starboard to the right (m)."""
    layout = {"xaxis": {"title": {"text": "to starboard (m)"}}, "showlegend": True}
    layout["yaxis"] = plots.TRACK_LAYOUT["yaxis"] | {"title": {"text": "ahead (m)"}}
    drawn = plots.figure(**plots.TRACK_LAYOUT | layout)
    for one in runs:
        log, rows = one.log, plots.evenly(len(one.log["t"]), DRAWN_ROWS)
        t = log["t"]
        x, y, psi = (float(np.interp(0.0, t, log[name])) for name in ("x", "y", "psi_unwrapped"))
        north, east = log["x"][rows] - x, log["y"][rows] - y
        ahead = math.cos(psi) * north + math.sin(psi) * east
        starboard = math.cos(psi) * east - math.sin(psi) * north
        mark_crossings(drawn, _rows_of(log, rows), one.metrics, (starboard, ahead), _colour(one))
        drawn.add_scatter(
            x=plots.numbers(starboard),
            y=plots.numbers(ahead),
            name=one.side,
            mode="lines",
            customdata=plots.numbers(t[rows], plots.TIME_DIGITS),
            line={"color": _colour(one), "width": 2},
        )
    drawn.update_traces(hovertemplate="%{customdata} s: %{x} m to starboard, %{y} m ahead")
    return plots.add_track_markers(drawn, group, range(len(runs)), [_colour(one) for one in runs])


def _histories(runs: Sequence[TrialRun], group: str) -> go.Figure:
    """Heading, executed and ordered steering, yaw rate and speed against time from the onset."""
    panels = [panel for panel in _PANELS if all(panel[0] in one.log for one in runs)]
    margin = {"t": 24, "b": 36, "l": 48, "r": 8}
    drawn = plots.figure(hovermode="x", margin=margin, showlegend=False)
    for k, (column, title, scale) in enumerate(panels):
        axis = {"xaxis": "x", "yaxis": f"y{k + 1}" if k else "y", "mode": "lines"}
        for one in runs:
            rows = plots.evenly(len(one.log["t"]), DRAWN_ROWS)
            x = plots.numbers(one.log["t"][rows], plots.TIME_DIGITS)
            if column == "delta_exec" and "delta_cmd" in one.log:
                ordered: dict[str, Any] = {"color": _colour(one), "width": 0.8, "shape": "hv"}
                y = plots.numbers(one.log["delta_cmd"][rows] * scale)
                drawn.add_scatter(x=x, y=y, name=one.side, line=ordered, hoverinfo="skip", **axis)
            y = plots.numbers(one.log[column][rows] * scale)
            line = {"color": _colour(one), "width": 1.8}
            drawn.add_scatter(x=x, y=y, name=one.side, line=line, **axis)
            if column == "psi_relative":
                mark_overshoots(drawn, one.log, one.metrics, _colour(one))
        domain = plots.panel_of(k, len(panels), 0.06)
        drawn.update_layout({f"yaxis{k + 1}": {"domain": domain, "nticks": 5}})
        drawn.add_annotation(plots.heading(title, domain[1]))
    title = {"text": "time since the onset (s)"}
    drawn.update_layout(xaxis={"title": title, "anchor": f"y{len(panels)}"})
    return plots.add_time_cursor(drawn, group)


def _rows_of(log: Mapping[str, Samples], rows: slice) -> dict[str, Float[np.ndarray, "_"]]:
    return {name: np.asarray(series)[rows] for name, series in log.items()}
