"""What was ordered in a recorded run: when, to which side, how far, and for how long.

The steering order is a rudder angle or, for twin thrusters, its equivalent

    delta = 35 deg * (T_port - T_starboard) / |T_port + T_starboard|.

Orders show as plateaus of that angle. In a recording of one trial (`find_orders`) the angle that
the run holds longest sets every threshold, and hand steering before the execute does not reach it
or does not stay. In a long recording of many (`find_plateaus`, `alternating_chains`) any angle
that stays counts. A realised rudder moves slowly: it was ordered away when it left its plateau.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import ndimage

from diffsea.channels import is_azimuth, is_rudder, side_pair, steers
from diffsea.scales import HARD_OVER
from diffsea.series import hold_last, stretches
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples, Trajectory


# A plateau is left by more than this part of its angle: no helmsman or servo holds better.
_PLATEAU_BAND = 0.08
_SMALLEST_ORDER = math.radians(1)  # no trial is run at less
_NEUTRAL = 0.3  # of the order: steering within it is that of a straight course
_OUTLIER_ROWS = 5  # of the median filter that removes outliers
_NARROWEST_BAND = math.radians(0.5)  # what rudder indicators resolve
_INSIDE_SHARE = 0.9  # of the rows of a plateau that lie within its band
_CREEP = 0.3  # of the level: a lag comes this near quickly, and creeps from there
_UNCHANGED = 0.005  # of the level: smaller changes are none
_PEAK = 0.7  # of its largest angle: a swing is near its peak
_UNLIKE = 0.2  # relative difference of size up to which two orders are a zig-zag's


@dataclasses.dataclass(frozen=True)
class SteeringSource:
    """The channels that a steering angle was read from, and their `group`, commanded or executed.

    Of a `pair` of thrusters it is the rudder-equivalent angle. As text it is for notes.
    """

    group: str = ""
    channels: tuple[str, ...] = ()
    pair: bool = False

    def __str__(self) -> str:
        return f"{self.group} {', '.join(self.channels)}" if self.channels else "none"


@dataclasses.dataclass(frozen=True)
class Orders:
    """Consecutive orders to alternating sides.

    `times` (s) when each was given, `end` (s) when the last was given up or the record
    ends; `angles` (rad) as the channel has them, whatever its sign convention.
    """

    times: tuple[float, ...] = ()
    angles: tuple[float, ...] = ()
    end: float = math.inf
    source: SteeringSource = SteeringSource()


@dataclasses.dataclass(frozen=True)
class Plateau:
    """A stretch of rows, both ends included, in which the steering stays at one angle (rad)."""

    first: int
    last: int
    level: float

    @property
    def side(self) -> float:
        """+1 or -1, the sign of the angle."""
        return math.copysign(1.0, self.level)

    def seconds(self, t: Samples) -> float:
        """How long it lasts, by the time stamps (s) of the rows."""
        return t[self.last] - t[self.first]


def steering_angle(trajectory: Trajectory) -> tuple[Samples, SteeringSource] | None:
    """Steering angle (rad) in every row and the channels it is from; none if not recorded.

    Commands come before executed values. A rudder is taken first, by its name,
    then a pair of port and starboard, then an azimuth angle. Of a pair,
    whose thrusts are in one unit, it is the equivalent angle, positive to starboard, with the sum
    in its denominator kept above a twentieth of the largest thrust.
    """
    for kind, group in (("commanded", trajectory.commanded), ("executed", trajectory.executed)):
        channels = _held_channels(group)
        rudders, pair = [name for name in channels if is_rudder(name)], side_pair(channels)
        if not rudders and pair is not None:
            left, right = (channels[name] for name in pair)
            # Turning on the spot has no equivalent: only its side and order of magnitude are right.
            least = 0.05 * max(np.max(np.abs(left)), np.max(np.abs(right)), 1e-12)
            angle = HARD_OVER * (left - right) / np.maximum(np.abs(left + right), least)
            return angle, SteeringSource(kind, pair, pair=True)
        angles = rudders or [name for name in channels if is_azimuth(name)]
        if angles:
            angle = np.mean([channels[n] for n in angles], axis=0)
            return angle, SteeringSource(kind, tuple(angles))
    return None


def as_thrust(
    trajectory: Trajectory, thrusts_at_rest: Mapping[str, Callable[[Samples], Any]]
) -> Trajectory:
    """The run with what propulsors push at rest, whose ratio gives the equivalent angle.

    `thrusts_at_rest` make a thrust (N) of a channel's values, as a vessel has them.
    """

    def in_thrust(group: Mapping[str, Samples]) -> dict[str, Samples]:
        known = {c: thrust(group[c]) for c, thrust in thrusts_at_rest.items() if c in group}
        return {c: np.asarray(known.get(c, series), float) for c, series in group.items()}

    return dataclasses.replace(
        trajectory,
        commanded=in_thrust(trajectory.commanded),
        executed=in_thrust(trajectory.executed),
    )


def propulsion(trajectory: Trajectory) -> Samples | None:
    """Sum of the driving channels, each over its largest value; none if not recorded."""
    for group in (trajectory.commanded, trajectory.executed):
        driving = [values for name, values in _held_channels(group).items() if not steers(name)]
        if driving:
            return np.sum([d / max(np.max(np.abs(d)), 1e-12) for d in driving], axis=0)
    return None


def stop_order(trajectory: Trajectory) -> float | None:
    """When the propulsion ahead was cut or reversed for good (s), else none."""
    t, drive = np.asarray(trajectory.t, float), propulsion(trajectory)
    if drive is None or np.max(drive) <= 0:
        return None
    last = int(np.flatnonzero(drive > 0.5 * np.max(drive))[-1])
    if last + 1 >= len(t) or np.max(drive[last + 1 :]) > 0.1 * np.max(drive):
        return None
    return float(t[last + 1])


def _held_channels(group: Mapping[str, Samples]) -> dict[str, Samples]:
    """The channels that have values, gaps holding the sample before."""
    arrays = {name: np.asarray(values, float) for name, values in group.items()}
    return {name: hold_last(v) for name, v in arrays.items() if np.isfinite(v).any()}


# Orders of a recording that is one trial


def find_orders(trajectory: Trajectory) -> Orders:
    """The longest chain of alternating orders at the angle that the run holds for longest.

    The trajectory is a prepared one: every row counts and has a heading.
    """
    steered = steering_angle(trajectory)
    if steered is None:
        return Orders()
    angle, source = steered
    t = np.asarray(trajectory.t, float)
    level = _longest_level(t, angle)
    chains: list[list[Plateau]] = []
    for plateau in _plateaus_at(angle, level) if level >= _SMALLEST_ORDER else ():
        if chains and _goes_straight_over(t, angle, chains[-1][-1], plateau):
            chains[-1].append(plateau)
        else:
            chains.append([plateau])
    if not chains:
        return Orders(source=source)
    chain = max(chains, key=lambda c: t[c[-1].last] - t[c[0].first])
    return Orders(
        times=tuple(_order_time(t, angle, plateau.first) for plateau in chain),
        angles=tuple(float(np.median(angle[p.first : p.last + 1])) for p in chain),
        end=float(t[chain[-1].last]),
        source=source,
    )


def heading_changes(trajectory: Trajectory, orders: Orders) -> Samples:
    """Change of heading (rad) under each order."""
    return np.diff(np.interp([*orders.times, orders.end], trajectory.t, trajectory.psi))


def largest_turn(trajectory: Trajectory, orders: Orders) -> Orders:
    """The one order under which the heading changed most, as orders of their own."""
    k = int(np.argmax(np.abs(heading_changes(trajectory, orders))))
    end = orders.times[k + 1] if k + 1 < len(orders.times) else orders.end
    return dataclasses.replace(
        orders, times=orders.times[k : k + 1], angles=orders.angles[k : k + 1], end=end
    )


def neutral_share(trajectory: Trajectory, orders: Orders) -> float:
    """Share of the rows before and after the orders in which the steering is near zero."""
    steered = steering_angle(trajectory)
    if steered is None:
        return 0.0
    t = np.asarray(trajectory.t)
    others = np.abs(steered[0][(t < orders.times[0]) | (t > orders.end)])
    return float(np.mean(others < _NEUTRAL * abs(orders.angles[0]))) if others.size else 0.0


def _longest_level(t: Samples, angle: Samples) -> float:
    """The size of angle (rad) that the run holds for the longest time; zero below any order."""
    size, weight = np.abs(angle), np.gradient(t)
    top = float(np.quantile(size, 0.995))
    if top < _SMALLEST_ORDER:
        return 0.0
    counts, edges = np.histogram(size, bins=40, range=(0.2 * top, 1.05 * top), weights=weight)
    best = int(np.argmax(counts[:-1] + counts[1:]))
    around = (size >= edges[best]) & (size <= edges[best + 2])
    return float(np.median(size[around])) if around.any() else 0.0


def _plateaus_at(angle: Samples, level: float) -> list[Plateau]:
    """Every stretch of three rows or more at a size of angle (rad), small gaps closed."""
    band = max(_PLATEAU_BAND * level, 3 * noise_scale(angle, 1))
    side = np.where(np.abs(np.abs(angle) - level) <= band, np.sign(angle), 0).astype(int)
    starts = np.flatnonzero(np.diff(side, prepend=0) * (side != 0))
    found: list[Plateau] = []
    for first in starts:
        after = np.flatnonzero(side[first:] != side[first])
        last = int(first + after[0] - 1) if after.size else len(angle) - 1
        begin = int(first)
        if found and found[-1].side == side[first]:
            gap = angle[found[-1].last : first]
            # A flicker, not a new order.
            if len(gap) <= 5 or np.min(side[first] * gap) > 0.7 * abs(gap[0]):
                begin = found.pop().first
        found.append(Plateau(begin, last, side[first] * level))
    return [plateau for plateau in found if plateau.last - plateau.first >= 2]


def _goes_straight_over(t: Samples, angle: Samples, before: Plateau, after: Plateau) -> bool:
    """Whether the steering went straight from one plateau to the opposite one, and soon."""
    transit = after.side * angle[before.last : after.first + 1]
    back = np.max(np.maximum.accumulate(transit) - transit)
    soon = t[after.first] - t[before.last] <= 2 * max(before.seconds(t), after.seconds(t))
    straight = back <= 2 * _PLATEAU_BAND * abs(after.level)
    return bool(before.side != after.side and soon and straight)


def _order_time(t: Samples, angle: Samples, arrived: int) -> float:
    """When the steering left its old place on the way to the plateau it reached (s).

    A step is ordered at the first row of the new value; a ramp where its line, drawn
    through the first half, meets the old value.
    """
    sense = np.sign(angle[arrived])
    left, steepest = arrived, 0.0
    while left > 0 and (move := sense * (angle[left] - angle[left - 1])) > 0.1 * steepest:
        steepest, left = max(steepest, move), left - 1
    if arrived - left <= 1:
        return float(t[arrived])
    part = (angle[left : arrived + 1] - angle[left]) / (angle[arrived] - angle[left])
    rising = np.flatnonzero((part > 0.05) & (part < 0.6)) + left
    if rising.size < 2:
        return float(t[left])
    slope, offset = np.polyfit(t[rising] - t[left], angle[rising] - angle[left], 1)
    return float(np.clip(t[left] - offset / slope, t[left], t[left + 1]))


# Orders of a long recording


def find_plateaus(angle: Samples, count: int, breaks: tuple[int, ...] = ()) -> list[Plateau]:
    """Every stretch of at least `count` rows in which the angle (rad) stays, zero included.

    A plateau goes on after a short flicker, but not across one of the `breaks`, rows that follow a
    hole of the recording.
    """
    noise = noise_scale(angle)

    def band(level: float) -> float:
        """How far (rad) from its level a held angle may be."""
        return max(_PLATEAU_BAND * abs(level), 4 * noise, _NARROWEST_BAND)

    found: list[Plateau] = []
    for start, end in itertools.pairwise([0, *breaks, len(angle)]):
        if end - start <= count:
            continue
        calm = ndimage.median_filter(angle[start:end], _OUTLIER_ROWS, mode="nearest")
        high = ndimage.maximum_filter1d(calm, count, mode="nearest")
        low = ndimage.minimum_filter1d(calm, count, mode="nearest")
        middle = _PLATEAU_BAND * np.abs(high + low) / 2
        widest = 2 * np.maximum(np.maximum(middle, 4 * noise), _NARROWEST_BAND)
        for rows in stretches(high - low <= widest):
            first = start + max(rows.start - count // 2, 0)
            last = start + min(rows.stop - 1 + count // 2, len(calm) - 1)
            level = float(np.median(angle[first : last + 1]))
            off = np.abs(calm[first - start : last + 1 - start] - level)
            on = first + np.flatnonzero(off <= band(level))
            if on.size < 0.5 * count or on.size < _INSIDE_SHARE * (on[-1] - on[0] + 1):
                continue
            first, last = int(on[0]), int(on[-1])
            old = found[-1] if found and found[-1].first >= start else None
            if old and first - old.last <= count and abs(level - old.level) <= band(old.level):
                first = found.pop().first
                level = float(np.median(angle[first : last + 1]))
            found.append(Plateau(first, last, level))
    return found


def find_swings(angle: Samples, least: float, breaks: tuple[int, ...] = ()) -> list[Plateau]:
    """Swings of the angle (rad) beyond `least` to either side, as if held near their peaks.

    Actuators that are slow beside the legs of a zig-zag never stay anywhere.
    """
    calm = ndimage.median_filter(angle, _OUTLIER_ROWS, mode="nearest")
    side = np.where(np.abs(calm) > least, np.sign(calm), 0).astype(int)
    changes = (np.flatnonzero(np.diff(side)) + 1).tolist()
    edges = np.unique([0, *changes, *breaks, len(side)])
    swings = []
    for start, stop in itertools.pairwise(edges):
        size = np.abs(calm[start:stop])
        if side[start] and stop - start > _OUTLIER_ROWS:
            near = np.flatnonzero(size >= _PEAK * np.max(size)) + start
            swings.append(Plateau(int(near[0]), int(near[-1]), float(side[start] * np.max(size))))
    return swings


def alternating_chains(plateaus: list[Plateau], t: Samples, least: float) -> list[list[Plateau]]:
    """Consecutive plateaus of alternating side and like size, above `least` rad."""
    chains: list[list[Plateau]] = []
    befores = [None, *plateaus][: len(plateaus)]
    for before, plateau in zip(befores, plateaus, strict=True):
        if abs(plateau.level) < least:
            continue
        follows = False
        if before and chains and chains[-1][-1] is before and before.side != plateau.side:
            sizes = abs(before.level), abs(plateau.level)
            longer = max(before.seconds(t), plateau.seconds(t))
            alike = abs(sizes[0] - sizes[1]) <= _UNLIKE * max(sizes)
            follows = alike and t[plateau.first] - t[before.last] <= longer
        if follows:
            chains[-1].append(plateau)
        else:
            chains.append([plateau])
    return chains


def last_row_before_move(
    angle: Samples, plateau: Plateau, count: int, noise: float, earliest: int
) -> int:
    """The last row before the steering began to move to a plateau, found backwards from it.

    It has been found where the angle stops falling back from the plateau, or stays for `count`
    rows. Rows before `earliest` are not looked at.
    """
    level = abs(plateau.level)
    moving = angle[earliest : plateau.first + 1]
    calm = plateau.side * ndimage.median_filter(moving, 3, mode="nearest")
    # A lag creeps at the end of its way: that part is not looked at.
    off = np.flatnonzero(np.abs(calm - level) > _CREEP * level)
    at = lowest = int(off[-1]) if off.size else len(calm) - 1
    tolerance = max(3 * noise, _UNCHANGED * level)
    while at > 0 and lowest - at <= count:
        at -= 1
        if calm[at] < calm[lowest] - tolerance:
            lowest = at
        elif calm[at] > calm[lowest] + max(tolerance, _PLATEAU_BAND * level):
            break
    return earliest + lowest


def departure_row(
    angle: Samples, before: float, threshold: float, arrived: int, earliest: int
) -> int:
    """The first row in which the angle is beyond `threshold` rad of `before`, for good.

    It is then on its way to the place where it has `arrived` (a row). Rows before `earliest`
    are not looked at.
    """
    near = np.flatnonzero(np.abs(angle[earliest : arrived + 1] - before) <= threshold)
    return earliest + int(near[-1]) + 1 if near.size else earliest
