"""Figures of reports: small panels, drawn to be read at the width of a phone.

Each figure becomes an `img` with its drawing inside the page and a text alternative.
"""

import base64
import html
import io
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diffsea.report.page import Html, markup
from diffsea.trajectory import Trajectory


WIDTH = 4.6  # inches
INK = "#1d2733"
MEASURED = INK
BEFORE = "#c2571a"
AFTER = "#1f5fa8"
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.titlesize": 10, "axes.labelsize": 10,
    "axes.edgecolor": "#8a96a3", "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": "#e7ebef", "grid.linewidth": 0.7, "axes.axisbelow": True,
    "lines.linewidth": 1.4, "legend.frameon": False, "legend.fontsize": 9.5,
    "svg.fonttype": "path", "svg.hashsalt": "diffsea", "path.simplify_threshold": 0.5,
}  # fmt: skip


class Line(NamedTuple):
    """One curve of a panel."""

    label: str
    colour: str
    run: Trajectory
    style: str = "-"
    width: float = 1.4


def measured(run: Trajectory) -> Line:
    """The measured run: a broad pale line that predictions are drawn over."""
    return Line("measured", "#aab4bf", run, "-", 3.2)


def picture(
    draw: Callable[[Figure], None], alternative: str, caption: str = "", height: float = 3.0
) -> Html:
    """A drawing as a figure of the page.

    Arguments:
        draw: fills an empty figure.
        alternative: what the figure shows, for those who do not see it.
        height: inches, for a width of 4.6.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        draw(figure)
        drawing = io.BytesIO()
        figure.savefig(drawing, format="svg", metadata={"Date": None, "Creator": None})
    data = base64.b64encode(drawing.getvalue()).decode()
    text = html.escape(alternative, quote=True)
    below = f"<figcaption>{markup(caption)}</figcaption>" if caption else ""
    return Html(
        f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{text}" '
        f'width="{WIDTH * 100:.0f}" height="{height * 100:.0f}">{below}</figure>'
    )


def track(lines: Sequence[Line], alternative: str, title: str, caption: str = "") -> Html:
    """Tracks seen from above, north up."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        series = {c: [_rows(line.run, c) for line in lines] for c in ("x", "y")}
        room = max(float(np.nanmax(s[0]) - np.nanmin(s[0])) for s in series.values())
        reach = {c: span(s, room) for c, s in series.items()}
        for line in lines:
            x, y = (_inside(_rows(line.run, c), reach[c]) for c in ("x", "y"))
            axes.plot(y, x, line.style, color=line.colour, label=line.label, lw=line.width)
        start = lines[0].run
        axes.plot(_rows(start, "y")[0], _rows(start, "x")[0], "o", color=INK, ms=5, label="start")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="east (m)", ylabel="north (m)", title=title)
        _legend(figure, axes)

    return picture(draw, alternative, caption, 3.6)


def history(
    lines: Sequence[Line],
    channels: Sequence[str],
    scale: float,
    label: str,
    alternative: str,
    title: str,
) -> Html:
    """Channels against time, one above the other."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, channel in zip(panels, channels, strict=True):
            values = [_rows(line.run, channel) * scale for line in lines]
            for line, series in zip(lines, values, strict=True):
                axes.plot(
                    _rows(line.run, "t"), series, line.style, color=line.colour,
                    label=line.label, lw=line.width,
                )  # fmt: skip
            _limit(axes, values)
            name = f"{channel}, " if len(channels) > 1 else ""
            axes.set_ylabel(f"{name}{label}")
        panels[0].set_title(title)
        panels[-1].set_xlabel("time (s)")
        _legend(figure, panels[0])

    return picture(draw, alternative, height=3.6)


def panels(lines: Sequence[Line], recording: Trajectory) -> list[Html]:
    """Track, heading, yaw rate and speeds of a run and its predictions."""
    name, who = recording.name, " and ".join(line.label for line in lines[1:])
    turn = float(np.degrees(1.0))
    out = []
    if recording.has("x") and recording.has("y"):
        text = f"Track of {name}, measured and predicted ({who})."
        out.append(track(lines, text, "track"))
    for channels, scale, label, title in (
        (("psi",), turn, "deg", "heading"),
        (("r",), turn, "deg/s", "yaw rate"),
        (("u", "v"), 1.0, "m/s", "speed ahead (u) and to starboard (v)"),
    ):
        if all(recording.has(channel) for channel in channels):
            text = f"{title} of {name} against time, measured and predicted ({who})."
            out.append(history(lines, channels, scale, label, text, title))
    return out


def _rows(run: Trajectory, channel: str) -> np.ndarray:
    return getattr(run.counted(), channel)


def span(series: Sequence[np.ndarray], room: float | None = None) -> tuple[float, float]:
    """Range of the first series, and of the others where they stay within `room` of it."""
    finite = [s[np.isfinite(s)] for s in series]
    finite = [s for s in finite if s.size] or [np.zeros(1)]
    low, high = float(finite[0].min()), float(finite[0].max())
    room = max(high - low if room is None else room, 1e-6)
    first, last = low - room, high + room
    for values in finite[1:]:
        low = min(low, max(float(values.min()), first))
        high = max(high, min(float(values.max()), last))
    return low, high


def _inside(values: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    return np.where((values >= span[0]) & (values <= span[1]), values, np.nan)


def _limit(axes: Axes, series: Sequence[np.ndarray]) -> None:
    low, high = span(series)
    margin = 0.06 * max(high - low, 1e-6)
    axes.set_ylim(low - margin, high + margin)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
