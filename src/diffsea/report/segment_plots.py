"""A long recording and the segments found in it."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diffsea.report.trial_plots import BLUE, GREY, ORANGE
from diffsea.segments.segments import SEGMENT_KINDS, Segment
from diffsea.segments.signals import Signals


_COLOURS = dict(
    zip(
        SEGMENT_KINDS,
        ("#1f5fa8", "#d1720f", "#9fc7a8", "#8c4a9e", "#c9c9c9", "#b03a48"),
        strict=True,
    )
)
_NARROW = 0.02  # of the recording: a narrower segment has its number only in the table


def save_segments(signals: Signals, found: Sequence[Segment], path: Path, title: str = "") -> None:
    """Heading, yaw rate, steering and speed over time, with coloured spans labelled by kind."""
    t = signals.t
    figure = Figure(figsize=(13.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    heading, yaw, steer, speed = (figure.add_subplot(4, 1, k + 1) for k in range(4))
    heading.plot(t, np.degrees(signals.psi), color=BLUE, lw=1.2)
    heading.set_ylabel("heading, deg")
    yaw.plot(t, np.degrees(signals.r), color=BLUE, lw=0.8)
    yaw.set_ylabel("yaw rate, deg/s")
    _steering(steer, signals)
    if signals.speed is not None:
        speed.plot(t, signals.speed, color=BLUE, lw=1.0)
    speed.set_ylabel("speed, m/s")
    speed.set_xlabel("time, s")
    for ax in (heading, yaw, steer, speed):
        ax.set_xlim(t[0], t[-1])
        ax.grid(alpha=0.25)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        for segment in found:
            colour = _COLOURS[segment.kind]
            ax.axvspan(segment.start, segment.onset, color=colour, alpha=0.12, lw=0)
            ax.axvspan(segment.onset, segment.end, color=colour, alpha=0.35, lw=0)
    _names(heading, signals, found)
    figure.suptitle(title)
    figure.savefig(path, dpi=110, format="png")


def _steering(ax: Axes, signals: Signals) -> None:
    """Commanded and executed angle; turning on the spot, which has none, is cut off."""
    largest = 1.0
    for angle, name, colour in (
        (signals.commanded, "commanded", ORANGE),
        (
            None if signals.origin == "commanded" else signals.steer,
            f"executed, {signals.origin}",
            BLUE,
        ),
    ):
        if angle is not None:
            ax.plot(signals.t, np.degrees(angle), color=colour, lw=1.0, label=name)
            largest = max(largest, float(np.degrees(np.quantile(np.abs(angle), 0.995))))
    if signals.steer is None:
        ax.text(0.5, 0.5, "no steering was recorded", transform=ax.transAxes, color=GREY)
    else:
        ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.98), ncol=2, fontsize=8)
    limit = min(1.15 * largest, 90.0)
    ax.set_ylim(-limit, limit)
    ax.set_ylabel("rudder angle, deg\n(or equivalent)")


def _names(ax: Axes, signals: Signals, found: Sequence[Segment]) -> None:
    """Numbers and kinds above the spans, and onsets as lines."""
    duration = signals.t[-1] - signals.t[0]
    for number, segment in enumerate(found, 1):
        middle = 0.5 * (segment.onset + segment.end)
        wide = segment.end - segment.start > _NARROW * duration
        text = f"{number} {segment.kind}" if wide else str(number)
        if segment.kind in ("turning", "zigzag") and math.isfinite(segment.order):
            ax.axvline(segment.onset, color="black", lw=0.7)
        ax.text(
            middle, 1.02, text, transform=ax.get_xaxis_transform(), rotation=60, fontsize=8,
            ha="left", va="bottom", color="#333333",
        )  # fmt: skip
