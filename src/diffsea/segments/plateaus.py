"""Steering that is held: the orders of a trial, told from hand steering and autopilots."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from diffsea.statistics import noise_scale


_FLICKER = 5  # rows of the median that removes outliers
_BAND = 0.08  # of the level: closer than this to it counts as being on it
_NARROWEST = math.radians(0.5)
_INSIDE = 0.9  # of the rows of a hold that lie within its band
_CREEP = 0.3  # of the level, from which on the way to it is steep
_LEVEL = 0.005  # of the level: smaller changes are none
_PEAK = 0.7  # of its largest angle: a swing is near its peak
_UNLIKE = 0.2  # relative difference of size up to which two orders are a zig-zag's

Samples = Float[np.ndarray, "time"]


@dataclasses.dataclass(frozen=True)
class Hold:
    """A stretch of rows in which the steering stays at one angle (rad)."""

    first: int
    last: int
    level: float


def find_holds(angle: Samples, count: int, breaks: tuple[int, ...] = ()) -> list[Hold]:
    """Every stretch of at least `count` rows in which the angle (rad) stays, zero included."""
    edges = [0, *breaks, len(angle)]
    noise = noise_scale(angle)
    return [
        hold
        for start, end in zip(edges[:-1], edges[1:], strict=True)
        if end - start > count
        for hold in _holds(angle[start:end], count, noise, start)
    ]


def band(level: float, noise: float) -> float:
    """How far (rad) from its level a held angle may be."""
    return max(_BAND * abs(level), 4 * noise, _NARROWEST)


def _holds(angle: Samples, count: int, noise: float, offset: int) -> list[Hold]:
    calm = ndimage.median_filter(angle, _FLICKER, mode="nearest")
    high = ndimage.maximum_filter1d(calm, count, mode="nearest")
    low = ndimage.minimum_filter1d(calm, count, mode="nearest")
    widest = 2 * np.maximum(np.maximum(_BAND * np.abs(high + low) / 2, 4 * noise), _NARROWEST)
    centres, number = ndimage.label(high - low <= widest)
    holds: list[Hold] = []
    for (rows,) in ndimage.find_objects(centres, number):
        first = max(rows.start - count // 2, 0)
        last = min(rows.stop - 1 + count // 2, len(angle) - 1)
        level = float(np.median(angle[first : last + 1]))
        on = np.flatnonzero(np.abs(calm[first : last + 1] - level) <= band(level, noise))
        first, last = first + on[0], first + on[-1]
        if on.size < max(_INSIDE * (last - first + 1), 0.5 * count):
            continue
        new = Hold(int(first) + offset, int(last) + offset, level)
        holds = _joined(holds, new, angle, count, noise, offset)
    return holds


def _joined(
    holds: list[Hold], new: Hold, angle: Samples, count: int, noise: float, offset: int
) -> list[Hold]:
    """The holds with a new one, which continues the last after a short flicker."""
    if not holds:
        return [new]
    old = holds[-1]
    if abs(new.level - old.level) > band(old.level, noise) or new.first - old.last > count:
        return [*holds, new]
    level = float(np.median(angle[old.first - offset : new.last + 1 - offset]))
    return [*holds[:-1], Hold(old.first, new.last, level)]


def find_lobes(angle: Samples, least: float, breaks: tuple[int, ...] = ()) -> list[Hold]:
    """Swings of the angle (rad) beyond `least` to either side, as if held near their peaks.

    Actuators that are slow beside the legs of a zig-zag never stay anywhere.
    """
    calm = ndimage.median_filter(angle, _FLICKER, mode="nearest")
    side = np.where(np.abs(calm) > least, np.sign(calm), 0).astype(int)
    edges = np.unique([0, *(np.flatnonzero(np.diff(side)) + 1), *breaks, len(side)])
    lobes = []
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        size = np.abs(calm[start:stop])
        if side[start] and stop - start > _FLICKER:
            near = np.flatnonzero(size >= _PEAK * np.max(size)) + start
            lobes.append(Hold(int(near[0]), int(near[-1]), side[start] * float(np.max(size))))
    return lobes


def chains(holds: list[Hold], t: Samples, least: float) -> list[list[Hold]]:
    """Consecutive holds of alternating side and like size, above `least` rad."""
    found: list[list[Hold]] = []
    for before, hold in zip([None, *holds[:-1]], holds, strict=True):
        if abs(hold.level) < least:
            continue
        if found and found[-1][-1] is before and _reverses(before, hold, t):
            found[-1].append(hold)
        else:
            found.append([hold])
    return found


def _reverses(before: Hold, after: Hold, t: Samples) -> bool:
    sizes = abs(before.level), abs(after.level)
    alike = abs(sizes[0] - sizes[1]) <= _UNLIKE * max(sizes)
    longer = max(t[hold.last] - t[hold.first] for hold in (before, after))
    return before.level * after.level < 0 and alike and t[after.first] - t[before.last] <= longer


def foot(angle: Samples, hold: Hold, count: int, noise: float, earliest: int) -> int:
    """The last row before the steering began to move to a hold, found backwards from it.

    It has been found where the angle stops falling back from the hold, or stays for `count`
    rows. Rows before `earliest` are not looked at.
    """
    sense = math.copysign(1.0, hold.level)
    calm = sense * ndimage.median_filter(angle[earliest : hold.first + 1], 3, mode="nearest")
    # A lag creeps at the end of its way: that part is not looked at.
    off = np.flatnonzero(np.abs(calm - abs(hold.level)) > _CREEP * abs(hold.level))
    at = lowest = int(off[-1]) if off.size else len(calm) - 1
    tolerance = max(3 * noise, _LEVEL * abs(hold.level))
    while at > 0 and lowest - at <= count:
        at -= 1
        if calm[at] < calm[lowest] - tolerance:
            lowest = at
        elif calm[at] > calm[lowest] + max(tolerance, _BAND * abs(hold.level)):
            break
    return earliest + lowest


def departure(angle: Samples, before: float, threshold: float, arrived: int, earliest: int) -> int:
    """The first row in which the angle is beyond `threshold` rad of `before`, for good.

    It is then on its way to the place where it has `arrived` (a row). Rows before `earliest`
    are not looked at.
    """
    near = np.flatnonzero(np.abs(angle[earliest : arrived + 1] - before) <= threshold)
    return earliest + int(near[-1]) + 1 if near.size else earliest
