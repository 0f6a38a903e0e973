# pyright: reportArgumentType=false
"""The experiment's figures."""

from experiments.harness.reporting import panels
from experiments.vrx_wamv.closed import Driven
from experiments.vrx_wamv.outside_class import Outside
from experiments.vrx_wamv.outside_draws import JOINT
from experiments.vrx_wamv.paths import KEPT_BACK, PATHS, Path
from experiments.vrx_wamv.plant import NEW, speed_for
from experiments.vrx_wamv.procedure import (
    PUBLISHED,
    PUBLISHED_FIRST,
    plateaus,
    speeds_from_rest,
    steady_speed,
)
from experiments.vrx_wamv.stages import Identified
from experiments.vrx_wamv.tuning import Tuned

import numpy as np
from matplotlib.figure import Figure


PLANT, PAPER, OURS, GREY = "#30363d", "#d1720f", "#1f5fa8", "#9aa4ae"


def identification(found: Identified) -> Figure:
    """Steady speed over thrust, and the spin, as the models have them."""
    figure, ((left, right),) = panels(1, 2, 10.0, 4.0)
    thrust = np.linspace(2.0, 260.0, 120)
    left.plot(thrust, [NEW.steady_speed(2 * T) for T in thrust], color=PLANT, label="plant")
    n, u = plateaus(found.data.straight)
    left.plot([NEW.thrust(k) for k in n], u, "o", color=PLANT, ms=5, label="measured")
    for label, model, style in (
        ("published, first", PUBLISHED_FIRST, {"color": PAPER, "ls": ":"}),
        ("published, corrected", PUBLISHED, {"color": PAPER}),
        *(
            (f"procedure, {name}", one.corrected, {"color": OURS, "ls": dash})
            for (name, one), dash in zip(found.procedures.items(), ("--", ":"), strict=True)
        ),
    ):
        speeds = [steady_speed(model, speed_for(T)) for T in thrust]
        left.plot(thrust, speeds, label=label, **style)
    joint = found.values["joint"]
    left.plot(thrust, [_speed(joint, T) for T in thrust], color=OURS, label="joint fit")
    left.set(xlabel="thrust ordered of each engine, N", ylabel="steady speed, m/s", ylim=(0, 2.6))
    left.legend(fontsize=7, frameon=False)
    _spin(right, found)
    return figure


def from_rest(found: Identified) -> Figure:
    """Measured speeds of the straight runs, and the published model beside one of them."""
    figure, (axes,) = panels(1, 3, 12.0, 3.6)
    for run in found.data.straight:
        axes[0].plot(run.t, run.measured["u"], lw=0.8, label=f"{run.name.split('-')[1]} N")
    axes[0].set(title="measured, thrust of each engine", ylabel="speed ahead, m/s")
    axes[0].legend(fontsize=7, frameon=False, ncol=2)
    run = found.data.straight[-1]
    for axis, model, title in (
        (axes[1], PUBLISHED_FIRST, "published, before the correction"),
        (axes[2], PUBLISHED, "published, after it"),
    ):
        axis.plot(run.t, run.measured["u"], ".", color=GREY, ms=3, label="measured")
        axis.plot(run.t, run.true["u"], color=PLANT, label="plant")
        speed = speeds_from_rest(model, run)
        axis.plot(run.t, speed, color=PAPER, label="model")
        low, high = axes[0].get_ylim()
        axis.set(title=title, ylim=(low, max(high, 1.05 * speed.max())))
        axis.legend(fontsize=7, frameon=False)
    for axis in axes:
        axis.set_xlabel("s")
        axis.grid(linewidth=0.3)
    return figure


def _speed(values: dict[str, float], thrust: float) -> float:
    """Steady speed of linear plus quadratic drag with thrust c u n + T."""
    a = -values["X_u"] - 2 * values["c"] * speed_for(thrust)
    b = -values["X_uu"]
    return float((-a + np.sqrt(a * a + 8 * b * thrust)) / (2 * b))


def _spin(axes, found: Identified) -> None:
    run = found.data.spin
    axes.plot(run.t, np.degrees(run.measured["r"]), ".", color=GREY, ms=3, label="measured")
    axes.plot(run.t, np.degrees(run.true["r"]), color=PLANT, label="plant")
    for name, model in (
        ("published", PUBLISHED),
        *((f"procedure, {k}", p.corrected) for k, p in found.procedures.items()),
    ):
        moment = 2 * model.thrust(30.0, 0.0) * 1.005
        grown = moment / model.N_r * (1 - np.exp(-model.N_r / model.m33 * run.t))
        dash = ":" if "ordered" in name else "--"
        style = {"color": PAPER} if name == "published" else {"color": OURS, "ls": dash}
        axes.plot(run.t, np.degrees(grown), label=name, **style)
    axes.set(xlabel="time, s", ylabel="yaw rate in the spin, deg/s", xlim=(0, 8))
    axes.legend(fontsize=7, frameon=False, loc="lower right")


def following(plant: dict[str, Driven], models: dict[str, dict[str, Driven]]) -> Figure:
    """The paper's paths on the plant and on models, and how fast they go round the circle."""
    figure, (axes,) = panels(1, 3, 12.0, 4.2)
    runs = {"plant": plant} | models
    styles = dict(zip(runs, ((PLANT, "-"), (PAPER, "--"), (GREY, "--"), (OURS, ":")), strict=False))
    for name, ways in runs.items():
        colour, dash = styles[name]
        for one, path in zip(axes, ("slow circle", "slow zigzag"), strict=False):
            motion = ways[path].motion
            one.plot(motion["y"], motion["x"], color=colour, ls=dash, lw=1.5, label=name)
        motion = ways["slow circle"].motion
        axes[2].plot(motion["t"], np.hypot(motion["u"], motion["v"]), color=colour, ls=dash)
    for one, (path, points) in zip(axes, PATHS.items(), strict=False):
        _legs(one, points)
        one.set(xlabel="east, m", ylabel="north, m", title=path)
    axes[0].set_aspect("equal")
    axes[1].set(ylim=(-5, 60))
    axes[2].set(xlabel="time, s", ylabel="speed on the circle, m/s", xlim=(0, 60))
    axes[0].legend(fontsize=7, frameon=False)
    return figure


def tuned(runs: dict[str, dict[str, Driven]], found: Tuned) -> Figure:
    """The plant's ways before and after, and the cost on the way to the gains."""
    paths = PATHS | KEPT_BACK
    figure, (axes,) = panels(1, len(paths) + 1, 14.0, 4.2)
    for one, (path, points) in zip(axes, paths.items(), strict=False):
        _legs(one, points)
        for colour, (name, ways) in zip((PAPER, OURS), runs.items(), strict=False):
            motion = ways[path].motion
            one.plot(motion["y"], motion["x"], color=colour, lw=1.2, label=name)
        kept = " (not tuned on)" if path in KEPT_BACK else ""
        one.set(xlabel="east, m", ylabel="north, m", title=f"{path}{kept}")
        one.set_aspect("equal", adjustable="datalim")
    axes[0].legend(fontsize=7, frameon=False)
    axes[-1].semilogy(found.costs, "o-", color=OURS, ms=3)
    axes[-1].set(xlabel="evaluation of the derivatives", ylabel="cost, m$^2$")
    return figure


def laws(runs: dict[str, dict[str, Driven]]) -> Figure:
    """The plant's ways under fixed gains and under those that follow distance and heading error."""
    paths = PATHS | KEPT_BACK
    figure, rows = panels(2, len(paths), 12.0, 8.0)
    for axes, how in zip(rows, ("by hand", "tuned"), strict=True):
        for one, (path, points) in zip(axes, paths.items(), strict=True):
            _legs(one, points)
            for colour, law in ((PAPER, "fixed"), (OURS, "dynamic")):
                motion = runs[f"{law}, {how}"][path].motion
                one.plot(motion["y"], motion["x"], color=colour, lw=1.2, label=f"{law} gains")
            one.set(xlabel="east, m", ylabel="north, m", title=f"{path}, {how}")
            one.set_aspect("equal", adjustable="datalim")
    rows[0][0].legend(fontsize=7, frameon=False)
    return figure


def diagnosis(record: dict) -> Figure:
    """What the diagnosis found beside the truth."""
    figure, ((axes,),) = panels(1, 1, 6.0, 2.4)
    names = [effect["parameter"] for effect in record["effects"]]
    share = [effect["value"] / effect["truth"] for effect in record["effects"]]
    error = [1.645 * effect["std"] / abs(effect["truth"]) for effect in record["effects"]]
    axes.errorbar(share, range(len(names)), xerr=error, fmt="o", color=OURS, capsize=3)
    axes.axvline(1.0, color=PLANT, lw=1)
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="found over true, with 90 % intervals", ylim=(-0.6, len(names) - 0.4))
    return figure


def _legs(axes, points: Path) -> None:
    corners = np.concatenate([np.zeros((1, 2)), points])
    axes.plot(corners[:, 1], corners[:, 0], color=GREY, lw=0.8, ls=":")
    axes.plot(points[:, 1], points[:, 0], "o", color=GREY, ms=4, mfc="none")


def outside(found: Outside) -> Figure:
    """Errors of every model on the plant outside the class: free predictions and closed loops."""
    figure, axes = panels(1, 2, 11.0, 3.6)
    left, right = axes[0]
    names = list(found.predictions)
    left.barh(names, [found.predictions[name]["position"] for name in names], color=PLANT)
    left.set(xlabel="free prediction of 64 s: rms of position, m")
    paths = list(next(iter(found.paths.values())))
    for k, name in enumerate(names):
        for path, marker in zip(paths, "osD^", strict=True):
            one = found.paths[name][path]
            if one["finished"] and one["plant_finished"]:
                right.plot(100 * one["time"], k, marker, color=PLANT, mfc="white",
                           label=path if k == names.index(JOINT) else None)  # fmt: skip
    right.set_yticks(range(len(names)), [])
    right.set(xscale="log", xlabel="error of the time to follow a path, % (none: not finished)")
    right.set_xticks([0.3, 1, 3, 10, 30], ["0.3", "1", "3", "10", "30"])
    right.minorticks_off()
    right.legend(frameon=False, fontsize=8)
    right.set_ylim(left.get_ylim())
    for ax in (left, right):
        ax.invert_yaxis()
    return figure
