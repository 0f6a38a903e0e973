"""What a fault of the motion costs: how far off the track of a minute is while it is left in.

One measure for offsets, scales, delays, outliers and turned axes alike, so that they can be put in
an order: metres by which what the channels say of a minute's way is changed by the repair.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from diffsea.recordings.auditing.edits import ChannelEdit
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.series import integrate
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


MINUTE = 60.0  # s; a run that is shorter is taken whole


def cost(finding: Finding, run: Trajectory) -> float:
    """How far off (m, root mean square) a minute's track is while the fault is left in.

    Positions are off by as much as the repair moves them. Velocities and headings are off by as
    much as it moves the end of the way that is reckoned from them, headings also of a way straight
    ahead at the recorded speed; yaw rates, of the way on the heading that is their integral from
    the minute's start. The largest of these counts.

    **Returns:** NaN for a fault that is not one of the motion, that no edit puts right, or of
    channels that alone tell no way: a yaw rate without any speed.
    """
    edits = finding.edits
    if not edits or not all(isinstance(edit, ChannelEdit) for edit in edits):
        return np.nan
    repaired = run
    for edit in edits:
        repaired = edit.apply(repaired)
    old, new = motion_of(run), motion_of(repaired)
    if len(old.t) != len(new.t):  # stamps were changed: the rows are no longer the same
        return np.nan
    changed = {c for c in MOTION_CHANNELS if not np.array_equal(old.values[c], new.values[c])}
    ways = []
    if changed & {"x", "y"} and old.has("x", "y"):
        known = _known(old, "x", "y") & _known(new, "x", "y")
        ways.append(np.abs(new.place - old.place)[known])
    if changed & {"psi", "u", "v"} and old.has("psi"):
        ways.append(_parted(old, new, _reckoned_way))
    if "psi" in changed and old.has("psi"):
        ways.append(_parted(old, new, _way_ahead))
    if "r" in changed and old.has("r"):
        ways.append(_parted(old, new, _way_by_yaw_rate))
    off = [float(np.sqrt(np.mean(way**2))) for way in ways if way.size]
    return max(off, default=np.nan)


def _known(motion: MeasuredMotion, *channels: str) -> Bool[np.ndarray, "time"]:
    return np.all([motion.known[channel] for channel in channels], axis=0)


_Rows = Int[np.ndarray, "minute"]
_Ways = Complex[np.ndarray, "minute"]  # m, of every minute


def _parted(
    old: MeasuredMotion, new: MeasuredMotion, way: Callable[[MeasuredMotion, _Rows, _Rows], _Ways]
) -> Float[np.ndarray, "minute"]:
    """How far apart (m) the ways of every minute end, reckoned before and after the repair."""
    if not all(one.has("u") or one.has("x", "y") for one in (old, new)):
        return np.empty(0)
    first = np.arange(old.t.size)
    last = np.searchsorted(old.t, old.t + MINUTE)
    whole = last < old.t.size
    first, last = (first[whole], last[whole]) if whole.any() else (first[:1], first[-1:])
    before, after = (way(one, first, last) for one in (old, new))
    return np.abs(after - before)


def _velocity(motion: MeasuredMotion) -> Complex[np.ndarray, "time"]:
    """Ahead + i to starboard, m/s; where none is measured by the positions, and all of it ahead."""
    if not motion.has("u"):
        return np.abs(np.gradient(motion.place, motion.t)) + 0j
    return motion.values["u"] + 1j * motion.values["v"]  # straight across what is not known


def _reckoned_way(motion: MeasuredMotion, first: _Rows, last: _Rows) -> _Ways:
    way = integrate(motion.t, _velocity(motion) * np.exp(1j * motion.values["psi"]))
    return way[last] - way[first]


def _way_ahead(motion: MeasuredMotion, first: _Rows, last: _Rows) -> _Ways:
    ahead = np.abs(_velocity(motion)) * np.exp(1j * motion.values["psi"])
    way = integrate(motion.t, ahead)
    return way[last] - way[first]


def _way_by_yaw_rate(motion: MeasuredMotion, first: _Rows, last: _Rows) -> _Ways:
    """In the axes that the vessel has at the minute's start."""
    turned = np.exp(1j * integrate(motion.t, motion.values["r"]))
    way = integrate(motion.t, _velocity(motion) * turned)
    return (way[last] - way[first]) / turned[first]
