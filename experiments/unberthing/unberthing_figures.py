# pyright: reportArgumentType=false
"""Plots of the route, the experiments and the hundred seeds."""

from experiments.harness.reporting import panels
from experiments.unberthing import harbour_route
from experiments.unberthing.harbour_ship import DEGREE, KNOT
from experiments.unberthing.unberthing_loop import Log
from experiments.unberthing.unberthing_scores import wrong_way

import matplotlib.axes
import numpy as np
from matplotlib.figure import Figure


COLOURS = {
    "published": "#b03a48", "trusted": "#1f5fa8", "no gate": "#8a8a8a",
    "trusted, push borne": "#3a8f5c", "no gate, push borne": "#d1720f",
}  # fmt: skip
_GREY = "#8a8a8a"


def plan() -> Figure:
    """Figure 6 of the paper: the five steps of the route, with the speed aimed at in each."""
    route, (figure, ((axes,),)) = harbour_route, panels(1, 1, 5.0, 6.5)
    turn = np.degrees(float(route.TURN))
    told = (
        f"{route.SIDEWAYS:.0f} m to port by thrusters",
        f"{route.AHEAD:.0f} m ahead, {_knots(1)} kn at the end",
        f"{route.STRAIGHT_3:.0f} m ahead, {_knots(2)} kn",
        f"{turn:.0f} deg to starboard, radius {route.RADIUS:.0f} m, {_knots(3)} kn",
        f"{route.STRAIGHT_5:.0f} m ahead, {_knots(4)} kn",
    )
    for step, words in enumerate(told, start=1):
        points = route.line(step)
        phase, colour = ("unberthing", "#1f5fa8") if step <= 2 else ("leaving", "#d1720f")
        label = f"{phase} phase" if step in (1, 3) else None
        axes.plot(points[:, 1], points[:, 0], color=colour, lw=2, label=label)
        axes.plot(points[-1, 1], points[-1, 0], "o", color=colour, ms=4)
        north, east = points[len(points) // 2]
        line = {"arrowstyle": "-", "lw": 0.5}
        axes.annotate(f"{step}: {words}", (east, north), (max(east, 20.0) + 40, north),
                      fontsize=8, va="center", arrowprops=line)  # fmt: skip
    axes.plot(0, 0, "s", color="black", ms=4)
    axes.annotate("berth", (0, 0), (8, -12), textcoords="offset points", fontsize=8)
    axes.set(xlabel="east, m", ylabel="north, m", xlim=(-150, 850), ylim=(-80, 1500))
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set_aspect("equal")
    axes.grid(linewidth=0.3)
    axes.set_axisbelow(True)
    return figure


def _knots(k: int) -> str:
    return f"{harbour_route.FAST[k] / KNOT:.3g}"


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


def scored(same: dict[str, dict], other: dict[str, dict]) -> Figure:
    """Wrong-way runs and errors of every control system, on ships of both structures."""
    figure, axes = panels(1, 2, 12.5, 0.9 + 0.36 * len(same))
    left, right = axes[0]
    ships = (("of the estimators' structure", same, "#1f5fa8", -0.14),
             ("of another structure", other, "#d1720f", 0.14))  # fmt: skip
    for label, summaries, colour, off in ships:
        for k, one in enumerate(summaries.values()):
            for ax, key, factor in ((left, "wrong_way", 100), (right, "p95_worst_step_2", 1)):
                low, high = one[f"{key}_interval"]
                ax.plot([factor * low, factor * high], [k + off] * 2, color=colour, lw=2)
                ax.plot(factor * one[key], k + off, "o", color=colour, ms=5,
                        label=label if k == 0 else None)  # fmt: skip
    for ax in (left, right):
        ax.set_yticks(range(len(same)), list(same) if ax is left else [])
        ax.set_ylim(len(same) - 0.5, -0.5)
        ax.grid(axis="y", color="#dddddd", lw=0.6)
        ax.set_axisbelow(True)
    left.set(xlabel="runs with thrusters the wrong way, % (95 % interval)", xlim=(-1, None))
    right.set(
        xscale="log", xlabel="95th percentile of the largest error in Step 2, m (95 % interval)"
    )
    right.set_xticks([3, 5, 10, 20, 50, 100], ["3", "5", "10", "20", "50", "100"])
    right.minorticks_off()
    left.legend(frameon=False, fontsize=8, title="ships", title_fontsize=8, loc="lower right")
    return figure


def _shade(ax: matplotlib.axes.Axes, log: Log) -> None:
    flags = wrong_way(log)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        ax.axvspan(log.t[begin], log.t[end - 1], color=COLOURS["published"], alpha=0.15, lw=0)
