"""Tables of diagnoses for READMEs: what was named, what else was looked at, what is predicted."""

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.harness.reporting import table

import numpy as np

from diffsea.report.quantities import (
    odds_or_bound,
    probability,
    round_to_error,
    significant,
    with_error,
)
from diffsea.report.wording.horizons import two_digits


Record = dict[str, Any]

SHOWN = 6  # candidates
QUANTITIES = {
    "position": ("m", "m"),
    "heading": ("rad", "deg"),
    "u": ("m/s", "m/s"),
    "v": ("m/s", "m/s"),
    "r": ("rad/s", "deg/s"),
}  # unit of the record, unit that is shown


def told(record: Record) -> Record:
    """What `results.json` keeps of a diagnosis: verdict, names, sizes, candidates, errors."""
    kept = ("verdict", "remainder_p_value", "fit", "seconds")
    effects = [
        {"name": labelled(one), "parameters": one["parameters"], "evidence": one["evidence"]}
        for one in record["effects"]
    ]
    candidates = [
        {key: row[key] for key in row if key in _OF_CANDIDATES} | {"label": labelled(row)}
        for row in record["candidates"][:SHOWN]
    ]
    horizons = record["held_out"]["horizons"]
    return {key: record[key] for key in kept} | {
        "effects": effects, "candidates": candidates, "horizons": horizons,
    }  # fmt: skip


def audit_table(audits: Mapping[str, Sequence[Record]]) -> str:
    """What an audit finds in a set: in how many runs, and the middle and ends of its size."""
    rows = []
    for title, findings in audits.items():
        kinds: dict[str, list[Record]] = {}
        for one in findings:
            what = f"{one['kind']} ({', '.join(one['channels'])})"
            kinds.setdefault(what, []).append(one)
        for k, (what, found) in enumerate(kinds.items()):
            values = [float(one["value"]) for one in found if one["value"] is not None]
            if not values:
                rows.append((title if k == 0 else "", what, len(found), ""))
                continue
            unit = str(found[0]["unit"])
            ends = [
                round_to_error(end, None, unit)
                for end in (np.median(values), min(values), max(values))
            ]
            size = ends[0] if len(values) == 1 else f"{ends[0]} ({ends[1]} to {ends[2]})"
            runs = len({one["recording"] for one in found})
            rows.append((title if k == 0 else "", what, runs, size))
        if not kinds:
            rows.append((title, "nothing", "", ""))
    return table(("", "found", "runs", "size, median (least to most)"), rows)


_OF_CANDIDATES = (
    "status", "reason", "log10_odds", "parameters", "held_out_gain", "held_out_gain_std",
)  # fmt: skip


def labelled(row: Record) -> str:
    """A name, what it acts on, and the run if it has one."""
    where = [*filter(None, [row.get("variant", "").replace("_", " ")])]
    where += row.get("actuators") or row.get("channels") or []
    if row.get("recording"):
        where = [*where, row["recording"]]
    return f"{row['name']} ({', '.join(where)})" if where else row["name"]


def sizes(row: Record) -> str:
    """All sizes of an effect with their standard errors."""
    found = row.get("parameters") or {}
    return ", ".join(
        f"{key} {with_error(one['value'], one['std'], one['unit'])}" for key, one in found.items()
    )


def names_table(records: Mapping[str, Record]) -> str:
    """What each diagnosis named, by its title."""
    rows = []
    for title, record in records.items():
        p = probability(record["remainder_p_value"])
        first = (title, record["verdict"])
        effects = [one for one in record["effects"] if one["name"] != "unexplained"]
        rows += [
            (*(first if k == 0 else ("", "")), labelled(one), sizes(one),
             odds_or_bound(one["evidence"]["log10_odds"]), p if k == 0 else "")
            for k, one in enumerate(effects)
        ] or [(*first, "nothing", "", "", p)]  # fmt: skip
    return table(("", "verdict", "named", "size", "odds", "p of what is left"), rows)


def candidates_table(record: Record) -> str:
    """The first candidates of a diagnosis, by their odds one at a time."""
    rows = []
    for row in record["candidates"][:SHOWN]:
        gain = row.get("held_out_gain")
        told_gain = "" if gain is None else f"{gain:.0f} +- {row['held_out_gain_std']:.0f}"
        rows.append((labelled(row), sizes(row), significant(row["log10_odds"], 2), told_gain,
                     row["status"], row["reason"]))  # fmt: skip
    head = ("candidate", "size", "log10 odds", "held-out gain, -2 log likelihood", "", "")
    return table(head, rows)


def predictions_table(
    rows_of: Mapping[str, Sequence[Record]], models: tuple[str, str] = ("nominal", "diagnosed")
) -> str:
    """Free-run errors of held-out runs by horizon, of one model -> of another, by title."""
    rows = []
    for title, horizons in rows_of.items():
        for k, row in enumerate(horizons):
            before, after = (row[model] for model in models)
            cells = [_pair(before, after, quantity) for quantity in QUANTITIES]
            rows.append((title if k == 0 else "", f"{row['seconds']:g}", *cells))
    head = [f"{name}, {unit}" for name, (_, unit) in QUANTITIES.items()]
    return table(("", "seconds ahead", *head), rows)


def _pair(before: Record, after: Record, quantity: str) -> str:
    ends = [float(one[quantity]) for one in (before, after) if one.get(quantity) is not None]
    if len(ends) < 2:
        return "-"
    own, shown = QUANTITIES[quantity]
    numbers = [two_digits(end, own).removesuffix(shown).strip() for end in ends]
    return numbers[0] if numbers[0] == numbers[1] else " -> ".join(numbers)
