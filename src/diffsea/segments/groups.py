"""Repeats: segments of one kind, side, order and approach speed belong together."""

import dataclasses
import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from scipy.cluster import hierarchy

from diffsea.segments.segments import Segment
from diffsea.segments.settings import SegmentSettings


def group_repeats(
    found: Sequence[Segment], settings: SegmentSettings | None = None
) -> list[Segment]:
    """The segments with `group` filled in: one label for those that repeat one another.

    All members of a group are alike: order and approach speed differ by no more than
    `settings.alike` of the larger (an order by less than `settings.order` in any case).
    What has no order or no speed is compared by what it has. The label says what is common.
    """
    settings = SegmentSettings() if settings is None else settings
    kinds: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for number, segment in enumerate(found):
        kinds[_group_key(segment)].append(number)
    labels: dict[int, str] = {}
    taken: set[str] = set()
    for numbers in kinds.values():
        for cluster in _clusters([found[n] for n in numbers], settings):
            members = [numbers[k] for k in cluster]
            label = _unused_label(_common_label([found[n] for n in members]), taken)
            taken.add(label)
            labels |= dict.fromkeys(members, label)
    return [dataclasses.replace(item, group=labels[n]) for n, item in enumerate(found)]


def _group_key(segment: Segment) -> tuple[object, ...]:
    """What must be the same: kind, manoeuvre, side, and which numbers are known."""
    known = math.isfinite(segment.order), math.isfinite(segment.approach.speed)
    return segment.kind, segment.manoeuvre, segment.side, *known


def _clusters(found: list[Segment], settings: SegmentSettings) -> list[list[int]]:
    """Complete linkage: the two members of a group that differ most are still alike."""
    if len(found) == 1:
        return [[0]]
    pairs = [
        _relative_difference(found[i], found[j], settings)
        for i in range(len(found))
        for j in range(i + 1, len(found))
    ]
    numbers = hierarchy.fcluster(hierarchy.complete(np.array(pairs)), 1.0, "distance")
    return [np.flatnonzero(numbers == n).tolist() for n in dict.fromkeys(numbers)]


def _relative_difference(one: Segment, other: Segment, settings: SegmentSettings) -> float:
    """How unlike two segments are; one is just alike."""
    differences = [0.0]
    if math.isfinite(one.order):
        allowed = max(settings.alike * max(one.order, other.order), settings.order)
        differences.append(abs(one.order - other.order) / allowed)
    speeds = one.approach.speed, other.approach.speed
    if math.isfinite(speeds[0]):
        allowed = settings.alike * max(*speeds, 1e-12)
        differences.append(abs(speeds[0] - speeds[1]) / allowed)
    return max(differences)


def _common_label(members: list[Segment]) -> str:
    first = members[0]
    words = [first.kind if first.manoeuvre == "unknown" else first.manoeuvre, first.side or ""]
    if math.isfinite(first.order):
        words.append(f"{math.degrees(np.mean([m.order for m in members])):.0f} deg")
    if math.isfinite(first.approach.speed):
        words.append(f"{np.mean([m.approach.speed for m in members]):.3g} m/s")
    return " ".join(word for word in words if word)


def _unused_label(label: str, taken: set[str]) -> str:
    number = 2
    name = label
    while name in taken:
        name, number = f"{label} ({number})", number + 1
    return name
