"""Marks in the pictures of a trial: where its numbers are read, and the limits of some."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from diffsea.report import plots
from diffsea.report.quantities import significant
from diffsea.trajectory import Samples


_OVERSHOOT = "overshoot_"
_CROSSINGS = (  # changes of heading at which numbers of a turn are read
    (math.pi / 2, (("advance", "advance"), ("transfer", "transfer"))),
    (math.pi, (("tactical_diameter", "tactical diameter"),)),
)

Log = Mapping[str, Samples]
Metrics = Mapping[str, Any]


def mark_overshoots(drawn: go.Figure, log: Log, metrics: Metrics, colour: str) -> None:
    """In a panel of heading changes (deg) against time: the headings of switching, each overshoot
    at its peak, and IMO's limit of it."""
    heading = metrics.get("switching_heading")
    if heading is None:
        return
    for side in (1.0, -1.0):
        line = {"color": plots.MEASURED, "width": 1, "dash": "dot"}
        drawn.add_hline(y=side * math.degrees(heading), line=line, yref="y", name="switching")
    t, change = np.asarray(log["t"]), np.asarray(log["psi_relative"])
    limits = metrics.get("imo", {})
    for number, row in enumerate(_peaks(t, change, heading), start=1):
        name = f"{_OVERSHOOT}{number}"
        if name not in metrics:
            break
        told = f"overshoot {significant(math.degrees(metrics[name]), 2)}°"
        if name in limits:
            told += f" (at most {significant(math.degrees(limits[name]['limit']), 3)}°)"
        above = 1.0 if change[row] > 0 else -1.0
        drawn.add_annotation(
            x=float(t[row]), y=math.degrees(change[row]), xref="x", yref="y", text=told,
            name=name, ax=0, ay=-14 * above, arrowhead=2, arrowwidth=1, arrowcolor=colour,
            font={"size": 10},
        )  # fmt: skip


def _peaks(
    t: Float[np.ndarray, "row"], change: Float[np.ndarray, "row"], heading: float
) -> list[int]:
    """Rows of the largest change of heading in each stretch beyond the heading of switching."""
    beyond = np.where((np.abs(change) > 0.98 * heading) & (t > 0), np.sign(change), 0.0)
    rows: list[int] = []
    for row in np.flatnonzero(beyond):
        new = not rows or beyond[rows[-1]] != beyond[row]
        if new:
            rows.append(int(row))
        elif abs(change[row]) > abs(change[rows[-1]]):
            rows[-1] = int(row)
    return rows


def mark_crossings(
    drawn: go.Figure, log: Log, metrics: Metrics, track: tuple[Samples, Samples], colour: str
) -> None:
    """In a track: where a turn's heading has changed by 90 and 180 deg, and what is read there.

    Arguments:
        track: to starboard and ahead of the onset (m), in the rows of the log.
    """
    if "tactical_diameter" not in metrics and "advance" not in metrics:
        return
    change = np.abs(np.asarray(log["psi_relative"]))
    for angle, numbers in _CROSSINGS:
        after = (np.asarray(log["t"]) > 0) & (change >= angle)
        known = [(label, metrics[name]) for name, label in numbers if name in metrics]
        if not after.any() or not known:
            continue
        row = int(np.argmax(after))
        told = ", ".join(f"{label} {significant(size, 3)} m" for label, size in known)
        x, y = (float(np.asarray(one)[row]) for one in track)
        drawn.add_annotation(
            x=x, y=y, xref="x", yref="y", text=told, name="crossing", ax=0, ay=-22, arrowhead=2,
            arrowwidth=1, arrowcolor=colour, font={"size": 10},
        )  # fmt: skip
