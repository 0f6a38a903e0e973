"""A battery of runs as one page: how often what went wrong, how far off, and all tracks."""

import math
from collections.abc import Sequence

import plotly.graph_objects as go

from diffsea.missions import BatteryRun
from diffsea.report import plots
from diffsea.report.page import Plot, Table, Verbatim, provenance, render
from diffsea.report.quantities import significant
from diffsea.report.wording.words import Record


DRAWN_RUNS = 60  # tracks: more would hide one another
DRAWN_ROWS = 300  # of a track
EVENT_WORDS = {
    "not_finished": "not finished",
    "waypoint_missed": "missed a waypoint",
    "at_limit": "had an order at a limit",
    "wrong_way": "was turned further from the path",
}
_NUMBER_WORDS = {
    "time": "time (s)",
    "path_rms": "path error, rms (m)",
    "path_largest": "path error, largest (m)",
    "position_rms": "distance from the pose, rms (m)",
    "position_largest": "distance from the pose, largest (m)",
    "heading_rms": "heading error, rms (rad)",
    "speed_rms": "speed error, rms (m/s)",
    "at_limit": "share of the time at a limit",
}
_UNFINISHED = plots.NOMINAL


def share_sentences(numbers: Record) -> list[str]:
    """How many runs had what, with intervals of 95 %."""
    return [
        f"{EVENT_WORDS[name]}: {one['runs']} of {numbers['runs']} ({_percent(one)})"
        for name, one in numbers["shares"].items()
    ]


def _percent(one: Record) -> str:
    low, high = (100 * end for end in one["interval"])
    return f"{100 * one['share']:.0f} %, interval {low:.0f} to {high:.0f} %"


def battery_page(run: BatteryRun, numbers: Record) -> str:
    """The page.

    Arguments:
        numbers: the content of run.json.
    """
    finished = numbers["runs"] - numbers["shares"]["not_finished"]["runs"]
    source = {
        "vessel": numbers["vessel"],
        "model": run.mission.model.name,
        "controller": numbers["controller"],
        "runs": numbers["runs"],
    }
    return render(
        "battery.html.j2",
        title=f"{numbers['mission']}, {numbers['runs']} times",
        subtitle=f"{numbers['vessel']} under {numbers['controller']}; plant and weather drawn",
        completed=finished == numbers["runs"],
        lead=f"{finished} of {numbers['runs']} runs were finished.",
        shares=_share_table(numbers),
        numbers=_number_table(numbers["numbers"]),
        tracks=Plot(_tracks(run), "Tracks of the runs beside the path, from above.", 560),
        table=_run_table(run.table),
        provenance=provenance(source, []),
    )


def _share_table(numbers: Record) -> Table:
    rows = []
    for name, one in numbers["shares"].items():
        low, high = (f"{100 * end:.0f}" for end in one["interval"])
        share = f"{100 * one['share']:.0f} %"
        rows.append([EVENT_WORDS[name], str(one["runs"]), share, f"{low} to {high} %"])
    columns = ["a run ...", "runs", "share", "95 % interval"]
    return Table(columns, rows, "Intervals are Wilson's", numeric=(1, 2, 3))


def _number_table(numbers: Record) -> Table:
    rows = [
        [_NUMBER_WORDS[name], *(significant(one[key], 3) for key in one)]
        for name, one in numbers.items()
    ]
    return Table(["number", "median", "95 % of runs below", "largest"], rows, numeric=(1, 2, 3))


def _run_table(table: Sequence[Record]) -> Table:
    columns = list(dict.fromkeys(name for row in table for name in row))

    def cell(value: object) -> str:
        if isinstance(value, float):
            return significant(value, 3) if math.isfinite(value) else ""
        return Verbatim("" if value is None else value)

    rows = [[cell(row.get(name)) for name in columns] for row in table]
    return Table([name.replace("_", " ") for name in columns], rows)


def _tracks(run: BatteryRun) -> go.Figure:
    """Tracks from above, north up; those that were not finished stand out."""
    drawn = plots.figure(**plots.TRACK_LAYOUT)
    for one in run.runs[:DRAWN_RUNS]:
        north, east = (plots.thin_rows(one.true, channel, DRAWN_ROWS) for channel in ("x", "y"))
        done = one.outcome.name == "COMPLETED"
        line = {"color": plots.DIAGNOSED if done else _UNFINISHED, "width": 0.8}
        name = f"seed {one.mission.seed}"
        drawn.add_scatter(
            x=plots.numbers(east), y=plots.numbers(north), mode="lines", line=line, name=name
        )
    points = run.mission.waypoints
    if points:
        look = {"color": plots.INK, "width": 1.5, "dash": "dash"}
        x, y = [one.y for one in points], [one.x for one in points]
        drawn.add_scatter(x=x, y=y, mode="lines+markers", line=look, name="path")
    return drawn
