# pyright: reportArgumentType=false
"""Plots of the experiments and of the hundred seeds."""

from experiments.harness.reporting import panels
from experiments.unberthing.harbour_ship import DEGREE
from experiments.unberthing.unberthing_loop import Log
from experiments.unberthing.unberthing_scores import Score, wrong_way

import matplotlib.axes
import numpy as np
from matplotlib.figure import Figure


COLOURS = {
    "published": "#b03a48", "trusted": "#1f5fa8", "no gate": "#8a8a8a",
    "trusted, push borne": "#3a8f5c", "no gate, push borne": "#d1720f",
}  # fmt: skip
_GREY = "#8a8a8a"


def exp_1(published: Log, cured: Log) -> Figure:
    """One draw of Exp. 1: track, error, thrusters and estimates, the cured run beside it."""
    figure, axes = panels(2, 3, 12.5, 6.4)
    runs = {"published": published, "trusted, push borne": cured}
    for name, log in runs.items():
        rows = np.asarray(log.step) <= 2
        t, colour = log.t[rows], COLOURS[name]
        label = {"published": "gradient descent"}.get(name, "least squares, trust, push borne")
        axes[0, 0].plot(np.asarray(log.state.y)[rows], np.asarray(log.state.x)[rows], color=colour)
        axes[0, 1].plot(t, log.cross[rows], color=colour, label=label)
        for k, style in ((3, "-"), (4, "--")):
            axes[0, 2].plot(t, log.blades[rows, k - 1] / DEGREE, style, color=colour, lw=1)
            axes[1, 0].plot(t, log.model[rows, 0, k], style, color=colour)
            axes[1, 1].plot(t, log.model[rows, 1, k], style, color=colour)
    axes[0, 0].plot([0, -40, -40], [0, 0, 300], ":", color="black", lw=1)
    axes[0, 0].set(xlabel="east, m", ylabel="north, m", title="track (dotted: plan)")
    axes[0, 0].set(xlim=(-60, 10))
    axes[0, 1].legend(frameon=False, fontsize=8, loc="upper left")
    axes[0, 1].set(title="cross-track error, m", xlabel="time, s")
    axes[0, 2].set(title="blade angles, deg (bow solid, stern dashed)", xlabel="time, s")
    axes[1, 0].set(title="$\\gamma_{vB}$ solid, $\\gamma_{vS}$ dashed", xlabel="time, s")
    axes[1, 1].set(title="$\\gamma_{rB}$ solid, $\\gamma_{rS}$ dashed", xlabel="time, s")
    rows = np.asarray(published.step) <= 2
    axes[1, 2].plot(published.t[rows], published.model[rows, 0, 0], color=COLOURS["published"])
    axes[1, 2].plot(
        published.t[rows], published.model[rows, 1, 1], "--", color=COLOURS["published"]
    )
    axes[1, 2].set(
        title="gradient descent: $\\varphi_{vv}$ solid, $\\varphi_{rr}$ dashed", xlabel="time, s"
    )
    for ax in axes.flat[1:]:
        _shade(ax, published)
    for ax in (axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 1]):
        ax.axhline(0, color=_GREY, lw=0.8, ls=":")
    return figure


def leaving(found: dict[str, Log]) -> Figure:
    """Exps. 2 and 3: error, rudder, speed, and the estimates that matter."""
    figure, axes = panels(2, 3, 12.5, 6.0)
    for (name, log), colour in zip(found.items(), ("#1f5fa8", "#d1720f"), strict=True):
        rows = np.asarray(log.step) <= 5
        t = log.t[rows]
        series = (
            log.cross[rows], log.blades[rows, 1] / DEGREE, np.asarray(log.state.u)[rows] / 0.51444,
            log.model[rows, 0, 5], log.model[rows, 1, 2], log.model[rows, 0, 2],
        )  # fmt: skip
        for ax, values in zip(axes.flat, series, strict=True):
            ax.plot(t, values, color=colour, lw=1.2, label=name)
        for begin in t[np.flatnonzero(np.diff(np.asarray(log.step)[rows]))]:
            axes[0, 0].axvline(begin, color=colour, lw=0.8, ls=":")
    titles = (
        "cross-track error, m (dotted: a step ends)", "rudder angle, deg", "speed, kn",
        "bias $c_v$, m/s per period", "$\\gamma_{r\\delta}$", "$\\gamma_{v\\delta}$",
    )  # fmt: skip
    for ax, title in zip(axes.flat, titles, strict=True):
        ax.set(title=title, xlabel="time, s")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return figure


def scored(found: dict[str, list[Score]], summaries: dict[str, dict]) -> Figure:
    """Largest errors of Step 2 over seeds, and shares of wrong-way runs."""
    figure, axes = panels(1, 2, 11.5, 4.2)
    for name, judged in found.items():
        worst = np.sort([abs(one.worst[2]) for one in judged])
        share = np.arange(1, len(worst) + 1) / len(worst)
        axes[0, 0].step(worst, share, where="post", color=COLOURS[name], label=name)
    axes[0, 0].set(xscale="log", xlabel="largest cross-track error in Step 2, m",
                   ylabel="share of runs", ylim=(0, 1.02))  # fmt: skip
    axes[0, 0].set_xticks([1, 2, 5, 10, 20, 50, 100, 200], [1, 2, 5, 10, 20, 50, 100, 200])
    axes[0, 0].minorticks_off()
    axes[0, 0].axvline(7.1, color="black", lw=0.8, ls=":")
    axes[0, 0].text(7.3, 0.03, "published run", fontsize=8)
    axes[0, 0].legend(frameon=False, fontsize=8)
    names = list(summaries)
    for k, name in enumerate(names):
        one = summaries[name]
        low, high = one["wrong_way_interval"]
        colour = COLOURS.get(name, COLOURS["published"])
        axes[0, 1].plot([100 * low, 100 * high], [k, k], color=colour, lw=2)
        axes[0, 1].plot(100 * one["wrong_way"], k, "o", color=colour)
    axes[0, 1].set_yticks(range(len(names)), names)
    axes[0, 1].invert_yaxis()
    axes[0, 1].set(xlabel="runs with thrusters the wrong way, % (95 % interval)", xlim=(-1, None))
    return figure


def _shade(ax: matplotlib.axes.Axes, log: Log) -> None:
    flags = wrong_way(log)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        ax.axvspan(log.t[begin], log.t[end - 1], color=COLOURS["published"], alpha=0.15, lw=0)
