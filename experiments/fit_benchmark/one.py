"""One contestant in a process of its own: its first fit, its second, and what they found."""

import time


BEGAN = time.perf_counter()

import argparse
import importlib
import json
import os
import resource
from pathlib import Path


CONTESTANTS = {  # module and function
    "diffsea free run": ("with_diffsea", "free_run"),
    "diffsea one shot": ("with_diffsea", "one_shot"),
    "diffsea innovations": ("with_diffsea", "innovations"),
    "optimistix": ("with_diffsea", "optimistix_alone"),
    "scipy one by one": ("with_scipy", "one_by_one"),
    "scipy side by side": ("with_scipy", "side_by_side"),
    "scipy compiled": ("with_scipy", "compiled"),
    "scipy compiled, in lanes": ("with_scipy", "compiled_in_lanes"),
    "casadi ipopt": ("with_casadi", "multiple_shooting"),
    "casadi ipopt, single shooting": ("with_casadi", "single_shooting"),
    "casadi compiled": ("with_compiled_casadi", "levenberg_marquardt"),
    "nelder-mead": ("nelder_mead", "output_error"),
    "by stages": ("nelder_mead", "published"),
    "by stages, own terms": ("nelder_mead", "own_terms"),
}


def spent() -> float:
    """Processor seconds of this process and those it started, since it began."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, kinds))


def main() -> None:
    """Fit twice and print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("contestant", choices=CONTESTANTS)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--core", type=int, help="run on this core only")
    parser.add_argument("--warm", type=int, default=1, help="fits after the first")
    args = parser.parse_args()
    if args.core is not None:
        os.sched_setaffinity(0, {args.core})
    module, name = CONTESTANTS[args.contestant]
    fit = getattr(importlib.import_module(f"experiments.fit_benchmark.{module}"), name)
    from experiments.fit_benchmark.data import load

    data = load(args.recordings)
    found = fit(data)
    times = {"cold": spent(), "cold_wall": time.perf_counter() - BEGAN}
    warm: list[tuple[float, float]] = []
    for _ in range(args.warm):
        cpu, wall = spent(), time.perf_counter()
        found = fit(data)
        warm.append((spent() - cpu, time.perf_counter() - wall))
    if warm:
        times["warm"], times["warm_wall"] = sorted(warm)[len(warm) // 2]
    print(json.dumps({"contestant": args.contestant, **times, **judged(data, found)}))


def judged(data, found) -> dict:
    """The error of the parameters, and the common cost.

    `refined` is the cost with the first states that suit the parameters best: the only one for
    a method that has no first states.
    """
    from experiments.fit_benchmark import plain
    from experiments.fit_benchmark.data import relative_error

    import numpy as np

    with np.errstate(all="ignore"):
        refined = plain.with_best_states(data, found.values)[1]
        cost = refined if found.first is None else plain.cost(data, found.values, found.first)
    return {
        "cost": cost,
        "refined": refined,
        "error": relative_error(data, found.values),
        "ratio": list(found.values / data.truth),
        "runs": found.runs,
        "jacobians": found.jacobians,
        "away": None if found.away is None else list(found.away),
    }


if __name__ == "__main__":
    main()
