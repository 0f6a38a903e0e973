"""Lines of results judged: an injected case beside its truth, a retelling beside the original."""

import dataclasses
import math
from typing import Any

from experiments.concealed_real import cases
from experiments.concealed_real.checks import Line, acted_on
from experiments.concealed_real.injections import DROPPED, INJECTIONS
from experiments.concealed_real.material import Document
from experiments.concealed_real.results import names
from experiments.concealed_real.retellings import CIRCULAR, RETELLINGS, difference


Z90 = 1.6449
SAME_SIZE = 3.0  # standard errors
ONSET_SHARE = 0.05  # of the shortest run: how near an onset must be
HORIZONS = ("5", "20", "60")  # s


@dataclasses.dataclass(frozen=True)
class Outcome:
    """An injected case: what was said, beside what was true and what the unchanged runs give.

    Arguments:
        kind: `effect`, `step` of a sensor, `outside` the catalogue, `harmless`, or `label`.
        limits: the size in the limits that it was drawn by.
        stated: the size in the limits that the unchanged runs beside it state, where they do.
        named: a right name is given.
        besides: a right name is given that the unchanged runs do not give, or not there, or with
            another size.
        wrong: names that are neither right nor given by the unchanged runs.
        lost: names that the unchanged runs give and this one does not.
        audited: the audit finds a kind that is right, in more places than unchanged.
        where: of the entries with a right name one acts on what is true; None without such.
        onset: likewise for the time of a step.
        covered: whether the 90 % interval of each number holds the truth; `errors` are relative.
        free: error of the position at each horizon, nominal and diagnosed, m.
    """

    case: str
    set: str
    injection: str
    kind: str
    limits: float | None
    stated: float | None
    verdict: str
    said: tuple[str, ...]
    named: bool
    besides: bool
    wrong: tuple[str, ...]
    lost: tuple[str, ...]
    audited: bool
    where: bool | None
    onset: bool | None
    covered: dict[str, bool]
    errors: dict[str, float]
    free: dict[str, tuple[float, float]]
    seconds: float


def kind_of(injection: str) -> str:
    """What naming means for an injection."""
    if injection in DROPPED or (INJECTIONS[injection].names
                                and not INJECTIONS[injection].may_be_silent):  # fmt: skip
        return "effect"
    if INJECTIONS[injection].names:
        return "step"
    if injection == "exchange":
        return "label"
    outside = ("swinging-compass", "restless-order")
    return "outside" if injection in outside else "harmless"


def judge(line: Line, unchanged: Line) -> Outcome:
    """An injected case beside its truth."""
    case = line["case"]
    true, said = cases.truth(case), names(line)
    before = names(unchanged)
    entries = [effect for effect in line["effects"] if effect["name"] in true["names"]]
    # Sizes of what was there before add up with what was injected: those are not compared.
    fresh = [effect for effect in entries if effect["name"] not in before]
    numbers = [_numbers(effect, true["numbers"]) for effect in fresh]
    best = min(numbers, key=lambda one: sum(one[1].values()), default=({}, {}))
    return Outcome(
        case["id"], case["set"], case["injection"], kind_of(case["injection"]), case["limits"],
        cases.in_limits(case, unchanged["frozen"]), line["verdict"], tuple(said),
        named=bool(entries),
        besides=any(not _is_among(effect, unchanged["effects"]) for effect in entries),
        wrong=tuple(n for n in said if n not in true["names"] and n not in before),
        lost=tuple(n for n in before if n not in said),
        audited=any(
            _count(line["audit"], kind) > _count(unchanged["audit"], kind)
            for kind in true["audit"]
        ),
        where=_in_place(entries, true["acts_on"]),
        onset=_on_time(entries, true["onset"], unchanged["frozen"]["features"]["shortest"]),
        covered=best[0],
        errors=best[1],
        free=_free(line),
        seconds=line["seconds"],
    )  # fmt: skip


def _is_among(effect: dict[str, Any], others: list[dict[str, Any]]) -> bool:
    """Whether the unchanged runs give an effect, too: by name, place, and size within its error."""
    for other in others:
        alike = other["name"] == effect["name"] and set(acted_on(other)) == set(acted_on(effect))
        far = max(difference(effect, other).values(), default=0.0)
        if alike and min(far, max(difference(other, effect).values(), default=0.0)) <= SAME_SIZE:
            return True
    return False


def _count(audit: list[dict[str, Any]], kind: str) -> int:
    return sum(one["kind"] == kind for one in audit)


def _in_place(entries: list[dict[str, Any]], true: list[str]) -> bool | None:
    """Whether one of the entries acts on just what is true; one that lists nothing acts on all."""
    if not entries or not true:
        return None
    return any(not acted_on(entry) or set(acted_on(entry)) == set(true) for entry in entries)


def _on_time(entries: list[dict[str, Any]], onset: float | None, shortest: float) -> bool | None:
    times = [e["parameters"]["time"]["value"] for e in entries if "time" in e["parameters"]]
    if onset is None or not times:
        return None
    return any(abs(time - onset) <= ONSET_SHARE * shortest for time in times)


def _numbers(
    effect: dict[str, Any], true: dict[str, float]
) -> tuple[dict[str, bool], dict[str, float]]:
    """Of each number that is true and stated: whether its interval holds it; its error.

    Relative errors; of directions and phases in radians.
    """
    covered, errors = {}, {}
    for name, value in true.items():
        stated = effect["parameters"].get(name)
        if name == "time" or stated is None or stated.get("std") is None:
            continue
        off = stated["value"] - value
        if name in CIRCULAR:
            off = (off + math.pi) % (2 * math.pi) - math.pi
        half = Z90 * stated["std"]
        low, high = stated.get("interval") or (stated["value"] - half, stated["value"] + half)
        covered[name] = low <= stated["value"] - off <= high
        errors[name] = abs(off) if name in CIRCULAR else abs(off) / max(abs(value), 1e-12)
    return covered, errors


def _free(line: Line) -> dict[str, tuple[float, float]]:
    """Position errors of free predictions, before and after, by the seconds ahead."""
    free = line.get("free", {})
    before, after = (free.get(model) or {} for model in ("nominal", "diagnosed"))
    both = ((h, before.get(h) or {}, after.get(h) or {}) for h in HORIZONS)
    quantity = lambda one: one.get("position", one.get("u"))
    pairs = {h: (quantity(a), quantity(b)) for h, a, b in both}
    return {h: (a, b) for h, (a, b) in pairs.items() if a is not None and b is not None}


# Told otherwise


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A retelling beside the original: same names, sizes apart in standard errors, misfit apart."""

    id: str
    same_names: bool
    missing: tuple[str, ...]
    new: tuple[str, ...]
    apart: float  # the largest, in standard errors; infinite where a name has no partner
    misfit: float  # nominal, as a share; the larger one of training and held-out
    holds: bool
    seconds: float


def compare(line: Line, unchanged: Line) -> Comparison:
    """A retelling beside the original."""
    retelling = RETELLINGS[line["id"].partition(":")[2]]
    document: Document = unchanged["frozen"]["document"]
    expected = [retelling.translate(effect, document) for effect in unchanged["effects"]]
    return _beside(line, unchanged, expected, (retelling.tolerance, retelling.misfit))


def compare_again(line: Line, unchanged: Line) -> Comparison:
    """The same runs by another revision, held to what the strictest retelling is held to."""
    strictest = tuple(
        min(getattr(one, limit) for one in RETELLINGS.values()) for limit in ("tolerance", "misfit")
    )
    return _beside(line, unchanged, unchanged["effects"], strictest)


def _beside(
    line: Line, unchanged: Line, expected: list[dict[str, Any]], limits: tuple[float, ...]
) -> Comparison:
    """A line beside the original: effects as expected, sizes and misfit within limits."""
    apart = max((_nearest(effect, line["effects"]) for effect in expected), default=0.0)
    was, now = set(names(unchanged)), set(names(line))
    misfit = _misfit(line, unchanged)
    failed = line["verdict"] == "failed"
    same = was == now and not failed
    holds = same and apart <= limits[0] and misfit <= limits[1]
    return Comparison(line["id"], same, tuple(sorted(was - now)), tuple(sorted(now - was)), apart,
                      misfit, holds, line["seconds"])  # fmt: skip


def _nearest(effect: dict[str, Any], found: list[dict[str, Any]]) -> float:
    """How far the nearest entry of the same name is, in standard errors; infinite for none."""
    alike = [other for other in found if other["name"] == effect["name"]]
    return min(
        (max(difference(other, effect).values(), default=0.0) for other in alike),
        default=math.inf,
    )


def _misfit(line: Line, unchanged: Line) -> float:
    """How far the nominal misfit is off, as a share."""
    was, now = (one.get("fit", {}).get("nominal", {}) for one in (unchanged, line))
    shares = [abs(now[k] / was[k] - 1) for k in was if was.get(k) and now.get(k)]
    return max(shares, default=math.inf)
