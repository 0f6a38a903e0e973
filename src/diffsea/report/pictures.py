"""Still pictures that commands write as PNG: trials, predictions, studies and segments.

Drawn by Matplotlib, for documents; pages have interactive plots instead.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diffsea.channels import is_rudder
from diffsea.metrics.orders import as_thrust, steering_angle
from diffsea.simulation.trials import Trial
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


if TYPE_CHECKING:  # a trial is drawn without loading what finds segments
    from diffsea.segments.segments import Segment
    from diffsea.segments.signals import Signals

BLUE, ORANGE, GREY = "#1f5fa8", "#d1720f", "#8a8a8a"
ACTUATOR_COLOURS = (BLUE, ORANGE, "#3a8f5c", "#8c4a9e", "#b03a48", "#5b6770")
SEGMENT_COLOURS = {
    "turning": "#1f5fa8",
    "zigzag": "#d1720f",
    "straight": "#9fc7a8",
    "coasting": "#8c4a9e",
    "station": "#c9c9c9",
    "unknown": "#b03a48",
}
# The numbers that a trial is run for, most informative first.
INFORMATIVE_NUMBERS = (
    "tactical_diameter advance overshoot_1 overshoot_2 initial_turning_distance "
    "steady_turning_diameter track_reach head_reach time_to_half_speed final_speed "
    "residual_yaw_rate yaw_rate_1 period"
).split()
PANELS = 4  # numbers in one picture of a study: more would be too small to read
TORNADO_BARS = 12  # parameters of a number, the strongest
WEAKEST_BAR = 1e-3  # of the strongest: a shorter bar cannot be seen
HEADING_ARROWS = 12  # along a track
NARROW_SEGMENT = 0.02  # of a recording: a narrower one has its number alone above it
LARGEST_ANGLE = 90.0  # deg, of the steering axis: turning on the spot has no rudder angle
MOTION_PANELS = (
    ("psi", 180 / math.pi, "heading, deg"),
    ("u", 1.0, "u, m/s"),
    ("v", 1.0, "v, m/s"),
    ("r", 180 / math.pi, "yaw rate, deg/s"),
)


def empty_figure(width: float, height: float) -> Figure:
    """A figure of so many inches that can be saved."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain_axes(figure: Figure, rows: int) -> list[Axes]:
    """Axes one above the other, without a frame."""
    axes = [figure.add_subplot(rows, 1, k + 1) for k in range(rows)]
    for ax in axes:
        remove_frame(ax)
    return axes


def remove_frame(ax: Axes, grid: Literal["both", "x", "y"] = "both") -> None:
    """A faint grid along some axes in place of the upper and the right edge."""
    ax.grid(axis=grid, alpha=0.25)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def save_trial_track(trial: Trial, path: Path, title: str) -> None:
    """The track seen from above, with the heading at the execute upwards.

    Marks show the execute and the switching of orders, arrows the heading, evenly in time.
    """
    run = trial.trajectory.counted()
    start = min(int(np.searchsorted(run.t, float(trial.execute_time))), len(run.t) - 1)
    north, east = run.x - run.x[start], run.y - run.y[start]
    cos, sin = math.cos(run.psi[start]), math.sin(run.psi[start])
    up, right = cos * north + sin * east, cos * east - sin * north
    figure = empty_figure(6.0, 6.0)
    (ax,) = plain_axes(figure, 1)
    ax.plot(right, up, color=BLUE, lw=1.5)
    ax.plot(0, 0, "o", color=ORANGE, ms=6, label="execute")
    times = np.asarray(trial.switch_times, float)
    for number, time in enumerate(times[:-1][np.isfinite(times[:-1])]):
        x, y = np.interp(time, run.t, right), np.interp(time, run.t, up)
        label = "switching" if number == 0 else None
        ax.plot(x, y, "s", color=GREY, ms=5, label=label)
    # Arrows show the heading, evenly in time.
    at = np.linspace(run.t[0], run.t[-1], HEADING_ARROWS + 2)[1:-1]
    rows = np.searchsorted(run.t, at)
    angle = run.psi[rows] - run.psi[start]
    look = {"angles": "uv", "pivot": "mid", "scale": 22, "width": 0.006}
    ax.quiver(right[rows], up[rows], np.sin(angle), np.cos(angle), **look, color=BLUE, alpha=0.7)
    ax.set(xlabel="to starboard of the approach, m", ylabel="along the approach, m", title=title)
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(frameon=False)
    figure.savefig(path, dpi=120, format="png")


def save_trial_series(trial: Trial, path: Path, title: str, vessel: Vessel) -> None:
    """Heading and steering, speeds, yaw rate and actuation over time since the execute.

    Executed actuation is solid, its orders dashed; angles are in degrees.

    Arguments:
        vessel: the one that ran it.
    """
    units = vessel.units
    run = trial.trajectory.counted()
    t = run.t - float(trial.execute_time)
    figure = empty_figure(8.0, 9.0)
    heading, speeds, yaw, actuation = plain_axes(figure, 4)
    heading.plot(t, np.degrees(run.psi), color=BLUE, label="heading")
    steered = steering_angle(as_thrust(run, vessel.thrusts_at_rest))
    if steered is not None:
        by_rudder = any(map(is_rudder, steered[1].channels))
        label = "rudder" if by_rudder else "rudder-equivalent order"
        heading.step(t, np.degrees(steered[0]), where="post", color=ORANGE, label=label)
    heading.set_ylabel("deg")
    heading.set_title(title, loc="left")
    speeds.plot(t, run.u, color=BLUE, label="u, forward")
    speeds.plot(t, run.v, color=ORANGE, label="v, to starboard")
    speeds.set_ylabel("m/s")
    yaw.plot(t, np.degrees(run.r), color=BLUE, label="yaw rate")
    yaw.set_ylabel("deg/s")
    for colour, channel in zip(ACTUATOR_COLOURS, run.executed, strict=False):
        unit = units.get(channel, "")
        factor, unit = (180 / math.pi, "deg") if unit == "rad" else (1.0, unit)
        name = f"{channel}, {unit}" if unit else channel
        actuation.plot(t, factor * run.executed[channel], color=colour, lw=1.3, label=name)
        ordered = run.commanded.get(channel)
        if ordered is not None:
            look = {"where": "post", "color": colour, "lw": 1.0, "ls": "--", "alpha": 0.6}
            actuation.step(t, factor * ordered, **look)
    actuation.set_ylabel("executed (order dashed)" if run.executed else "no actuation")
    actuation.set_xlabel("time since the execute, s")
    for ax in (heading, speeds, yaw, actuation):  # above the axes, where no curve runs
        ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=4, fontsize=8)
    figure.savefig(path, dpi=120, format="png")


def save_prediction(predicted: Trajectory, recording: Trajectory, path: Path, title: str) -> None:
    """A recording (grey) and what the model makes of its orders.

    The track stands left, with its start; heading, u, v and yaw rate stand right, as far as they
    were recorded.
    """
    run = recording.counted()
    figure = empty_figure(11.0, 6.5)
    grid = figure.add_gridspec(4, 2)
    track = figure.add_subplot(grid[:, 0])
    if run.has("x") and run.has("y"):
        track.plot(run.y, run.x, color=GREY, lw=2.5, label="recorded")
    track.plot(predicted.y, predicted.x, color=BLUE, lw=1.3, label="predicted")
    track.plot(predicted.y[:1], predicted.x[:1], "o", color=ORANGE, label="start")
    track.set(xlabel="east, m", ylabel="north, m", title=title)
    track.set_aspect("equal", adjustable="datalim")
    track.legend(frameon=False)
    remove_frame(track)
    for k, (channel, factor, name) in enumerate(MOTION_PANELS):
        ax = figure.add_subplot(grid[k, 1])
        if run.has(channel):
            ax.plot(run.t, factor * getattr(run, channel), color=GREY, lw=2.5)
        ax.plot(predicted.t, factor * getattr(predicted, channel), color=BLUE, lw=1.3)
        ax.set_ylabel(name)
        remove_frame(ax)
    ax.set_xlabel("time, s")
    figure.savefig(path, dpi=120, format="png")


def most_informative(names: Sequence[str], count: int = PANELS) -> list[str]:
    """The few most informative of some numbers of trials."""
    ranked = [name for name in INFORMATIVE_NUMBERS if name in names]
    return (ranked + [name for name in names if name not in ranked])[:count]


def _panel_grid(count: int, row_height: float) -> tuple[Figure, list[Axes]]:
    """Axes for so many numbers, two in a row."""
    rows = (count + 1) // 2
    figure = empty_figure(11.0, row_height * max(1, rows))
    return figure, [figure.add_subplot(rows, 2, k + 1) for k in range(count)]


def save_tornado(relative: Mapping[str, Mapping[str, float]], path: Path, title: str) -> None:
    """Bars of the strongest elasticities of the most informative numbers.

    Arguments:
        relative: by number, then by parameter: % of change per 1 % of the parameter.
    """
    shown = most_informative([name for name, row in relative.items() if row])
    figure, panels = _panel_grid(len(shown), 3.4)
    for ax, number in zip(panels, shown, strict=True):
        row = relative[number]
        weakest = WEAKEST_BAR * max(map(abs, row.values()))
        ranked = sorted((n for n in row if abs(row[n]) > weakest), key=lambda n: abs(row[n]))
        strongest = ranked[-TORNADO_BARS:]
        values = [row[name] for name in strongest]
        ax.barh(strongest, values, color=[BLUE if v > 0 else ORANGE for v in values])
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(number, fontsize=10)
        ax.set_xlabel("% change per 1 % of the parameter", fontsize=9)
        ax.tick_params(labelsize=8)
        remove_frame(ax, "x")
    figure.suptitle(title)
    figure.savefig(path, dpi=120, format="png")


def save_map(table: pd.DataFrame, axes: tuple[str, str], path: Path, title: str) -> None:
    """The most informative numbers over a grid of two parameters; failed designs stay white.

    Crosses mark designs that fail the IMO criterion for a number.
    """
    numbers = [
        name
        for name in table.select_dtypes("number")
        if name not in axes and np.ptp(table[name].dropna()) > 0
    ]
    shown = most_informative(numbers)
    figure, panels = _panel_grid(len(shown), 4.2)
    for ax, number in zip(panels, shown, strict=True):
        surface = table.pivot(index=axes[1], columns=axes[0], values=number)
        x, y, z = surface.columns.to_numpy(), surface.index.to_numpy(), surface.to_numpy()
        drawn = ax.pcolormesh(x, y, z, cmap="viridis", shading="nearest")
        if min(z.shape) > 2 and np.isfinite(z).all():
            lines = ax.contour(x, y, z, colors="white", linewidths=0.8)
            ax.clabel(lines, fontsize=7)
        verdict = f"imo_{number}"
        failing = table[table[verdict] == "fail"] if verdict in table else table[:0]
        if len(failing):
            ax.plot(failing[axes[0]], failing[axes[1]], "x", color=ORANGE, ms=4, label="fails IMO")
            ax.legend(fontsize=7)
        figure.colorbar(drawn, ax=ax)
        ax.set_title(number, fontsize=10)
        ax.set(xlabel=axes[0], ylabel=axes[1])
    figure.suptitle(f"{title} (SI units)")
    figure.savefig(path, dpi=120, format="png")


def save_segments(signals: "Signals", found: "Sequence[Segment]", path: Path, title: str) -> None:
    """Heading, yaw rate, steering and speed over time, with coloured spans labelled by kind.

    A span is pale before its onset; that of a turn or a zigzag is a line.
    """
    t = signals.t
    figure = empty_figure(13.0, 9.0)
    heading, yaw, steer, speed = axes = plain_axes(figure, 4)
    heading.plot(t, np.degrees(signals.psi), color=BLUE, lw=1.2)
    heading.set_ylabel("heading, deg")
    yaw.plot(t, np.degrees(signals.r), color=BLUE, lw=0.8)
    yaw.set_ylabel("yaw rate, deg/s")
    _draw_steering(steer, signals)
    if signals.speed is not None:
        speed.plot(t, signals.speed, color=BLUE, lw=1.0)
    speed.set_ylabel("speed, m/s")
    speed.set_xlabel("time, s")
    for ax in axes:
        ax.set_xlim(t[0], t[-1])
        for segment in found:
            colour = SEGMENT_COLOURS[segment.kind]
            ax.axvspan(segment.start, segment.onset, color=colour, alpha=0.12, lw=0)
            ax.axvspan(segment.onset, segment.end, color=colour, alpha=0.35, lw=0)
    look = {"rotation": 60, "fontsize": 8, "ha": "left", "va": "bottom", "color": "#333333"}
    for number, segment in enumerate(found, 1):
        middle = 0.5 * (segment.onset + segment.end)
        wide = segment.end - segment.start > NARROW_SEGMENT * (t[-1] - t[0])
        text = f"{number} {segment.kind}" if wide else str(number)
        if segment.kind in ("turning", "zigzag") and math.isfinite(segment.order):
            heading.axvline(segment.onset, color="black", lw=0.7)
        heading.text(middle, 1.02, text, transform=heading.get_xaxis_transform(), **look)
    figure.suptitle(title)
    figure.savefig(path, dpi=110, format="png")


def _draw_steering(ax: Axes, signals: "Signals") -> None:
    """Commanded and executed angle; turning on the spot, which has none, is cut off."""
    executed = None if signals.origin == "commanded" else signals.steer
    largest = 1.0
    for angle, name, colour in (
        (signals.commanded, "commanded", ORANGE),
        (executed, f"executed, {signals.origin}", BLUE),
    ):
        if angle is not None:
            ax.plot(signals.t, np.degrees(angle), color=colour, lw=1.0, label=name)
            largest = max(largest, float(np.degrees(np.quantile(np.abs(angle), 0.995))))
    if signals.steer is None:
        ax.text(0.5, 0.5, "no steering was recorded", transform=ax.transAxes, color=GREY)
    else:
        ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.98), ncol=2, fontsize=8)
    limit = min(1.15 * largest, LARGEST_ANGLE)
    ax.set_ylim(-limit, limit)
    ax.set_ylabel("rudder angle, deg\n(or equivalent)")
