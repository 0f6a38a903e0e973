"""The figures of the experiment."""

from experiments.harness.reporting import panels
from experiments.metamodels.gunnerus import DAYS, TESTS, deviations_at_executes

import numpy as np


DARK, LIGHT, ORANGE, GREEN = "#1f5fa8", "#9db8d6", "#d1720f", "#3a8a4f"
COLOURS = {"average": ORANGE, "average beyond the mark": "#c9b48a", "metamodel": DARK,
           "corrected average": GREEN}  # fmt: skip


def all_of(save, service: dict, repeats: dict, errors: dict, real: dict, further: dict) -> None:
    """Every figure."""
    save(_service(service["series"]), "service")
    save(
        _validation(service["series"]["validation"], repeats["series"]["validation"]), "validation"
    )
    records = repeats["series"]["records"]
    save(_repeats(records), "repeats")
    save(_executes(records), "executes")
    save(_benchmark(records["group 2"], repeats["series"]["benchmark"]), "benchmark")
    save(_averaging(errors), "averaging")
    if real:
        save(_recorded(real), "recorded")
    if "figure" in further.get("series", {}):
        save(_beyond(further["series"]["figure"]), "nuisances")


def _service(series: dict):
    figure, axes = panels(1, 3, 11.0, 3.8)
    track, rates, aside = axes[0]
    found = series["found"]
    for piece, label in zip(found.pieces, found.labels, strict=True):
        x, y = piece.channels["x"], piece.channels["y"]
        track.plot(y / 1e3, x / 1e3, color=f"C{label % 10}", lw=0.4, alpha=0.4)
    track.set(xlabel="east, km", ylabel="north, km", title="trials found, by group", aspect="equal")
    chosen = {id(p) for p in series["chosen"]}
    for piece in series["members"][:120]:
        mine = id(piece) in chosen
        rates.plot(piece.t, np.degrees(piece.channels["rudder"]), lw=0.8 if mine else 0.4,
                   color=DARK if mine else LIGHT, zorder=2 if mine else 1)  # fmt: skip
    rates.set(xlabel="s", ylabel="rudder, deg", title="rudder in group 1; dark: the calmest 12")
    piece = series["aside"]
    rates_ = np.degrees(piece.channels["r"])
    aside.plot(piece.t, rates_, color="black", lw=1.0, label="trial put aside")
    predicted = np.degrees(series["predicted"])[: len(piece.t)]
    aside.plot(piece.t[: len(predicted)], predicted, color=DARK, lw=1.2, ls="--", label="metamodel")
    aside.set(xlabel="s", ylabel="yaw rate, deg/s", title="cross-validation")
    aside.legend(fontsize=8)
    return figure


def _validation(ferry: dict, speeds: dict):
    figure, axes = panels(1, 3, 11.0, 3.4)
    ways = {"metamodel": ("black", "-"), "ship": (GREEN, ":"), "model 1": (DARK, "--"),
            "model 2": (ORANGE, "--")}  # fmt: skip
    for name, (colour, style) in ways.items():
        axes[0, 0].plot(
            ferry["t"], np.degrees(ferry[name]), style, color=colour, lw=1.1, label=name
        )
    axes[0, 0].set(title="case 1: rudder of the trial put aside", ylabel="yaw rate, deg/s")
    for axis, ratio, title in ((axes[0, 1], 1.0, "case 2: full speed"),
                               (axes[0, 2], 0.75, "case 2: 0.75 of it")):  # fmt: skip
        rows = speeds["t"] < 260
        for name, (colour, style) in ways.items():
            axis.plot(speeds["t"][rows], np.degrees(speeds[name][ratio])[rows], style,
                      color=colour, lw=1.1, label=name)  # fmt: skip
        axis.set(title=title, ylim=(-0.75, 0.75))
    axes[0, 2].legend(fontsize=7, ncol=2)
    for axis in axes[0]:
        axis.set_xlabel("s")
    return figure


def _repeats(records: dict):
    """Yaw rate, heading and rudder of one campaign of each day."""
    figure, axes = panels(3, len(records), 11.0, 6.0)
    quantities = (("r", "yaw rate, deg/s"), ("psi", "heading, deg"), ("delta", "rudder, deg"))
    for column, (name, day) in enumerate(records.items()):
        for axis, (key, label) in zip(axes[:, column], quantities, strict=True):
            for k, series in enumerate(np.degrees(np.asarray(getattr(day, key))[:TESTS])):
                axis.plot(day.t, series, color=DARK if k % 2 == 0 else ORANGE, lw=0.8)
            axis.set_ylabel(label, fontsize=8)
            axis.grid(alpha=0.3)
        wind, control = DAYS[name]
        axes[0, column].set_title(
            f"{name}: wind {wind[0]:g} to {wind[1]:g} m/s, orders {control.delay:g} s late; "
            "orange: port first", fontsize=8, loc="left",
        )  # fmt: skip
        axes[-1, column].set_xlabel("s")
    return figure


def _executes(records: dict):
    """How far headings are beyond 10 deg at the second and third execute."""
    figure, axes = panels(1, 2, 9.0, 3.4)
    for axis, number, title in ((axes[0, 0], 0, "second execute"), (axes[0, 1], 1, "third")):
        for (name, day), colour in zip(records.items(), (ORANGE, DARK), strict=True):
            beyond = np.degrees(deviations_at_executes(day)[:TESTS, number])
            axis.plot(range(1, TESTS + 1), beyond, "o", color=colour, label=name)
        axis.axhline(0, color="black", lw=0.8)
        axis.set(title=title, xlabel="trial", ylabel="heading beyond 10 deg, deg")
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    return figure


def _benchmark(day, predicted: dict):
    """Both days' metamodels under the rudder of one trial of the second day."""
    figure, axes = panels(1, 1, 7.5, 3.6)
    axis = axes[0, 0]
    axis.plot(day.t, np.degrees(np.asarray(day.r)[0]), color="black", lw=1.2, label="trial")
    for (name, rates), colour in zip(predicted.items(), (ORANGE, DARK), strict=True):
        rates = np.degrees(rates[: len(day.t)])
        axis.plot(day.t, rates, "--", color=colour, lw=1.2, label=f"metamodel of {name}")
    axis.set(xlabel="s", ylabel="yaw rate, deg/s")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    return figure


def _averaging(errors: dict):
    controls, winds = list(errors["errors"]), list(next(iter(errors["errors"].values())))
    figure, axes = panels(len(controls), len(winds), 11.0, 5.6)
    for row, control in zip(axes, controls, strict=True):
        for axis, wind in zip(row, winds, strict=True):
            for method, scores in errors["errors"][control][wind].items():
                axis.plot(errors["counts"], scores["rms"], "o-", ms=3, lw=1.2,
                          color=COLOURS[method], label=method)  # fmt: skip
            axis.set(xscale="log", yscale="log", ylim=(0.08, 4.0), xticks=errors["counts"],
                     xticklabels=errors["counts"])  # fmt: skip
            unit = "" if wind == "calm" else " m/s"
            axis.set_title(f"{control} control, {wind}{unit}", fontsize=9)
            axis.minorticks_off()
            axis.grid(alpha=0.3)
        row[0].set_ylabel("rms error of overshoots, deg")
    for axis in axes[-1]:
        axis.set_xlabel("number of trials")
    axes[0, 0].legend(fontsize=7)
    return figure


def _recorded(real: dict):
    shown = [(name, *part["series"][name], part["trials"][name]["percent"])
             for part in real.values() for name in part["series"]]  # fmt: skip
    figure, axes = panels(3, 4, 11.0, 6.0)
    for axis, (name, trial, predicted, percent) in zip(axes.ravel(), shown, strict=False):
        t = trial.dt * np.arange(len(trial.r))
        axis.plot(t, np.degrees(trial.r), color="black", lw=1.0)
        axis.plot(t, np.degrees(predicted), color=DARK, lw=1.0, ls="--")
        axis.plot(t, np.degrees(trial.delta) / 10, color=LIGHT, lw=0.7)
        short = name.replace("HSVA_CPMC_KVLCC2_", "KVLCC2 ").replace("zigzag_31-Jul-2020_", "Esso ")
        axis.set_title(f"{short}: {percent:.0f} %", fontsize=8)
        axis.tick_params(labelsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("yaw rate, deg/s", fontsize=8)
    return figure


def _beyond(shown: dict):
    figure, axes = panels(1, len(shown), 11.0, 3.6)
    for axis, (title, boxes) in zip(axes[0], shown.items(), strict=True):
        names = list(boxes)
        axis.boxplot([np.asarray(boxes[n], float) for n in names], whis=(5, 95), showfliers=False,
                     medianprops={"color": DARK})  # fmt: skip
        axis.set_xticks(range(1, len(names) + 1), names, fontsize=7)
        axis.set_title(title, fontsize=9)
        axis.grid(axis="y", alpha=0.3)
    return figure
