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
from matplotlib.patches import Patch

from diffsea.diagnosis.locate import DEGREES, Cell
from diffsea.report.page import Html, markup
from diffsea.types import Trajectory


WIDTH = 4.6  # inches
INK = "#1d2733"
MEASURED = INK
BEFORE = "#c2571a"
AFTER = "#1f5fa8"
_LEVELS = (1e-8, 1e-4, 1e-2)  # family-wise
_SHADES = ("#7a1204", "#d9622b", "#f7c59f", "#ffffff")
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
        reach = {c: _span(s, room) for c, s in series.items()}
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
    return np.asarray(getattr(run, channel), float)[np.asarray(run.valid, bool)]


def _span(series: Sequence[np.ndarray], room: float | None = None) -> tuple[float, float]:
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
    low, high = _span(series)
    margin = 0.06 * max(high - low, 1e-6)
    axes.set_ylim(low - margin, high + margin)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def time_map(cells: Sequence[Cell], names: Sequence[str], title: str, alternative: str) -> Html:
    """Significance of unnamed forces in windows of time, one row for each run."""
    windows = [cell for cell in cells if cell.run is not None]
    height = 1.35 + 0.24 * len(names)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(DEGREES), sharey=True)
        for degree, axes in enumerate(panels):
            for cell in windows:
                if cell.degree == degree:
                    axes.barh(
                        cell.run, cell.end - cell.start, left=cell.start, height=0.9,
                        color=_shade(cell, len(cells)), edgecolor="#d9dfe5", lw=0.5,
                    )  # fmt: skip
            axes.set(title=DEGREES[degree], xlabel="time (s)", ylim=(len(names) - 0.4, -0.6))
            axes.grid(visible=False)
        panels[0].set_yticks(range(len(names)), [_short(name) for name in names])
        _shades(figure)

    figure = _titled(draw, title)
    return picture(figure, alternative, height=height)


def regime_map(cells: Sequence[Cell], title: str, alternative: str) -> Html:
    """Significance of unnamed forces in classes of what the vessel was doing."""
    found = [cell for cell in cells if cell.run is None]
    labels = list(dict.fromkeys(cell.regime for cell in found))
    height = 1.2 + 0.21 * len(labels)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for cell in found:
            axes.barh(
                labels.index(cell.regime), 1, left=cell.degree - 0.5, height=1.0,
                color=_shade(cell, len(cells)), edgecolor="#d9dfe5", lw=0.5,
            )  # fmt: skip
        axes.set_xticks(range(len(DEGREES)), DEGREES)
        axes.set_yticks(range(len(labels)), labels)
        axes.set(xlim=(-0.5, len(DEGREES) - 0.5), ylim=(len(labels) - 0.5, -0.5))
        axes.grid(visible=False)
        axes.tick_params(length=0)
        _shades(figure)

    return picture(_titled(draw, title), alternative, height=height)


def _titled(draw: Callable[[Figure], None], title: str) -> Callable[[Figure], None]:
    def both(figure: Figure) -> None:
        draw(figure)
        figure.suptitle(title, fontsize=10, fontweight="bold")

    return both


def _short(name: str) -> str:
    return name if len(name) <= 18 else f"{name[:8]}…{name[-9:]}"


def _shade(cell: Cell, tests: int) -> str:
    return _SHADES[int(np.searchsorted(_LEVELS, cell.p_value * tests, side="right"))]


def _shades(figure: Figure) -> None:
    """The key to the shades, below the maps."""
    labels = ("p < 1e-8", "p < 1e-4", "p < 0.01", "nothing")
    keys = [
        Patch(facecolor=shade, edgecolor="#aab4bf", lw=0.6, label=label)
        for shade, label in zip(_SHADES, labels, strict=True)
    ]
    figure.legend(
        handles=keys[::-1], loc="outside lower center", ncols=len(keys), handlelength=1.2,
        columnspacing=1.2,
    )  # fmt: skip


def flagged_track(run: Trajectory, windows: Sequence[tuple[float, float]], title: str) -> Html:
    """A measured track with the stretches marked where the model fails."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        t, x, y = (_rows(run, channel) for channel in ("t", "x", "y"))
        axes.plot(y, x, color="#aab4bf", lw=2.0, label="measured track")
        label = "model fails here"
        for start, end in windows:
            # One sample more, so that windows that follow one another join.
            inside = (t >= start) & (t <= t[min(np.searchsorted(t, end) + 1, len(t) - 1)])
            axes.plot(
                np.where(inside, y, np.nan), np.where(inside, x, np.nan), color=_SHADES[1], lw=4,
                label=label, solid_capstyle="butt",
            )  # fmt: skip
            label = ""
        axes.plot(y[0], x[0], "o", color=INK, ms=5, label="start")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="east (m)", ylabel="north (m)", title=title)
        _legend(figure, axes)

    text = f"Track of {run.name}; {len(windows)} stretches are marked where the model fails."
    return picture(draw, text, height=3.6)
