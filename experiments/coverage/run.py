# pyright: reportArgumentType=false
"""Do the 90 % intervals of a fit hold the truth nine times in ten?

Every case draws a vessel's derivatives from the prior of the fit, simulates two noisy, gusty
runs of it by the independent simulator of the tests, and fits them from the prior's mean.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from diffsea.runtime import prepare_jax


prepare_jax()

import numpy as np
from scipy.stats import binomtest


ROOT = Path(__file__).resolve().parents[2]

from experiments.harness import reporting

from tests.oracle import sensors
from tests.oracle.simulator import load, simulate

from diffsea import Trajectory, UserError
from diffsea.identification.coordinates import free_by_default
from diffsea.identification.estimates import parameter_estimates
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


SECONDS, INTERVAL = 80.0, 0.25
LEAST_TO_TELL = 100  # cases
FILES = {"usv": "tests/oracle/usv.toml", "boat": "tests/oracle/boat.toml"}


def main() -> None:
    """Fit every case, then print and write the coverage of each parameter."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--vessel", choices=FILES, default="usv")
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--no-gusts", action="store_true", help="sensor noise only")
    args = parser.parse_args()
    out = ROOT / "out" / "coverage"
    out.mkdir(parents=True, exist_ok=True)
    document = load(str(ROOT / FILES[args.vessel]))
    rows: list[dict] = []
    began, started = time.monotonic(), time.perf_counter()
    for seed in range(args.first_seed, args.first_seed + args.cases):
        try:
            rows += case(document, seed, not args.no_gusts)
        except (UserError, RuntimeError, FloatingPointError) as error:
            print(f"seed {seed}: left out: {error}", file=sys.stderr)
        if seed % 10 == 9:
            done = seed - args.first_seed + 1
            print(f"[{time.monotonic() - began:5.0f} s] {done} cases", file=sys.stderr, flush=True)
    found = {name: coverage([r for r in rows if r["name"] == name]) for name in names(rows)}
    found["all"] = coverage(rows)
    show(found)
    label = f"{args.vessel}{'-still' if args.no_gusts else ''}"
    record = {"coverage": found, "rows": rows}
    (out / f"{label}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    if args.cases < LEAST_TO_TELL:
        print(f"fewer than {LEAST_TO_TELL} cases: README and results.json are left alone")
        return
    home = Path(__file__).resolve().parent
    kept = {"cases": args.cases, "first_seed": args.first_seed, "coverage": found}
    tables = {} if args.no_gusts else {label.upper(): coverage_table(found)}
    reporting.Experiment(home, home, False, started).write_part(label, kept, tables)


def coverage_table(found: dict[str, dict]) -> str:
    """Share of intervals that hold the truth, by parameter."""
    rows = [
        (f"all {row['count']}" if name == "all" else name, f"{100 * row['share']:.0f} %",
         f"{100 * row['low']:.0f} to {100 * row['high']:.0f} %", f"{100 * row['determined']:.0f} %")
        for name, row in found.items()
    ]  # fmt: skip
    return reporting.table(("parameter", "inside", "95 % interval", "determined by the data"), rows)


def names(rows: list[dict]) -> list[str]:
    """Parameters in the order of the table."""
    return list(dict.fromkeys(row["name"] for row in rows))


def case(document: dict, seed: int, gusts: bool) -> list[dict]:
    """The table of one fit, with the truth and whether the interval holds it."""
    rng = np.random.default_rng(seed)
    nominal = build(document)
    problem = make_problem(nominal, [run(document, rng, False)])  # for its priors only
    hull = dict(document["hull"])
    for parameter in problem.layout.parameters:
        hull[parameter.name] = float(parameter.decode(parameter.spread * rng.standard_normal()))
    truth = document | {"hull": hull}
    runs = [run(truth, rng, gusts) for _ in range(2)]
    problem = make_problem(nominal, runs, free_by_default(nominal))
    free = tuple(p.name for p in problem.layout.parameters)
    found = parameter_estimates(problem.layout.parameters, estimate(problem, free))
    table = [one.as_dict() for one in found]
    for one, row in zip(found, table, strict=True):
        low, high = one.interval
        row["truth"] = hull[one.name]
        row["inside"] = bool(low <= hull[one.name] <= high)
        row["seed"] = seed
    return table


def run(document: dict, rng: np.random.Generator, gusts: bool) -> Trajectory:
    """Steps of random thrust, sampled with noise."""
    blow = sensors.gust(rng, 0.0, SECONDS) if gusts else None
    channels = [thruster["name"] for thruster in document["thruster"]]
    limits = [thruster["max_force"] for thruster in document["thruster"]]
    orders = [
        (t, {c: limit * rng.uniform(0.1, 0.85) for c, limit in zip(channels, limits, strict=True)})
        for t in np.arange(0.0, SECONDS, 4.0)
    ]
    sim = simulate(document, orders, SECONDS, gust=blow, rtol=1e-8, atol=1e-10)
    t = np.arange(0.0, SECONDS, INTERVAL)
    rec = sensors.record(sim, t, sensors.suite(), rng, wrapped=False)
    return Trajectory(
        t,
        **{c: np.asarray(rec[c], float) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(rec[f"cmd_{c}"], float) for c in channels},
        executed={},
        extra={},
        valid=np.ones(len(t), bool),
    )


def coverage(rows: list[dict]) -> dict:
    """Share of intervals that hold the truth, with its own 95 % interval (Wilson)."""
    inside = sum(row["inside"] for row in rows)
    interval = binomtest(inside, len(rows)).proportion_ci(method="wilson")
    return {
        "share": inside / len(rows),
        "low": interval.low,
        "high": interval.high,
        "count": len(rows),
        "determined": float(np.mean([row["determined"] for row in rows])),
    }


def show(found: dict[str, dict]) -> None:
    """One line for each parameter."""
    print(f"{'parameter':10s} {'inside':>7s} {'95 % interval':>15s} {'fits':>5s}  due to data")
    for name, row in found.items():
        span = f"{100 * row['low']:.0f} to {100 * row['high']:.0f} %"
        share, data = 100 * row["share"], 100 * row["determined"]
        print(f"{name:10s} {share:6.0f}% {span:>15s} {row['count']:5d} {data:8.0f} %")


if __name__ == "__main__":
    main()
