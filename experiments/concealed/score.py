"""Score a set: figures with Wilson 95 % intervals, confusion matrix, power, reliability, failures.

    python -m experiments.concealed.score --set develop

Reads DIR/results and DIR/sealed (after checking the sealed files against DIR/manifest.json),
writes DIR/scores/: scores.json, scores.md, confusion.csv, confusion.png, power.png, cases.csv
and failures.csv. `--table CASES.CSV` gives parts.md and the pictures of a table of cases, which may
be those of several runs of this.
"""

import argparse
import json
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from . import report, sealing
from .outcomes import Outcome, read_all, read_table


BINS = (1.0, 2.0, 4.0, 8.0, 16.0, 31.0)
LARGE = 8.0  # detection limits from which naming must succeed
FEW_KINDS = {  # strata whose runs are of few kinds
    "standard": "standard trials",
    "alike": "one manoeuvre",
    "short": "one manoeuvre, short",
}
TARGETS = {
    "false alarms, clean": "at most 1 % (upper bound 2.5 %)",
    "named rightly, of decided, at least 8 limits": "95 %",
    "wrong name, any case": "at most 3 %",
    "parameter error, median": "at most 10 %",
    "90 % intervals that hold the truth": "85 to 95 %",
    "share of the true structure's held-out gain": "at least 85 %",
    "outside the catalogue: no catalogue name": "at least 85 %",
    "ambiguous, resolved by the recommended manoeuvre": "at least 85 %",
    "seconds a case, median, compiled": "30 s",
}


def wilson(hits: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson score interval of a share."""
    if n == 0:
        return math.nan, math.nan
    p, z2 = hits / n, z * z
    middle, half = p + z2 / (2 * n), z * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max((middle - half) / (1 + z2 / n), 0.0), min((middle + half) / (1 + z2 / n), 1.0)


def share(flags: Iterable[bool]) -> dict:
    """{"hits", "n", "share", "low", "high"}."""
    flags = [bool(f) for f in flags]
    hits, n = sum(flags), len(flags)
    low, high = wilson(hits, n)
    return {"hits": hits, "n": n, "share": hits / n if n else math.nan, "low": low, "high": high}


def score(outcomes: list[Outcome], resolved: list[dict], gains: list[dict]) -> dict:
    """All figures of a set."""
    of = lambda *strata: [o for o in outcomes if o.stratum in strata]
    single, effects = of("single"), [o for o in outcomes if o.limits]
    found = lambda o: len(set(o.named) & set(o.true))
    large = [o for o in single if o.limits[0] >= LARGE]
    values = [e for o in effects for e in o.errors.values()]
    rates = {
        "failed": share(o.verdict == "failed" for o in outcomes),
        "false alarms, clean": share(bool(o.named) for o in of("clean")),
        "not consistent, clean": share(o.verdict != "consistent" for o in of("clean")),
        "false alarms, benign misfit": share(bool(o.named) for o in of("benign")),
        "named rightly, of decided, at least 8 limits": share(o.right for o in large if o.decided),
        "named rightly, of all, at least 8 limits": share(o.right for o in large),
        "named rightly, of decided": share(o.right for o in single if o.decided),
        "named rightly, of all": share(o.right for o in single),
        "named rightly, with its place, of decided": share(o.strict for o in single if o.decided),
        "first name right, of decided": share(o.top for o in single if o.decided),
        "first name right, of all": share(o.top for o in single),
        "truth in the set offered, of all": share(set(o.true) <= o.offered for o in single),
        "truth in the set offered, of those with names": share(
            set(o.true) <= o.offered for o in single if o.offered
        ),
        "pairs: both named, nothing else": share(o.right for o in of("pair")),
        "pairs: at least one named rightly": share(found(o) >= 1 for o in of("pair")),
        "triples: all three named, nothing else": share(o.right for o in of("triple")),
        "triples: at least two named rightly": share(found(o) >= 2 for o in of("triple")),
        "triples: at least one named rightly": share(found(o) >= 1 for o in of("triple")),
        **{
            f"{runs}: {what}": share(flags)
            for stratum, runs in FEW_KINDS.items()
            for what, flags in (
                ("named rightly, of decided", [o.right for o in of(stratum) if o.decided]),
                ("named rightly, of all", [o.right for o in of(stratum)]),
                ("ambiguous", [o.verdict == "ambiguous" for o in of(stratum)]),
            )
        },
        "wrong name, any case": share(o.wrong for o in outcomes),
        "outside the catalogue: no catalogue name": share(not o.named for o in of("outside")),
        "outside the catalogue: unexplained": share(
            o.verdict == "unexplained" for o in of("outside")
        ),
        "uninformative manoeuvres: no wrong name": share(not o.wrong for o in of("uninformative")),
        "uninformative manoeuvres: decided": share(o.decided for o in of("uninformative")),
        "90 % intervals that hold the truth": share(c for o in effects for c in o.covered.values()),
        "onset within 5 % of the run": share(o.onset for o in effects if o.onset is not None),
        "degree of freedom of the first place": share(
            o.where for o in effects if o.where is not None
        ),
        "ambiguous: truth in the set offered": share(
            set(o.true) <= o.offered for o in effects if o.verdict == "ambiguous"
        ),
        "ambiguous: a manoeuvre is recommended": share(
            o.next_manoeuvre not in (None, "none") for o in effects if o.verdict == "ambiguous"
        ),
        "ambiguous, resolved by the recommended manoeuvre": share(r["resolved"] for r in resolved),
    }
    numbers = {
        "parameter error, median": _median(values),
        "parameter error, 90 % quantile": float(np.quantile(values, 0.9)) if values else math.nan,
        "direction error, median, deg": math.degrees(
            _median([a for o in effects for a in o.angles.values()])
        ),
        "share of the true structure's held-out gain": _gain_share(gains),
        "seconds a case, median, compiled": _median(
            [o.seconds for o in outcomes if o.warm and o.seconds is not None]
        ),
        "seconds a case, largest": max((o.seconds or 0.0 for o in outcomes), default=math.nan),
    }
    return {
        "cases": len(outcomes),
        "strata": {s: len(of(s)) for s in sorted({o.stratum for o in outcomes})},
        "rates": rates,
        "numbers": numbers,
        "targets": TARGETS,
        **by_parts(outcomes),
    }


def by_parts(outcomes: list[Outcome]) -> dict:
    """By hull, effect, size and stated odds."""
    single = [o for o in outcomes if o.stratum == "single"]
    hulls = sorted({o.hull for o in outcomes})
    return {
        "by_hull": {h: _of_hull([o for o in outcomes if o.hull == h]) for h in hulls},
        "by_effect": _by_effect(single),
        "power": power(single),
        "reliability": reliability(outcomes),
    }


def _median(values: list) -> float:
    return float(np.median(values)) if values else math.nan


def _gain_share(gains: list[dict]) -> float:
    """Median over cases of (nominal - diagnosed) / (nominal - true structure)."""
    shares = [
        (g["nominal"] - g["diagnosed"]) / (g["nominal"] - g["true"])
        for g in gains
        if g["nominal"] - g["true"] > 0.1 * g["nominal"]
    ]
    return _median(shares)


def _of_hull(part: list[Outcome]) -> dict:
    single = [o for o in part if o.stratum == "single"]
    quiet = [o for o in part if o.stratum in ("clean", "benign")]
    return {
        "named rightly, of decided": share(o.right for o in single if o.decided),
        "named rightly, of all": share(o.right for o in single),
        "wrong name": share(o.wrong for o in part),
        "false alarms": share(bool(o.named) for o in quiet),
    }


def _by_effect(single: list[Outcome]) -> dict:
    found = {}
    for name in sorted({o.true[0] for o in single}):
        part = [o for o in single if o.true[0] == name]
        errors = [e for o in part for e in o.errors.values()]
        found[name] = {
            "named rightly": share(o.right for o in part),
            "decided": share(o.decided for o in part),
            "offered": share(name in o.offered for o in part),
            "parameter error, median": _median(errors),
        }
    return found


def power(single: list[Outcome]) -> list[dict]:
    """By size in detection limits: named rightly, offered, and anything noticed at all."""
    unnoticed = ("consistent", "insufficient", "failed")
    rows = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        part = [o for o in single if low <= o.limits[0] < high]
        rows.append({
            "from": low, "to": high,
            "right": share(o.right for o in part),
            "offered": share(o.true[0] in o.offered for o in part),
            "noticed": share(o.verdict not in unnoticed for o in part),
        })  # fmt: skip
    return rows


def reliability(outcomes: list[Outcome]) -> list[dict]:
    """Names by their stated odds: how often they are true."""
    stated = [
        (odds, name in o.true)
        for o in outcomes
        if o.verdict == "explained"
        for name, odds in zip(o.named, o.log10_odds, strict=True)
        if odds is not None
    ]
    edges = (-math.inf, 1.0, 2.0, 3.0, 5.0, 10.0, math.inf)
    rows = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        part = [(x, hit) for x, hit in stated if low <= x < high]
        probability = [1.0 / (1.0 + 10.0 ** -min(max(x, -300.0), 300.0)) for x, _ in part]
        rows.append({
            "log10_odds_from": None if math.isinf(low) else low,
            "log10_odds_to": None if math.isinf(high) else high,
            "stated": float(np.mean(probability)) if part else math.nan,
            "true": share(hit for _, hit in part),
        })  # fmt: skip
    return rows


def check_seal(folder: Path) -> None:
    """Raise SystemExit where a sealed file or a case is not what the manifest says."""
    was = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    for part, files in was.items():
        if sealing.manifest(folder / part) != files:
            raise SystemExit(f"{folder / part} is not what {folder / 'manifest.json'} says")


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", default="develop")
    parser.add_argument("--out", type=Path, help="folder of the set (default: out/concealed/SET)")
    parser.add_argument("--table", type=Path, metavar="CASES.CSV",
                        help="these cases by their parts, beside the table")  # fmt: skip
    args = parser.parse_args(argv)
    if args.table:
        outcomes = read_table(args.table)
        report.write_parts(args.table.parent, by_parts(outcomes), outcomes)
        return
    folder = args.out or Path("out/concealed") / args.set
    check_seal(folder)
    outcomes = read_all(folder)
    extra = lambda name: json.loads(p.read_text("utf-8")) if (p := folder / name).exists() else []
    found = score(outcomes, extra("resolved.json"), extra("gains.json"))
    settings = folder / "settings.json"
    found["settings"] = json.loads(settings.read_text("utf-8")) if settings.exists() else None
    found["baselines"] = extra("baselines.json")
    report.write(folder / "scores", found, outcomes)
    print((folder / "scores" / "scores.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
