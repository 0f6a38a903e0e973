"""What was ordered in a recorded run: the execute, the later switchings, the manoeuvre.

The steering order is a rudder angle or, for twin thrusters, its equivalent

    delta = 35 deg * (T_port - T_starboard) / |T_port + T_starboard|.

A trial holds its angle, so the angle that the run holds longest (its plateau) sets every
threshold, and hand steering before the execute does not reach it or does not stay. A
realised rudder moves slowly: it was ordered away when it left its plateau.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from diffsea.scales import HARD_OVER
from diffsea.series import hold_last
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples, Trajectory


MANOEUVRES = ("turning-circle", "zigzag", "pull-out", "stopping", "straight", "unknown")

_BAND = 0.08  # of the plateau: closer than this to it counts as being on it
_SMALLEST_ORDER = math.radians(1)
_TURN = math.radians(120)  # change of heading under one order that makes it a turn
_LONG_LEG = math.radians(150)  # as much of one order among several: no zig-zag leg
_LARGEST_REVERSAL = math.radians(60)
_PULL_OUT = math.radians(20)
_STRAIGHT = math.radians(15)


@dataclasses.dataclass(frozen=True)
class Orders:
    """Consecutive orders to alternating sides.

    `times` (s) when each was given, `end` (s) when the last was given up or the record
    ends; `angles` (rad) as the channel has them, whatever its sign convention.
    """

    times: tuple[float, ...] = ()
    angles: tuple[float, ...] = ()
    end: float = math.inf
    channel: str = "none"  # what they were read from, for notes


def steering(trajectory: Trajectory) -> tuple[Samples, str] | None:
    """Steering angle (rad) in every row and the channel it is from; none if not recorded.

    Commands come before executed values. A channel with "rudder" in its name is taken
    first, then a pair named port / starboard or left / right, then an azimuth angle.
    """
    for kind, channels in (
        ("commanded", trajectory.commanded),
        ("executed", trajectory.executed),
    ):
        usable = {
            name: hold_last(np.asarray(values, float))
            for name, values in channels.items()
            if np.isfinite(np.asarray(values, float)).any()
        }
        angle = _angle(usable)
        if angle is not None:
            return angle[0], f"{kind} {angle[1]}"
    return None


def as_thrust(trajectory: Trajectory, units: Mapping[str, str]) -> Trajectory:
    """The run with shaft speeds as what they push at rest, whose ratio gives the equivalent angle.

    `units` are those of the channels, as a vessel has them.
    """

    def pushed(group: Mapping[str, Samples]) -> dict[str, Samples]:
        return {c: s * np.abs(s) if units.get(c) == "rev/s" else s for c, s in group.items()}

    return dataclasses.replace(
        trajectory, commanded=pushed(trajectory.commanded), executed=pushed(trajectory.executed)
    )


def propulsion(trajectory: Trajectory) -> Samples | None:
    """Sum of the driving channels, each over its largest value; none if not recorded."""
    for channels in (trajectory.commanded, trajectory.executed):
        driving = [
            hold_last(np.asarray(values, float))
            for name, values in channels.items()
            if not _steers(name) and np.isfinite(np.asarray(values, float)).any()
        ]
        if driving:
            return np.sum([d / max(np.max(np.abs(d)), 1e-12) for d in driving], axis=0)
    return None


def find_orders(trajectory: Trajectory) -> Orders:
    """The longest chain of alternating orders held at the plateau.

    The trajectory is a prepared one: every row counts and has a heading.
    """
    steered = steering(trajectory)
    if steered is None:
        return Orders()
    angle, channel = steered
    t = np.asarray(trajectory.t, float)
    plateau = _plateau(t, angle)
    if plateau < _SMALLEST_ORDER:
        return Orders(channel=channel)
    chains: list[list[tuple[int, int, int]]] = []
    for run in _held_runs(angle, plateau):
        if chains and _follows(t, angle, plateau, chains[-1][-1], run):
            chains[-1].append(run)
        else:
            chains.append([run])
    if not chains:
        return Orders(channel=channel)
    chain = max(chains, key=lambda c: t[c[-1][1]] - t[c[0][0]])
    return Orders(
        times=tuple(_order_time(t, angle, first) for first, _, _ in chain),
        angles=tuple(float(np.median(angle[a : b + 1])) for a, b, _ in chain),
        end=float(t[chain[-1][1]]),
        channel=channel,
    )


def the_turn(trajectory: Trajectory, orders: Orders) -> Orders:
    """The one order under which the heading changed most, as orders of their own."""
    change = np.abs(_changes(trajectory, orders))
    k = int(np.argmax(change))
    end = orders.times[k + 1] if k + 1 < len(orders.times) else orders.end
    return dataclasses.replace(
        orders, times=orders.times[k : k + 1], angles=orders.angles[k : k + 1], end=end
    )


def identify(trajectory: Trajectory, orders: Orders) -> str:
    """The manoeuvre, one of `MANOEUVRES`, from the orders and what the heading did."""
    named = "unknown"
    if orders.times and _stands_out(trajectory, orders) and _approached(trajectory, orders):
        named = _steered_manoeuvre(trajectory, orders)
    if named == "unknown" and _stopped(trajectory):
        return "stopping"
    if named == "unknown" and np.ptp(trajectory.psi) < _STRAIGHT:
        return "straight"
    return named


def _steered_manoeuvre(trajectory: Trajectory, orders: Orders) -> str:
    change = _changes(trajectory, orders)
    if np.max(np.abs(change)) >= (_TURN if len(change) == 1 else _LONG_LEG):
        return "turning-circle"
    if len(change) == 1:
        released = _neutral_share(trajectory, orders) > 0.7
        return "pull-out" if released and abs(change[0]) > _PULL_OUT else "unknown"
    reached = np.cumsum(change)[:-1]
    size = np.abs(reached)
    alternate = np.all(reached[1:] * reached[:-1] < 0) and np.min(size) > 0
    alike = np.ptp(size) <= 0.5 * np.mean(size) and np.mean(size) < _LARGEST_REVERSAL
    return "zigzag" if alternate and alike else "unknown"


def _changes(trajectory: Trajectory, orders: Orders) -> Samples:
    """Change of heading (rad) under each order."""
    return np.diff(np.interp([*orders.times, orders.end], trajectory.t, trajectory.psi))


def _approached(trajectory: Trajectory, orders: Orders) -> bool:
    """Whether the vessel was under way before the order; a turn on the spot is no trial."""
    start = orders.times[0]
    speed = np.hypot(trajectory.u, trajectory.v)
    if not np.isfinite(speed).any():
        return True
    after = np.quantile(speed[trajectory.t >= start], 0.95)
    return bool(np.interp(start, trajectory.t, speed) >= 0.5 * after)


def _stands_out(trajectory: Trajectory, orders: Orders) -> bool:
    """Whether the orders fill much of the record, or hardly anything else was ordered."""
    share = (orders.end - orders.times[0]) / (trajectory.t[-1] - trajectory.t[0])
    return bool(share > 0.4 or _neutral_share(trajectory, orders) > 0.7)


def _neutral_share(trajectory: Trajectory, orders: Orders) -> float:
    """Share of the rows before and after the orders in which the steering is near zero."""
    steered = steering(trajectory)
    if steered is None:
        return 0.0
    t = np.asarray(trajectory.t)
    others = np.abs(steered[0][(t < orders.times[0]) | (t > orders.end)])
    return float(np.mean(others < 0.3 * abs(orders.angles[0]))) if others.size else 0.0


def stop_order(trajectory: Trajectory) -> float | None:
    """When the propulsion ahead was cut or reversed for good (s), else none."""
    t, drive = np.asarray(trajectory.t, float), propulsion(trajectory)
    if drive is None or np.max(drive) <= 0:
        return None
    last = int(np.flatnonzero(drive > 0.5 * np.max(drive))[-1])
    if last + 1 >= len(t) or np.max(drive[last + 1 :]) > 0.1 * np.max(drive):
        return None
    return float(t[last + 1])


def _stopped(trajectory: Trajectory) -> bool:
    start = stop_order(trajectory)
    if start is None or not np.isfinite(trajectory.u).any():
        return False
    at_order = np.interp(start, trajectory.t, trajectory.u)
    after = np.asarray(trajectory.u)[trajectory.t >= start]
    return bool(at_order > 0.8 * np.max(trajectory.u) and np.min(after) <= 0)


def _steers(name: str) -> bool:
    return "rudder" in name.lower() or name.lower().endswith(".angle")


def _angle(channels: dict[str, Samples]) -> tuple[Samples, str] | None:
    rudders = [name for name in channels if "rudder" in name.lower()]
    pair = [
        _on_side(channels, words) for words in (("port", "left"), ("starboard", "stbd", "right"))
    ]
    azimuths = [name for name in channels if name.lower().endswith(".angle")]
    if rudders:
        return np.mean([channels[name] for name in rudders], axis=0), ", ".join(rudders)
    if pair[0] and pair[1]:
        return equivalent_angle(channels[pair[0]], channels[pair[1]]), f"{pair[0]}, {pair[1]}"
    if azimuths:
        return np.mean([channels[name] for name in azimuths], axis=0), ", ".join(azimuths)
    return None


def _on_side(channels: dict[str, Samples], words: tuple[str, ...]) -> str | None:
    named = (n for n in channels if any(w in n.lower() for w in words) and not _steers(n))
    return next(named, None)


def equivalent_angle(port: Samples, starboard: Samples) -> Samples:
    """Rudder-equivalent angle (rad, positive to starboard) of two thrusts in one unit.

    The sum in the denominator is kept above a twentieth of the largest thrust: turning on
    the spot has no equivalent and only its side and order of magnitude are right.
    """
    largest = max(np.max(np.abs(port)), np.max(np.abs(starboard)), 1e-12)
    total = np.maximum(np.abs(port + starboard), 0.05 * largest)
    return HARD_OVER * (port - starboard) / total


def _plateau(t: Samples, angle: Samples) -> float:
    """The size of angle (rad) that the run holds for the longest time."""
    size, weight = np.abs(angle), np.gradient(t)
    top = float(np.quantile(size, 0.995))
    if top < _SMALLEST_ORDER:
        return 0.0
    counts, edges = np.histogram(size, bins=40, range=(0.2 * top, 1.05 * top), weights=weight)
    best = int(np.argmax(counts[:-1] + counts[1:]))
    around = (size >= edges[best]) & (size <= edges[best + 2])
    return float(np.median(size[around])) if around.any() else 0.0


def _held_runs(angle: Samples, plateau: float) -> list[tuple[int, int, int]]:
    """First row, last row and sign of every stretch at the plateau, small gaps closed."""
    noise = noise_scale(angle, 1)
    band = max(_BAND * plateau, 3 * noise)
    state = np.where(np.abs(np.abs(angle) - plateau) <= band, np.sign(angle), 0).astype(int)
    starts = np.flatnonzero(np.diff(state, prepend=0) * (state != 0))
    runs: list[tuple[int, int, int]] = []
    for first in starts:
        after = np.flatnonzero(state[first:] != state[first])
        last = int(first + after[0] - 1) if after.size else len(angle) - 1
        if runs and runs[-1][2] == state[first] and _stays(angle[runs[-1][1] : first], runs[-1][2]):
            runs[-1] = (runs[-1][0], last, runs[-1][2])
        else:
            runs.append((int(first), last, int(state[first])))
    return [run for run in runs if run[1] - run[0] >= 2]


def _stays(angle: Samples, sign: int) -> bool:
    """Whether a gap between two stretches on one side is a flicker, not a new order."""
    return len(angle) <= 5 or bool(np.min(sign * angle) > 0.7 * abs(angle[0]))


def _follows(
    t: Samples, angle: Samples, plateau: float, run: tuple[int, int, int],
    following: tuple[int, int, int],
) -> bool:  # fmt: skip
    """Whether the steering went straight from one plateau to the opposite one."""
    transit = following[2] * angle[run[1] : following[0] + 1]
    back = np.max(np.maximum.accumulate(transit) - transit)
    longer = max(t[last] - t[first] for first, last, _ in (run, following))
    soon = t[following[0]] - t[run[1]] <= 2 * longer
    return bool(run[2] != following[2] and soon and back <= 2 * _BAND * plateau)


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
