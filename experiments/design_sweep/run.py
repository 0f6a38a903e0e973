"""Thrust by mass: 10^5 designs of a twin-thruster craft through the IMO trials, and back."""

from experiments.design_sweep import (
    design_maps,
    independent,
    neighbours,
    plain_loops,
    sweeping,
    wanted,
)
from experiments.design_sweep.loading import KINDS, MASS, STEP, THRUST
from experiments.harness.memory import peak_memory
from experiments.harness.reporting import Experiment, comparison, experiment, limited, table

import numpy as np

from diffsea import Vessel, read_vessel


LIMIT = 5.0  # ship lengths, of the tactical diameter


def main() -> None:
    run = experiment(__file__, __doc__)
    vessel = read_vessel("otter").vessel
    length = float(vessel.rigid_body.length)
    size, kinds = ((8, 8), KINDS[:1]) if run.quick else ((320, 320), KINDS)
    found = sweeping.swept(run, vessel, size, kinds)
    criteria = sweeping.criteria(found, length)
    run.save(design_maps.maps(found, length, KINDS), "maps")
    checks = independent.differences(found, independent.drawn(found, 2 if run.quick else 6))
    run.say("independent simulator done")
    speeds = rates(run, vessel, found)
    beyond = {"independent": checks, "speed": speeds, "sweep": outcomes(found)}
    beyond["memory_gib"] = peak_memory()
    if not run.quick:
        # What is known so far, before what takes longest.
        run.write({"comparison": rows(criteria), "beyond": beyond}, tables(criteria, beyond))
        beyond["prediction"] = predicted(run, vessel, found)
        beyond["front"] = front(run, vessel, found, length)
        beyond["inverse"] = inverse(run, vessel, found, length)
    beyond["memory_gib"] = peak_memory()
    run.write({"comparison": rows(criteria), "beyond": beyond}, tables(criteria, beyond))


def rows(criteria: list[dict]) -> list[dict]:
    """Every IMO criterion: its limit, and what the designs have."""
    return [
        limited(
            c["criterion"], c["unit"], f"at most {c['limit']:g}",
            f"{c['least']:.3g} to {c['most']:.3g}",
            f"MSC.137(76) {c['section']}; {100 * c['share_pass']:.1f} % of the designs pass",
        )
        for c in criteria
    ]  # fmt: skip


def outcomes(found: sweeping.Swept) -> dict:
    return {
        "designs": found.thrust.size * found.mass.size,
        "trials": {
            label: table["outcome"].value_counts().to_dict()
            for label, table in found.tables.items()
        },
        "seconds": found.seconds,
        "share_that_pass_everything": design_maps.share_compliant(found),
    }


def rates(run: Experiment, vessel: Vessel, found: sweeping.Swept) -> dict:
    """Vessel-steps per second of a sweep beside plain loops, one right after the other."""
    kind = KINDS[0] if run.quick else KINDS[2]
    few = 2 if run.quick else 8
    thrusts = np.linspace(*THRUST, few).tolist()
    masses = np.linspace(*MASS, few).tolist()
    plain = plain_loops.timed(independent.document, thrusts, masses, STEP, 100.0)
    sweep = sweeping.rate(vessel, kind, 16 if run.quick else 48)
    run.say("plain loops done")
    return {
        "sweep": sweep, "sweep_by_trial": found.rates, **plain,
        "over_python": sweep / plain["python"], "over_numpy": sweep / plain["numpy"],
    }  # fmt: skip


def predicted(run: Experiment, vessel: Vessel, found: sweeping.Swept) -> dict:
    """First-order predictions of neighbours from exact derivatives."""
    each = 8
    at = neighbours.bases(found, each)
    x = np.stack([np.log(found.thrust[at[1]]), np.log(found.mass[at[0]])], axis=-1)
    run.say("differentiating 64 designs")
    value, slope = neighbours.with_slopes(vessel, x)
    maps = neighbours.truth(found, vessel)[at[0], at[1]]
    offsets = [(s * a, s * b) for s in (-1, 1) for k in (1, 2, 5, 10, 20, 40)
               for a, b in ((0, k), (k, 0), (k, k), (k, -k))]  # fmt: skip
    pairs = neighbours.predictions(found, vessel, at, value, slope, offsets)
    more = neighbours.quantities_ahead(found, vessel, x, value, slope, 1.1)
    kinks = neighbours.kinks_by_quantity(vessel)
    shape = (each, each)
    run.save(
        design_maps.prediction(
            found, pairs, neighbours.QUANTITIES, np.abs(more[:, 0]).reshape(shape),
            found.thrust[at[1]].reshape(shape)[0], found.mass[at[0]].reshape(shape)[:, 0], kinks,
        ),
        "prediction",
    )  # fmt: skip
    result = {"same_as_sweep": float(np.abs(value / maps - 1).max()), "kinks_N": kinks[[0, 2]]}
    for k, name in enumerate(neighbours.QUANTITIES[:3]):
        smooth = ~pairs.crosses[:, k]
        error = np.abs(pairs.error[:, k])
        result[name] = {
            "power_of_step": neighbours.power(pairs.step[smooth], error[smooth]),
            **{
                f"{which}_{percent}": bucket(pairs.step, error, chosen, percent)
                for percent in (1, 5, 10, 20)
                for which, chosen in (("smooth", smooth), ("across", ~smooth))
            },
        }
    return result


def bucket(step: np.ndarray, error: np.ndarray, chosen: np.ndarray, percent: int) -> dict:
    """Median and largest relative error of steps within a third of a size."""
    near = chosen & (np.abs(np.log(100 * step / percent)) < 0.35)
    if not near.any():
        return {"pairs": 0, "median": None, "worst": None}
    return {
        "pairs": int(near.sum()), "median": float(np.median(error[near])),
        "worst": float(error[near].max()),
    }  # fmt: skip


def front(run: Experiment, vessel: Vessel, found: sweeping.Swept, length: float) -> dict:
    """The fastest design of every mass that turns within the limit, and its price."""
    masses = np.linspace(*MASS, 32)
    run.say("searching the front")
    answer = wanted.solve(vessel, [wanted.at_mass("tactical diameter", LIMIT, m) for m in masses])
    x = np.log(np.stack([answer.thrust, answer.mass], axis=-1))
    value, slope = neighbours.with_slopes(vessel, x)
    # On the front d TD = 0: d ln T / d ln m = -TD_m / TD_T, and the speed follows.
    along = -slope[:, 0, 1] / slope[:, 0, 0]
    price = (slope[:, 3, 1] + slope[:, 3, 0] * along) / answer.mass
    result = {
        "mass": answer.mass, "thrust": answer.thrust, "speed": value[:, 3], "slope": price,
        "steps": answer.steps, "solved": answer.solved.tolist(),
        "worst_residual": float(answer.residual.max()),
        "slope_by_differences": np.gradient(value[:, 3], answer.mass),
        "off_grid_contour_N": contour_gap(found, length, answer),
    }  # fmt: skip
    run.save(design_maps.verdicts(found, length, KINDS, result), "front")
    return result


def contour_gap(found: sweeping.Swept, length: float, answer: wanted.Found) -> float:
    """Largest distance (N) of the front from the limit interpolated on the grid."""
    diameter = found.column(KINDS[0], "tactical_diameter") / length
    gaps = []
    for thrust, mass in zip(answer.thrust, answer.mass, strict=True):
        row = np.array([np.interp(mass, found.mass, diameter[:, j])
                        for j in range(found.thrust.size)])  # fmt: skip
        first = int(np.argmax(row > LIMIT))
        gaps.append(abs(np.interp(LIMIT, row[first - 1 : first + 1],
                                  found.thrust[first - 1 : first + 1]) - thrust))  # fmt: skip
    return float(np.max(gaps))


def inverse(run: Experiment, vessel: Vessel, found: sweeping.Swept, length: float) -> dict:
    """Thrust and mass from a wanted tactical diameter and overshoot, and back."""
    drawn = independent.drawn(found, 32, seed=1)
    maps = neighbours.truth(found, vessel).reshape(-1, len(neighbours.QUANTITIES))[drawn]
    run.say("inverse design")
    coarse = neighbours.bases(found, 6)
    known = np.log(np.stack([found.thrust[coarse[1]], found.mass[coarse[0]]], axis=-1))
    answer = wanted.solve(vessel, [wanted.both(row[0], row[2]) for row in maps], known)
    table_ = found.tables[KINDS[0].label].iloc[drawn]
    thrust, mass = table_["thrust"].to_numpy(), table_["mass"].to_numpy()
    same = np.hypot(answer.thrust / thrust - 1, answer.mass / mass - 1) < 1e-4
    check = []
    for k in np.flatnonzero(answer.solved)[:3]:
        design = (float(answer.thrust[k]), float(answer.mass[k]))
        circle = independent.trial(KINDS[0], *design)
        zigzag = independent.trial(KINDS[2], *design)
        check.append(
            {
                "wanted": maps[k][[0, 2]], "thrust": design[0], "mass": design[1],
                "independent": [circle["tactical_diameter"] / length,
                                float(np.degrees(zigzag["overshoot_1"]))],
            }
        )  # fmt: skip
    return {
        "wishes": len(drawn), "solved": int(answer.solved.sum()),
        "same_design": int((same & answer.solved).sum()),
        "another_design": int((~same & answer.solved).sum()),
        "median_steps": float(np.median(answer.steps[answer.solved])),
        "worst_residual": float(answer.residual[answer.solved].max()),
        "designs": [
            {"thrust": thrust[k], "mass": mass[k], "found_thrust": answer.thrust[k],
             "found_mass": answer.mass[k], "solved": bool(answer.solved[k]),
             "steps": int(answer.steps[k])}
            for k in range(len(drawn))
        ],
        "independent": check,
    }  # fmt: skip


def tables(criteria: list[dict], beyond: dict) -> dict[str, str]:
    result = {"comparison": comparison(rows(criteria)), "speed": speed_table(beyond["speed"])}
    result["independent"] = independent_table(beyond["independent"])
    if "prediction" in beyond:
        result["prediction"] = prediction_table(beyond["prediction"])
        result["inverse"] = inverse_table(beyond["inverse"])
        result["front"] = front_table(beyond["front"])
    result["whole"] = whole_table(beyond)
    return result


def whole_table(beyond: dict) -> str:
    sweep = beyond["sweep"]
    lines = [
        ("designs", str(sweep["designs"])),
        *((f"{label}: outcome", ", ".join(f"{n} {o}" for o, n in found.items()))
          for label, found in sweep["trials"].items()),
        *((f"{label}: s, with compiling", f"{s:.0f}") for label, s in sweep["seconds"].items()),
        ("pass every criterion", f"{100 * sweep['share_that_pass_everything']:.1f} %"),
        ("largest memory, GiB", f"{beyond['memory_gib']:.2f}"),
    ]  # fmt: skip
    return table(("", ""), lines)


def speed_table(speed: dict) -> str:
    lines = [
        ("`diffsea.studies.sweep`, event located, float64", f"{speed['sweep']:.2g}", "1"),
        ("NumPy, 4096 designs at once, flipped at the sample", f"{speed['numpy']:.2g}",
         f"{speed['over_numpy']:.3g}"),
        ("plain Python, flipped at the sample", f"{speed['python']:.2g}",
         f"{speed['over_python']:.3g}"),
    ]  # fmt: skip
    return table(("", "vessel-steps per second", "the sweep is faster by"), lines)


def independent_table(checks: list[dict]) -> str:
    lines = []
    for key in dict.fromkeys((c["trial"], c["number"]) for c in checks):
        found = [abs(c["relative_difference"]) for c in checks if (c["trial"], c["number"]) == key]
        lines.append((*key, str(len(found)), f"{max(found):.1e}"))
    return table(("trial", "number", "designs", "largest relative difference"), lines)


def prediction_table(found: dict) -> str:
    lines = []
    for name in neighbours.QUANTITIES[:3]:
        for which, label in (("smooth", "no"), ("across", "yes")):
            cells = [in_percent(found[name][f"{which}_{p}"]) for p in (1, 5, 10, 20)]
            lines.append((name, label, *cells))
    head = (
        "error, %: median (worst)",
        "saturates between",
        *(f"step {p} %" for p in (1, 5, 10, 20)),
    )
    return table(head, lines)


def in_percent(entry: dict) -> str:
    """Median and worst error of a bucket in per cent."""
    if entry["median"] is None:
        return "-"
    return f"{100 * entry['median']:.2g} ({100 * entry['worst']:.2g})"


def inverse_table(found: dict) -> str:
    lines = [
        ("wishes: (tactical diameter, overshoot) of designs drawn at random", str(found["wishes"])),
        ("solved", str(found["solved"])),
        ("... to the design they were drawn from", str(found["same_design"])),
        ("... to another design with the same two numbers", str(found["another_design"])),
        ("Newton steps, median", f"{found['median_steps']:g}"),
        ("largest residual (L, deg)", f"{found['worst_residual']:.1e}"),
    ]
    for check in found["independent"]:
        lines.append((
            f"wanted {check['wanted'][0]:.5f} L, {check['wanted'][1]:.5f} deg: "
            f"{check['thrust']:.3f} N, {check['mass']:.3f} kg; the independent simulator has",
            f"{check['independent'][0]:.5f} L, {check['independent'][1]:.5f} deg",
        ))  # fmt: skip
    return table(("", ""), lines)


def front_table(found: dict) -> str:
    chosen = np.linspace(0, len(found["mass"]) - 1, 6).round().astype(int)
    lines = [
        (f"{found['mass'][k]:.0f}", f"{found['thrust'][k]:.2f}", f"{found['speed'][k]:.4f}",
         f"{1e3 * found['slope'][k]:.3f}", f"{1e3 * found['slope_by_differences'][k]:.3f}")
        for k in chosen
    ]  # fmt: skip
    head = ("mass, kg", "thrust, N", "speed, m/s", "mm/s per kg, exact", "by differences along it")
    return table(head, lines)


if __name__ == "__main__":
    main()
