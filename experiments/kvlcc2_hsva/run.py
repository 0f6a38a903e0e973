"""KVLCC2 zig-zags: the steering gear from motion alone, dropped terms found again, no weather.

python -m experiments.kvlcc2_hsva.run rudder terms
"""

import copy
import dataclasses
import re
from pathlib import Path


HERE = Path(__file__).resolve().parent

from experiments.harness.diagnosis_tables import names_table, predictions_table, told
from experiments.harness.real_runs import (
    Case,
    audited,
    document_of,
    load,
    named,
    out_folder,
    plot_candidates,
    study,
    write_results,
)
from experiments.harness.reporting import Experiment, experiment_in_parts, table

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from diffsea import Trajectory, read_vessel, replay
from diffsea.vessel.files import Table


# Small and large zig-zags to both sides, short enough; none of the runs held out was fitted by
# `real_fits` either, whose vessel is the start here.
TRAIN = tuple(f"HSVA_CPMC_KVLCC2_Z_{z}.dat" for z in ("10_10_P", "20_10_S", "20_05"))
HELD_OUT = tuple(f"HSVA_CPMC_KVLCC2_Z_{z}.dat" for z in ("10_10_S", "25_05"))
FITTED = "out/real_fits/kvlcc2-innovation.toml"
FINE = 0.01  # s
MOVED = np.radians(0.5)  # a rudder that has left its place

LATERAL = ("Y_vvv", "Y_vvr", "Y_vrr", "Y_rrr", "N_vvv", "N_vvr", "N_vrr", "N_rrr")
ALONE = {"a_H": 0.0, "gamma_R_port": 1.0, "gamma_R_starboard": 1.0}
DROPPED = {  # hull derivatives to drop, rudder numbers to replace, what should be named
    "nothing": ((), {}, None),
    "crossflow": (LATERAL, {}, "crossflow-drag"),
    "coupling": (("Y_r", "N_v"), {}, "sway-yaw-coupling"),
    "interaction": ((), ALONE, "rudder-interaction"),
}
TITLES = {
    "nothing": "nothing",
    "crossflow": "all nonlinear lateral derivatives",
    "coupling": "Y_r and N_v",
    "interaction": "rudder interaction (a_H = 0, gamma_R = 1)",
}
WEATHER = ("current", "wind", "wave-force")


PARTS = ("rudder", "terms")


def main() -> None:
    """Run the parts that are named, all by default."""
    run, parts = experiment_in_parts(__file__, __doc__, PARTS)
    runs = load(HERE, "kvlcc2_hsva/*.dat", "mapping_repaired.toml")
    runs = {name: runs[name] for name in (*TRAIN, *HELD_OUT)}
    document = document_of(FITTED)
    if "rudder" in parts:
        _rudder(run, steering_gear(document, runs))
    if "terms" in parts:
        findings = audited(runs)
        _terms(run, {what: without(document, runs, what, findings) for what in DROPPED})


def _rudder(run: Experiment, record: dict) -> None:
    """Write what the diagnosis says of the steering gear beside what the record shows."""
    write_results("kvlcc2_hsva/rudder", record)
    recorded = record["recorded_rudder"]
    rows = [
        (name, one["executes"], one["slew"], one["delay"], one["ramp"]["slew"],
         one["ramp"]["delay"])
        for name, one in recorded.items()
    ]  # fmt: skip
    tables = {
        "RUDDER": names_table({"orders given, rudder withheld": record}),
        "RECORDED": table(("recorded rudder", "executes", "slew while over, deg/s",
                           "moves after, s", "as one ramp: slew, deg/s", "dead time, s"), rows),
        "RUDDER_PREDICTIONS": predictions_table({"": record["held_out"]["horizons"]}),
    }  # fmt: skip
    run.write_part("rudder", told(record) | {"recorded_rudder": recorded}, tables)


def _terms(run: Experiment, records: dict[str, dict]) -> None:
    """Write what the diagnoses name once terms have been dropped."""
    for what, record in records.items():
        write_results(f"kvlcc2_hsva/without_{what}", record)
    titles = {f"dropped: {TITLES[what]}": record for what, record in records.items()}
    weather = {what: record["weather"] for what, record in records.items()}
    rows = [
        (TITLES[what], *(next((r["log10_odds"] for r in found if r["name"] == name), None)
                         for name in WEATHER))
        for what, found in weather.items()
    ]  # fmt: skip
    tables = {
        "TERMS": names_table(titles),
        "TERMS_PREDICTIONS": predictions_table(
            {title: record["held_out"]["horizons"] for title, record in titles.items()}
        ),
        "WEATHER": table(("log10 odds, one at a time", *WEATHER), rows),
    }
    results = {what: told(record) | {"weather": weather[what]} for what, record in records.items()}
    run.write_part("terms", results, tables)


# The steering gear


def steering_gear(document: Table, runs: dict[str, Trajectory]) -> dict:
    """Diagnose with the zig-zag's orders in place of the recorded rudder."""
    helm = {name: ordered(run) for name, run in runs.items()}
    document = copy.deepcopy(document)
    del document["rudder"][0]["rate_limit"]
    measured = {
        name: slew(runs[name], helm[name]) | {"ramp": as_one_ramp(runs[name], helm[name])}
        for name in runs
    }
    record = study(Case("kvlcc2_hsva/rudder", document, helm, HELD_OUT))
    print("recorded, which the diagnosis never saw:")
    for name, row in measured.items():
        print(f"  {name}: slew {row['slew']:.2f} deg/s, moves {row['delay']:.2f} s after the order")
    draw(runs[HELD_OUT[0]], helm[HELD_OUT[0]])
    plot_candidates("kvlcc2_hsva/rudder", {"orders given, rudder withheld": record})
    return record | {"recorded_rudder": measured}


def ordered(run: Trajectory) -> Trajectory:
    """The run with the orders of its zig-zag in place of the recorded rudder.

    The file's name has amplitude and check angle. The first execute is where the rudder first
    moves; every later one is where the heading passes the check angle on the rudder's side.
    """
    match = re.search(r"Z_(\d+)_(\d+)", run.name)
    if match is None:
        raise ValueError(f"{run.name} does not say which zig-zag it is")
    amplitude, check = (np.radians(float(number)) for number in match.groups())
    rudder, psi = np.asarray(run.executed["rudder"]), np.asarray(run.psi)
    now = int(np.argmax(np.abs(rudder - rudder[0]) > MOVED))
    heading = np.mean(psi[: max(now, 1)])
    side = np.sign(rudder[now] - rudder[0])
    orders = np.zeros(len(psi))
    while now < len(psi):
        orders[now:] = side * amplitude
        passed = np.flatnonzero(side * (psi[now:] - heading) >= check)
        if not passed.size:
            break
        now, side = now + int(passed[0]), -side
    rest = {name: series for name, series in run.executed.items() if name != "rudder"}
    return dataclasses.replace(run, commanded={"rudder": orders}, executed=rest)


def slew(run: Trajectory, helm: Trajectory) -> dict[str, float]:
    """Rate (deg/s) of the recorded rudder while it goes over, and its delay after orders (s)."""
    t, rudder = np.asarray(run.t), np.asarray(run.executed["rudder"])
    rate = np.abs(np.gradient(rudder, t))
    over = rate > 0.5 * np.quantile(rate, 0.999)
    orders = np.asarray(helm.commanded["rudder"])
    # The first order has no heading of its own: it was set where the rudder moves.
    executes = np.flatnonzero(np.diff(orders))[1:] + 1
    delays = []
    for k in executes:
        moved = np.flatnonzero(np.abs(rudder[k:] - rudder[k]) > MOVED)
        if moved.size:
            delays.append(t[k + moved[0]] - t[k] - MOVED / np.median(rate[over]))
    return {
        "slew": float(np.degrees(np.median(rate[over]))),
        "delay": float(np.median(delays)),
        "executes": len(delays),
    }


def as_one_ramp(run: Trajectory, helm: Trajectory) -> dict[str, float]:
    """Dead time (s) and slew rate (deg/s) of a servo that comes nearest to the recorded rudder.

    What two numbers can say of a rudder whose strokes begin and end softly: least squares over
    all samples.
    """
    t, rudder = np.asarray(run.t), np.asarray(run.executed["rudder"])
    orders = np.asarray(helm.commanded["rudder"])
    fine = np.arange(t[0], t[-1], FINE)

    def off(at: np.ndarray) -> np.ndarray:
        dead_time, rate = at
        given = orders[np.maximum(np.searchsorted(t, fine - dead_time, side="right") - 1, 0)]
        angle = [given[0]]
        for order in given[1:]:
            angle.append(angle[-1] + float(np.clip(order - angle[-1], -rate * FINE, rate * FINE)))
        return np.interp(t, fine, angle) - rudder

    found = least_squares(off, [0.3, np.radians(15.0)], diff_step=0.02)
    return {
        "delay": float(found.x[0]),
        "slew": float(np.degrees(found.x[1])),
        "rms": float(np.degrees(np.sqrt(np.mean(found.fun**2)))),
    }


def draw(run: Trajectory, helm: Trajectory) -> None:
    """Orders, the recorded rudder, and the rudder that the diagnosed vessel makes of the orders."""
    out = out_folder("kvlcc2_hsva/rudder")
    made = replay(read_vessel(str(out / "vessel.toml")).vessel, helm).executed["rudder"]
    figure = Figure(figsize=(9.0, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    lines = (
        (helm.commanded["rudder"], "order, from the zig-zag rule", "#8a8a8a", "-"),
        (run.executed["rudder"], "recorded, withheld", "black", "-"),
        (made, "by the diagnosed vessel", "#d1720f", "--"),
    )
    for series, text, colour, style in lines:
        axes.plot(run.t, np.degrees(np.asarray(series)), style, color=colour, label=text, lw=1.2)
    axes.set(xlabel="time, s", ylabel="rudder, deg", title=f"{run.name}, held out")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(out / "rudder.png", dpi=110)


# Terms of the nominal model


def without(document: Table, runs: dict[str, Trajectory], what: str, findings: list[dict]) -> dict:
    """Diagnose with part of the fitted vessel dropped."""
    gone, rudder, expected = DROPPED[what]
    document = copy.deepcopy(document)
    document["hull"] = {k: v for k, v in document["hull"].items() if k not in gone}
    document["rudder"][0] |= rudder
    name = f"kvlcc2_hsva/without_{what}"
    record = study(Case(name, document, runs, HELD_OUT, findings=findings))
    names = named(record)
    print(f"dropped {what}, expected {expected or 'nothing'}: named {', '.join(names) or 'none'}")
    weather = [row for row in record["candidates"] if row["name"] in WEATHER]
    for row in weather:
        print(f"  {row['name']}: {row['status']}, log10 odds {row['log10_odds']:.1f}")
    plot_candidates(name, {f"dropped: {what}": record})
    return record | {"expected": expected, "weather": weather}


if __name__ == "__main__":
    main()
