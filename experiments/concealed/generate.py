"""Draw a set of cases.

    python -m experiments.concealed.generate --set develop --count 40 [--seed N] [--out DIR]

Writes DIR/cases/ (all that the tool is shown), DIR/sealed/ (the plan and one JSON of truth per
case) and DIR/manifest.json with the SHA-256 of every file of both.
"""

import argparse
import csv
import io
import itertools
import json
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import tomli_w

from . import draw, sealing
from .hulls import HULLS


OUT = Path("out/concealed")


def write_case(case: dict, folder: Path) -> None:
    """Vessel file and recordings below folder/cases, truth below folder/sealed."""
    recordings, truth = draw.make_case(case)
    here = folder / "cases" / case["id"]
    for name, columns in zip(draw.RUNS, recordings, strict=True):
        path = (here / name).with_suffix(".csv")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(csv_text(columns), encoding="utf-8")
    with (here / "vessel.toml").open("wb") as file:
        tomli_w.dump(HULLS[case["hull"]].document, file)
    text = json.dumps(truth, indent=1, default=float) + "\n"
    (folder / "sealed").mkdir(exist_ok=True)
    (folder / "sealed" / f"{case['id']}.json").write_text(text, encoding="utf-8")


def csv_text(columns: dict[str, np.ndarray]) -> str:
    """A table with empty cells where there was no reading."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow("" if math.isnan(v) else f"{v + 0.0:.7g}" for v in row)
    return text.getvalue()


def generate(set_name: str, count: int, seed: int, part: int | None, folder: Path) -> list[dict]:
    """Draw the plan, write its cases (those of `--subset` if given), then the manifest."""
    cases = draw.plan(set_name, count, seed)
    if part is not None:
        cases = draw.subset(cases, part)
    began = time.monotonic()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for i, _ in enumerate(pool.map(write_case, cases, itertools.repeat(folder)), 1):
            if i % 20 == 0:
                print(f"[{time.monotonic() - began:5.0f} s] {i} cases", flush=True)
    plan = {"set": set_name, "count": count, "seed": seed, "subset": part, "cases": cases}
    text = json.dumps(plan, indent=1) + "\n"
    (folder / "sealed" / "plan.json").write_text(text, encoding="utf-8")
    manifest = {k: sealing.manifest(folder / k) for k in ("cases", "sealed")}
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return cases


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", choices=draw.SETS, default="develop")
    parser.add_argument("--count", type=int, help="cases (default: the set's own number)")
    parser.add_argument("--subset", type=int, help="write only a balanced part of so many cases")
    parser.add_argument("--seed", type=int, help="of the plan (default: one for each set)")
    parser.add_argument("--out", type=Path, help=f"folder (default: {OUT}/SET)")
    args = parser.parse_args()
    folder = args.out or OUT / args.set
    drawn = draw.SETS[args.set]
    seed = drawn.seed if args.seed is None else args.seed
    count = drawn.count if args.count is None else args.count
    cases = generate(args.set, count, seed, args.subset, folder)
    print(f"{len(cases)} cases in {folder}")


if __name__ == "__main__":
    main()
