"""Figures of the sweep: maps with the IMO limits, predictions, the front."""

from experiments.design_sweep.sweeping import LENGTH, PANELS, Swept, compliant, in_units
from experiments.harness.reporting import panels

import numpy as np
from matplotlib.figure import Figure


BLUE, ORANGE, RED, GREY = "#2463a6", "#d97706", "#c81e1e", "#8a8a8a"
UNITS = {LENGTH: "ship lengths", "deg": "deg"}


def maps(found: Swept, length: float, kinds) -> Figure:
    """Every number with an IMO limit over thrust and mass; the limit as a red line."""
    shown = [panel for panel in PANELS if kinds[panel[1]].label in found.tables]
    columns = min(3, len(shown))
    lines = -(-len(shown) // columns)
    figure, axes = panels(lines, columns, 4.2 * columns, 3.5 * lines)
    for ax, (title, k, name, unit, limit, _) in zip(axes.ravel(), shown, strict=False):
        values = in_units(found.column(kinds[k], name), unit, length)
        filled = ax.contourf(found.thrust, found.mass, values, 16, cmap="viridis")
        lines_ = ax.contour(found.thrust, found.mass, values, 8, colors="white", linewidths=0.5)
        ax.clabel(lines_, fontsize=6, fmt="%.3g")
        reached = np.nanmin(values) < limit < np.nanmax(values)
        if reached:
            line = ax.contour(found.thrust, found.mass, values, [limit], colors=RED, linewidths=2)
            ax.clabel(line, fmt=f"limit {limit:g}", fontsize=8)
        beyond = "" if reached else f"\nlimit {limit:g}: every design below"
        ax.set_title(f"{title}, {UNITS[unit]}{beyond}", fontsize=9)
        ax.set(xlabel="total thrust, N", ylabel="mass, kg")
        figure.colorbar(filled, ax=ax)
    return figure


def verdicts(found: Swept, length: float, kinds, fronts: dict) -> Figure:
    """Which designs pass every criterion, with the exact front."""
    figure, (line,) = panels(1, 2, 11.0, 4.4)
    ax = line[0]
    failed = np.zeros((found.mass.size, found.thrust.size))
    for _, k, name, _, _, _ in PANELS:
        table = found.tables.get(kinds[k].label)
        if table is not None and f"imo_{name}" in table:
            failed += (table[f"imo_{name}"] == "fail").to_numpy().reshape(failed.shape)
    drawn = ax.pcolormesh(
        found.thrust, found.mass, failed, cmap="RdYlGn_r", shading="nearest", vmin=-0.5, vmax=3.5
    )
    figure.colorbar(drawn, ax=ax, ticks=range(4), label="criteria failed")
    ax.plot(fronts["thrust"], fronts["mass"], ".-", color=RED, label="5 L, by root finding")
    ax.set(xlabel="total thrust, N", ylabel="mass, kg", title="IMO verdicts")
    ax.legend(fontsize=8)
    ax = line[1]
    ax.plot(fronts["mass"], fronts["speed"], ".-", color=BLUE)
    ax.set(
        xlabel="mass, kg", ylabel="approach speed, m/s",
        title="fastest design that turns within 5 L",
    )  # fmt: skip
    ax.grid(alpha=0.3)
    other = ax.twinx()
    other.plot(fronts["mass"], 1e3 * np.asarray(fronts["slope"]), "--", color=ORANGE)
    other.set_ylabel("its price, mm/s per kg (dashed)", color=ORANGE)
    return figure


def prediction(found: Swept, pairs, names, errors_ahead, thrust, mass, kinks) -> Figure:
    """Error of first-order predictions against step, and where it is large."""
    figure, axes = panels(1, 3, 14.0, 4.2)
    for ax, k, title in ((axes[0][0], 0, names[0]), (axes[0][1], 2, names[2])):
        error, across = np.abs(pairs.error[:, k]), pairs.crosses[:, k]
        ax.loglog(100 * pairs.step[~across], error[~across], ".", ms=3, color=BLUE, alpha=0.4,
                  label="smooth between")  # fmt: skip
        ax.loglog(100 * pairs.step[across], error[across], ".", ms=4, color=ORANGE, alpha=0.6,
                  label="a thruster saturates between")  # fmt: skip
        steps = np.array([0.1, 30.0])
        ax.loglog(steps, 3e-5 * steps**2, ":", color="black", label="step²")
        ax.set(xlabel="relative step, %", title=f"{title}: error of the prediction")
        ax.set_ylim(1e-9, 1)
        ax.grid(alpha=0.3)
    axes[0][0].set_ylabel("relative error")
    axes[0][0].legend(fontsize=8, loc="lower right")
    ax = axes[0][2]
    drawn = ax.pcolormesh(thrust, mass, 100 * errors_ahead, cmap="viridis", shading="nearest")
    figure.colorbar(drawn, ax=ax, label="error, %")
    ax.axvline(kinks[0], color=RED, lw=1.5)
    ax.text(kinks[0], mass[-1], " saturates at 35°", color=RED, fontsize=8, va="top")
    ax.set(
        xlabel="total thrust of the known design, N", ylabel="mass, kg",
        title=f"{names[0]} predicted for 10 % more thrust",
    )  # fmt: skip
    return figure


def share_compliant(found: Swept) -> float:
    """Share of designs that pass everything."""
    return float(compliant(found).mean())
