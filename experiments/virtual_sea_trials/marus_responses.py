"""Figures of the trials as they were driven: motion over time, tracks, zig-zags, yaw rates."""

import itertools
import math

from experiments.harness.reporting import panels
from experiments.virtual_sea_trials import marus_published as published
from experiments.virtual_sea_trials.marus_plots import BLUE, GREEN, GREY, ORANGE
from experiments.virtual_sea_trials.marus_trials import Logged, reconstructed, rudder_equivalent

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


BEFORE = 5.0  # s of the approach that is shown
CIRCLE, ZIGZAG = 60.0, 25.0  # s after the onset
ONSET = 4.0  # s after the onset, in which yaw rates are told apart by eye


def kinematics(circle: Logged, zigzag: Logged) -> Figure:
    """Speeds ahead and to starboard and yaw rate over time, of a circle and a zig-zag."""
    figure, axes = panels(3, 2, 10.0, 6.0)
    for column, one, after in ((0, circle, CIRCLE), (1, zigzag, ZIGZAG)):
        t, rows = _time(one, after)
        for axis, name, scale, unit in zip(
            axes[:, column], "uvr", (1.0, 1.0, np.degrees(1.0)), ("m/s", "m/s", "deg/s"),
            strict=True,
        ):  # fmt: skip
            axis.plot(t, scale * np.asarray(getattr(one.log, name))[rows], color=BLUE, linewidth=1)
            axis.axvline(0, color=GREY, linewidth=0.8, linestyle="--")
            axis.set_ylabel(f"{name}, {unit}")
            axis.grid(linewidth=0.3)
        axes[0, column].set_title(one.run.title, fontsize=9, loc="left")
        axes[2, column].set_xlabel("s after the onset")
    return figure


def tracks(circles: list[Logged]) -> Figure:
    """Tracks of circles from the onset over ship lengths, the original course upwards."""
    figure, axes = panels(1, 1, 7.5, 4.2)
    axis = axes[0, 0]
    for one, colour in zip(circles, (ORANGE, BLUE), strict=True):
        t, rows = _time(one, np.inf)
        x, y, psi = (np.asarray(getattr(one.log, name))[rows] for name in ("x", "y", "psi"))
        x0, y0, course = (np.interp(0.0, t, values) for values in (x, y, psi))
        north, east = (x - x0) / published.LENGTH, (y - y0) / published.LENGTH
        along = north * np.cos(course) + east * np.sin(course)
        across = east * np.cos(course) - north * np.sin(course)
        axis.plot(across, along, color=colour, label=one.run.title, linewidth=1.2)
    axis.plot(0, 0, "o", color="black", markersize=4)
    axis.set_aspect("equal")
    axis.set_xlabel("to starboard, ship lengths")
    axis.set_ylabel("along the approach, ship lengths")
    axis.grid(linewidth=0.3)
    axis.legend(fontsize=8, loc="lower right")
    return figure


def zigzags(runs: list[Logged]) -> Figure:
    """Executed steering, heading with its overshoots, and yaw rate of zig-zags."""
    figure, axes = panels(3, len(runs), 13.0, 6.4)
    for column, one in enumerate(runs):
        t, rows = _time(one, ZIGZAG)
        steering, heading, rate = axes[:, column]
        angle = np.degrees(rudder_equivalent(one.log.executed))[rows]
        steering.step(t, angle, color=ORANGE, where="post", linewidth=1)
        psi = np.degrees(np.asarray(one.log.psi))[rows]
        psi = psi - np.interp(0.0, t, psi)
        heading.plot(t, psi, color=BLUE, linewidth=1)
        for level in (-one.run.heading, one.run.heading):
            heading.axhline(level, color=GREY, linewidth=0.6, linestyle="--")
        _mark_overshoots(heading, one, t, psi)
        rate.plot(t, np.degrees(np.asarray(one.log.r))[rows], color=GREEN, linewidth=0.8)
        steering.set_title(one.run.title, fontsize=8, loc="left")
        rate.set_xlabel("s after the onset")
        for axis in axes[:, column]:
            axis.grid(linewidth=0.3)
    for axis, label in zip(
        axes[:, 0], ("rudder-equivalent, deg", "heading, deg", "yaw rate, deg/s"), strict=True
    ):
        axis.set_ylabel(label)
    return figure


def _mark_overshoots(axis: Axes, one: Logged, t: np.ndarray, psi: np.ndarray) -> None:
    """The first two overshoots at the turning points of the heading."""
    switches = np.append(np.asarray(one.metrics["switch_times"])[1:] - one.segment.onset, t[-1])
    for number, (begin, end) in enumerate(itertools.pairwise(switches), 1):
        within = np.flatnonzero((t >= begin) & (t <= end))
        row = within[np.argmax(np.abs(psi[within]))]
        size = math.degrees(one.metrics[f"overshoot_{number}"])
        axis.plot(t[row], psi[row], "o", color=ORANGE, markersize=4)
        axis.annotate(f"+{size:.2f}", (t[row], psi[row]), xytext=(6, 0), fontsize=7,
                      textcoords="offset points", va="center")  # fmt: skip


def yaw_rates(one: Logged) -> Figure:
    """The logged yaw rate beside that of the logged heading."""
    figure, axes = panels(2, 1, 8.0, 4.6)
    for axis, after in zip(axes[:, 0], (CIRCLE, ONSET), strict=True):
        t, rows = _time(one, after)
        rebuilt = np.degrees(reconstructed(one.log))[rows]
        axis.plot(t, rebuilt, color=ORANGE, linewidth=0.8, label="from the heading")
        logged = np.degrees(np.asarray(one.log.r))[rows]
        axis.plot(t, logged, color=BLUE, linewidth=0.8, label="logged")
        axis.set_ylabel("yaw rate, deg/s")
        axis.grid(linewidth=0.3)
    axes[0, 0].set_title(one.run.title, fontsize=9, loc="left")
    axes[0, 0].legend(fontsize=8)
    axes[1, 0].set_xlabel("s after the onset")
    return figure


def _time(one: Logged, after: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) from the onset, and which rows of the log they are."""
    t = np.asarray(one.log.t) - one.segment.onset
    rows = (t >= -BEFORE) & (t <= after)
    return t[rows], rows
