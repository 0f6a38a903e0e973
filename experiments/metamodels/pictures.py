"""The figures of the experiment."""

from experiments.harness.reporting import panels
from experiments.metamodels.ferry import LONGEST
from experiments.metamodels.gunnerus import DAYS, TESTS, deviations_at_executes
from experiments.metamodels.metamodel import same_length
from experiments.metamodels.repeated import ITSELF, METHODS

import numpy as np


DARK, LIGHT, ORANGE, GREEN = "#1f5fa8", "#9db8d6", "#d1720f", "#3a8a4f"
COLOURS = {"average": ORANGE, "average beyond the mark": "#c9b48a", "metamodel": DARK,
           "corrected average": GREEN}  # fmt: skip
STYLES = dict(zip((*METHODS, ITSELF), (
    (ORANGE, "-", "o"), ("#8fc79d", "none", "s"), (GREEN, "none", "s"), ("#6f9fd8", "--", "^"),
    (DARK, "--", "^"), ("#8a8a8a", ":", "x")), strict=True))  # fmt: skip
LASTING = 0.9  # share of trials that a mean is shown of
QUANTITIES = {"u": "speed ahead, m/s", "v": "sway velocity, m/s", "r": "yaw rate, deg/s",
              "rudder": "rudder, deg"}  # fmt: skip


def all_of(
    save, service: dict, repeats: dict, errors: dict, real: dict, real_repeats: dict, further: dict
) -> None:
    """Every figure."""
    save(_service(service["series"]), "service")
    save(_group(service["series"]["members"]), "group")
    save(_chosen(service["series"]["chosen"]), "chosen")
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
        save(_real_repeats(real_repeats), "real_repeats")
    if "figure" in further.get("series", {}):
        save(_beyond(further["series"]["figure"]), "nuisances")


def _service(series: dict):
    """Tracks of all trials by group, and the trial put aside."""
    figure, axes = panels(1, 2, 9.0, 4.0)
    track, aside = axes[0]
    found = series["found"]
    for piece, label in zip(found.pieces, found.labels, strict=True):
        x, y = piece.channels["x"], piece.channels["y"]
        track.plot(y / 1e3, x / 1e3, color=f"C{label % 10}", lw=0.4, alpha=0.4)
    track.set(xlabel="east, km", ylabel="north, km", title="trials found, by group", aspect="equal")
    piece = series["aside"]
    rates = np.degrees(piece.channels["r"])
    aside.plot(piece.t, rates, color="black", lw=1.0, label="trial put aside")
    predicted = np.degrees(series["predicted"])[: len(piece.t)]
    aside.plot(piece.t[: len(predicted)], predicted, color=DARK, lw=1.2, ls="--", label="metamodel")
    aside.set(xlabel="s", ylabel="yaw rate, deg/s", title="cross-validation")
    aside.legend(fontsize=8)
    return figure


def _shown(piece, name: str) -> np.ndarray:
    values = piece.channels[name]
    return values if name in ("u", "v") else np.degrees(values)


def _mean(pieces: list, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean of trials at the same time (s) since their start, while most of them last."""
    values, known = same_length([_shown(piece, name) for piece in pieces], LONGEST)
    rows = known.mean(0) >= LASTING
    mean = (values * known).sum(0)[rows] / known.sum(0)[rows]
    longest = max(pieces, key=lambda piece: len(piece.t))
    return longest.t[: len(mean)], mean


def _group(pieces: list):
    """Speeds, yaw rate and rudder of all trials of a group, with their means."""
    figure, axes = panels(2, 2, 10.0, 6.0)
    for axis, (name, label) in zip(axes.ravel(), QUANTITIES.items(), strict=True):
        for piece in pieces:
            axis.plot(piece.t, _shown(piece, name), color=LIGHT, lw=0.4, alpha=0.6)
        axis.plot(*_mean(pieces, name), color=DARK, lw=1.8)
        axis.set(ylabel=label)
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("s since the turn began")
    figure.suptitle(f"group 1: {len(pieces)} trials; dark: mean while 90 % of them last")
    return figure


def _chosen(pieces: list):
    """Yaw rate and rudder of the trials that the metamodel is identified from."""
    figure, axes = panels(2, 1, 7.5, 5.6)
    for axis, name in zip(axes[:, 0], ("r", "rudder"), strict=True):
        for piece in pieces:
            axis.plot(piece.t, _shown(piece, name), color=LIGHT, lw=0.9)
        axis.plot(*_mean(pieces, name), color=DARK, lw=1.6)
        axis.set(ylabel=QUANTITIES[name])
        axis.grid(alpha=0.3)
    axes[0, 0].set_title(
        f"the {len(pieces)} trials of group 1 with the least side wind; dark: mean while 90 % of "
        "them last", fontsize=10,
    )  # fmt: skip
    axes[-1, 0].set_xlabel("s since the turn began")
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
    figure, axes = panels(3, 4, 11.0, 6.4)
    for axis, (name, trial, predicted, percent) in zip(axes.ravel(), shown, strict=False):
        t = trial.dt * np.arange(len(trial.r))
        axis.plot(t, np.degrees(trial.r), color="black", lw=1.0, label="measured")
        axis.plot(t, np.degrees(predicted), color=DARK, lw=1.0, ls="--", label="predicted")
        axis.plot(t, np.degrees(trial.delta) / 10, color=LIGHT, lw=0.7, label="rudder / 10, deg")
        axis.set_title(f"{_short(name)}: {percent:.0f} %", fontsize=8)
        axis.tick_params(labelsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("yaw rate, deg/s", fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("s", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncol=3,
                  fontsize=8)  # fmt: skip
    return figure


def _short(name: str) -> str:
    if name.startswith("zigzag_"):
        return "Esso " + name.split("_", 2)[2][:5].replace("_", ":")
    return name.replace("HSVA_CPMC_KVLCC2_Z_", "KVLCC2 ").replace("_", " ")


def _real_repeats(repeats: dict):
    """Headings and overshoots of real repeats kept back, by method."""
    shown = [pair for part in repeats.values()
             for pair in zip(part["trials"], part["series"], strict=True)]  # fmt: skip
    figure, axes = panels(2, max(len(shown), 1), 11.0, 6.0)
    for column, (row, (trial, truth, found)) in zip(axes.T, shown, strict=False):
        heading, overshoot = column
        t = trial.dt * np.arange(len(truth))
        heading.plot(t, np.degrees(truth), color="black", lw=1.6)
        for method, psi in found.items():
            colour, line, _ = STYLES[method]
            heading.plot(t, np.degrees(psi), line, color=colour, lw=1.1)
        for k, value in enumerate(row["measured"]["overshoots_deg"]):
            overshoot.plot([k - 0.4, k + 0.4], [value, value], color="black", lw=1.6,
                           label="measured" if k == 0 else None)  # fmt: skip
        for number, (method, (colour, line, mark)) in enumerate(STYLES.items()):
            values = row["methods"][method]["overshoots_deg"]
            places = np.arange(2) + 0.12 * (number - 2.5)
            overshoot.plot(places, values, mark, color=colour, ms=6)
            overshoot.plot([], [], ls=line, marker=mark, color=colour, ms=6, label=method)
        heading.set_title(f"kept back: {_short(row['name'])}", fontsize=9)
        heading.set_xlabel("s since the first execute", fontsize=8)
        overshoot.set_xticks([0, 1], ["first", "second"])
        overshoot.margins(y=0.1)
        for axis in column:
            axis.grid(alpha=0.3)
            axis.tick_params(labelsize=8)
    axes[0, 0].set_ylabel("heading towards the first side, deg", fontsize=8)
    axes[1, 0].set_ylabel("overshoot, deg", fontsize=8)
    figure.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside lower center", ncol=4,
                  fontsize=8)  # fmt: skip
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
