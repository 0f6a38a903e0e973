# pyright: reportArgumentType=false
"""The scores as files: JSON, a Markdown table, confusion matrix, power curve, failures by case."""

import csv
import json
import math
from pathlib import Path

import matplotlib


matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from .outcomes import Outcome


NOTHING = ("(consistent)", "(ambiguous)", "(unexplained)", "(failed)")


def write(folder: Path, scores: dict, outcomes: list[Outcome]) -> None:
    """Everything below `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_clean(scores), indent=1) + "\n"
    (folder / "scores.json").write_text(text, encoding="utf-8")
    (folder / "scores.md").write_text(markdown(scores), encoding="utf-8")
    _pictures(folder, scores["power"], outcomes)
    _table(folder / "failures.csv", outcomes, failed_only=True)
    _table(folder / "cases.csv", outcomes, failed_only=False)


def write_parts(folder: Path, parts: dict, outcomes: list[Outcome]) -> None:
    """The pictures, and in parts.md the tables by size, effect, hull and odds."""
    _pictures(folder, parts["power"], outcomes)
    text = "\n".join([f"{len(outcomes)} cases.", *_by_parts(parts)]) + "\n"
    (folder / "parts.md").write_text(text, encoding="utf-8")


def _pictures(folder: Path, power: list[dict], outcomes: list[Outcome]) -> None:
    """Confusion matrix, as a table too, and power curve."""
    _confusion_files(folder, *confusion(outcomes))
    if any(row["right"]["n"] for row in power):
        _power_figure(folder / "power.png", power)


def _clean(value):
    """NaN as null, for JSON."""
    if isinstance(value, dict):
        return {k: _clean(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_clean(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def percent(s: dict) -> str:
    """37 % (30 to 45), 52/140."""
    if not s["n"]:
        return "none"
    return (f"{100 * s['share']:.0f} % ({100 * s['low']:.0f} to {100 * s['high']:.0f}), "
            f"{s['hits']}/{s['n']}")  # fmt: skip


def markdown(scores: dict) -> str:
    """The tables that the README quotes."""
    targets = scores["targets"]
    lines = [f"{scores['cases']} cases: "
             + ", ".join(f"{n} {s}" for s, n in scores["strata"].items()) + ".", "",
             "| figure | found (Wilson 95 %) | target |", "| --- | --- | --- |"]  # fmt: skip
    for name, s in scores["rates"].items():
        if not s["n"] and name not in targets:
            continue  # a stratum that this set has not
        lines.append(f"| {name} | {percent(s)} | {targets.get(name, '')} |")
    for name, x in scores["numbers"].items():
        lines.append(
            f"| {name} | {'none' if math.isnan(x) else f'{x:.3g}'} | {targets.get(name, '')} |"
        )
    lines += _by_parts(scores)
    if scores.get("baselines"):
        lines += ["", "| method | first name right | truth in its set | names on clean |",
                  "| --- | --- | --- | --- |"]  # fmt: skip
        for row in scores["baselines"]:
            cells = [percent(row[k]) for k in ("top", "set", "alarm")]
            lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _by_parts(scores: dict) -> list[str]:
    lines = ["", "| size in detection limits | named rightly | offered | noticed |",
             "| --- | --- | --- | --- |"]  # fmt: skip
    for row in scores["power"]:
        lines.append(f"| {row['from']:g} to {row['to']:g} | {percent(row['right'])} | "
                     f"{percent(row['offered'])} | {percent(row['noticed'])} |")  # fmt: skip
    lines += ["", "| effect | named rightly | decided | offered | parameter error, median |",
              "| --- | --- | --- | --- | --- |"]  # fmt: skip
    for name, e in scores["by_effect"].items():
        x = e["parameter error, median"]
        error = "" if math.isnan(x) else f"{100 * x:.0f} %"
        lines.append(f"| {name} | {percent(e['named rightly'])} | {percent(e['decided'])} | "
                     f"{percent(e['offered'])} | {error} |")  # fmt: skip
    lines += ["", "| hull | named rightly, of decided | of all | wrong name | false alarms |",
              "| --- | --- | --- | --- | --- |"]  # fmt: skip
    for name, e in scores["by_hull"].items():
        lines.append(f"| {name} | " + " | ".join(percent(s) for s in e.values()) + " |")
    lines += ["", "| stated log10 odds | stated probability, mean | true |", "| --- | --- | --- |"]
    for row in scores["reliability"]:
        if row["true"]["n"]:
            low, high = row["log10_odds_from"], row["log10_odds_to"]
            edges = f"{'' if low is None else f'{low:g}'} to {'' if high is None else f'{high:g}'}"
            lines.append(f"| {edges} | {row['stated']:.4f} | {percent(row['true'])} |")
    return lines


def confusion(outcomes: list[Outcome]) -> tuple[list[str], list[str], np.ndarray]:
    """True effect (single ones, and the strata without) against the first name or the verdict."""
    label = lambda o: o.true[0] if o.limits else f"({o.stratum})"
    said = lambda o: o.named[0] if o.decided else f"({o.verdict})"
    used = [o for o in outcomes if o.stratum == "single" or not o.limits]
    rows = sorted({label(o) for o in used}, key=lambda n: (n.startswith("("), n))
    names = {said(o) for o in used} | {r for r in rows if not r.startswith("(")}
    columns = sorted(n for n in names if not n.startswith("("))
    columns += [n for n in NOTHING if n in names]
    counts = np.zeros((len(rows), len(columns)), int)
    for o in used:
        if said(o) in columns:
            counts[rows.index(label(o)), columns.index(said(o))] += 1
    return rows, columns, counts


def _confusion_files(folder: Path, rows: list[str], columns: list[str], counts: np.ndarray) -> None:
    with (folder / "confusion.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["true \\ said", *columns])
        for name, line in zip(rows, counts, strict=True):
            writer.writerow([name, *line.tolist()])
    if not rows or not columns:
        return
    figure, axes = plt.subplots(figsize=(2.5 + 0.3 * len(columns), 2.0 + 0.28 * len(rows)))
    per_row = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(per_row, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        colour = "white" if per_row[i, j] > 0.5 else "black"
        axes.text(j, i, counts[i, j], ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set_xlabel("said first")
    axes.set_ylabel("true")
    figure.savefig(folder / "confusion.png", dpi=120, bbox_inches="tight")
    plt.close(figure)


def _power_figure(path: Path, power: list[dict]) -> None:
    figure, axes = plt.subplots(figsize=(6, 4))
    middle = np.array([math.sqrt(row["from"] * row["to"]) for row in power])
    kinds = (("noticed", "anything noticed", 0.96), ("offered", "in the set offered", 1.0),
             ("right", "named rightly", 1.04))  # fmt: skip
    for kind, label, aside in kinds:
        s = [row[kind] for row in power]
        y = np.array([x["share"] for x in s])
        spread = np.abs(np.array([[x["low"] for x in s], [x["high"] for x in s]]) - y)
        axes.errorbar(aside * middle, y, spread, marker="o", capsize=3, label=label)
    axes.set_xscale("log")
    axes.set_xticks([1, 2, 4, 8, 16, 30], ["1", "2", "4", "8", "16", "30"])
    axes.set_xlabel("size of the effect, detection limits")
    axes.set_ylabel("share of cases")
    axes.set_ylim(-0.02, 1.02)
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def _table(path: Path, outcomes: list[Outcome], failed_only: bool) -> None:
    """A line for each case; `what` for a wrong name, a missed large effect, an alarm, an error."""
    columns = ("case", "hull", "stratum", "true", "limits", "verdict", "named", "rivals",
               "log10 odds", "errors", "covered", "seconds", "what", "message")  # fmt: skip
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for o in outcomes:
            what = _failure(o)
            if failed_only and not what:
                continue
            message = (o.failure or "").strip().splitlines()[-1:] or [""]
            writer.writerow([o.case, o.hull, o.stratum, "+".join(o.keys), _joined(o.limits),
                             o.verdict, "+".join(o.named), "+".join(o.rivals),
                             _joined(o.log10_odds),
                             _joined(o.errors.values()), "+".join(map(str, o.covered.values())),
                             o.seconds, what, message[0]])  # fmt: skip


def _joined(numbers) -> str:
    return "+".join("" if x is None else f"{x:.3g}" for x in numbers)


def _failure(o: Outcome) -> str:
    if o.verdict == "failed":
        return "error"
    if o.wrong:
        return "wrong name"
    if o.limits and o.stratum != "uninformative" and not o.right and min(o.limits) >= 8.0:
        return "ambiguous" if set(o.true) <= o.offered else "missed"
    return ""
