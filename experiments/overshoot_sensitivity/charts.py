"""Figures: tornado, error against step, the naive scheme, local against global."""

from collections.abc import Sequence

from experiments.harness.reporting import panels

import numpy as np
from matplotlib.figure import Figure


BLUE, ORANGE, GREY, GREEN = "#2463a6", "#d97706", "#8a8a8a", "#2f8f4e"
TITLES = {
    "overshoot_1": "first overshoot",
    "overshoot_2": "second overshoot",
    "peak_yaw_rate": "peak yaw rate",
    "tactical_diameter": "tactical diameter",
}


def tornado(rows: Sequence[tuple[str, list[tuple[str, list[str], np.ndarray]]]]) -> Figure:
    """Signed elasticities, a row of panels per vessel, strongest above; `rows` by vessel."""
    columns = max(len(entries) for _, entries in rows)
    figure, axes = panels(len(rows), columns, 3.6 * columns, 3.7 * len(rows))
    for line, (vessel, entries) in zip(axes, rows, strict=True):
        for ax in line[len(entries) :]:
            ax.set_visible(False)
        for ax, (title, names, values) in zip(line, entries, strict=False):
            strongest = np.argsort(np.abs(values))[-12:]
            shown = values[strongest]
            colours = [BLUE if v > 0 else ORANGE for v in shown]
            ax.barh([names[k] for k in strongest], shown, color=colours)
            ax.axvline(0, color="black", lw=0.8)
            ax.set_title(f"{vessel}: {title}", fontsize=9)
            ax.tick_params(labelsize=7)
            ax.grid(axis="x", alpha=0.3)
    for ax in axes[-1]:
        ax.set_xlabel("% change per 1 % of the parameter", fontsize=8)
    return figure


def step_errors(entries: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> Figure:
    """Error of central differences against step: median and worst of a vessel's parameters."""
    figure, axes = panels(1, len(entries), 4.8 * len(entries), 3.8)
    for ax, (title, steps, error) in zip(axes[0], entries, strict=True):
        ax.loglog(steps, np.median(error, axis=1), "o-", color=BLUE, ms=4, label="median")
        ax.loglog(steps, error.max(axis=1), "s--", color=ORANGE, ms=4, label="worst parameter")
        ax.loglog(
            steps, error.max(axis=1)[0] * (steps / steps[0]) ** 2, ":", color=GREY, label="step²"
        )
        ax.set_ylim(1e-14, 10)
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("step h of ln p")
        ax.grid(alpha=0.3)
    axes[0][0].set_ylabel("error, relative to the largest derivative")
    axes[0][0].legend(fontsize=8)
    return figure


def naive(stairs: dict, names: list[str], exact: np.ndarray, sampled: dict) -> Figure:
    """Overshoot against a parameter, and all derivatives, of the naive scheme and exactly."""
    figure, (line,) = panels(1, 2, 11.0, 4.6)
    change = 100 * (np.exp(stairs["x"]) - 1)
    ax = line[0]
    for step, curve in stairs["sampled"].items():
        ax.plot(change, curve, lw=1, label=f"flipped at the sample, {step:g} s")
    ax.plot(change, stairs["located"], color="black", lw=2, label="located in the step")
    ax.set(xlabel=f"change of {stairs['parameter']}, %", ylabel="first overshoot, deg")
    ax.set_title("20/20 zig-zag", fontsize=10)
    ax.legend(fontsize=8)
    ax.grid(alpha=0.3)
    order = np.argsort(np.abs(exact))
    height, ax = 0.8 / (1 + len(sampled)), line[1]
    places = np.arange(len(order))
    ax.barh(places + 0.4, exact[order], height, color="black", label="exact")
    for k, (step, values) in enumerate(sampled.items(), 1):
        wrong = np.sign(values) != np.sign(exact)
        for subset, colour, label in (
            (~wrong, (GREEN, BLUE, GREY)[k % 3], f"at the sample, {step:g} s"),
            (wrong, ORANGE, None),
        ):
            shown = np.where(subset, values, 0.0)[order]
            ax.barh(places + 0.4 - k * height, shown, height, color=colour, label=label)
    ax.set_yticks(places, [names[k] for k in order], fontsize=7)
    ax.axvline(0, color="black", lw=0.8)
    ax.set_xlabel("d first overshoot / d ln p, deg (orange: wrong sign)")
    ax.legend(fontsize=8)
    ax.grid(axis="x", alpha=0.3)
    return figure


def local_and_global(entries: Sequence[tuple[str, list[str], np.ndarray, dict]]) -> Figure:
    """Shares of variance from the derivatives beside Sobol's first-order and total ones."""
    figure, axes = panels(1, len(entries), 4.0 * len(entries), 4.8)
    for ax, (title, names, local, found) in zip(axes[0], entries, strict=True):
        shown = np.argsort(np.maximum(local, found["ST"]))[-12:]
        places = np.arange(len(shown))
        ax.barh(places + 0.27, local[shown], 0.27, color="black", label="from derivatives")
        ax.barh(
            places, found["S1"][shown], 0.27, xerr=found["S1_conf"][shown], color=BLUE,
            label="Sobol, first order", error_kw={"lw": 0.8},
        )  # fmt: skip
        ax.barh(
            places - 0.27, found["ST"][shown], 0.27, xerr=found["ST_conf"][shown], color=ORANGE,
            label="Sobol, total", error_kw={"lw": 0.8},
        )  # fmt: skip
        ax.set_yticks(places, [names[k] for k in shown], fontsize=7)
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("share of variance")
        ax.grid(axis="x", alpha=0.3)
    axes[0][0].legend(fontsize=7, loc="lower right")
    return figure
