"""Esso Osaka, wind concealed: audit, diagnose, infer the wind of every run, then score it.

And with the wind given, as an anemometer aboard gives it.

python -m experiments.esso_osaka.run audit circles diagnosis wind given
"""

import copy
import dataclasses
import json
from pathlib import Path
from typing import Any

from diffsea.runtime import prepare_jax


HERE = Path(__file__).resolve().parent
prepare_jax()  # before jax is imported, or its XLA flags would come too late

from experiments.esso_osaka import circles
from experiments.harness.diagnosis_tables import (
    audit_table,
    candidates_table,
    names_table,
    predictions_table,
    told,
)
from experiments.harness.real_runs import (
    DATA,
    Case,
    audited,
    document_of,
    load,
    out_folder,
    plot_candidates,
    show_audit,
    spans,
    study,
    write_results,
)
from experiments.harness.reporting import Experiment, experiment_in_parts, table

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from diffsea import EFFECTS, Trajectory
from diffsea.identification.coordinates import free_by_default
from diffsea.identification.data.dataset import DatasetShape
from diffsea.identification.estimates import Estimate, parameter_records
from diffsea.identification.fit import Start, estimate
from diffsea.identification.holdout import Split, held_out_coordinates, row_deviance, split_data
from diffsea.identification.problem import Problem, make_problem
from diffsea.vessel.files import Table, build


# Chosen before any result was seen, for time: zig-zags without their ends, turns without the 100 s
# of acceleration by hand, and two minutes of a random run, the only kind that goes astern.
TRAIN = {  # from, to, s
    "zigzag_31-Jul-2020_13_04_24.csv": (0, 120),
    "zigzag_31-Jul-2020_13_22_52.csv": (0, 120),
    "zigzag_31-Jul-2020_14_03_39.csv": (0, 120),
    "turn_14-Sep-2020_13_51_45.csv": (100, 300),
    "random_06-Aug-2020_16_24_25_4.csv": (0, 120),
}
HELD_OUT = {
    "zigzag_31-Jul-2020_13_42_53.csv": (0, 150),
    "turn_14-Oct-2020_14_56_07.csv": (100, 300),
}
REST = {  # nothing but their wind is inferred, with the hull as fitted
    "turn_14-Oct-2020_14_29_49.csv": (100, 300),
    "turn_14-Sep-2020_14_16_04.csv": (100, 300),
    "random_06-Aug-2020_16_24_25_5.csv": (0, 120),
}
# Frontal and lateral wind area of the model, m^2, as the data's publisher states them.
AREAS = {"frontal_area": 0.135, "lateral_area": 0.520}
SMOOTHED = ("u", "v")  # low-passed and late


def main() -> None:
    """Run the parts that are named, all by default."""
    run, parts = experiment_in_parts(
        __file__, __doc__, ["audit", "circles", "diagnosis", "wind", "given"]
    )
    pattern = "esso_osaka/recordings/*.csv"
    repaired = load(HERE, pattern, "mapping_repaired.toml")
    runs = spans(repaired, TRAIN | HELD_OUT | REST)
    document = copy.deepcopy(document_of("esso_osaka"))
    document["effect"] = [{"name": "wind", "speed": 0.0, "direction": 0.0, **AREAS}]
    if "audit" in parts:
        _audit(run, {"as published": load(HERE, pattern), "repaired": repaired})
    if "circles" in parts:
        _circles(run, repaired)
    if "diagnosis" in parts:
        _diagnosis(run, document, runs)
    if "given" in parts:
        _given_wind(run, runs)
    if "wind" in parts:
        record = {"from all channels": infer(document, runs, ())}
        record["without u and v"] = infer(document, runs, SMOOTHED)
        draw(record)
        write_results("esso_osaka/wind", record)
        run.write_part("wind", record, {"WIND": wind_table(record), "RUNS": runs_table(record)})


def _audit(run: Experiment, sets: dict[str, dict[str, Trajectory]]) -> None:
    findings = {title: audited(runs) for title, runs in sets.items()}
    for title, found in findings.items():
        show_audit(title, found)
    write_results("esso_osaka/audit", findings)
    run.write_part("audit", findings, {"AUDIT": audit_table(findings)})


def _circles(run: Experiment, recordings: dict[str, Trajectory]) -> None:
    turns = {name: run for name, run in recordings.items() if name.startswith("turn")}
    found = circles.drifts(turns)
    # What was concealed is read only here.
    record = circles.scored(found, {name: measured(run) for name, run in turns.items()})
    for row in record["rows"]:
        print(f"  {row['recording']}: drifts at {row['speed']:.3f} +- {row['scatter']:.3f} m/s, "
              f"as if wind from {row['from']:.0f} of {row['measured_from']:.0f} deg")  # fmt: skip
    print(f"  median error {record['median_direction_error']:.0f} deg")
    folder = DATA / "esso_osaka"
    pairs = [
        circles.seconds(folder / "recordings" / name, folder / "measured_wind" / name)
        for name in recordings
    ]
    record["mounting"] = circles.mounting(pairs)
    print("  the anemometer's zero is turned by {turned:.0f} deg, {interval}".format(
        **record["mounting"]))  # fmt: skip
    write_results("esso_osaka/circles", record)
    rows = [
        (row["recording"], row["laps"], f"{row['speed']:.3f} +- {row['scatter']:.3f}", row["from"],
         row["measured_from"], row["off"], 100 * row["share"])
        for row in record["rows"]
    ]  # fmt: skip
    head = ("turn", "laps", "drift, m/s", "as if wind from, deg", "measured, deg", "off, deg",
            "drift, % of the wind")  # fmt: skip
    run.write_part("circles", record, {"CIRCLES": table(head, rows)})


def _diagnosis(run: Experiment, document: Table, runs: dict[str, Trajectory]) -> None:
    used = {name: run for name, run in runs.items() if name not in REST}
    record = study(Case("esso_osaka", document, used, tuple(HELD_OUT), per_run=True))
    plot_candidates("esso_osaka", {"Esso Osaka, wind concealed": record})
    found = {}
    for effect in record["effects"]:
        if effect["name"] == "wind":
            found[effect["recording"]] = effect["parameters"]
    print("the diagnosis named wind" if found else "the diagnosis did not name wind")
    # What was concealed is read only here, after the diagnosis.
    record["wind"] = scored(found, runs)
    record["side_force"] = [
        row for row in record["candidates"] if row["name"] == "propeller-side-force"
    ]
    for row in record["side_force"]:
        print(f"propeller side force: {json.dumps(row)}")
    write_results("esso_osaka", record)
    tables = {
        "NAMES": names_table({"wind concealed": record}),
        "CANDIDATES": candidates_table(record),
        "PREDICTIONS": predictions_table({"": record["held_out"]["horizons"]}),
    }
    run.write_part("diagnosis", told(record) | {"wind": record["wind"]}, tables)


def _given_wind(run: Experiment, runs: dict[str, Trajectory]) -> None:
    """The diagnosis of the same recordings with the wind that was measured in them."""
    used = {name: in_its_wind(run) for name, run in runs.items() if name not in REST}
    record = study(Case("esso_osaka/given", document_of("esso_osaka"), used, tuple(HELD_OUT)))
    tables = {
        "GIVEN": names_table({"wind given": record}),
        "GIVEN_PREDICTIONS": predictions_table({"": record["held_out"]["horizons"]}),
    }
    run.write_part("given", told(record), tables)


def in_its_wind(run: Trajectory) -> Trajectory:
    """The recording with the true wind that was measured, between its samples by components."""
    table = pd.read_csv(DATA / "esso_osaka" / "measured_wind" / f"{Path(run.name).stem}.csv")
    angle = table["wind_dir_true [rad]"]
    parts = (table["wind_velo_true [m/s]"] * of(angle) for of in (np.cos, np.sin))
    north, east = (np.interp(run.t, table["t [s]"], part) for part in parts)
    wind = {"wind_speed": np.hypot(north, east), "wind_direction": np.arctan2(east, north)}
    return dataclasses.replace(run, extra={**run.extra, **wind})


# The wind asked for: one of its own in every run, nothing else added to the hull


def infer(document: Table, runs: dict[str, Trajectory], dropped: tuple[str, ...]) -> dict:
    """Wind of every run from motion alone, and its share of the gain of the measured one."""
    vessel = build(document)
    free = free_by_default(vessel)
    seen = {name: _without(run, dropped) for name, run in runs.items()}
    train, test = ([seen[name] for name in part] for part in (TRAIN, HELD_OUT))

    def problem_of(some: list[Trajectory], least: DatasetShape) -> Problem:
        return make_problem(vessel, some, free, (EFFECTS["wind"],), True, least=least)

    data = split_data(problem_of, train, test, True)
    nominal = estimate(data.train, free)
    informed = estimate(data.train, free, Start(_given(data.train, train)))
    blind = estimate(data.train, (*free, "wind"))
    found = dict(zip(TRAIN, parameter_records(data.train, blind, "wind"), strict=False))
    for part in (HELD_OUT, REST):
        # On a dataset of the same shape, for which the programs are compiled.
        others = problem_of([seen[name] for name in part], data.train.dataset.shape)
        wind = parameter_records(others, _wind_of(others, blind, len(free)), "wind")
        found |= dict(zip(part, wind, strict=False))
    record = {"wind": scored(found, runs)}
    record["gain"] = _gains(data, nominal, informed, blind, test)
    print(f"without {dropped or 'nothing'}:")
    show(record)
    return record


def _without(run: Trajectory, channels: tuple[str, ...]) -> Trajectory:
    return dataclasses.replace(run, **{c: np.full(len(run.t), np.nan) for c in channels})


def _given(problem: Problem, runs: list[Trajectory]) -> np.ndarray:
    """Coordinates at the vessel file, with the measured wind in every run."""
    effect = EFFECTS["wind"]
    out = np.zeros(problem.layout.size)
    place = problem.layout.slices["wind"]
    sizes = np.array(effect.sizes(problem.base))
    for number, run in enumerate(runs):
        flow = np.array(effect.encode(problem.base, measured(run)))
        first = place.start + number * len(sizes)
        out[first : first + len(sizes)] = flow / sizes
    return out


def _wind_of(problem: Problem, fitted: Estimate, parameters: int) -> Estimate:
    """The wind of runs that were not fitted, everything else as it was."""
    start = np.zeros(problem.layout.size)
    start[:parameters] = fitted.coordinates[:parameters]
    return estimate(problem, ("wind",), Start(start, fitted.noise), rounds=4, fixed_noise=True)


def _gains(
    data: Split, nominal: Estimate, informed: Estimate, blind: Estimate, test: list[Trajectory]
) -> dict[str, float]:
    """-2 log likelihood gained on what was held out, over the model in a calm.

    The informed model is given the measured wind of the held-out runs; the blind one estimates
    it on their first part.
    """
    known = np.asarray(data.test.dataset.known).any(1)
    at = _given(data.test, [*data.held_out])
    hull = len(data.train.layout.parameters)
    at[:hull] = informed.coordinates[:hull]

    def deviance(coordinates: np.ndarray, fitted: Estimate) -> float:
        return float(row_deviance(data.test, coordinates, fitted.noise)[known].sum())

    calm = deviance(held_out_coordinates(data, nominal), nominal)
    told = calm - deviance(at, informed)
    found = calm - deviance(held_out_coordinates(data, blind), blind)
    share = found / told if told > 0 else float("nan")
    return {"informed": told, "blind": found, "share": share}


# The score


def measured(run: Trajectory) -> dict[str, float]:
    """Vector mean of the measured true wind over the span of a run: speed, direction (from)."""
    table = pd.read_csv(DATA / "esso_osaka" / "measured_wind" / f"{Path(run.name).stem}.csv")
    table = table[table["t [s]"].between(float(run.t[0]), float(run.t[-1]))]
    speed, direction = table["wind_velo_true [m/s]"], table["wind_dir_true [rad]"]
    north, east = (speed * np.cos(direction)).mean(), (speed * np.sin(direction)).mean()
    return {
        "speed": float(np.hypot(north, east)),
        "direction": float(np.arctan2(east, north) % (2 * np.pi)),
    }


def scored(found: dict[str, dict], runs: dict[str, Trajectory]) -> dict:
    """Inferred against measured mean wind."""
    rows = []
    for name, parameters in found.items():
        truth = measured(runs[name])
        off = parameters["direction"]["value"] - truth["direction"]
        rows.append({
            "recording": name,
            "fitted": name in TRAIN,
            "speed": parameters["speed"]["value"],
            "speed_std": parameters["speed"]["std"],
            "measured_speed": truth["speed"],
            "speed_ratio": parameters["speed"]["value"] / truth["speed"],
            "direction": float(np.degrees(parameters["direction"]["value"])),
            "measured_direction": float(np.degrees(truth["direction"])),
            "direction_error": float(np.degrees((off + np.pi) % (2 * np.pi) - np.pi)),
        })  # fmt: skip
    if not rows:
        return {"rows": []}
    speeds = [[row[key] for row in rows] for key in ("speed", "measured_speed")]
    rank: Any = spearmanr(speeds[0], speeds[1]) if len(rows) > 2 else None
    return {
        "rows": rows,
        "median_direction_error": float(np.median([abs(r["direction_error"]) for r in rows])),
        "median_speed_ratio": float(np.median([r["speed_ratio"] for r in rows])),
        "median_speed_error": float(np.median([abs(r["speed_ratio"] - 1) for r in rows])),
        "rank_correlation": None if rank is None else float(rank.statistic),
        "rank_p_value": None if rank is None else float(rank.pvalue),
    }


def show(record: dict) -> None:
    """Print the wind of every run, the medians and the shares of the gain."""
    for row in record["wind"]["rows"]:
        print(f"  {row['recording']}{'' if row['fitted'] else ' (not fitted)'}: "
              f"{row['speed']:.2f} +- {row['speed_std']:.2f} of {row['measured_speed']:.2f} m/s, "
              f"from {row['direction']:.0f} of {row['measured_direction']:.0f} deg, off by "
              f"{row['direction_error']:.0f}")  # fmt: skip
    print("  " + ", ".join(f"{k} {v:.3g}" for k, v in record["wind"].items() if k != "rows"))
    print(f"  held-out gain in -2 log likelihood: {record['gain']}")


def wind_table(record: dict) -> str:
    """How well winds are inferred, in the runs that were fitted and in those that were not."""
    parts = {"fitted": True, "not fitted": False}
    rows = []
    for what, key, factor, limit in (
        ("direction, median error, deg", "direction_error", 1.0, "20"),
        ("speed, median error, %", "speed_ratio", 100.0, "25"),
    ):
        for part, fitted in parts.items():
            cells = []
            for one in record.values():
                own = [row for row in one["wind"]["rows"] if row["fitted"] == fitted]
                less = 1.0 if key == "speed_ratio" else 0.0
                cells.append(factor * float(np.median([abs(row[key] - less) for row in own])))
            rows.append((f"{what}, runs {part}", *cells, limit))
    ranks = [one["wind"]["rank_correlation"] for one in record.values()]
    rows.append(("rank correlation of speeds, all runs", *ranks, "ranking right"))
    for what, key in (("measured wind, hull refitted", "informed"), ("inferred wind", "blind")):
        gains = [one["gain"][key] for one in record.values()]
        rows.append((f"held-out gain in -2 log likelihood, {what}", *gains, ""))
    return table(("", *record, "asked"), rows)


def runs_table(record: dict) -> str:
    """The wind of every run, inferred from all channels, beside the measured mean."""
    rows = [
        (row["recording"], "yes" if row["fitted"] else "no",
         f"{row['speed']:.2f} +- {row['speed_std']:.2f}", row["measured_speed"], row["direction"],
         row["measured_direction"], row["direction_error"])
        for row in record["from all channels"]["wind"]["rows"]
    ]  # fmt: skip
    head = ("run", "fitted", "wind, m/s", "measured", "from, deg", "measured", "off, deg")
    return table(head, rows)


def draw(record: dict) -> None:
    """Inferred against measured wind, speed and direction."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for (title, one), colour in zip(record.items(), ("#1f5fa8", "#d1720f"), strict=True):
        rows = one["wind"]["rows"]
        column = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        left.errorbar(
            column["measured_speed"], column["speed"], column["speed_std"], fmt="o",
            color=colour, label=title,
        )  # fmt: skip
        turned = column["measured_direction"] + column["direction_error"]
        right.plot(column["measured_direction"], turned, "o", color=colour)
    top = left.get_xlim()[1]
    left.plot([0, top], [0, top], ":", color="#8a8a8a")
    right.plot([0, 360], [0, 360], ":", color="#8a8a8a")
    left.set(xlabel="measured mean wind, m/s", ylabel="inferred, m/s")
    right.set(xlabel="measured direction (from), deg", ylabel="inferred, deg")
    left.legend(frameon=False, fontsize=8)
    figure.savefig(out_folder("esso_osaka/wind") / "wind.png", dpi=110)


if __name__ == "__main__":
    main()
