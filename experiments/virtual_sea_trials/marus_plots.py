"""The figures of the README."""

import math

from experiments.harness.reporting import panels
from experiments.virtual_sea_trials import marus_published as published
from experiments.virtual_sea_trials import marus_trials

import numpy as np
from matplotlib.figure import Figure


BLUE, ORANGE, GREY, GREEN = "#1f5fa8", "#d1720f", "#8a939c", "#2b8a4b"


def every_figure(even: list[dict], uneven: list[dict], name: str) -> Figure:
    """Obtained less published, in per cent, of every figure: the even vessel and the best one."""
    figure, axes = panels(1, 1, 9.0, 6.0)
    axis = axes[0, 0]
    labels = [f"{row['title']}: {row['number'].replace('_', ' ')}" for row in even][::-1]
    for rows, colour, marker, title in (
        (even, GREY, "o", "port and starboard alike"), (uneven, BLUE, "D", f"with {name}"),
    ):  # fmt: skip
        off = [100 * (row["obtained"] / row["published"] - 1) for row in rows][::-1]
        axis.plot(off, range(len(off)), marker, color=colour, label=title, markersize=5)
    axis.axvline(0, color="black", linewidth=0.8)
    axis.set_yticks(range(len(labels)), labels, fontsize=7)
    axis.set_xlabel("obtained less published, % of the published figure")
    axis.grid(axis="x", linewidth=0.3)
    axis.legend(fontsize=8, loc="lower left")
    return figure


def open_directions(rows: list[dict]) -> Figure:
    """Eigenvectors of the figures' information, the least known on top."""
    figure, axes = panels(1, 1, 8.0, 4.6)
    axis = axes[0, 0]
    names = list(rows[0]["vector"])
    weights = np.array([[row["vector"][name] for name in names] for row in rows])
    image = axis.imshow(weights, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axis.set_xticks(range(len(names)), names, rotation=45, fontsize=8)
    shares = [f"{100 * row['determined']:.1f} %" for row in rows]
    axis.set_yticks(range(len(rows)), shares, fontsize=8)
    axis.set_ylabel("share that the figures determine")
    axis.set_title("directions in prior widths, one to a row", fontsize=9, loc="left")
    figure.colorbar(image, ax=axis, label="weight")
    return figure


def odds(rows: list[dict]) -> Figure:
    """Odds of every candidate against a vessel whose sides are alike."""
    figure, axes = panels(1, 1, 8.0, 3.2)
    axis = axes[0, 0]
    shown = rows[::-1]
    colours = [BLUE if row["name"] == rows[0]["name"] else GREY for row in shown]
    axis.barh([row["name"] for row in shown], [row["log10_odds"] for row in shown], color=colours)
    axis.axvline(0, color="black", linewidth=0.8)
    axis.set_xlabel("log10 odds against a vessel that is the same to port and starboard")
    return figure


def diameters(drawn: dict[str, np.ndarray], fitted: dict) -> Figure:
    """Tactical over steady diameter against drift."""
    figure, axes = panels(1, 1, 6.5, 4.2)
    axis = axes[0, 0]
    drift = np.degrees(drawn["drift"])
    ratio = drawn["tactical_diameter"] / drawn["steady_turning_diameter"]
    seen = axis.scatter(drift, ratio, c=100 * drawn["speed_loss"], s=8, cmap="viridis")
    figure.colorbar(seen, ax=axis, label="speed lost in the turn, %")
    beta = np.linspace(0, max(drift.max(), 30), 100)
    axis.plot(beta, np.cos(np.radians(beta)), color="black", label="cos(drift)")
    for run, colour in zip(published.RUNS[:2], (ORANGE, GREEN), strict=True):
        ratio = run.numbers["tactical_diameter"] / run.numbers["steady_turning_diameter"]
        axis.axhline(
            ratio, color=colour, linewidth=1, linestyle="--", label=f"published, {run.title}"
        )
    axis.plot(math.degrees(fitted["drift"]), fitted["ratio"], "*", color="red", markersize=12,
              label="fitted vessel")  # fmt: skip
    axis.axhline(1, color=GREY, linewidth=0.6)
    axis.set_ylim(0.6, 1.5)
    axis.set_xlabel("steady drift angle, deg")
    axis.set_ylabel("tactical over steady diameter")
    axis.legend(fontsize=7)
    return figure


def traced(at_once: marus_trials.Logged, real: marus_trials.Logged) -> Figure:
    """Ordered and executed rudder-equivalent, and heading: actuators at once and real ones."""
    figure, axes = panels(2, 2, 10.0, 4.6)
    for column, one, title in ((0, at_once, "thrusters answer at once"),
                               (1, real, "lag, dead band and limit")):  # fmt: skip
        log, start = one.log, one.segment.onset
        t = np.asarray(log.t) - start
        rows = (t > -2) & (t < 14)
        for values, colour, label in (
            (log.commanded, GREY, "ordered"), (log.executed, ORANGE, "executed"),
        ):  # fmt: skip
            angle = np.degrees(marus_trials.rudder_equivalent(values))[rows]
            axes[0, column].step(t[rows], angle, color=colour, label=label, where="post")
        psi = np.degrees(np.asarray(log.psi))
        axes[1, column].plot(t[rows], (psi - np.interp(0, t, psi))[rows], color=BLUE)
        for level in (-one.run.heading, one.run.heading):
            axes[1, column].axhline(level, color=GREY, linewidth=0.6, linestyle="--")
        axes[0, column].set_title(f"{one.run.title}: {title}", fontsize=8, loc="left")
        axes[1, column].set_xlabel("s after the onset")
    axes[0, 0].set_ylabel("rudder-equivalent, deg")
    axes[1, 0].set_ylabel("heading, deg")
    axes[0, 0].legend(fontsize=8)
    return figure


def biases(ways: dict[str, dict[str, float]]) -> Figure:
    """Relative errors of the derivatives by way of identification."""
    figure, axes = panels(1, 1, 8.0, 3.6)
    axis = axes[0, 0]
    names = list(next(iter(ways.values())))
    width = 0.8 / len(ways)
    for k, ((way, found), colour) in enumerate(
        zip(ways.items(), (BLUE, ORANGE, GREEN), strict=False)
    ):
        places = np.arange(len(names)) + (k - 0.5 * (len(ways) - 1)) * width
        axis.bar(places, [100 * found[name] for name in names], width, color=colour, label=way)
    axis.axhline(0, color="black", linewidth=0.8)
    axis.set_xticks(range(len(names)), names, fontsize=8)
    axis.set_ylabel("error of the estimate, %")
    axis.legend(fontsize=8)
    return figure
