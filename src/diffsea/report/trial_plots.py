"""Figures of runs: the track, the motion over time, and a prediction beside its recording."""

import math
from collections.abc import Mapping
from pathlib import Path

import matplotlib.axes
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diffsea.metrics.orders import as_thrust, steering
from diffsea.simulation.trials import Trial
from diffsea.trajectory import Trajectory


BLUE, ORANGE, GREY = "#1f5fa8", "#d1720f", "#8a8a8a"
_COLOURS = (BLUE, ORANGE, "#3a8f5c", "#8c4a9e", "#b03a48", "#5b6770")


def save_track(trial: Trial, path: Path, title: str = "") -> None:
    """The track seen from above, with the heading at the execute upwards."""
    run = trial.trajectory.counted()
    start = int(np.searchsorted(run.t, float(trial.execute_time)))
    start = min(start, len(run.t) - 1)
    up, right = _turned(run, run.x[start], run.y[start], run.psi[start])
    figure, axes = _figure(1, (6.0, 6.0))
    (ax,) = axes
    ax.plot(right, up, color=BLUE, lw=1.5)
    ax.plot(0, 0, "o", color=ORANGE, ms=6, label="execute")
    times = np.asarray(trial.switch_times, float)
    for number, time in enumerate(times[:-1][np.isfinite(times[:-1])]):
        ax.plot(
            np.interp(time, run.t, right), np.interp(time, run.t, up), "s", color=GREY, ms=5,
            label="switching" if number == 0 else None,
        )  # fmt: skip
    _silhouettes(ax, run, up, right, run.psi[start])
    ax.set(xlabel="to starboard of the approach, m", ylabel="along the approach, m", title=title)
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(frameon=False)
    _save(figure, path)


def save_series(
    trial: Trial, path: Path, title: str = "", units: Mapping[str, str] | None = None
) -> None:
    """Heading and steering, speeds, yaw rate and actuation over time since the execute.

    `units` are those of the channels, as the vessel has them.
    """
    run = trial.trajectory.counted()
    t = run.t - float(trial.execute_time)
    figure, axes = _figure(4, (8.0, 9.0))
    axes[0].plot(t, np.degrees(run.psi), color=BLUE, label="heading")
    steered = steering(as_thrust(run, units or {}))
    if steered is not None:
        label = "rudder" if "rudder" in steered[1] else "rudder-equivalent order"
        axes[0].step(t, np.degrees(steered[0]), where="post", color=ORANGE, label=label)
    axes[0].set_ylabel("deg")
    axes[1].plot(t, run.u, color=BLUE, label="u, forward")
    axes[1].plot(t, run.v, color=ORANGE, label="v, to starboard")
    axes[1].set_ylabel("m/s")
    axes[2].plot(t, np.degrees(run.r), color=BLUE, label="yaw rate")
    axes[2].set_ylabel("deg/s")
    _actuation(axes[3], t, run, units or {})
    axes[3].set_xlabel("time since the execute, s")
    axes[0].set_title(title, loc="left")
    for ax in axes:  # above the axes, where no curve runs
        ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=4, fontsize=8)
    _save(figure, path)


def save_prediction(predicted: Trajectory, recording: Trajectory, path: Path, title: str) -> None:
    """A recording and what the model makes of its orders."""
    run = recording.counted()
    figure = Figure(figsize=(11.0, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, 2)
    track = figure.add_subplot(grid[:, 0])
    axes = [figure.add_subplot(grid[k, 1]) for k in range(4)]
    if run.has("x") and run.has("y"):
        track.plot(run.y, run.x, color=GREY, lw=2.5, label="recorded")
    track.plot(predicted.y, predicted.x, color=BLUE, lw=1.3, label="predicted")
    track.plot(predicted.y[:1], predicted.x[:1], "o", color=ORANGE, label="start")
    track.set(xlabel="east, m", ylabel="north, m", title=title)
    track.set_aspect("equal", adjustable="datalim")
    track.legend(frameon=False)
    for ax, (channel, factor, name) in zip(axes, _MOTION, strict=True):
        if run.has(channel):
            ax.plot(run.t, factor * getattr(run, channel), color=GREY, lw=2.5)
        ax.plot(predicted.t, factor * getattr(predicted, channel), color=BLUE, lw=1.3)
        ax.set_ylabel(name)
        _plain(ax)
    axes[-1].set_xlabel("time, s")
    _plain(track)
    figure.savefig(path, dpi=120, format="png")


_MOTION = (
    ("psi", 180 / math.pi, "heading, deg"),
    ("u", 1.0, "u, m/s"),
    ("v", 1.0, "v, m/s"),
    ("r", 180 / math.pi, "yaw rate, deg/s"),
)


def _turned(run: Trajectory, x0: float, y0: float, psi0: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions along and to starboard of a heading, from a point."""
    north, east = run.x - x0, run.y - y0
    cos, sin = math.cos(psi0), math.sin(psi0)
    return cos * north + sin * east, cos * east - sin * north


def _silhouettes(
    ax: matplotlib.axes.Axes, run: Trajectory, up: np.ndarray, right: np.ndarray, psi0: float
) -> None:
    """Arrows along the track that show the heading, evenly in time."""
    rows = np.searchsorted(run.t, np.linspace(run.t[0], run.t[-1], 14)[1:-1])
    angle = run.psi[rows] - psi0
    ax.quiver(
        right[rows], up[rows], np.sin(angle), np.cos(angle), angles="uv", pivot="mid", scale=22,
        width=0.006, color=BLUE, alpha=0.7,
    )  # fmt: skip


def _actuation(
    ax: matplotlib.axes.Axes, t: np.ndarray, run: Trajectory, units: Mapping[str, str]
) -> None:
    """Executed actuation, and its orders dashed; angles in degrees."""
    for colour, channel in zip(_COLOURS, run.executed, strict=False):
        unit = units.get(channel, "")
        factor = 180 / math.pi if unit == "rad" else 1.0
        unit = "deg" if unit == "rad" else unit
        name = f"{channel}, {unit}" if unit else channel
        ax.plot(t, factor * run.executed[channel], color=colour, lw=1.3, label=name)
        ordered = run.commanded.get(channel)
        if ordered is not None:
            ax.step(t, factor * ordered, where="post", color=colour, lw=1.0, ls="--", alpha=0.6)
    ax.set_ylabel("executed (order dashed)")
    if not run.executed:
        ax.set_ylabel("no actuation")


def _figure(rows: int, size: tuple[float, float]) -> tuple[Figure, list]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(rows, 1, k + 1) for k in range(rows)]
    for ax in axes:
        _plain(ax)
    return figure, axes


def _plain(ax: matplotlib.axes.Axes) -> None:
    ax.grid(alpha=0.25)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=120, format="png")
