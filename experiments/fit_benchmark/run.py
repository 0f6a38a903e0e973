"""Fits of the same recordings from the same start by the library and by its peers.

Every contestant runs in processes of its own, one at a time, in turns.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from experiments.fit_benchmark.data import OUT, ROOT, make
from experiments.fit_benchmark.one import CONTESTANTS


HERE = Path(__file__).parent
REFERENCE = "diffsea free run"
SAME = 1e-4, 0.1  # of the cost, and absolute: within either it is the same optimum
PATIENCE = 1800.0  # s for one process


def main() -> None:
    """Make the recordings, let everybody fit them, print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="processes for each contestant")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=CONTESTANTS, default=list(CONTESTANTS))
    parser.add_argument("--gusts", type=int, default=0, help="seeds of the table with gusts")
    parser.add_argument("--table", action="store_true", help="only print what there is")
    parser.add_argument("--keep", action="store_true", help="put the table into the README, too")
    args = parser.parse_args()
    began = time.perf_counter()
    OUT.mkdir(parents=True, exist_ok=True)
    if not args.table:
        compete(args.only, args.seed, args.repeats)
        with_gusts(range(1, args.gusts + 1))
    found = records(f"times-{args.seed}.jsonl")
    if args.keep:
        keep_table(found, began)
    elif found:
        print(table(found))
    show_gusts(records("gusts.jsonl"))


def compete(names: Iterable[str], seed: int, repeats: int) -> None:
    """Everybody in turn, `repeats` times; what they say is added to a file at once."""
    path = OUT / f"still-{seed}.npz"
    make(path, seed)
    for _ in range(repeats):
        for name in names:
            keep(f"times-{seed}.jsonl", asked(name, path, warm=1))


def with_gusts(seeds: Iterable[int]) -> None:
    """The library's two objectives on runs with gusts."""
    for seed in seeds:
        path = OUT / f"gusts-{seed}.npz"
        make(path, seed, gusts=1.0)
        for name in ("diffsea free run", "diffsea innovations"):
            keep("gusts.jsonl", asked(name, path, warm=0))


def asked(name: str, recordings: Path, warm: int) -> dict | None:
    """What one process reports; None, and why, where it fails."""
    one_thread = {f"{kind}_NUM_THREADS": "1" for kind in ("OMP", "OPENBLAS", "MKL")}
    module = "experiments.fit_benchmark.one"
    command = [sys.executable, "-m", module, name, recordings, "--warm", str(warm)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE, check=True, cwd=ROOT,
            env=os.environ | one_thread,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        print(f"{name}: gave up after {PATIENCE:.0f} s", file=sys.stderr)
        return None
    except subprocess.CalledProcessError as error:
        print(f"{name}: failed\n{error.stderr[-2000:]}", file=sys.stderr)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def keep(file: str, record: dict | None) -> None:
    """Add a line to a file of results."""
    if record is not None:
        with (OUT / file).open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(record) + "\n")
        print(f"{record['contestant']}: done", file=sys.stderr, flush=True)


def records(file: str) -> dict[str, list[dict]]:
    """All results so far by contestant, in the order of the contestants."""
    if not (OUT / file).exists():
        return {}
    lines = (OUT / file).read_text(encoding="utf-8").splitlines()
    found = [json.loads(line) for line in lines]
    return {n: own for n in CONTESTANTS if (own := [r for r in found if r["contestant"] == n])}


def middle(rows: list[dict], key: str) -> float:
    """Median."""
    return statistics.median(row[key] for row in rows)


HEADINGS = (
    "method", "cold s", "warm s", "cold, ratio", "warm, ratio", "runs + Jacobians",
    "cost - least", "with best states", "same optimum", "error %", "processes",
)  # fmt: skip


def keep_table(found: dict[str, list[dict]], began: float) -> None:
    """Write results.json beside the README, and the table into it."""
    from experiments.harness.reporting import Experiment

    least = min(row["cost"] for rows in found.values() for row in rows)
    results = {"least_cost": least, "contestants": found}
    Experiment(HERE, HERE, quick=False, began=began).write(results, {"TIMES": table(found)})


def table(found: dict[str, list[dict]]) -> str:
    """The table of times, as Markdown; ratios are to `REFERENCE`."""
    least = min(row["cost"] for rows in found.values() for row in rows)
    lines = [f"| {' | '.join(HEADINGS)} |", f"{'| --- ' * len(HEADINGS)}|"]
    for name, rows in found.items():
        lines.append(f"| {' | '.join([name, *line(rows, found.get(REFERENCE), least)])} |")
    return "\n".join(lines)


def line(rows: list[dict], reference: list[dict] | None, least: float) -> list[str]:
    """One contestant's figures: medians of times, what the last process found."""
    last, times = rows[-1], [middle(rows, key) for key in ("cold", "warm")]
    ratios = ["", ""]
    if reference:
        others = (middle(reference, key) for key in ("cold", "warm"))
        ratios = [f"{own / other:.2g}" for own, other in zip(times, others, strict=True)]
    over, refined = last["cost"] - least, last["refined"] - least
    return [
        *(f"{seconds:.2f}" for seconds in times), *ratios,
        f"{last['runs']} + {last['jacobians']}", f"{over:.3g}", f"{refined:.3g}",
        "yes" if over < max(SAME[0] * least, SAME[1]) else "no",
        f"{100 * last['error']:.2f}", str(len(rows)),
    ]  # fmt: skip


def show_gusts(found: dict[str, list[dict]]) -> None:
    """Errors with gusts, as Markdown."""
    if not found:
        return
    print("\n| method | error % | rms of errors in standard errors | within 1.64 | estimates |")
    print("| --- | --- | --- | --- | --- |")
    for name, rows in found.items():
        away = [z for row in rows for z in row["away"]]
        error = statistics.mean(row["error"] ** 2 for row in rows) ** 0.5
        rms = statistics.mean(z * z for z in away) ** 0.5
        inside = statistics.mean(abs(z) < 1.645 for z in away)
        print(f"| {name} | {100 * error:.2f} | {rms:.2f} | {100 * inside:.0f} % | {len(away)} |")


if __name__ == "__main__":
    main()
