"""Results as plain numbers, and the README's tables."""

from experiments.harness.reporting import compared, comparison, table

import numpy as np


def results(
    service: dict, repeats: dict, errors: dict, real: dict, real_repeats: dict, further: dict
) -> dict:
    """What is written down: series and models left out."""
    ferry = {k: v for k, v in service.items() if k not in ("series", "model", "found")}
    days = {k: v for k, v in repeats.items() if k != "series"}
    recorded, repeated = (
        {name: {k: v for k, v in part.items() if k != "series"} for name, part in sets.items()}
        for sets in (real, real_repeats)
    )
    return {
        "comparison": _compared(ferry, days),
        "case_1": ferry,
        "case_2": days,
        "averaging": errors,
        "recorded": recorded,
        "real_repeats": repeated,
        "beyond": {k: v for k, v in further.items() if k != "series"},
    }


def _compared(ferry: dict, days: dict) -> list[dict]:
    first, checks = ferry["metamodels"][0], ferry["validation"]
    group, speeds, models = days["days"], days["speeds"], days["validation"]
    return [
        compared("case 1: groups of zig-zag-like trials", "", 3, len(ferry["group_sizes"])),
        compared("trials used, least side wind", "", 12, 12, "chosen, not obtained"),
        compared("a1 of the metamodel", "1/s", "positive", first["coefficients"]["a1"]),
        compared("cross-validation", "%", "in a figure only", first["cross_validation_percent"],
                 "one calm trial put aside, as published"),
        compared("the same, all other trials, median", "%", None,
                 first["others_percent"]["median"]),
        compared("rudder angles", "deg", "up to 5", first["largest_rudder_deg"]),
        compared("scatter of trials of group 1 about their mean: speed ahead", "%", "similar",
                 first["scatter_percent"]["u"], "rms over that of the mean"),
        compared("the same of sway velocities", "%", "similar", first["scatter_percent"]["v"]),
        compared("the same of yaw rates", "%", "similar", first["scatter_percent"]["r"]),
        compared("the same of rudder angles", "%", "more", first["scatter_percent"]["rudder"]),
        compared("model 1 (planar motion tests) against metamodel", "%", 67.0,
                 checks["model 1"]["against_metamodel_percent"]),
        compared("model 2 (from dimensions) against metamodel", "%", 35.0,
                 checks["model 2"]["against_metamodel_percent"]),
        compared("case 2: neutral rudder, group 1", "deg", 0.46, group["group 1"]["neutral_deg"],
                 "port is negative here"),
        compared("neutral rudder, group 2", "deg", 0.46, group["group 2"]["neutral_deg"],
                 "likewise"),
        compared("fit to a benchmark trial, metamodels of groups 1 / 2", "%", "nearly identical",
                 " / ".join(f"{v:.1f}" for v in days["benchmark_percent"].values())),
        *_to_12(days["to_12"]),
        *_over_days(group, days["to_12"]),
        compared("loss of yaw rate at 0.75 of the speed, metamodels", "%", 25.0,
                 speeds["metamodels"]),
        compared("the same, simulation model", "%", 30.0,
                 models["model 2"]["reduction_percent"], "model 2"),
        compared("simulation model against metamodel, full speed", "%", 64.4,
                 models["model 2"]["full_speed_percent"], "model 2"),
        compared("the same, low speed", "%", 62.3, models["model 2"]["low_speed_percent"],
                 "model 2"),
    ]  # fmt: skip


def _to_12(found: dict) -> list[dict]:
    """The ideal 10/12 to port beside the intervals of the trials' means."""
    return [
        compared(f"ideal 10/12 to port, {name}: overshoots", "deg", "within 95 % of the means",
                 " / ".join(f"{value:.2f}" for value in one["overshoots_deg"]),
                 f"{sum(one['within'])} of 2 within")
        for name, one in found.items()
    ]  # fmt: skip


def _over_days(days: dict, to_12: dict) -> list[dict]:
    """How many overshoots of ideal trials are within the intervals, over all repeated days."""
    rows = [
        compared(f"ideal 10/12 to port over repeated days, {name}: within 95 % of the means", "",
                 "all", one["share_within"], "share of overshoots")
        for name, one in to_12.items()
    ]  # fmt: skip
    return rows + [
        compared(f"ideal 10/10 to either side, likewise, {name}", "", None,
                 day["metamodel_within"], "share of overshoots")
        for name, day in days.items()
    ]  # fmt: skip


def tables(out: dict) -> dict[str, str]:
    """The README's tables by their keys."""
    return {
        "COMPARISON": comparison(out["comparison"]),
        "METAMODELS": _metamodels(out["case_1"]),
        "DAYS": _days(out["case_2"]),
        "MODELS": _models(out["case_1"], out["case_2"]),
        "AVERAGING": _averaging(out["averaging"]),
        **_real(out["recorded"], out["real_repeats"]),
        **{key: _rows(rows) for key, rows in out["beyond"].get("tables", {}).items()},
    }


def _metamodels(ferry: dict) -> str:
    head = ("group", "trials", "side wind", "T, s", "K, 1/s", "neutral, deg", "calm trial aside, %",
            "others: median, %", "first overshoot 10/10 stbd, deg")  # fmt: skip
    rows = []
    for number, row in enumerate(ferry["metamodels"], 1):
        size = f"{number}, of {ferry['group_sizes'][number - 1]}"
        calm = f"up to {row['largest_side_wind']:.1f} m/s"
        rows.append((size, "12 calmest", calm, *_numbers(row), row["others_percent"]["median"],
                     row["ideal_overshoots_deg"][0][0]))  # fmt: skip
        for key, trials in (("without_wind_exclusion", "12 of any wind"),
                            ("worst_fits_dropped", "the 8 of them that fit best")):  # fmt: skip
            some = row[key]
            first = some["ideal_overshoots_deg"][0][0]
            rows.append((size, trials, "any", *_numbers(some), None, first))
    return table(head, rows)


def _numbers(row: dict) -> tuple:
    a = row["coefficients"]
    return 1 / a["a1"], a["b"] / a["a1"], row["neutral_deg"], row["cross_validation_percent"]


def _days(days: dict) -> str:
    head = (
        "",
        "first execute",
        "overshoot",
        "mean, deg",
        "U95, deg",
        "metamodel, deg",
        "truth, deg",
    )
    rows = []
    for day, record in days["days"].items():
        for s, (side, both) in enumerate(record["intervals"].items()):
            for k, (name, entry) in enumerate(both.items()):
                asked, true = record["ideal_overshoots_deg"][s][k], days["truth_deg"][s][k]
                rows.append(
                    (day, side.split()[0], name, entry["mean_deg"], entry["u95_deg"], asked, true)
                )
    return table(head, rows)


def _models(ferry: dict, days: dict) -> str:
    head = ("", "case 1, %", "the same against the ship, %", "case 2, full speed, %",
            "case 2, low speed, %", "loss of yaw rate, %")  # fmt: skip
    rows = []
    for name, row in ferry["validation"].items():
        if name in days["validation"]:
            two = days["validation"][name]
            rows.append((name, row["against_metamodel_percent"], row["against_ship_percent"],
                         two["full_speed_percent"], two["low_speed_percent"],
                         two["reduction_percent"]))  # fmt: skip
    return table(head, rows)


def _averaging(errors: dict) -> str:
    counts = errors["counts"]
    head = ("control", "wind, m/s", "method", *(f"N = {n}" for n in counts), "bias, N largest")
    rows = []
    for control, winds in errors["errors"].items():
        for wind, methods in winds.items():
            for method, scores in methods.items():
                rows.append((control, wind, method, *scores["rms"], scores["bias"][-1]))
    return table(head, rows)


def _real(real: dict, repeats: dict) -> dict[str, str]:
    """Tables of real trials, none where no recordings are."""
    if not real:
        return {}
    return {
        "RECORDED": _recorded(real),
        "REAL_REPEATS": _repeated(repeats),
        "REAL_REPEATS_ERRORS": _repeated_errors(repeats),
    }


def _recorded(real: dict) -> str:
    head = ("trial", "wind, m/s", "speed, m/s", "left out: fit, %", "overshoots measured, deg",
            "predicted, deg", "alone: fit, %", "alone: neutral rudder, deg")  # fmt: skip
    rows = []
    for part in real.values():
        for name, row in part["trials"].items():
            both = [_pair(row[k]) for k in ("measured_deg", "predicted_deg")]
            alone = row["alone"]
            rows.append((name, row["wind"], row["speed"], row["percent"], *both,
                         alone["percent"], alone["neutral_deg"]))  # fmt: skip
    return table(head, rows)


def _repeated(repeats: dict) -> str:
    head = ("kept back", "", "overshoots, deg", "times between executes, s",
            "overshoots off, deg rms", "times off, % rms", "heading off, deg rms")  # fmt: skip
    rows = []
    for part in repeats.values():
        for row in part["trials"]:
            told = row["measured"]
            rows.append((row["name"], "measured", _pair(told["overshoots_deg"]),
                         _pair(told["times"]), None, None, None))  # fmt: skip
            for method, said in row["methods"].items():
                rows.append((row["name"], method, _pair(said["overshoots_deg"]),
                             _pair(said["times"]), *said["errors"].values()))  # fmt: skip
    return table(head, rows)


def _repeated_errors(repeats: dict) -> str:
    head = ("set", "method", "overshoots, deg", "times between executes, %", "heading, deg")
    return table(head, [
        (name, method, *errors.values())
        for name, part in repeats.items() for method, errors in part["errors"].items()
    ])  # fmt: skip


def _pair(values) -> str:
    """Two numbers beside each other, dashes for what there is not."""
    known = [None if x is None or not np.isfinite(x) else x for x in values]
    return (
        "-"
        if known == [None, None]
        else " / ".join("-" if x is None else f"{x:.1f}" for x in known)
    )


def _rows(rows: list[dict]) -> str:
    return table(list(rows[0]), [list(row.values()) for row in rows])
