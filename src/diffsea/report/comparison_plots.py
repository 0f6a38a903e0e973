"""Plots of runs beside what models predict of them: tracks and histories with one cursor."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from diffsea.report.comparison import Comparison
from diffsea.report.figures import span
from diffsea.report.interactive import (
    DIAGNOSED,
    MEASURED,
    NOMINAL,
    figure,
    follows_time,
    follows_track,
    numbers,
)
from diffsea.report.location_plots import rows, track_layout
from diffsea.trajectory import Trajectory


_LOOKS = ({"color": NOMINAL, "width": 1.6, "dash": "dash"}, {"color": DIAGNOSED, "width": 1.8})
_MEASURED = {"color": MEASURED, "width": 4}
_DEGREE = float(np.degrees(1.0))
_PANELS = (
    ("psi", "heading (deg)", _DEGREE), ("r", "yaw rate (deg/s)", _DEGREE),
    ("u", "speed ahead u (m/s)", 1.0), ("v", "speed to starboard v (m/s)", 1.0),
)  # fmt: skip
Curve = tuple[str, Trajectory, dict]  # name, run, look


def curves(run: Comparison, models: Mapping[str, str]) -> list[Curve]:
    """The measured run and the predictions of it; the last model is the result."""
    looks = _LOOKS[-len(models) :]
    predicted = [
        (label, run.predictions[model].run, look)
        for (model, label), look in zip(models.items(), looks, strict=True)
    ]
    return [("measured", run.recording, _MEASURED), *predicted]


def tracks(shown: Sequence[Curve], group: str, most: int) -> go.Figure:
    """Tracks from above, each of at most so many points."""
    drawn = figure(**track_layout() | {"showlegend": True})
    north, east = ([rows(run, c, most) for _, run, _ in shown] for c in ("x", "y"))
    room = max(float(np.nanmax(series[0]) - np.nanmin(series[0])) for series in (north, east))
    for k, (name, run, look) in enumerate(shown):
        drawn.add_scatter(
            x=numbers(east[k]), y=numbers(north[k]), customdata=numbers(rows(run, "t", most), 5),
            mode="lines", name=name, line=look,
            hovertemplate="%{customdata} s: %{x} m east, %{y} m north",
        )  # fmt: skip
    drawn.update_xaxes(range=_margined(span(east, room)))
    drawn.update_yaxes(range=_margined(span(north, room)))
    return follows_track(drawn, group, range(len(shown)), [look["color"] for _, _, look in shown])


def has_history(run: Trajectory) -> bool:
    """Whether anything of `histories` was measured."""
    return any(run.has(channel) for channel, _, _ in _PANELS)


def histories(shown: Sequence[Curve], group: str, most: int) -> go.Figure:
    """What was measured of heading, yaw rate and speeds against time, one above the other."""
    measured = shown[0][1]
    panels = [panel for panel in _PANELS if measured.has(panel[0])]
    drawn = figure(hovermode="x", margin={"t": 24, "b": 36, "l": 48, "r": 8}, showlegend=False)
    for k, (channel, title, scale) in enumerate(panels):
        values = [rows(run, channel, most) * scale for _, run, _ in shown]
        if channel == "psi":
            values = unwrapped(values)
        for (name, run, look), series in zip(shown, values, strict=True):
            drawn.add_scatter(
                x=numbers(rows(run, "t", most), 5), y=numbers(series), mode="lines", name=name,
                line=look, xaxis="x", yaxis=f"y{k + 1}" if k else "y",
            )  # fmt: skip
        top = 1 - k / len(panels)
        axis = {"domain": [max(top - 1 / len(panels), 0.0), top - 0.06], "nticks": 5}
        axis["range"] = _margined(span(values))
        drawn.update_layout({f"yaxis{k + 1}": axis})
        drawn.add_annotation(
            text=title, x=0, y=top - 0.06, xref="paper", yref="paper", xanchor="left",
            yanchor="bottom", showarrow=False,
        )  # fmt: skip
    drawn.update_layout(xaxis={"title": {"text": "time (s)"}, "anchor": f"y{len(panels)}"})
    return follows_time(drawn, group)


def unwrapped(headings: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Headings in degrees without steps, all on the turn of the first one."""
    out = []
    for heading in headings:
        known = np.isfinite(heading)
        whole = heading.copy()
        whole[known] = np.unwrap(heading[known], period=360.0)
        if out and known.any():
            both = known & np.isfinite(out[0])
            first = int(np.argmax(both))
            whole -= 360.0 * np.round((whole[first] - out[0][first]) / 360.0) if both.any() else 0.0
        out.append(whole)
    return out


def _margined(bounds: tuple[float, float]) -> list[float]:
    low, high = bounds
    margin = 0.06 * max(high - low, 1e-6)
    return [low - margin, high + margin]
