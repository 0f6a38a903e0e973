"""Many values of a mission's numbers, and tuned ones, as pages."""

from collections.abc import Mapping, Sequence

import pandas as pd

from diffsea.missions import MissionRun
from diffsea.report.page import Section, Table, Verbatim, provenance, render
from diffsea.report.pages.mission import error_sentences, order_table, run_plots, source_of_run
from diffsea.report.pages.sweep import (
    axis_table,
    drawn_numbers,
    extent_table,
    how_drawn,
    number_plot,
)
from diffsea.report.quantities import for_people, significant
from diffsea.report.wording.numbers import number_unit, number_words
from diffsea.report.wording.words import Record, enumeration


AT_END = 0.01  # of a range: nearer to its end is at it


def closed_loop_page(table: pd.DataFrame, best: pd.DataFrame, record: Record) -> str:
    """A mission with many values of its numbers: how well each did.

    Arguments:
        table: a row for each design, as grid.csv has them.
        best: rows of the table, the best first.
        record: the content of run.json.
    """
    names = list(record["parameters"])
    units = dict.fromkeys(names, "SI units")
    outcomes = [f"{count} {name}" for name, count in record["outcomes"].items()]
    return render(
        "sections.html.j2",
        bundle="cartesian",
        title=f"{record['mission']}, {record['designs']} times",
        subtitle=f"{record['vessel']} under {record['controller']}, over {enumeration(names)}",
        word="",
        tone="fit",
        lead=f"{record['designs']} runs: {enumeration(outcomes)}.",
        sentences=best_sentences(record),
        sections=[
            Section(
                "Numbers over parameters",
                how_drawn(table, names),
                [number_plot(table, units, one) for one in drawn_numbers(table, names)],
            ),
            Section("Best runs", ["Those with the smallest error."], tables=[_best_table(best)]),
            Section("What was varied", tables=[axis_table(record["parameters"])]),
            Section("Numbers", tables=[extent_table(record["metrics"])]),
        ],
        provenance=provenance(record["source"], []),
    )


def best_sentences(record: Record) -> list[str]:
    """The smallest error and where it is, beside that of the mission as it stands."""
    best = record.get("best")
    if best is None:
        return ["No run was completed."]
    at = ", ".join(f"{name} {significant(best[name], 3)}" for name in record["parameters"])
    name = record["judged_by"]
    told = f"Smallest {number_words(name)} of completed runs: {_told(best[name], name)}, at {at}"
    stands = record["as_it_stands"][name]
    own = "it diverged" if stands is None else _told(stands, name)
    return [f"{told}; as the mission stands {own}."]


def _told(value: float, name: str) -> str:
    scale, unit = for_people(1.0, number_unit(name))
    return f"{significant(scale * value, 3)} {unit}".strip()


def _best_table(best: pd.DataFrame) -> Table:
    columns = [str(name) for name in best]
    rows = [
        [significant(cell, 3) if isinstance(cell, float) else Verbatim(cell) for cell in row]
        for row in best.itertuples(index=False)
    ]
    return Table([name.replace("_", " ") for name in columns], rows, "SI units")


def tuning_page(run: MissionRun, numbers: Record) -> str:
    """A tuned mission: what changed, how the path that judges went, and the run.

    Arguments:
        numbers: the content of run.json, with `tuning`.
    """
    tuning = numbers["tuning"]
    sentences = judged_sentences(tuning)
    plots = run_plots(run, "run")
    return render(
        "sections.html.j2",
        title=f"{run.mission.name}, tuned",
        subtitle=f"{run.mission.vessel.name} under {run.mission.controller.kind}",
        word="",
        tone="consistent" if tuning["better"] else "unexplained",
        lead=sentences[0],
        sentences=sentences[1:] + error_sentences(numbers),
        sections=[
            Section("What was tuned", tables=[_tuned_table(tuning["numbers"])]),
            Section("Every path before and after", tables=[_path_table(tuning["paths"])]),
            Section("Starts", tables=[_start_table(tuning["starts"])]),
            Section("The run", plots=list(plots.plots)),
            Section("Orders against limits", tables=[order_table(numbers["orders"])]),
        ],
        provenance=provenance(
            source_of_run(run, numbers), [(run.recorded, "simulated, as the sensors show it")]
        ),
    )


def judged_sentences(tuning: Record) -> list[str]:
    """What became better: on the paths that judge first."""
    sentences = []
    for one in sorted(tuning["paths"], key=lambda path: path["tuned_on"]):
        role = "Tuned on" if one["tuned_on"] else "Judged on a path that it was not tuned on"
        name = next(n for n in one["before"] if n.endswith("_rms"))
        before, after = (_told(one[when][name], name) for when in ("before", "after"))
        cost = [significant(one[when]["cost"], 3) for when in ("before", "after")]
        sentences.append(
            f"{role}, {one['name']}: {number_words(name)} {before} before, {after} after; cost "
            f"{cost[0]} before, {cost[1]} after."
        )
    for name, one in tuning["numbers"].items():
        room = one["to"] - one["from"]
        if min(one["after"] - one["from"], one["to"] - one["after"]) < AT_END * room:
            sentences.append(f"{name} went to the end of its range: the best lies beyond it.")
    if not tuning["better"]:
        sentences.insert(0, "The tuned numbers are no better on the path that judges: keep yours.")
    return sentences


def _tuned_table(numbers: Mapping[str, Record]) -> Table:
    rows = [
        [Verbatim(name), *(significant(one[key], 4) for key in ("before", "after", "from", "to"))]
        for name, one in numbers.items()
    ]
    return Table(["number", "before", "after", "from", "to"], rows, "SI units", (1, 2, 3, 4))


def _path_table(paths: Sequence[Record]) -> Table:
    rows = []
    for one in paths:
        for name in one["before"]:
            tell = (lambda value, _: significant(value, 3)) if name == "cost" else _told
            values = [tell(one[when][name], name) for when in ("before", "after")]
            role = "tuned on" if one["tuned_on"] else "judges"
            rows.append([Verbatim(one["name"]), role, number_words(name), *values])
    return Table(["path", "role", "number", "before", "after"], rows, numeric=(3, 4))


def _start_table(starts: Sequence[Record]) -> Table:
    rows = []
    for one in starts:
        begun, ended = (
            ", ".join(f"{name} {significant(value, 3)}" for name, value in one[key].items())
            for key in ("start", "found")
        )
        costs = [significant(one[key], 4) for key in ("cost_before", "cost")]
        rows.append([Verbatim(begun), Verbatim(ended), *costs, str(one["steps"])])
    return Table(["from", "to", "cost before", "cost after", "steps"], rows, numeric=(2, 3, 4))
