"""Overshoots against every derivative: exact, by differences, by the naive scheme, globally."""

from typing import Any

from experiments.harness.reporting import Experiment, comparison, experiment, limited, table
from experiments.overshoot_sensitivity import at_the_sample, charts, differences, global_analysis
from experiments.overshoot_sensitivity.trial_lanes import (
    CIRCLE_NUMBERS,
    TRIALS,
    ZIGZAG_NUMBERS,
    Bench,
    Case,
    jacobian,
    labels,
)

import numpy as np

from diffsea.metrics.imo import first_overshoot_limit, second_overshoot_limit


OTTER = Case("otter", 2.0, 1.0, 0.05)
TANKER = Case("kvlcc2", 7.0, 1.179, 0.2)
QUICK = Case("otter", 2.0, 1.0, 0.05, circle=False)
BASES = {"otter": 256, "kvlcc2": 128}  # Saltelli's N
WIDTHS = {"otter": (0.1, 0.3), "kvlcc2": (0.1,)}
SAMPLE_STEPS = (0.2, 0.02)  # s
RAD = np.pi / 180


def main() -> None:
    run = experiment(__file__, __doc__)
    cases = (QUICK,) if run.quick else (OTTER, TANKER)
    results, rows, figures = {"vessels": {}}, [], {"tornado": [], "steps": [], "global": []}
    for case in cases:
        bench = Bench(case)
        run.say(f"{case.name}: {len(bench.factors)} parameters")
        local = [jacobian(bench, k) for k in range(3 if case.circle else 2)]
        found = {"exact": exact_table(bench, local)}
        rows += limits(bench, local)
        figures["tornado"].append((case.name, tornado_entries(bench, local)))
        run.say("finite differences")
        found["differences"] = by_differences(run, bench, local, figures["steps"])
        run.say("global analysis")
        found["global"] = globally(run, bench, local, figures["global"])
        if case.name == "otter":
            run.say("the naive scheme")
            found["at_the_sample"] = naively(run, bench, local)
        results["vessels"][case.name] = found
    run.save(charts.tornado(figures["tornado"]), "tornado")
    run.save(charts.step_errors(figures["steps"]), "differences")
    run.save(charts.local_and_global(figures["global"]), "local_global")
    write(run, results, rows)


def exact_table(bench: Bench, local: list) -> dict:
    """Numbers and derivatives by trial, number and parameter; elasticities beside them."""
    names, result = labels(bench.factors), {}
    for trial, (value, slope) in zip(TRIALS, local, strict=False):
        for number, k in wanted(bench, trial):
            derivative = {
                factor.label: slope[i, k] / factor.value for i, factor in enumerate(bench.factors)
            }
            result[f"{trial} {number}"] = {
                "value": value[k],
                "elasticity": dict(zip(names, slope[:, k] / value[k], strict=True)),
                "derivative": derivative,
            }
    return result


def wanted(bench: Bench, trial: str) -> list[tuple[str, int]]:
    """The numbers of a trial and their columns."""
    names = CIRCLE_NUMBERS if trial.startswith("circle") else ZIGZAG_NUMBERS
    return [(name, bench.case.numbers.index(name)) for name in names]


def tornado_entries(bench: Bench, local: list) -> list:
    names, entries = labels(bench.factors), []
    for trial, number in (
        (0, "overshoot_1"), (0, "overshoot_2"), (1, "overshoot_1"), (1, "peak_yaw_rate"),
        (2, "tactical_diameter"),
    ):  # fmt: skip
        if trial < len(local):
            value, slope = local[trial]
            k = bench.case.numbers.index(number)
            title = f"{TRIALS[trial].removeprefix('zigzag ')} {charts.TITLES[number]}"
            entries.append((title, names, slope[:, k] / value[k]))
    return entries


def limits(bench: Bench, local: list) -> list[dict]:
    """The overshoots beside the limits of MSC.137(76) at this L/V."""
    passing = bench.case.length / bench.case.speed
    k = bench.case.numbers.index
    criteria = (
        ("10/10 first overshoot", local[0][0][k("overshoot_1")], first_overshoot_limit(passing)),
        ("10/10 second overshoot", local[0][0][k("overshoot_2")], second_overshoot_limit(passing)),
        ("20/20 first overshoot", local[1][0][k("overshoot_1")], 25 * RAD),
    )
    rows = [
        limited(f"{bench.case.name}: {name}", "deg", f"at most {limit / RAD:g}", value / RAD,
                 "IMO MSC.137(76) 5.3.3")
        for name, value, limit in criteria
    ]  # fmt: skip
    if bench.case.circle:
        diameter = local[2][0][k("tactical_diameter")] / bench.case.length
        rows.append(limited(f"{bench.case.name}: tactical diameter", "L", "at most 5", diameter,
                             "IMO MSC.137(76) 5.3.1"))  # fmt: skip
    return rows


def by_differences(run: Experiment, bench: Bench, local: list, figures: list) -> dict:
    """Central differences of the 10/10 and 20/20 numbers at many steps, beside the exact ones."""
    steps = differences.STEPS
    chosen = list(range(len(bench.factors)))
    columns, result = [bench.case.numbers.index(name) for name in ZIGZAG_NUMBERS], {}
    for trial in range(1 if run.quick else 2):
        approximate = differences.central(bench, trial, chosen, steps)[:, :, columns]
        error = differences.errors(approximate, local[trial][1][:, columns])
        for k, name in enumerate(ZIGZAG_NUMBERS):
            entry = differences.best(steps, error[:, :, k])
            entry["order"] = differences.order(steps, np.array(entry["median_error"]))
            result[f"{TRIALS[trial]} {name}"] = entry
        if trial == 0 or bench.case.name == "kvlcc2":
            title = f"{bench.case.name}: {TRIALS[trial]} first overshoot"
            figures.append((title, steps, np.maximum(error[:, :, 0], 1e-16)))
    return result


def naively(run: Experiment, bench: Bench, local: list) -> dict:
    """Derivatives of the scheme that flips at the sample, and a staircase beside the truth."""
    names, count = labels(bench.factors), len(bench.factors)
    exact = local[1][1][:, bench.case.numbers.index("overshoot_1")]
    result, slopes = {"exact_deg": dict(zip(names, exact / RAD, strict=True))}, {}
    for step in SAMPLE_STEPS[:1] if run.quick else SAMPLE_STEPS:
        value, slope = at_the_sample.sampled(
            bench, 20 * RAD, step, np.zeros((count, count)), np.eye(count)
        )
        wrong = at_the_sample.signs_that_differ(slope, exact)
        slopes[step] = slope / RAD
        result[f"{step:g} s"] = {
            "overshoot_deg": value[0] / RAD,
            "derivative_deg": dict(zip(names, slope / RAD, strict=True)),
            "wrong_sign": [names[k] for k in wrong],
            "median_relative_error": float(
                np.median(np.abs(slope - exact)[exact != 0] / np.abs(exact[exact != 0]))
            ),
        }
    result["overshoot_deg"] = local[1][0][bench.case.numbers.index("overshoot_1")] / RAD
    run.save(charts.naive(stairs(run, bench), names, exact / RAD, slopes), "at_the_sample")
    return result


def stairs(run: Experiment, bench: Bench) -> dict:
    """First overshoot (deg) of the 20/20 over a range of one parameter, both ways."""
    names = labels(bench.factors)
    at = names.index("thrusters.time_constant")
    x = np.linspace(-0.3, 0.3, 16 if run.quick else 241)
    points = np.outer(x, np.eye(len(names))[at])
    steps = SAMPLE_STEPS[:1] if run.quick else SAMPLE_STEPS
    k = bench.case.numbers.index("overshoot_1")
    return {
        "parameter": names[at], "x": x,
        "located": bench.run(points, None, 1).value[:, k] / RAD,
        "sampled": {
            step: at_the_sample.sampled(bench, 20 * RAD, step, points)[0] / RAD for step in steps
        },
    }  # fmt: skip


def globally(run: Experiment, bench: Bench, local: list, figures: list) -> dict:
    """Sobol indices over boxes of relative changes, beside the shares from the derivatives."""
    names, result = labels(bench.factors), {}
    base = 8 if run.quick else BASES[bench.case.name]
    for width in WIDTHS[bench.case.name][: 1 if run.quick else None]:
        points = global_analysis.sampled(bench, width, base)
        for trial in range(1 if run.quick else len(local)):
            found = global_analysis.indices(bench, width, points, trial)
            for number, k in wanted(bench, TRIALS[trial]):
                value, slope = local[trial][0][k], local[trial][1][:, k]
                shares, entry = global_analysis.local_shares(slope), found[number]
                key = f"{TRIALS[trial]} {number} +-{100 * width:g} %"
                result[key] = {
                    **{n: dict(zip(names, entry[n], strict=True)) for n in ("S1", "ST")},
                    "local": dict(zip(names, shares, strict=True)),
                    "disagreements": global_analysis.disagreements(names, shares, entry),
                    "interactions": float(1 - entry["S1"].sum()),
                    "rank_correlation": rank_correlation(shares, entry["ST"]),
                    "std_sampled": entry["std"],
                    "std_from_derivatives": float(np.linalg.norm(slope) * width / np.sqrt(3)),
                    "mean_shift": float(entry["mean"] / value - 1),
                    "incomplete": entry["incomplete"],
                    "runs": entry["runs"],
                }
                if (trial, number) == (min(1, len(local) - 1), "overshoot_1") or run.quick:
                    title = f"{bench.case.name}: {TRIALS[trial]} {charts.TITLES[number]},\n"
                    title += f"parameters ±{100 * width:g} %"
                    figures.append((title, names, shares, entry))
    return result


def rank_correlation(local: np.ndarray, total: np.ndarray, least: float = 0.005) -> float:
    """Spearman's, over the factors that hold more than `least` of the variance either way."""
    from scipy.stats import spearmanr

    kept = np.maximum(local, total) > least
    found: Any = spearmanr(local[kept], total[kept])
    return float(found.statistic)


def write(run: Experiment, results: dict, rows: list[dict]) -> None:
    vessels = results["vessels"]
    tables = {
        "comparison": comparison(rows),
        "strongest": strongest_table(vessels),
        "differences": differences_table(vessels),
        "naive": naive_table(vessels["otter"]["at_the_sample"]),
        "global": global_table(vessels),
        "disagreements": disagreement_table(vessels),
    }
    beyond = {name: found for name, found in vessels.items()}
    run.write({"comparison": rows, "beyond": beyond}, tables)


def strongest_table(vessels: dict) -> str:
    lines = []
    for name, found in vessels.items():
        for number, entry in found["exact"].items():
            row = entry["elasticity"]
            strongest = sorted(row, key=lambda key: -abs(row[key]))[:5]
            unit, scale = unit_of(number)
            lines.append((name, number, f"{entry['value'] * scale:.4g} {unit}",
                          ", ".join(f"{key} {row[key]:+.3f}" for key in strongest)))  # fmt: skip
    return table(("vessel", "number", "value", "% per 1 % of the strongest parameters"), lines)


def unit_of(number: str) -> tuple[str, float]:
    if number.endswith("diameter"):
        return "m", 1.0
    return ("deg/s" if number.endswith("rate") else "deg"), 1 / RAD


def differences_table(vessels: dict) -> str:
    lines = []
    for name, found in vessels.items():
        for number, entry in found["differences"].items():
            powers = np.round(np.log10(entry["steps"]), 1)
            errors = dict(zip(powers, entry["median_error"], strict=True))
            shown = [f"{errors[k]:.1e}" for k in (-1, -3, -5, -9)]
            best = (f"{entry['best_step']:.0e}", f"{entry['worst_error_at_best']:.1e}")
            lines.append((name, number, *shown, *best))
    head = ("vessel", "number", "h = 0.1", "1e-3", "1e-5", "1e-9", "best h", "worst there")
    return table(head, lines)


def naive_table(found: dict) -> str:
    steps = [key for key in found if key.endswith(" s")]
    exact = found["exact_deg"]
    shown = sorted(exact, key=lambda key: -abs(exact[key]))
    lines = [("first overshoot, deg", found["overshoot_deg"],
              *(found[s]["overshoot_deg"] for s in steps))]  # fmt: skip
    for name in shown:
        if abs(exact[name]) > 1e-9:
            cells = []
            for step in steps:
                slope = found[step]["derivative_deg"][name]
                wrong = name in found[step]["wrong_sign"]
                cells.append(f"**{slope:.4g}**" if wrong else f"{slope:.4g}")
            lines.append((f"d / d ln {name}, deg", exact[name], *cells))
    return table(("", "exact", *(f"at the sample, {s}" for s in steps)), lines)


def global_table(vessels: dict) -> str:
    lines = []
    for name, found in vessels.items():
        for key, entry in found["global"].items():
            ratio = entry["std_from_derivatives"] / entry["std_sampled"]
            lines.append((name, key, str(entry["runs"]), f"{entry['rank_correlation']:.3f}",
                          f"{entry['interactions']:.3f}", f"{ratio:.3f}",
                          f"{100 * entry['mean_shift']:+.2f} %"))  # fmt: skip
    head = ("vessel", "number and range", "runs", "rank correlation", "1 - sum of S1",
            "std: derivatives / sampled", "mean - nominal")  # fmt: skip
    return table(head, lines)


def disagreement_table(vessels: dict) -> str:
    lines = []
    for name, found in vessels.items():
        for key, entry in found["global"].items():
            for row in entry["disagreements"][:3]:
                lines.append((name, key, row["parameter"], row["local"], row["S1"],
                              f"{row['ST']:.3f} ± {row['ST_conf']:.3f}",
                              f"{row['local_rank']} / {row['global_rank']}"))  # fmt: skip
    head = ("vessel", "number and range", "parameter", "local share", "S1", "ST", "rank here/there")
    return table(head, lines)


if __name__ == "__main__":
    main()
