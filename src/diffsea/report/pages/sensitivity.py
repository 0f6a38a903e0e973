"""What a parameter does to a trial's numbers: pages of derivatives, and of shares over ranges."""

from collections.abc import Mapping, Sequence

import plotly.graph_objects as go

from diffsea.report import plots
from diffsea.report.page import Plot, Section, Table, Verbatim, provenance, render
from diffsea.report.pages.sweep import NO_INFLUENCE, SHOWN_NUMBERS, axis_table
from diffsea.report.pictures import most_informative
from diffsea.report.quantities import for_people, significant
from diffsea.report.wording.numbers import number_unit, number_words
from diffsea.report.wording.words import Record


SHOWN_BARS = 10  # parameters of a number
WEAKEST = 1e-3  # of the strongest, below which a bar cannot be seen


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
            f"{significant(size, 2)} %: the strongest influence on what is drawn."
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
