"""Idle stretches of a recording: at rest without orders, disarmed, carried about, upside down.

They say nothing about how a vessel answers her orders, and a fit takes a boat on a trailer for one
that moves by itself. What is left are the spans that are used.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from diffsea.recordings.conditioning import cut
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.series import hold_last, interpolate_missing, stretches, strictly_later
from diffsea.trajectory import Samples, Trajectory


SHORTEST = 10.0  # s: a shorter stretch is neither idle nor used
_KEPT_REST = 5.0  # s of rest before and after, from which a run begins and in which it ends
_AVERAGED = 5.0  # s over which motion is averaged: wander of a satellite fix is none
_REST = 0.1  # of the motion that the recording usually has: less is none
_USUAL = 90.0  # percentile that stands for usual motion
_QUIET = 30.0  # s without a change of orders, before a vessel can be said to be carried
_CARRIED = 1.5  # times the speed under orders, which no vessel drifts at
_ORDER_STEP = 0.01  # of an actuator's range: smaller changes are none
_UPSIDE_DOWN = math.radians(90)  # of roll


@dataclasses.dataclass(frozen=True)
class IdleStretch:
    """A stretch from `start` to `end` (s) in which nothing can be learnt, and why."""

    start: float
    end: float
    why: str


def idle_stretches(run: Trajectory) -> list[IdleStretch]:
    """The idle stretches of a recording of ten seconds or more, in order, without overlap.

    Rest is less than a tenth of the motion that the recording usually has, averaged over five
    seconds, while no order changes; five seconds of it are kept at either side of what is used.
    A vessel without orders for half a minute that moves half as fast again as under orders is
    carried. `armed` and roll tell the other two.
    """
    run = run.counted()
    run = run.rows(strictly_later(run.t))
    if run.t.size < 2 or run.t[-1] - run.t[0] < SHORTEST:
        return []
    motion = motion_of(run)
    turned, disarmed = _upside_down(run), _disarmed(run)
    changes = _order_changes(run)
    carried = _carried(motion, changes)
    rest = _at_rest(motion, changes)
    found = []
    for why, rows, kept in (
        ("upside down", turned, 0.0),
        ("disarmed", disarmed & ~turned, 0.0),
        ("carried: fast without orders", carried & ~turned & ~disarmed, 0.0),
        ("at rest without orders", rest & ~turned & ~disarmed & ~carried, _KEPT_REST),
    ):
        for part in stretches(rows):
            first, last = float(run.t[part.start]), float(run.t[part.stop - 1])
            first += kept if part.start > 0 else 0.0
            last -= kept if part.stop < run.t.size else 0.0
            if last - first >= SHORTEST:
                found.append(IdleStretch(first, last, why))
    return sorted(found, key=lambda one: one.start)


def used_spans(run: Trajectory, idle: Sequence[IdleStretch]) -> list[tuple[float, float]]:
    """From when to when (s) a recording is used: ten seconds or more between idle stretches."""
    t = run.counted().t
    ends = [float(t[0]), *itertools.chain(*((one.start, one.end) for one in idle)), float(t[-1])]
    spans = list(zip(ends[::2], ends[1::2], strict=True))
    return [(start, end) for start, end in spans if end - start >= SHORTEST or not idle]


def without_idle(run: Trajectory) -> tuple[list[Trajectory], list[IdleStretch]]:
    """The used spans as recordings of their own, named by their times, and what was left out.

    The run itself where nothing is idle, or where all of it would be.
    """
    idle = idle_stretches(run)
    spans = used_spans(run, idle)
    if not idle or not spans:
        return [run], []
    pieces = [cut(run, *span) for span in spans]
    return [
        dataclasses.replace(piece, name=f"{run.name} [{start:.0f} s to {end:.0f} s]")
        for piece, (start, end) in zip(pieces, spans, strict=True)
    ], idle


def used_parts(run: Trajectory) -> tuple[list[Trajectory], str]:
    """What fits use of a recording, and in words what they leave out; empty where nothing.

    Only of a log that was read by what it contains: who gives a mapping has said what is meant.
    """
    parts, idle = without_idle(run) if run.read.recognised else ([run], [])
    told = ", ".join(f"{one.start:.0f} s to {one.end:.0f} s ({one.why})" for one in idle)
    return parts, f"{run.name}: left out as idle: {told}" if idle else ""


def _upside_down(run: Trajectory) -> Bool[np.ndarray, "time"]:
    phi = run.extra.get("phi")
    if phi is None:
        return np.zeros(run.t.shape, dtype=bool)
    roll = np.abs(np.angle(np.exp(1j * interpolate_missing(run.t, phi))))
    return np.where(np.isfinite(roll), roll, 0.0) > _UPSIDE_DOWN


def _disarmed(run: Trajectory) -> Bool[np.ndarray, "time"]:
    """Where the autopilot says so; before its first word it is not known, and counts as armed."""
    armed = run.extra.get("armed")
    if armed is None or not np.isfinite(armed).any():
        return np.zeros(run.t.shape, dtype=bool)
    return hold_last(armed, leading="missing") == 0


def _order_changes(run: Trajectory) -> Float[np.ndarray, "change"] | None:
    """Times (s) at which any order changed, of executed actuation where there are no orders."""
    group = run.commanded or run.executed
    if not group:
        return None
    times = [np.empty(0)]
    for series in group.values():
        values = hold_last(np.asarray(series, float))
        step = np.abs(np.diff(values))
        reach = np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0
        times.append(run.t[1:][step > _ORDER_STEP * reach] if reach > 0 else np.empty(0))
    return np.sort(np.concatenate(times))


def _speed(motion: MeasuredMotion) -> Samples | None:
    """Speed over ground (m/s) averaged as a vector, so that wander of a fix cancels."""
    width = max(1, round(_AVERAGED / motion.interval))
    if motion.has("u"):
        u = motion.values["u"]
        v = motion.values["v"] if motion.has("v") else np.zeros_like(u)
    elif motion.has("x", "y"):
        u, v = (np.gradient(motion.values[axis], motion.t) for axis in "xy")
    else:
        return None
    return np.hypot(*(ndimage.uniform_filter1d(part, width, mode="nearest") for part in (u, v)))


def _at_rest(
    motion: MeasuredMotion, changes: Float[np.ndarray, "change"] | None
) -> Bool[np.ndarray, "time"]:
    """Where nothing moves and no order changes."""
    width = max(1, round(_AVERAGED / motion.interval))
    speed, rest = _speed(motion), np.ones(motion.t.shape, dtype=bool)
    rate = None
    if motion.has("r"):
        rate = np.abs(ndimage.uniform_filter1d(motion.values["r"], width, mode="nearest"))
    if speed is None:
        return ~rest
    for series in (speed, rate):
        if series is not None:
            rest &= series < _REST * np.percentile(series, _USUAL)
    return rest & (_since_change(motion.t, changes) > 1.0)


def _since_change(t: Samples, changes: Float[np.ndarray, "change"] | None) -> Samples:
    """Seconds to the nearest change of an order; infinite without any."""
    if changes is None or not changes.size:
        return np.full(t.shape, np.inf)
    after = np.searchsorted(changes, t)
    ahead = np.append(changes, np.inf)[after] - t
    behind = t - np.concatenate([[-np.inf], changes])[after]
    return np.minimum(ahead, behind)


def _carried(
    motion: MeasuredMotion, changes: Float[np.ndarray, "change"] | None
) -> Bool[np.ndarray, "time"]:
    """Where the vessel is far faster than under orders, and no order has changed for long."""
    speed, quiet = _speed(motion), _since_change(motion.t, changes) > _QUIET
    if speed is None or changes is None or quiet.all() or not quiet.any():
        return np.zeros(motion.t.shape, dtype=bool)
    return quiet & (speed > _CARRIED * np.percentile(speed[~quiet], 98))
