"""Score the proof: tables with Wilson 95 % intervals, from the lines of results.

    python -m experiments.concealed_real.score [--out DIR]

Writes scores.json and scores.md beside the lines.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from experiments.concealed.score import BINS, share
from experiments.concealed_real import facts, results, sets
from experiments.concealed_real.checks import Line
from experiments.concealed_real.judging import (
    HORIZONS,
    Comparison,
    Outcome,
    compare,
    compare_again,
    judge,
)

import numpy as np


Rate = dict[str, Any]
WELCOME, HOLDS, FAILS = "-", "yes", "**no**"


# Injected


def rates(outcomes: Sequence[Outcome]) -> dict[str, Rate]:
    """Shares of cases, each with its interval."""
    of = lambda *kinds: [o for o in outcomes if o.kind in kinds]
    effects, asserted = of("effect"), [o for o in of("effect") if o.named]
    known = lambda flags: [flag for flag in flags if flag is not None]
    return {
        "failed": share(o.verdict == "failed" for o in outcomes),
        "named": share(o.named for o in effects),
        "named besides what the unchanged runs give": share(o.besides for o in effects),
        "named, or found by the audit": share(o.besides or o.audited for o in effects),
        "wrong names": share(bool(o.wrong) for o in outcomes),
        "wrong names, effects": share(bool(o.wrong) for o in effects),
        "names of the unchanged runs lost": share(
            bool(o.lost) for o in outcomes if o.verdict != "failed"
        ),
        "outside the catalogue: without a name": share(not o.wrong for o in of("outside")),
        "steps of a sensor: no wrong name": share(not o.wrong for o in of("step")),
        "steps of a sensor: named or found by the audit": share(
            o.besides or o.audited for o in of("step")
        ),
        "harmless: no name": share(not o.wrong for o in of("harmless")),
        "exchanged labels: found by the audit": share(o.audited for o in of("label")),
        "acts on the right channels": share(known(o.where for o in asserted)),
        "onset within 5 % of the run": share(known(o.onset for o in outcomes)),
        "90 % intervals that hold the truth": share(
            hit for o in asserted for hit in o.covered.values()
        ),
    }


def power(
    outcomes: Sequence[Outcome], of: Callable[[Outcome], float | None], bins: Sequence[float] = BINS
) -> list[dict[str, Any]]:
    """By size in detection limits: named besides, noticed at all, given a wrong name."""
    sized = [(size, o) for o in outcomes if o.kind == "effect" and (size := of(o)) is not None]
    rows = []
    for low, high in zip(bins[:-1], bins[1:], strict=True):
        part = [o for size, o in sized if low <= size < high]
        rows.append({
            "from": low, "to": high,
            "named": share(o.besides for o in part),
            "named or audited": share(o.besides or o.audited for o in part),
            "wrong": share(bool(o.wrong) for o in part),
        })  # fmt: skip
    return rows


def free_runs(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float]]:
    """Of named cases, free predictions after over before: median, and share that got worse."""
    found = {}
    for horizon in HORIZONS:
        ratios = [o.free[horizon][1] / o.free[horizon][0] for o in outcomes
                  if o.said and horizon in o.free and o.free[horizon][0] > 0]  # fmt: skip
        worse = [ratio > 1.0 for ratio in ratios]
        middle = float(np.median(ratios)) if ratios else math.nan
        found[horizon] = {"median": middle, "worse": share(worse)}
    return found


def numbers(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Sizes against the truth, and time."""
    errors = [e for o in outcomes for name, e in o.errors.items()
              if name not in ("direction", "phase")]  # fmt: skip
    angles = [math.degrees(o.errors[n]) for o in outcomes for n in ("direction", "phase")
              if n in o.errors]  # fmt: skip
    seconds = [o.seconds for o in outcomes]
    median = lambda values: float(np.median(values)) if values else math.nan
    return {
        "error of sizes, median": median(errors),
        "error of directions, median, deg": median(angles),
        "seconds a case, median": median(seconds),
        "seconds a case, largest": max(seconds, default=math.nan),
    }


def parts(outcomes: Sequence[Outcome], of: Callable[[Outcome], str]) -> dict[str, dict[str, Rate]]:
    """Few rates by set or by injection."""
    shown = ("named besides what the unchanged runs give", "named, or found by the audit",
             "wrong names", "90 % intervals that hold the truth")  # fmt: skip
    found = {}
    for name in sorted({of(o) for o in outcomes}):
        all_rates = rates([o for o in outcomes if of(o) == name])
        found[name] = {key: all_rates[key] for key in shown}
    return found


# Facts and retellings


def fact_rows(lines: dict[str, Line]) -> list[dict[str, Any]]:
    """Every check of every fact that was asked."""
    rows = []
    for key in facts.FACTS:
        if key in lines:
            held = facts.judge(key, lines[key])
            rows += [{"fact": key, "check": what, "holds": holds} for what, holds in held.items()]
    return rows


# Tables


def shown(rate: Rate) -> str:
    """A share as `named % (low to high), hits/n`."""
    if not rate["n"]:
        return "-"
    low, high = (f"{100 * rate[end]:.0f}" for end in ("low", "high"))
    return f"{100 * rate['share']:.0f} % ({low} to {high}), {rate['hits']}/{rate['n']}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [list(head), ["---"] * len(head), *(list(row) for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def unchanged_table(lines: dict[str, Line]) -> str:
    """What the unchanged runs give."""
    head = ("set", "for", "verdict", "named", "free run at 60 s, before -> after", "seconds")
    rows = []
    for name, line in lines.items():
        free = line.get("free", {})
        ends = [(free.get(m) or {}).get("60", {}).get("position") for m in ("nominal", "diagnosed")]
        errors = " -> ".join("-" if e is None else f"{e:.3g} m" for e in ends)
        use = "development" if sets.SETS[name].develop else "report"
        said = ", ".join(results.names(line)) or "nothing"
        rows.append((name, use, line["verdict"], said, errors, f"{line['seconds']:.0f}"))
    return table(head, rows)


def told_table(comparisons: Sequence[Comparison]) -> str:
    """Every retelling beside the original."""
    head = ("set: told", "same", "missing", "new", "apart, standard errors", "misfit off")
    return table(head, (
        (c.id, HOLDS if c.holds else FAILS, ", ".join(c.missing), ", ".join(c.new),
         f"{c.apart:.2g}", f"{100 * c.misfit:.2g} %")
        for c in comparisons
    ))  # fmt: skip


def injected_tables(scored: dict[str, Any]) -> list[str]:
    """Rates, power against size, free runs, sets and kinds."""
    size = lambda row: f"{row['from']:g} to {row['to']:g}"
    per = lambda some: [(name, *map(shown, each.values())) for name, each in some.items()]
    head = ("named besides", "named or audited", "wrong names", "90 % intervals")
    return [
        table(("figure", "found (Wilson 95 %)"),
              [(key, shown(rate)) for key, rate in scored["rates"].items()]
              + [(key, f"{value:.3g}") for key, value in scored["numbers"].items()]),
        *(table((f"size in {limits}", "named besides", "named or audited", "wrong names"),
                [(size(row), shown(row["named"]), shown(row["named or audited"]),
                  shown(row["wrong"])) for row in scored[key]])
          for limits, key in (("detection limits", "power"),
                              ("the limits stated beside", "power by the limits stated beside"))),
        table(("free run ahead, s", "after / before, median", "worse"),
              [(h, f"{one['median']:.3g}", shown(one["worse"]))
               for h, one in scored["free"].items()]),
        table(("set", *head), per(scored["by_set"])),
        table(("injected", *head), per(scored["by_injection"])),
    ]  # fmt: skip


def again_table(pairs: Sequence[tuple[Outcome, Outcome]]) -> str:
    """Injected cases by two revisions, the same cases side by side."""
    keys = ("wrong names", "named besides what the unchanged runs give",
            "names of the unchanged runs lost", "90 % intervals that hold the truth")  # fmt: skip
    were = [before for before, _ in pairs if before.wrong]
    chosen = {"wrong before": were, "not wrong before": [b for b, _ in pairs if not b.wrong]}
    rows = []
    for name, cases in chosen.items():
        of = {case.case for case in cases}
        sides = [rates([pair[side] for pair in pairs if pair[0].case in of]) for side in (0, 1)]
        rows += [(f"{name}: {key}", *(shown(side[key]) for side in sides)) for key in keys]
    return table(("of the cases", "before", "by another revision"), rows)


def score(folder: Path) -> tuple[dict[str, Any], str]:
    """All figures, and their tables in Markdown."""
    lines = {part: results.read(part, folder) for part in results.PARTS}
    unchanged = {name: one for name, one in lines["unchanged"].items() if "frozen" in one}
    outcomes = [judge(line, unchanged[line["case"]["set"]]) for line in lines["injected"].values()
                if line["case"]["set"] in unchanged]  # fmt: skip
    told = [compare(line, unchanged[line["set"]]) for line in lines["told"].values()
            if line["set"] in unchanged]  # fmt: skip
    again = [compare_again(line, unchanged[name]) for name, line in lines["again"].items()
             if name in unchanged]  # fmt: skip
    judged = {outcome.case: outcome for outcome in outcomes}
    pairs = [(judged[key], judge(line, unchanged[line["case"]["set"]]))
             for key, line in lines["injected_again"].items() if key in judged]  # fmt: skip
    checks = fact_rows(lines["facts"])
    scored = {
        "cases": len(outcomes),
        "rates": rates(outcomes),
        "numbers": numbers(outcomes),
        "power": power(outcomes, lambda o: o.limits),
        "power by the limits stated beside": power(outcomes, lambda o: o.stated, (0.0, *BINS)),
        "free": free_runs(outcomes),
        "by_set": parts(outcomes, lambda o: o.set),
        "by_injection": parts(outcomes, lambda o: o.injection),
        "facts": checks,
        "facts that hold": share(row["holds"] for row in checks if row["holds"] is not None),
        "told otherwise, the same": share(one.holds for one in told),
        "by another revision, the same": share(one.holds for one in again),
        "wrong names of the same cases": {
            "before": share(bool(before.wrong) for before, _ in pairs),
            "by another revision": share(bool(now.wrong) for _, now in pairs),
        },
        "revisions": sorted({line["revision"] for some in lines.values() for line in
                             some.values()}),
    }  # fmt: skip
    verdict = {True: HOLDS, False: FAILS, None: WELCOME}
    pages = [
        "## Unchanged", unchanged_table(lines["unchanged"]),
        f"## By another revision, the same: {shown(scored['by another revision, the same'])}",
        told_table(again),
        f"## Facts: {shown(scored['facts that hold'])}",
        table(("fact", "check", "holds"),
              [(row["fact"], row["check"], verdict[row["holds"]]) for row in checks]),
        f"## Told otherwise, the same: {shown(scored['told otherwise, the same'])}",
        told_table(told),
        f"## Injected: {len(outcomes)} cases", *injected_tables(scored),
        f"## Injected, by another revision: {len(pairs)} cases", again_table(pairs),
    ]  # fmt: skip
    return scored, "\n\n".join(pages) + "\n"


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--out", type=Path, default=results.FOLDER, help="folder of the results")
    args = parser.parse_args(argv)
    scored, pages = score(args.out)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "scores.json").write_text(json.dumps(scored, indent=1) + "\n", encoding="utf-8")
    (args.out / "scores.md").write_text(pages, encoding="utf-8")
    print(pages)


if __name__ == "__main__":
    main()
