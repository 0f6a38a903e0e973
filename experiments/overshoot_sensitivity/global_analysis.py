"""Variance-based global sensitivities by SALib, beside what the derivatives alone would say."""

from experiments.overshoot_sensitivity.trial_lanes import Bench, labels

import numpy as np
from jaxtyping import Float
from SALib.analyze import sobol as analysis
from SALib.sample import sobol as sampling


def problem(bench: Bench, width: float) -> dict:
    """Every factor uniform in its logarithm within +-width."""
    names = labels(bench.factors)
    return {"num_vars": len(names), "names": names, "bounds": [[-width, width]] * len(names)}


def sampled(bench: Bench, width: float, base: int, seed: int = 0) -> np.ndarray:
    """Saltelli's points: base (factors + 2) of them."""
    return sampling.sample(problem(bench, width), base, calc_second_order=False, seed=seed)


def indices(
    bench: Bench, width: float, points: np.ndarray, trial: int, seed: int = 0
) -> dict[str, dict]:
    """Sobol indices of every number: first order S1, total ST, their 95 % half-widths.

    Runs that were not completed take the median of the others; their share is told.
    """
    found = bench.run(points, None, trial)
    result = {}
    for k, number in enumerate(bench.case.numbers):
        column = found.value[:, k]
        good = np.isfinite(column) & found.completed
        if not good.any():
            continue
        filled = np.where(good, column, np.median(column[good]))
        spread = analysis.analyze(problem(bench, width), filled, calc_second_order=False, seed=seed)
        result[number] = {
            **{name: np.asarray(spread[name]) for name in ("S1", "ST", "S1_conf", "ST_conf")},
            "incomplete": float(1 - good.mean()),
            "mean": float(filled.mean()),
            "std": float(filled.std()),
            "runs": len(points),
        }
    return result


def local_shares(slope: Float[np.ndarray, "factor"]) -> Float[np.ndarray, "factor"]:
    """Shares of variance if the number were linear: squares of the derivatives, over their sum."""
    return slope**2 / np.sum(slope**2)


def ranks(shares: Float[np.ndarray, "factor"]) -> np.ndarray:
    """Place of every factor, 1 the strongest."""
    place = np.empty(len(shares), int)
    place[np.argsort(-shares, kind="stable")] = np.arange(1, len(shares) + 1)
    return place


def disagreements(names: list[str], local: np.ndarray, found: dict, least: float = 0.01) -> list:
    """Factors whose total share differs from the local one by more than its uncertainty."""
    rows = []
    here, there = ranks(local), ranks(found["ST"])
    for k, name in enumerate(names):
        gap = found["ST"][k] - local[k]
        if abs(gap) > max(found["ST_conf"][k], least):
            rows.append(
                {
                    "parameter": name, "local": local[k], "S1": found["S1"][k],
                    "ST": found["ST"][k], "ST_conf": found["ST_conf"][k],
                    "local_rank": int(here[k]), "global_rank": int(there[k]),
                }
            )  # fmt: skip
    return sorted(rows, key=lambda row: -abs(row["ST"] - row["local"]))
