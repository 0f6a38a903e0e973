"""Designs and derivatives of a trial as pages: what a parameter does to the numbers."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from diffsea.report import plots
from diffsea.report.page import Plot, Section, Table, Verbatim, provenance, render
from diffsea.report.pages.campaign import number_unit, number_words
from diffsea.report.pictures import most_informative
from diffsea.report.quantities import for_people, significant
from diffsea.report.words import Record, enumeration


SHOWN_NUMBERS = 6  # of a trial, the most informative ones, that are drawn
SHOWN_BARS = 10  # parameters of a number
WEAKEST = 1e-3  # of the strongest, below which a bar cannot be seen
NO_INFLUENCE = 1e-6  # of a number: rounding, and how steady an approach is
DRAWN_DESIGNS = 4000  # of a cloud: more cannot be told apart, and make the page long
FAILS = "fails the criterion"


def sweep_page(table: pd.DataFrame, summary: Record, source: Record) -> str:
    """A sweep: the numbers over the parameters, how many designs meet the criteria.

    Arguments:
        table: a row for each design, as sweep.parquet has them.
        summary: the content of sweep.json.
        source: what was run; shown as it is.
    """
    names = list(summary["parameters"])
    shown = drawn_numbers(table, names)
    drawn = [number_plot(table, names, number) for number in shown]
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
            Section("Numbers over parameters", how_drawn(table, names), drawn),
            Section("What was swept", tables=[axis_table(summary["parameters"])]),
            Section("Numbers", tables=[extent_table(summary["metrics"])]),
        ],
        provenance=provenance(source, []),
    )


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


def number_plot(table: pd.DataFrame, names: Sequence[str], number: str) -> Plot:
    """One number over the parameters, in the units of people."""
    unit = for_people(0.0, number_unit(number))[1]
    label = f"{number_words(number)}{f' ({unit})' if unit else ''}"
    if len(names) == 2 and _is_grid(table, names):
        drawn = _map(table, names, number)
    else:
        ranks = {name: _rank_correlation(table, name, number) for name in names}
        drawn = _cloud(table, max(ranks, key=lambda name: ranks[name]), number)
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


def _map(table: pd.DataFrame, names: Sequence[str], number: str) -> go.Figure:
    """A heat map over a grid of two parameters; crosses fail the criterion."""
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
    return drawn.update_layout(xaxis={"title": {"text": names[0]}}, yaxis_title_text=names[1])


def _cloud(table: pd.DataFrame, parameter: str, number: str) -> go.Figure:
    """A point for each design; those that fail the criterion in another colour."""
    known = table[table[number].notna()].iloc[:: max(1, -(-len(table) // DRAWN_DESIGNS))]
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
    return drawn.update_layout(xaxis={"title": {"text": f"{parameter} (SI units)"}})


def _failing(table: pd.DataFrame, number: str) -> pd.DataFrame:
    verdict = f"imo_{number}"
    return table.loc[table[verdict] == "fail"] if verdict in table else table.iloc[:0]


def axis_table(axes: Mapping[str, Record]) -> Table:
    rows = [
        [Verbatim(name), significant(axis["from"], 4), significant(axis["to"], 4)]
        for name, axis in axes.items()
    ]
    return Table(["parameter", "from", "to"], rows, "SI units", (1, 2))


def extent_table(metrics: Mapping[str, Record]) -> Table:
    rows = []
    for name, column in metrics.items():
        if not column["designs"]:
            continue
        scale, unit = for_people(1.0, number_unit(name))
        ends = [significant(scale * column[key], 3) for key in ("least", "median", "most")]
        rows.append([number_words(name), *ends, unit, str(column["designs"])])
    columns = ["number", "least", "median", "most", "unit", "designs that have it"]
    return Table(columns, rows, numeric=(1, 2, 3, 5))


def sensitivity_page(
    relative: Mapping[str, Mapping[str, float]],
    values: Mapping[str, float],
    title: tuple[str, str],
    source: Record,
) -> str:
    """Relative sensitivities of a trial's numbers: per cent per one per cent of a parameter.

    Arguments:
        relative: by number, then by parameter; zeros are left out.
        values: of the numbers, in SI units.
        title: the vessel's name, and the trial.
        source: what was run; shown as it is.
    """
    relative = {
        number: {name: size for name, size in row.items() if abs(size) > NO_INFLUENCE}
        for number, row in relative.items()
    }
    shown = most_informative([name for name, row in relative.items() if row], SHOWN_NUMBERS)
    strongest = max(
        ((abs(size), number, name) for number in shown for name, size in relative[number].items()),
        default=None,
    )
    lead = "No parameter has an influence."
    if strongest is not None:
        size = relative[strongest[1]][strongest[2]]
        lead = (
            f"One per cent more {strongest[2]} changes the {number_words(strongest[1])} by "
            f"{significant(size, 2)} %: the strongest influence."
        )
    return render(
        "sections.html.j2",
        title=f"Sensitivities of {title[0]}",
        subtitle=title[1],
        word="",
        tone="fit",
        lead=lead,
        sentences=[
            "Derivatives are exact, through the switching of orders; approach speed, orders and "
            "time step stay as they are."
        ],
        sections=[
            Section(
                "Per cent of each number per one per cent of a parameter",
                plots=[_tornado(number, relative[number]) for number in shown],
            ),
            Section("All numbers", tables=[_elasticity_table(relative, values)]),
        ],
        provenance=provenance(source, []),
    )


def sobol_page(
    indices: Mapping[str, Mapping[str, Record]],
    ranges: Mapping[str, tuple[float, float]],
    left_out: Sequence[str],
    title: tuple[str, str],
    source: Record,
) -> str:
    """Sobol indices: which share of each number's variance a parameter makes over its range.

    Arguments:
        indices: the content of sobol.json.
        ranges: from and to by parameter.
        left_out: numbers that some designs do not have.
        title: the vessel's name, and the trial.
        source: what was run; shown as it is.
    """
    shown = most_informative(list(indices), SHOWN_NUMBERS)
    lead = "No number changes over these ranges."
    if shown:
        row = indices[shown[0]]
        name = max(row, key=lambda one: row[one]["total"]["value"])
        share = 100 * row[name]["total"]["value"]
        lead = (
            f"{name} has a part in {share:.0f} % of the variance of the {number_words(shown[0])}: "
            "more than any other parameter."
        )
    missing = [
        f"{number_words(name)}: not a number of every design, left out." for name in left_out
    ]
    return render(
        "sections.html.j2",
        title=f"Sobol indices of {title[0]}",
        subtitle=title[1],
        word="",
        tone="fit",
        lead=lead,
        sentences=["All values of a range are alike likely; intervals are of 90 %.", *missing],
        sections=[
            Section(
                "Share of each number's variance",
                ["Blue: alone; grey: with what it does together with others."],
                [_index_bars(number, indices[number]) for number in shown],
            ),
            Section("All numbers", tables=[_index_table(indices)]),
            Section(
                "Ranges",
                tables=[
                    axis_table(
                        {n: dict(zip(("from", "to"), r, strict=True)) for n, r in ranges.items()}
                    )
                ],
            ),
        ],
        provenance=provenance(source, []),
    )


def _index_bars(number: str, row: Mapping[str, Record]) -> Plot:
    """Bars of total and first indices with intervals, the largest on top."""
    ranked = sorted(row, key=lambda name: row[name]["total"]["value"])[-SHOWN_BARS:]
    drawn = plots.figure(showlegend=False, barmode="overlay")
    for kind, colour, width in (("total", plots.MEASURED, 0.8), ("first", plots.DIAGNOSED, 0.45)):
        found = [row[name][kind] for name in ranked]
        values = [one["value"] for one in found]
        above = [one["high"] - one["value"] for one in found]
        below = [one["value"] - one["low"] for one in found]
        error = {"array": plots.numbers(above), "arrayminus": plots.numbers(below), "thickness": 1}
        drawn.add_bar(
            x=plots.numbers(values),
            y=ranked,
            orientation="h",
            marker={"color": colour},
            width=width,
            name="in all" if kind == "total" else "alone",
            error_x=error,
        )
    drawn.add_annotation(plots.heading(number_words(number), 1.0))
    drawn.update_layout(xaxis={"title": {"text": "share of the variance"}})
    text = f"Shares of the variance of the {number_words(number)} by parameter"
    return Plot(drawn, text, 100 + 26 * len(ranked))


def _index_table(indices: Mapping[str, Mapping[str, Record]]) -> Table:
    rows = []
    for number, row in indices.items():
        ranked = sorted(row, key=lambda name: -row[name]["total"]["value"])[:SHOWN_BARS]
        for name in ranked:
            cells = []
            for kind in ("first", "total"):
                one = row[name][kind]
                cells.append(f"{one['value']:.2f} ({one['low']:.2f} to {one['high']:.2f})")
            rows.append([number_words(number), Verbatim(name), *cells])
    return Table(["number", "parameter", "alone", "in all"], rows, numeric=(2, 3))


def _tornado(number: str, row: Mapping[str, float]) -> Plot:
    """Bars of the strongest parameters of a number, the strongest on top."""
    least = WEAKEST * max(map(abs, row.values()))
    ranked = sorted((n for n in row if abs(row[n]) > least), key=lambda n: abs(row[n]))
    strongest = ranked[-SHOWN_BARS:]
    sizes = [row[name] for name in strongest]
    colours = [plots.DIAGNOSED if size > 0 else plots.NOMINAL for size in sizes]
    bars = go.Bar(
        x=plots.numbers(sizes), y=strongest, orientation="h", marker={"color": colours}, name=""
    )
    drawn = plots.figure(bars, showlegend=False)
    drawn.add_annotation(plots.heading(number_words(number), 1.0))
    drawn.update_layout(xaxis={"title": {"text": "% per 1 % of the parameter"}})
    return Plot(
        drawn, f"Strongest parameters of the {number_words(number)}", 90 + 22 * len(strongest)
    )


def _elasticity_table(
    relative: Mapping[str, Mapping[str, float]], values: Mapping[str, float]
) -> Table:
    rows = []
    for number, row in relative.items():
        value, unit = for_people(values[number], number_unit(number))
        ranked = sorted(row, key=lambda name: -abs(row[name]))[:SHOWN_BARS]
        told = ", ".join(f"{name} {significant(row[name], 2)}" for name in ranked)
        rows.append([number_words(number), significant(value, 4), unit, Verbatim(told or "-")])
    caption = "Per cent of the number per one per cent of the strongest parameters"
    return Table(["number", "value", "unit", "strongest"], rows, caption, (1,))
