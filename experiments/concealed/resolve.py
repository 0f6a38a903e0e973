"""Ambiguous cases: sail the manoeuvre that the tool recommends on the true vessel, ask again.

    python -m experiments.concealed.resolve --set develop [--most 20]

The commands come from the file that `diagnose --next-manoeuvre` wrote (results/CASE/next.csv: t
and cmd_ columns, each row held until the next); where the tool wrote none, from the name of the
manoeuvre. The new recording joins the training runs in DIR/resolve/cases/CASE, which run.py then
diagnoses as blindly as before. Resolved: the true names, and only they. Writes DIR/resolved.json.
"""

import argparse
import csv
import dataclasses
import json
import math
import shutil
from pathlib import Path

import numpy as np

from . import draw, orders, sealing
from .generate import csv_text
from .hulls import HULLS, Hull
from .outcomes import judge, read_all


SEED = 4_000_037  # added to the case's own, for gusts and noise of the extra run


def record(case: dict, schedule: Path | None, manoeuvre: str | None) -> dict[str, np.ndarray]:
    """One more recording of the case's true vessel under a schedule of commands, to its end."""
    hull = HULLS[case["hull"]]
    model, _ = draw.true_vessel(case, np.random.default_rng(case["seed"]))
    rng = np.random.default_rng(case["seed"] + SEED)
    if schedule is not None:
        given = read_schedule(schedule, model.labels(), hull.step)
        hull, policy = dataclasses.replace(hull, rows=len(given)), orders.Replay(given)
    else:
        policy = by_name(manoeuvre or "", hull, model.sensing, rng)
    track = draw.run(model, hull, policy, rng)
    return draw.columns(track, model, hull, rng)


def read_schedule(path: Path, labels: list[str], step: float) -> np.ndarray:
    """Orders (rows, channels) every `step` seconds up to the last stamp, held from each."""
    with path.open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    t = np.array([float(row["t"]) for row in table])
    missing = [n for n in labels if f"cmd_{n}" not in table[0]]
    if missing:
        raise ValueError(f"{path} has no column for {', '.join(missing)}")
    values = np.array([[float(row[f"cmd_{n}"]) for n in labels] for row in table])
    every = np.arange(round(t[-1] / step) + 1) * step
    return values[np.clip(np.searchsorted(t, every + 1e-9, side="right") - 1, 0, len(t) - 1)]


def by_name(name: str, hull: Hull, sensing, rng: np.random.Generator):
    """A manoeuvre of that name, as the simulator would sail it."""
    mix, rows, start = hull.mix, hull.rows, -(10**6)
    every = max(1, round(hull.control / hull.step))
    if "zigzag" in name:
        zigzag = orders.Zigzag(mix, sensing, hull.instruments["compass"].std, every, rng)
        slow = (-1, 0.25, 0.4, math.radians(20))
        return zigzag.configure([slow, (rows // 2, 0.75, 0.4, math.radians(20))])
    if "circle" in name:
        return orders.Table(
            [(start, 0.6, 0.0), (rows // 20, 0.6, 0.5), (rows // 2, 0.25, -0.5)], mix
        )
    if any(part in name for part in ("stop", "coast", "crash", "sprint", "acceleration")):
        return orders.crash_and_coast(rng, rows, hull.astern, mix)
    if "spin" in name:
        return orders.Table(
            [(start, 0.1, 0.0), (rows // 20, 0.0, 0.7), (rows // 2, 0.0, -0.7)], mix
        )
    return orders.random_steps(rng, rows, 0.5 * hull.hold / hull.step, (0.1, 0.9), 0.6, mix)


def prepare(folder: Path, most: int | None) -> list[str]:
    """Write the cases with one more run to folder/resolve; their ids."""
    there = folder / "resolve"
    ids = []
    for outcome in read_all(folder):
        known = outcome.verdict == "ambiguous" and outcome.true
        if not known or (most is not None and len(ids) >= most):
            continue
        schedule = folder / "results" / outcome.case / "next.csv"
        if not schedule.exists() and outcome.next_manoeuvre in (None, "none"):
            print(f"{outcome.case}: the tool says that no manoeuvre would tell")
            continue
        sealed = folder / "sealed" / f"{outcome.case}.json"
        case = json.loads(sealed.read_text(encoding="utf-8"))
        extra = record(case, schedule if schedule.exists() else None, outcome.next_manoeuvre)
        target = there / "cases" / outcome.case
        shutil.copytree(folder / "cases" / outcome.case, target, dirs_exist_ok=True)
        (target / "train" / "run7.csv").write_text(csv_text(extra), encoding="utf-8")
        (there / "sealed").mkdir(parents=True, exist_ok=True)
        shutil.copy(sealed, there / "sealed")
        ids.append(outcome.case)
    if ids:
        manifest = {k: sealing.manifest(there / k) for k in ("cases", "sealed")}
        text = json.dumps(manifest, indent=1) + "\n"
        (there / "manifest.json").write_text(text, encoding="utf-8")
    return ids


def collect(folder: Path, ids: list[str]) -> list[dict]:
    """How each case came out with one more run."""
    rows = []
    for name in ids:
        here = folder / "resolve" / "results" / name
        if not (here / "run.json").exists():
            continue
        truth = json.loads((folder / "sealed" / f"{name}.json").read_text(encoding="utf-8"))
        path = here / "diagnosis.json"
        diagnosis = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
        run = json.loads((here / "run.json").read_text(encoding="utf-8"))
        after = judge(truth, diagnosis, run)
        rows.append({"case": name, "resolved": after.right, "verdict": after.verdict,
                     "named": after.named, "true": after.true})  # fmt: skip
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", default="develop")
    parser.add_argument("--out", type=Path, help="folder of the set (default: out/concealed/SET)")
    parser.add_argument("--most", type=int, help="cases at most")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    folder = (args.out or Path("out/concealed") / args.set).resolve()
    ids = prepare(folder, args.most)
    if ids:
        from .run import run

        run(folder / "resolve", args.workers, ids, redo=True, any_revision=True)
    rows = collect(folder, ids)
    (folder / "resolved.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"{sum(r['resolved'] for r in rows)} of {len(rows)} resolved")


if __name__ == "__main__":
    main()
