"""Does the p-value of a diagnosis's first look come out as often as it says?"""

import tempfile
from pathlib import Path

from experiments.concealed import draw
from experiments.concealed.generate import write_case
from experiments.harness.reporting import Experiment, experiment, panels, table

import numpy as np
from scipy.stats import binomtest, kstest

from diffsea import read_recording, read_vessel
from diffsea.diagnosis.bootstrap import LEAST_DRAWS, Bootstrap, bootstrap
from diffsea.diagnosis.screening import candidate_effects
from diffsea.identification.coordinates import free_by_default
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem


LEVELS = (0.01, 0.05, 0.1, 0.5)


def main() -> None:
    run = experiment(__file__, __doc__)
    plan = draw.plan("scored", draw.SETS["scored"].count, draw.SETS["scored"].seed)
    clean = [c for c in plan if c["stratum"] == "clean"]
    hulls = sorted({c["hull"] for c in clean})[: 1 if run.quick else None]
    results = {}
    for hull in hulls:
        case = next(c for c in clean if c["hull"] == hull)
        drawn = nothing_missing(run, case, LEAST_DRAWS)
        results[hull] = {"case": case["id"], "draws": drawn.draws,
                         "strongest": drawn.strongest, "located": drawn.located}  # fmt: skip
        run.write({"hulls": results, "rates": rates(results)}, {"rates": rates_table(results)})
    run.save(figure(results), "p_values")


def nothing_missing(run: Experiment, case: dict, draws: int) -> Bootstrap:
    """First-order p-values in data drawn from the model fitted to a clean case."""
    with tempfile.TemporaryDirectory() as work:
        write_case(case, Path(work))
        here = Path(work) / "cases" / case["id"]
        vessel = read_vessel(here / "vessel.toml").vessel
        recordings = tuple(read_recording(p) for p in sorted((here / "train").glob("*.csv")))
    free = free_by_default(vessel)
    effects = candidate_effects(vessel, list(recordings))
    problem = make_problem(vessel, list(recordings), free, effects)
    nominal = estimate(problem, free)
    tell = lambda message: run.say(f"{case['hull']}: {message}")
    return bootstrap(problem, nominal, draws, tell)


def rates(results: dict) -> list[dict]:
    """How often each kind of p-value comes out below each level, all hulls together."""
    found = []
    for kind in ("strongest", "located"):
        p = np.concatenate([np.asarray(r[kind]) for r in results.values()])
        for level in LEVELS:
            low, high = binomtest(int((p <= level).sum()), len(p)).proportion_ci(method="wilson")
            found.append({"kind": kind, "level": level, "hits": int((p <= level).sum()),
                          "n": len(p), "low": low, "high": high})  # fmt: skip
    return found


def rates_table(results: dict) -> str:
    """By level and, for the distance from uniform, by hull."""
    lines = [
        (f"{r['kind']}, p at most {r['level']:g}", f"{r['hits']}/{r['n']}",
         f"{100 * r['hits'] / r['n']:.1f} % ({100 * r['low']:.1f} to {100 * r['high']:.1f})")
        for r in rates(results)
    ]  # fmt: skip
    for hull, r in results.items():
        test = kstest(r["strongest"], "uniform")
        lines.append((f"{hull}: largest distance from uniform", str(r["draws"]),
                      f"{test.statistic:.3f} (p = {test.pvalue:.2g})"))  # fmt: skip
    return table(("", "data sets", "found (Wilson 95 %)"), lines)


def figure(results: dict):
    """Observed against stated p-values, both axes logarithmic."""
    drawing, axes = panels(1, 1, 5.0, 4.5)
    ax = axes[0, 0]
    for hull, r in results.items():
        p = np.sort(np.asarray(r["strongest"]))
        ax.loglog(p, (1 + np.arange(len(p))) / (1 + len(p)), marker=".", label=hull)
    ax.loglog([1e-3, 1], [1e-3, 1], "k--", linewidth=1, label="as stated")
    ax.set(xlabel="p-value stated", ylabel="share of data sets at or below it",
           xlim=(1e-3, 1), ylim=(3e-3, 1))  # fmt: skip
    ax.legend()
    return drawing


if __name__ == "__main__":
    main()
