"""Designs of a trial as a page: the numbers over the parameters."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from diffsea.report import plots
from diffsea.report.page import Plot, Section, Table, Verbatim, provenance, render
from diffsea.report.pictures import most_informative
from diffsea.report.quantities import for_people, significant
from diffsea.report.wording.numbers import number_unit, number_words
from diffsea.report.wording.words import Record, enumeration
from diffsea.studies.inverse import MET


DESIGNS_OF_ENDS = ("least_design", "most_design")  # in sweep.json, of each number
SHOWN_NUMBERS = 6  # of a trial, the most informative ones, that are drawn
NO_INFLUENCE = 1e-6  # of a number: rounding, and how steady an approach is
DRAWN_DESIGNS = 4000  # of a cloud: more cannot be told apart, and make the page long
SHOWN_OF_FRONT = 12  # designs, in its table
FAILS = "fails the criterion"


def sweep_page(
    table: pd.DataFrame, summary: Record, source: Record, front: pd.DataFrame | None = None
) -> str:
    """A sweep: the numbers over the parameters, how many designs meet the criteria.

    Arguments:
        table: a row for each design, as sweep.parquet has them.
        summary: the content of sweep.json.
        source: what was run; shown as it is.
        front: designs that no other beats, where some were asked for.
    """
    names = list(summary["parameters"])
    shown = drawn_numbers(table, names)
    units = {name: axis.get("unit", "") for name, axis in summary["parameters"].items()}
    drawn = [number_plot(table, units, number) for number in shown]
    outcomes = [f"{count} {name}" for name, count in summary["outcomes"].items()]
    how = "a grid" if _is_grid(table, names) else "a sample"
    return render(
        "sections.html.j2",
        bundle="cartesian",
        title=f"Designs of {summary['vessel']}",
        subtitle=f"{summary['manoeuvre']}, {how} over {enumeration(names)}",
        word="",
        tone="fit",
        lead=f"{summary['designs']} designs: {enumeration(outcomes)}.",
        sentences=[_criterion_sentence(name, found) for name, found in summary["imo"].items()],
        sections=[
            *_looked_for(table, summary, front),
            Section("Numbers over parameters", how_drawn(table, names), drawn),
            Section("What was swept", tables=[axis_table(summary["parameters"])]),
            Section("Numbers", tables=[extent_table(summary["metrics"])]),
        ],
        provenance=provenance(source, []),
    )


def _looked_for(table: pd.DataFrame, summary: Record, front: pd.DataFrame | None) -> list[Section]:
    """What was found of what the sweep was to find: wanted numbers, and the best designs."""
    sections = []
    if "inverse" in summary:
        wanted, found = summary["inverse"]["wanted"], summary["inverse"]["designs"]
        met = sum(one["off"] <= MET for one in found)
        words = enumeration([f"{number_words(n)} {_told(v, n)}" for n, v in wanted.items()])
        told = f"{met} designs of these ranges were found" if met > 1 else "One design was found"
        if not met:
            told = "No design of these ranges was found; here are the nearest ones"
        tables = [_found_table(wanted, found)]
        sections.append(
            Section("Designs that are wanted", [f"{told}. Wanted: {words}."], (), tables)
        )
    if front is not None and len(front):
        goals, names = summary["front"]["goals"], list(summary["parameters"])
        words = enumeration([f"the {goal} {number_words(n)}" for n, goal in goals.items()])
        told = (
            f"{len(front)} of {summary['designs']} designs, for {words}: no other is better in one "
            "of these without being worse in another."
        )
        drawn = [_front_plot(table, front, list(goals))] if len(goals) > 1 else []
        shown = _front_table(front, names, list(goals))
        sections.append(Section("Designs that no other beats", [told], drawn, [shown]))
    return sections


def _found_table(wanted: Mapping[str, float], found: Sequence[Record]) -> Table:
    names = list(found[0]["parameters"])
    rows = []
    for one in found:
        values = [significant(one["parameters"][name], 5) for name in names]
        reached = [_told(one["metrics"].get(name, math.nan), name) for name in wanted]
        off = "-" if one["off"] <= MET else f"{significant(100 * one['off'], 2)} %"
        rows.append([*values, *reached, off])
    columns = [*map(Verbatim, names), *map(number_words, wanted), "off by"]
    return Table(columns, rows, "Parameters in SI units", tuple(range(len(columns))))


def _front_table(front: pd.DataFrame, names: Sequence[str], goals: Sequence[str]) -> Table:
    shown = front.iloc[plots.evenly(len(front), SHOWN_OF_FRONT)]
    rows = [
        [significant(row[name], 4) for name in names] + [_told(row[goal], goal) for goal in goals]
        for row in shown.to_dict("records")
    ]
    columns = [*map(Verbatim, names), *map(number_words, goals)]
    return Table(columns, rows, "Parameters in SI units", tuple(range(len(columns))))


def _told(value: float, number: str) -> str:
    if not math.isfinite(value):
        return "-"
    scaled, unit = for_people(float(value), number_unit(number))
    return f"{significant(scaled, 4)} {unit}".strip()


def _front_plot(table: pd.DataFrame, front: pd.DataFrame, goals: Sequence[str]) -> Plot:
    """All designs and those of the front over the first two numbers."""
    units = [for_people(0.0, number_unit(goal))[1] for goal in goals[:2]]
    labels = [
        f"{number_words(goal)}{f' ({unit})' if unit else ''}"
        for goal, unit in zip(goals, units, strict=False)
    ]
    cloud = table.dropna(subset=list(goals[:2]))
    drawn = plots.figure(showlegend=True)
    for part, name, colour, opacity in (
        (cloud.iloc[plots.evenly(len(cloud), DRAWN_DESIGNS)], "design", plots.DIAGNOSED, 0.35),
        (front, "no other beats it", plots.NOMINAL, 1.0),
    ):
        x, y = (plots.numbers(_scaled(part[goal], goal)) for goal in goals[:2])
        marker = {"color": colour, "size": 6, "opacity": opacity}
        drawn.add_scatter(x=x, y=y, mode="markers", marker=marker, name=name)
    drawn.update_layout(xaxis={"title": {"text": labels[0]}}, yaxis_title_text=labels[1])
    return Plot(drawn, f"{labels[1]} over {labels[0]}", 330)


def drawn_numbers(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """The most informative numbers that differ among the designs."""
    numeric = [str(n) for n in table.select_dtypes("number") if n not in names]
    values = {name: table[name].dropna() for name in numeric}
    differing = [n for n, v in values.items() if np.ptp(v) > NO_INFLUENCE * np.abs(v).max()]
    return most_informative(differing, SHOWN_NUMBERS)


def _is_grid(table: pd.DataFrame, names: Sequence[str]) -> bool:
    counts = [len(set(table[name])) for name in names]
    return math.prod(counts) == len(table)


def how_drawn(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    if len(names) == 1 or (len(names) == 2 and _is_grid(table, names)):
        return ["Designs that failed, or whose trial has no such number, are left out."]
    return [
        "Each number over the parameter that orders it best (Spearman's rank correlation); what "
        "the others do is the scatter."
    ]


def _criterion_sentence(name: str, found: Mapping[str, int]) -> str:
    judged = found["pass"] + found["fail"]
    return (
        f"{number_words(name)}: {found['pass']} of {judged} meet the criterion of IMO MSC.137(76)."
    )


def _labelled(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit not in ("", "1") else name


def number_plot(table: pd.DataFrame, units: Mapping[str, str], number: str) -> Plot:
    """One number over the parameters, in the units of people; `units` are those of parameters."""
    names = list(units)
    unit = for_people(0.0, number_unit(number))[1]
    label = f"{number_words(number)}{f' ({unit})' if unit else ''}"
    if len(names) == 2 and _is_grid(table, names):
        drawn = _map(table, units, number)
    else:
        ranks = {name: _rank_correlation(table, name, number) for name in names}
        strongest = max(ranks, key=lambda name: ranks[name])
        drawn = _cloud(table, strongest, number)
        drawn.update_layout(xaxis={"title": {"text": _labelled(strongest, units[strongest])}})
    drawn.add_annotation(plots.heading(label, 1.0))
    return Plot(drawn, f"{label} over {enumeration(list(names))}", 330)


def _rank_correlation(table: pd.DataFrame, parameter: str, number: str) -> float:
    """Spearman's rank correlation of a number with a parameter, without its sign."""
    both = table[[parameter, number]].dropna()
    if len(both) < 3 or len(set(both[parameter])) < 2:
        return 0.0
    return abs(float(np.corrcoef(both.rank().to_numpy().T)[0, 1]))


def _scaled(values: Iterable[float], number: str) -> np.ndarray:
    return for_people(1.0, number_unit(number))[0] * np.asarray(list(values), float)


def _map(table: pd.DataFrame, units: Mapping[str, str], number: str) -> go.Figure:
    """A heat map over a grid of two parameters; crosses fail the criterion."""
    names, labels = list(units), [_labelled(name, unit) for name, unit in units.items()]
    surface = table.pivot(index=names[1], columns=names[0], values=number)
    z = [plots.numbers(_scaled(row, number)) for _, row in surface.iterrows()]
    x, y = (plots.numbers(axis.to_numpy(float)) for axis in (surface.columns, surface.index))
    heat = go.Heatmap(x=x, y=y, z=z, colorscale="Viridis", colorbar={"thickness": 12})
    drawn = plots.figure(heat, showlegend=False)
    failing = _failing(table, number)
    if len(failing):
        marker = {"symbol": "x", "color": plots.NOMINAL, "size": 6}
        points = [plots.numbers(failing[name].to_numpy(float)) for name in names]
        drawn.add_scatter(x=points[0], y=points[1], mode="markers", marker=marker, name=FAILS)
    return drawn.update_layout(xaxis={"title": {"text": labels[0]}}, yaxis_title_text=labels[1])


def _cloud(table: pd.DataFrame, parameter: str, number: str) -> go.Figure:
    """A point for each design; those that fail the criterion in another colour."""
    known = table[table[number].notna()].iloc[plots.evenly(len(table), DRAWN_DESIGNS)]
    failing = _failing(known, number)
    drawn = plots.figure(showlegend=bool(len(failing)))
    for part, name, colour in (
        (known.drop(failing.index), "design", plots.DIAGNOSED),
        (failing, FAILS, plots.NOMINAL),
    ):
        points = (
            plots.numbers(part[parameter].to_numpy(float)),
            plots.numbers(_scaled(part[number], number)),
        )
        marker = {"color": colour, "size": 5, "opacity": 0.6}
        drawn.add_scatter(x=points[0], y=points[1], mode="markers", marker=marker, name=name)
    return drawn


def _failing(table: pd.DataFrame, number: str) -> pd.DataFrame:
    verdict = f"imo_{number}"
    return table.loc[table[verdict] == "fail"] if verdict in table else table.iloc[:0]


def axis_table(axes: Mapping[str, Record]) -> Table:
    """Where each parameter went, with a column of units where any has one."""
    told = ["unit"] if any(axis.get("unit") for axis in axes.values()) else []
    rows = [
        [
            Verbatim(name),
            *(significant(axis[end], 4) for end in ("from", "to")),
            *(axis.get(column, "") for column in told),
        ]
        for name, axis in axes.items()
    ]
    return Table(["parameter", "from", "to", *told], rows, "SI units", (1, 2))


def extent_table(metrics: Mapping[str, Record]) -> Table:
    rows = []
    for name, column in metrics.items():
        if not column["designs"]:
            continue
        scale, unit = for_people(1.0, number_unit(name))
        ends = [significant(scale * column[key], 3) for key in ("least", "median", "most")]
        designs = [Verbatim(design_words(column[key])) for key in DESIGNS_OF_ENDS]
        rows.append([number_words(name), *ends, unit, str(column["designs"]), *designs])
    columns = ["number", "least", "median", "most", "unit", "designs that have it"]
    columns += ["least in", "most in"]
    return Table(columns, rows, numeric=(1, 2, 3, 5))


def design_words(design: Mapping[str, float]) -> str:
    """The parameters of a design, as options have them: `mass=60 thrust=200`."""
    return " ".join(f"{name}={value:.4g}" for name, value in design.items())
