"""Fits to part of each real set, predictions of the rest, beside the data's own noise.

python -m experiments.real_fits.run kvlcc2 kcs blueboat esso
"""

import argparse
import dataclasses
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from diffsea.runtime import prepare_jax


prepare_jax()

from experiments.check_data import absent, data_folder
from experiments.harness.diagnosis_tables import predictions_table
from experiments.harness.reporting import Experiment, table

import numpy as np

from diffsea import (
    Study,
    Trajectory,
    UserError,
    Vessel,
    read_mapping,
    read_recording,
    read_vessel,
    recording_metrics,
)
from diffsea.identification.run_models import RunModel
from diffsea.identification.study import FitSettings, identify
from diffsea.report.predictions import ComparedRun, horizon_table, predict
from diffsea.simulation import planning
from diffsea.vessel.files import build, dump, updated_document


HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DATA = data_folder()
NUMBERS = ("overshoot_1", "overshoot_2", "advance", "transfer", "tactical_diameter",
           "peak_yaw_rate")  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Set:
    """One set of recordings: what is fitted and what is held out, by file name."""

    vessel: str
    mapping: str
    pattern: str
    held_out: tuple[str, ...]
    train: tuple[str, ...] = ()  # all others if empty
    settings: FitSettings = FitSettings(profiles=())
    left_out: tuple[str, ...] = ()  # channels that are not measurements of their own
    objectives: tuple[str, ...] = ("innovation", "free-run")
    shows_numbers: bool = False  # trial numbers of the runs held out
    circles: float | None = None  # approach speed (m/s) of 35 deg circles to predict


SETS = {
    "kvlcc2": Set(
        "kvlcc2", "kvlcc2_hsva", "kvlcc2_hsva/*.dat",
        tuple(f"HSVA_CPMC_KVLCC2_Z_{z}.dat" for z in ("10_10_S", "25_05", "30_05")),
        shows_numbers=True, circles=1.179,
    ),
    "kcs": Set(
        str(HERE / "kcs.toml"), "kcs_marin", "kcs_marin/*.txt",
        ("SIMMAN2020_container_KCS_MARIN_zigzag_port_20_FS.txt",), shows_numbers=True,
    ),
    "blueboat": Set(
        "blueboat", "blueboat", "blueboat/*.csv",
        ("fixed_00000228.csv", "fixed_00000232.csv"),
        ("fixed_00000218.csv", "fixed_00000223.csv", "fixed_00000226.csv", "fixed_00000230.csv"),
    ),
    "esso": Set(
        "esso_osaka", "esso_osaka", "esso_osaka/recordings/*.csv",
        ("zigzag_31-Jul-2020_13_42_53.csv", "turn_14-Oct-2020_14_56_07.csv"),
        ("zigzag_31-Jul-2020_13_04_24.csv", "zigzag_31-Jul-2020_13_22_52.csv",
         "zigzag_31-Jul-2020_14_03_39.csv", "turn_14-Sep-2020_13_51_45.csv"),
        FitSettings(profiles=(), effects=("current", "wind"), per_recording=True),
        ("u", "v"),  # low-passed: smoother and later than positions and yaw rate allow
        objectives=("innovation",),  # a free run leaves the priors far behind
    ),
}  # fmt: skip


def main() -> None:
    """Fit and predict the sets that are named."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("sets", nargs="*", default=list(SETS), metavar="SET")
    parser.add_argument("--objective", choices=("innovation", "free-run"), nargs="+",
                        default=["innovation", "free-run"])  # fmt: skip
    args = parser.parse_args()
    run = Experiment(HERE, HERE, False, time.perf_counter())
    for name in args.sets:
        for objective in args.objective:
            if objective in SETS[name].objectives:
                settings = dataclasses.replace(SETS[name].settings, objective=objective)
                case = dataclasses.replace(SETS[name], settings=settings)
                study_set(run, f"{name}-{objective}", case)


def study_set(run: Experiment, name: str, case: Set) -> None:
    """Fit, predict, print and write one set."""
    began = time.monotonic()

    def tell(message: str) -> None:
        print(f"[{time.monotonic() - began:5.0f} s] {name}: {message}", file=sys.stderr, flush=True)

    runs = load(case)
    fitted_on = {name: without(run, case.left_out) for name, run in runs.items()}
    train = [
        r for k, r in fitted_on.items() if k not in case.held_out and k in (case.train or runs)
    ]
    test = [fitted_on[k] for k in case.held_out]
    file = read_vessel(case.vessel)
    study = identify(file.vessel, train, case.settings, tell)
    document = updated_document(file.document, study.values, [])
    vessel = build(document)
    judged, fitted = study.held_out(test)
    before = [RunModel(file.vessel, states) for states in study.start_states(train, test)]
    record = {
        "rows": study.rows,
        "effects": study.effects,
        "quality": study.quality(test),
        "noise": noise(study),
        "horizons": errors(judged, before, fitted),
        "numbers": [
            row
            for run, after in zip(judged, fitted, strict=True)
            for row in numbers(run, file.vessel, after.vessel)
        ],
        "identifiability": study.identifiability.as_dict(),
        "circles": circles(case, file.vessel, vessel),
    }
    show(name, record)
    out = ROOT / "out" / "real_fits"
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.toml").write_text(dump(document), encoding="utf-8")
    text = json.dumps(record, indent=1, default=lambda value: np.asarray(value).tolist())
    (out / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    kept = {k: record[k] for k in ("rows", "quality", "noise", "horizons", "numbers", "circles")}
    run.write_part(name, kept, tables_of(name, case, record))


def tables_of(name: str, case: Set, record: dict) -> dict[str, str]:
    """The tables of a set and an objective, by their place in the README."""
    place = name.upper().replace("-", "_")
    horizons = {"file -> fit": record["horizons"]}
    found = {f"{place}_AHEAD": predictions_table(horizons, ("file", "fit"))}
    if case.shows_numbers:
        rows = [(row["run"], *_in_degrees(row)) for row in record["numbers"]]
        head = ("run", "", "measured", "file", "fit", "unit")
        found[f"{place}_NUMBERS"] = table(head, rows)
    if record["circles"]:
        rows = [
            ("starboard" if row["side"] > 0 else "port", row["model"], row["advance"],
             row["tactical_diameter"])
            for row in record["circles"]
        ]  # fmt: skip
        head = ("35 deg circle", "", "advance / L", "tactical diameter / L")
        found[f"{place}_CIRCLES"] = table(head, rows)
    return found


def _in_degrees(row: dict) -> tuple[str, float, float | None, float, str]:
    """Number, measured, of the file, of the fit and unit, as people read them."""
    angle = row["number"].startswith(("overshoot", "peak"))
    unit = ("deg/s" if row["number"].startswith("peak") else "deg") if angle else "m"
    factor = math.degrees(1.0) if angle else 1.0
    file = None if row["file"] is None else factor * row["file"]
    return row["number"], factor * row["measured"], file, factor * row["fit"], unit


def without(run: Trajectory, channels: tuple[str, ...]) -> Trajectory:
    """A run with channels taken for not measured."""
    return dataclasses.replace(run, **{c: np.full(len(run.t), np.nan) for c in channels})


def load(case: Set) -> dict[str, Trajectory]:
    """Recordings by file name, as repaired after the audit."""
    files = sorted(DATA.glob(case.pattern))
    if not files:
        sys.exit(absent(case.pattern))
    mapping = read_mapping(ROOT / "experiments" / case.mapping / _mapping(case))
    return {file.name: read_recording(file, mapping) for file in files}


def _mapping(case: Set) -> str:
    repaired = ROOT / "experiments" / case.mapping / "mapping_repaired.toml"
    return repaired.name if repaired.exists() else "mapping.toml"


def errors(
    test: Sequence[Trajectory], before: Sequence[RunModel], after: Sequence[RunModel]
) -> list[dict]:
    """Free-run errors at 5, 20 and 60 s, of the vessel file and of the fit to each run."""
    runs = [
        ComparedRun(
            run,
            {
                "file": predict(start.vessel, run, start.states),
                "fit": predict(fitted.vessel, run, fitted.states),
            },
        )
        for run, start, fitted in zip(test, before, after, strict=True)
    ]
    return horizon_table(runs)


def noise(study: Study) -> dict[str, float]:
    """Standard deviations of the sensors, as estimated."""
    channels = ("x", "y", "psi", "u", "v", "r")
    return dict(zip(channels, np.exp(np.asarray(study.noise.sensor)).tolist(), strict=True))


def numbers(run: Trajectory, before: Vessel, after: Vessel) -> list[dict]:
    """Trial numbers of a run as measured, and of its open-loop predictions."""
    length = float(after.rigid_body.length)
    try:
        measured = recording_metrics(run, length)
        kind = measured["manoeuvre"]
        file, fit = (recording_metrics(predict(v, run).run, length, kind) for v in (before, after))
    except UserError:
        return []
    return [
        {"run": run.name, "number": k, "measured": measured[k], "file": file.get(k), "fit": fit[k]}
        for k in NUMBERS
        if all(isinstance(one.get(k), float) for one in (measured, fit))
    ]


def circles(case: Set, before: Vessel, after: Vessel) -> list[dict]:
    """35 deg turning circles, which are not among the recordings, in ship lengths."""
    rows = []
    for side in (1.0, -1.0) if case.circles else ():
        for label, vessel in (("file", before), ("fit", after)):
            plan = planning.plan_trial(
                vessel, "turning-circle", angle=math.radians(35), side=side, speed=case.circles
            )
            values = planning.run_and_measure(vessel, plan)[1]
            length = float(vessel.rigid_body.length)
            rows.append({"side": side, "model": label} | {
                k: float(values[k]) / length for k in ("advance", "tactical_diameter")
            })  # fmt: skip
    return rows


def show(name: str, record: dict) -> None:
    """The tables of one set."""
    print(f"\n{name}: misfit over noise {record['quality']}")
    for row in record["horizons"]:
        told = []
        for quantity, factor in (("position", 1), ("heading", 57.3), ("u", 1), ("r", 57.3)):
            if quantity in row["fit"]:
                pair = [f"{factor * row[m][quantity]:.2g}" for m in ("file", "fit")]
                told.append(f"{quantity} {' -> '.join(pair)}")
        print(f"  {row['seconds']:g} s ahead ({row['starts']} starts): {', '.join(told)}")
    print("  noise: " + ", ".join(f"{k} {v:.2g}" for k, v in record["noise"].items()))
    for row in record["numbers"]:
        file = "-" if row["file"] is None else f"{row['file']:.4g}"
        print(f"  {row['run']} {row['number']}: {row['measured']:.4g}, {file} -> {row['fit']:.4g}")
    for row in record["circles"]:
        print(f"  circle {row['side']:+.0f} {row['model']}: advance {row['advance']:.3f} L, "
              f"tactical diameter {row['tactical_diameter']:.3f} L")  # fmt: skip


if __name__ == "__main__":
    main()
