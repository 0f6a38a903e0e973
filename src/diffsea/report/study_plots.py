"""Figures of studies: what a number is most sensitive to, and maps over two parameters."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diffsea.report.trial_plots import BLUE, ORANGE


# The numbers that a trial is run for, most telling first.
_TELLING = (
    "tactical_diameter", "advance", "overshoot_1", "overshoot_2", "initial_turning_distance",
    "steady_turning_diameter", "track_reach", "head_reach", "time_to_half_speed", "final_speed",
    "residual_yaw_rate", "yaw_rate_1", "period",
)  # fmt: skip
_BARS = 12


def telling(names: list[str], count: int) -> list[str]:
    """The most telling few of some numbers."""
    ranked = [name for name in _TELLING if name in names]
    return (ranked + [name for name in names if name not in ranked])[:count]


def save_tornado(relative: Mapping[str, Mapping[str, float]], path: Path, title: str = "") -> None:
    """Bars of the strongest elasticities of the most telling numbers."""
    shown = telling([name for name, row in relative.items() if row], 4)
    figure = Figure(figsize=(11.0, 3.4 * max(1, (len(shown) + 1) // 2)), layout="constrained")
    FigureCanvasAgg(figure)
    for place, number in enumerate(shown):
        ax = figure.add_subplot((len(shown) + 1) // 2, 2, place + 1)
        row = relative[number]
        least = 1e-3 * max(map(abs, row.values()))
        strongest = sorted(
            (name for name in row if abs(row[name]) > least), key=lambda name: abs(row[name])
        )[-_BARS:]
        values = [row[name] for name in strongest]
        ax.barh(strongest, values, color=[BLUE if v > 0 else ORANGE for v in values])
        ax.axvline(0, color="black", lw=0.8)
        ax.set_title(number, fontsize=10)
        ax.set_xlabel("% change per 1 % of the parameter", fontsize=9)
        ax.tick_params(labelsize=8)
        ax.grid(axis="x", alpha=0.25)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    figure.suptitle(title)
    figure.savefig(path, dpi=120, format="png")


def save_map(table: pd.DataFrame, axes: tuple[str, str], path: Path, title: str = "") -> None:
    """The most telling numbers over a grid of two parameters; failed designs stay white."""
    numbers = [
        name
        for name in table.select_dtypes("number")
        if name not in axes and np.ptp(table[name].dropna()) > 0
    ]
    shown = telling(numbers, 4)
    figure = Figure(figsize=(11.0, 4.2 * max(1, (len(shown) + 1) // 2)), layout="constrained")
    FigureCanvasAgg(figure)
    for place, number in enumerate(shown):
        ax = figure.add_subplot((len(shown) + 1) // 2, 2, place + 1)
        surface = table.pivot(index=axes[1], columns=axes[0], values=number)
        x, y, z = surface.columns.to_numpy(), surface.index.to_numpy(), surface.to_numpy()
        drawn = ax.pcolormesh(x, y, z, cmap="viridis", shading="nearest")
        if min(z.shape) > 2 and np.isfinite(z).all():
            lines = ax.contour(x, y, z, colors="white", linewidths=0.8)
            ax.clabel(lines, fontsize=7)
        _failing(ax, table, axes, number)
        figure.colorbar(drawn, ax=ax)
        ax.set_title(number, fontsize=10)
        ax.set(xlabel=axes[0], ylabel=axes[1])
    figure.suptitle(f"{title} (SI units)")
    figure.savefig(path, dpi=120, format="png")


def _failing(ax, table: pd.DataFrame, axes: tuple[str, str], number: str) -> None:
    """Crosses on designs that fail the IMO criterion for a number."""
    if f"imo_{number}" in table:
        failing = table[table[f"imo_{number}"] == "fail"]
        if len(failing):
            ax.plot(failing[axes[0]], failing[axes[1]], "x", color=ORANGE, ms=4, label="fails IMO")
            ax.legend(fontsize=7)
