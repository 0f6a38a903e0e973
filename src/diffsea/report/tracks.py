"""Tracks of runs from above, north up, with what flows there."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from diffsea.report import plots
from diffsea.report.histories import Curve, axis_range, measured_rows


_ARROW = 34  # pixels, of an arrow of a flow
_BELOW = 0.16  # of the picture's height, from one flow to the next


class DrawnFlow(NamedTuple):
    """A current or a wind: what it is called with its speed, and the way it goes (rad)."""

    text: str
    towards: float


def compared_tracks(
    curves: Sequence[Curve], group: str, most: int, flows: Sequence[DrawnFlow] = ()
) -> go.Figure:
    """Tracks from above, north up; the axes leave out what strays far from the measured one.

    Arguments:
        curves: what was measured, then each prediction, the result last.
        group: of plots that share a cursor.
        most: points of a track.
        flows: drawn as arrows.
    """
    drawn = plots.figure(**plots.TRACK_LAYOUT | {"showlegend": True})
    rows = [measured_rows(run, ("x", "y"), most) for _, run, _ in curves]
    north, east = ([one[channel] for one in rows] for channel in ("x", "y"))
    room = max(float(np.ptp(series[0])) if series[0].size else 0.0 for series in (north, east))
    for k, (name, _, line) in enumerate(curves):
        times = plots.numbers(rows[k]["t"], plots.TIME_DIGITS)
        x, y = plots.numbers(east[k]), plots.numbers(north[k])
        drawn.add_scatter(x=x, y=y, customdata=times, mode="lines", name=name, line=line)
    drawn.update_traces(hovertemplate="%{customdata} s: %{x} m east, %{y} m north")
    drawn.update_xaxes(range=axis_range(east, room))
    drawn.update_yaxes(range=axis_range(north, room))
    add_north(drawn)
    for number, flow in enumerate(flows):
        _add_flow(drawn, flow, 0.86 - _BELOW * number)
    colours = [str(line["color"]) for _, _, line in curves]
    return plots.add_track_markers(drawn, group, range(len(curves)), colours)


def add_north(drawn: go.Figure) -> go.Figure:
    """Mark a map's way north, at its upper right."""
    place = {"xref": "paper", "yref": "paper", "x": 0.985, "y": 0.99, "ax": 0, "ay": _ARROW}
    return drawn.add_annotation(
        **place, text="N", name="north", xanchor="center", arrowhead=2, arrowwidth=1.6,
        arrowcolor=plots.MEASURED,
    )  # fmt: skip


def _add_flow(drawn: go.Figure, flow: DrawnFlow, height: float) -> None:
    """An arrow that goes as the flow does, at the picture's left, and what it is."""
    tail = {"ax": -_ARROW * math.sin(flow.towards), "ay": _ARROW * math.cos(flow.towards)}
    place = {"xref": "paper", "yref": "paper", "y": height}
    drawn.add_annotation(
        **place, **tail, x=0.07, text="", name="flow", arrowhead=2, arrowwidth=2,
        arrowcolor=plots.CURSOR,
    )  # fmt: skip
    drawn.add_annotation(
        **place, x=0.13, text=flow.text, name="flow", showarrow=False, xanchor="left"
    )
