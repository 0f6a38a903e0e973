"""Interactive plots inside a page: Plotly figures, drawn by a script that the page carries.

The library and `plots.js` stand once at the end of the page, each figure as JSON beside the
place where it is drawn, so that the page works offline. Plots of one run share a time cursor.
"""

import html
import importlib.resources
import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from diffsea.report.page import Html, markup


# Okabe and Ito's colours, told apart with any kind of colour vision.
INK = "#1d2733"
MEASURED = "#8a96a3"
NOMINAL = "#d55e00"
DIAGNOSED = "#0072b2"
CURSOR = "#009e73"
GREY = "#dfe3e8"
_NEGATIVE = ("#08306b", "#2171b5", "#9ecae1")  # strong to weak
_POSITIVE = ("#fdb863", "#d55e00", "#7f2704")  # weak to strong
PALE = ("#e6f0f8", "#fdf0e0")  # what is not significant, to either side
_DIGITS = 4
_AXIS = {
    "gridcolor": "#e7ebef", "zeroline": False, "linecolor": "#8a96a3", "showline": True,
    "automargin": True, "ticks": "outside", "ticklen": 3, "title": {"standoff": 6},
}  # fmt: skip
_TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": INK},
        "margin": {"l": 48, "r": 12, "t": 30, "b": 40},
        "paper_bgcolor": "#fff", "plot_bgcolor": "#fff",
        "xaxis": _AXIS, "yaxis": _AXIS,
        "hoverlabel": {"namelength": -1},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    }
)  # fmt: skip
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
# Nothing can be fetched from elsewhere, whatever the library would like to.
HEAD = Html(f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">')


def figure(*traces: go.Scatter, **layout: object) -> go.Figure:
    """A figure in the style of the page."""
    return go.Figure(data=traces, layout={"template": _TEMPLATE, **layout})


def plot(
    drawn: go.Figure, alternative: str, height: int, caption: str = "", classes: str = ""
) -> Html:
    """A figure as a part of the page.

    Arguments:
        alternative: what it shows, for those who do not see it.
        height: pixels; the width is that of the place.
    """
    drawn.update_layout(height=height)
    data = drawn.to_json()  # with every `<` escaped, so that it cannot end the script around it
    text = html.escape(alternative, quote=True)
    below = f"<figcaption>{markup(caption)}</figcaption>" if caption else ""
    return Html(
        f'<figure class="interactive {classes}"><div class="plot" role="img" '
        f'aria-label="{text}" style="height:{height}px"></div>'
        f'<script type="application/json">{data}</script>{below}</figure>'
    )


def scripts() -> Html:
    """The library and what draws and connects the plots, for the end of the page."""
    own = importlib.resources.files("diffsea.report").joinpath("plots.js").read_text("utf-8")
    return Html(
        "<noscript><p>The plots of this page need JavaScript.</p></noscript>\n"
        f"<script>{get_plotlyjs()}</script>\n<script>\n{own}</script>"
    )


def follows_time(drawn: go.Figure, group: str) -> go.Figure:
    """Give a figure with time along its x axis the cursor of a group of plots."""
    line = {"color": CURSOR, "width": 1.5}
    drawn.add_shape(
        type="line", x0=0, x1=0, y0=0, y1=1, yref="paper", line=line, visible=False, name="cursor"
    )
    return drawn.update_layout(meta={"group": group, "cursor": "time"})


def follows_track(drawn: go.Figure, group: str, curves: Sequence[int], fill: Sequence[str]):
    """Give a figure of tracks a marker on each curve for the cursor of a group of plots.

    The traces `curves` have their times as `customdata`.
    """
    for k, colour in zip(curves, fill, strict=True):
        drawn.add_shape(
            type="circle", xsizemode="pixel", ysizemode="pixel", x0=-5, x1=5, y0=-5, y1=5,
            xanchor=drawn.data[k].x[0], yanchor=drawn.data[k].y[0], fillcolor=colour,
            line={"color": "#fff", "width": 1.5}, visible=False, name="cursor",
        )  # fmt: skip
    return drawn.update_layout(meta={"group": group, "cursor": "track", "curves": list(curves)})


def numbers(values: np.ndarray, digits: int = _DIGITS) -> list[float | None]:
    """A series with so many digits of its range: what a plot shows, in the fewest characters."""
    values = np.asarray(values, float)
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    reach = span or (float(np.abs(finite).max()) if finite.size else 0.0) or 1.0
    decimals = digits - 1 - math.floor(math.log10(reach))
    return [round(float(v), decimals) if math.isfinite(v) else None for v in values]


def stepped(threshold: float) -> list[tuple[float, str]]:
    """A colour scale of values from -1 to 1, pale within `threshold` of zero."""
    low, high = 0.5 - 0.5 * threshold, 0.5 + 0.5 * threshold
    strong, middle, weak = _NEGATIVE
    scale = [(0.0, strong), (0.5 * low, middle), (low, weak), (low, PALE[0])]
    weak, middle, strong = _POSITIVE
    scale += [(0.5, "#ffffff"), (high, PALE[1])]
    return [*scale, (high, weak), (0.5 * (1 + high), middle), (1.0, strong)]


def smooth() -> list[tuple[float, str]]:
    """A colour scale of values from -1 to 1 through grey."""
    colours = (*_NEGATIVE[:2], "#dfe3e8", *_POSITIVE[1:])
    return [(0.25 * k, colour) for k, colour in enumerate(colours)]
