"""Drift of turning circles: what wind and current together do to a vessel that turns on and on."""

import math
from typing import NamedTuple

import numpy as np

from diffsea.errors import UserError
from diffsea.trajectory import Trajectory


_LAP = 2 * math.pi
_LEAST_EXTRA = 0.05  # of a lap beyond the first: fewer pairs of headings have no mean
_PAIRS = 72  # of moments a lap apart: one each 5 deg of two laps


class Drift(NamedTuple):
    """Mean velocity of a circle's centre over ground."""

    north: float  # m/s
    east: float  # m/s
    scatter: float  # m/s, root mean square of single pairs about the mean
    laps: float

    @property
    def speed(self) -> float:
        """Speed, m/s."""
        return math.hypot(self.north, self.east)

    @property
    def direction(self) -> float:
        """Where it drifts to, rad clockwise from north, 0 to 2 pi."""
        return math.atan2(self.east, self.north) % _LAP


def circle_drift(run: Trajectory, start: float) -> Drift:
    """Drift of a turning circle that is steady from `start` (s) on.

    The way between two moments a whole turn apart, over the time between: what stays of it is
    no turning. Means over all such pairs, as IMO MSC/Circ.1053 corrects turning circles for
    current. A force that is fixed to the earth drifts a circle about downwind of it; wind and
    current cannot be told apart by it.

    Raises:
        UserError: the run turns by less than 1.05 laps after `start`, or has no positions or
            heading.
    """
    run = run.counted()
    run = run.rows(run.t >= start)
    known = np.isfinite(run.psi)
    at, turned = run.t[known], np.unwrap(run.psi[known])
    if len(turned):  # the angle turned by then, which never falls
        turned = turned - turned[0]
        turned = np.maximum.accumulate(math.copysign(1.0, turned[-1]) * turned)
    laps = turned[-1] / _LAP if len(turned) else 0.0
    if laps < 1 + _LEAST_EXTRA or not (run.has("x") and run.has("y")):
        raise UserError(
            f"{run.name}: a drift needs positions and more than {1 + _LEAST_EXTRA:.2f} laps after "
            f"t = {start:g} s, and there are {laps:.2f}; record the circle for longer"
        )
    first = np.linspace(0.0, turned[-1] - _LAP, _PAIRS)
    before, after = (np.interp(turn, turned, at) for turn in (first, first + _LAP))
    ways = []
    for position in (run.x, run.y):
        known = np.isfinite(position)
        there = [np.interp(times, run.t[known], position[known]) for times in (before, after)]
        ways.append(there[1] - there[0])
    velocity = np.stack(ways, axis=-1) / (after - before)[:, None]
    mean = velocity.mean(0)
    scatter = float(np.sqrt(np.mean(np.sum((velocity - mean) ** 2, axis=-1))))
    return Drift(float(mean[0]), float(mean[1]), scatter, float(laps))
