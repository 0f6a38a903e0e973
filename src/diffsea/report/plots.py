"""How Plotly draws in the pages: colours, axes, few digits, and the cursor that plots share.

`templates/plots.js` draws each figure from its JSON and moves one time cursor through all plots
of a run.
"""

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.trajectory import Trajectory


# Okabe and Ito's colours, told apart with any kind of colour vision.
INK = "#1d2733"
MEASURED = "#8a96a3"
NOMINAL = "#d55e00"
DIAGNOSED = "#0072b2"
CURSOR = "#009e73"
GREY = "#dfe3e8"
PALE = ("#e6f0f8", "#fdf0e0")  # what is not significant, to either side
_NEGATIVE = ("#08306b", "#2171b5", "#9ecae1")  # strong to weak
_POSITIVE = ("#fdb863", "#d55e00", "#7f2704")  # weak to strong
SIGNIFICANT_DIGITS = 4  # of a series' range: finer than a pixel of any screen
TIME_DIGITS = 5  # of times, which name rows
_AXIS = {
    "gridcolor": "#e7ebef",
    "zeroline": False,
    "linecolor": "#8a96a3",
    "showline": True,
    "automargin": True,
    "ticks": "outside",
    "ticklen": 3,
    "title": {"standoff": 6},
}
_TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": INK},
        "margin": {"l": 48, "r": 12, "t": 30, "b": 40},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "hoverlabel": {"namelength": -1},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    }
)
TRACK_LAYOUT = {  # of a map, north up, both axes to the same scale
    "showlegend": False,
    "hovermode": "closest",
    "margin": {"t": 24, "b": 40, "l": 48, "r": 8},
    "xaxis": {"title": {"text": "east (m)"}},
    "yaxis": {"title": {"text": "north (m)"}, "scaleanchor": "x", "scaleratio": 1},
}


def figure(*traces: go.Scatter | go.Bar | go.Heatmap, **layout: object) -> go.Figure:
    """A figure in the style of the pages.

    Arguments:
        layout: properties of Plotly's layout, over those of the style.
    """
    return go.Figure(data=traces, layout={"template": _TEMPLATE, **layout})


def heading(text: str, y: float) -> dict[str, object]:
    """An annotation above the panel that ends at the height `y`, 0 to 1, of its figure."""
    place = {"x": 0, "y": y, "xref": "paper", "yref": "paper"}
    return place | {"text": text, "xanchor": "left", "yanchor": "bottom", "showarrow": False}


def panel_of(number: int, count: int, gap: float) -> list[float]:
    """From where to where, 0 to 1, a panel stands below those before it, its heading above it."""
    top = 1 - number / count
    return [max(top - 1 / count, 0.0), top - gap]


def add_time_cursor(drawn: go.Figure, group: str) -> go.Figure:
    """Give a figure with time along its x axis the cursor of a group of plots."""
    line = {"color": CURSOR, "width": 1.5}
    ends = {"x0": 0, "x1": 0, "y0": 0, "y1": 1, "yref": "paper"}
    drawn.add_shape(type="line", **ends, line=line, visible=False, name="cursor")
    return drawn.update_layout(meta={"group": group, "cursor": "time"})


def add_track_markers(
    drawn: go.Figure, group: str, curves: Sequence[int], fill: Sequence[str]
) -> go.Figure:
    """Give a figure of tracks a marker on each curve for the cursor of a group of plots.

    The traces `curves` have their times as `customdata`.
    """
    circle = {"type": "circle", "x0": -5, "x1": 5, "y0": -5, "y1": 5, "name": "cursor"}
    circle |= {"xsizemode": "pixel", "ysizemode": "pixel", "visible": False}
    for k, colour in zip(curves, fill, strict=True):
        first = {"xanchor": drawn.data[k]["x"][0], "yanchor": drawn.data[k]["y"][0]}
        drawn.add_shape(**circle, **first, fillcolor=colour, line={"color": "#fff", "width": 1.5})
    return drawn.update_layout(meta={"group": group, "cursor": "track", "curves": list(curves)})


def evenly(count: int, most: int) -> slice:
    """At most `most` of so many rows, evenly: more points cannot be told apart on a page."""
    return slice(None, None, max(1, math.ceil(count / most)))


def thin_rows(run: Trajectory, channel: str, most: int) -> Float[np.ndarray, "row"]:
    """A channel's valid rows, thinned evenly to at most `most`."""
    values = getattr(run.counted(), channel)
    return values[evenly(len(values), most)]


def numbers(
    values: Sequence[float] | np.ndarray, digits: int = SIGNIFICANT_DIGITS
) -> list[float | None]:
    """A series with so many digits of its range, so that a page needs few characters for it.

    What is not finite becomes None, which JSON can hold.
    """
    values = np.asarray(values, float)
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    reach = span or (float(np.abs(finite).max()) if finite.size else 0.0) or 1.0
    decimals = digits - 1 - math.floor(math.log10(reach))
    return [round(float(v), decimals) if math.isfinite(v) else None for v in values]


def stepped_scale(threshold: float) -> list[tuple[float, str]]:
    """A colour scale of values from -1 to 1, pale within `threshold` of zero."""
    low, high = 0.5 - 0.5 * threshold, 0.5 + 0.5 * threshold
    strong, middle, weak = _NEGATIVE
    scale = [(0.0, strong), (0.5 * low, middle), (low, weak), (low, PALE[0])]
    weak, middle, strong = _POSITIVE
    scale += [(0.5, "#ffffff"), (high, PALE[1])]
    return [*scale, (high, weak), (0.5 * (1 + high), middle), (1.0, strong)]


def smooth_scale() -> list[tuple[float, str]]:
    """A colour scale of values from -1 to 1 through grey."""
    colours = (*_NEGATIVE[:2], GREY, *_POSITIVE[1:])
    return [(0.25 * k, colour) for k, colour in enumerate(colours)]
