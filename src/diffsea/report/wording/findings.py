"""What the audit found, in words: alike findings of several recordings together."""

from collections.abc import Iterable
from typing import TypeVar

from diffsea.recordings import Finding
from diffsea.recordings.auditing.finding import weight
from diffsea.report.quantities import is_known, round_to_error, significant
from diffsea.report.wording.words import Record, as_words, count_recordings


LEAST_COST = 0.01  # m in a minute, below which none is told


def misread_sentences(summary: Record) -> list[str]:
    """What the audit says is wrong with how recordings are read, and how to put it right.

    Each once, with the recordings that show it.
    """
    told = []
    for group in alike_findings(filter(is_misread, summary["audit"]), "repair"):
        first, repair = group[0], group[0].get("repair")
        where = first["recording"] if len(group) == 1 else count_recordings(len(group))
        told.append(f"{first['message']} (in {where}){f'. Repair: {repair}' if repair else ''}.")
    return told


def is_misread(finding: Record) -> bool:
    """Whether what is wrong, without a doubt, is how a recording is read."""
    return weight(finding["kind"], finding.get("doubt"), None)[0]


Found = TypeVar("Found", Finding, Record)

WEIGHED = (
    "First what is wrong with how the recording is read, then by cost: how far off a minute's "
    "track is while the fault is left in."
)


def heaviest_first(found: Iterable[Found]) -> list[Found]:
    """Findings in the order in which they matter, as `WEIGHED` says; costs not known come last."""

    def key(one: Finding | Record) -> tuple[bool, float]:
        if isinstance(one, Finding):
            return weight(one.kind, one.doubt, one.cost)
        return weight(one["kind"], one.get("doubt"), one.get("cost"))

    return sorted(found, key=key, reverse=True)


def cost_words(cost: float | None) -> str:
    """What a fault costs: `0.34 m`; nothing where that is not known."""
    if not is_known(cost):
        return ""
    return f"{significant(cost, 2)} m" if cost >= LEAST_COST else f"below {LEAST_COST:g} m"


def alike_findings(found: Iterable[Record], *same: str) -> list[list[Record]]:
    """Findings of the audit, those of one kind on the same channels of several recordings together.

    Arguments:
        same: keys that they must have in common, besides.
    """
    alike: dict[tuple[object, ...], list[Record]] = {}
    for one in found:
        key = one["kind"], *(one.get("channels") or ()), *(one.get(name) for name in same)
        others = [group for known, group in alike.items() if known[:-1] == key]
        where = one["recording"]
        open_ones = [g for g in others if all(other["recording"] != where for other in g)]
        if open_ones:
            open_ones[0].append(one)
        else:
            alike[(*key, len(alike))] = [one]
    return list(alike.values())


def finding_line(group: list[Record]) -> str:
    """What was found in one recording, and the sizes in the others that show it, too."""
    first, sizes = group[0], [one.get("value") for one in group]
    text = f"{as_words(first['kind'])} in {first['recording']}: {first['message']}"
    if len(group) == 1:
        return text
    known = [size for size in sizes if is_known(size)]
    span = ""
    if len(known) == len(group):
        ends = [round_to_error(end(known), None, first.get("unit", "")) for end in (min, max)]
        span = f", {' to '.join(ends)}" if len(set(ends)) > 1 else ""
    return f"{text}; and in {len(group) - 1} more{span}"
