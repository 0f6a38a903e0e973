"""Drift of turning circles: what wind and current together do to a vessel that turns on and on."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffsea.errors import UserError
from diffsea.trajectory import Trajectory


LAP = 2 * math.pi
LEAST = 0.05  # of a lap beyond the first: fewer pairs of headings have no mean
_PAIRS = 72


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
        return math.atan2(self.east, self.north) % LAP


def circle_drift(run: Trajectory, start: float) -> Drift:
    """Drift of a turning circle that is steady from `start` (s) on.

    The way between two moments a whole turn apart, over the time between: what stays of it is
    no turning. Means over all such pairs, as IMO MSC/Circ.1053 corrects turning circles for
    current. A force that is fixed to the earth drifts a circle about downwind of it; wind and
    current cannot be told apart by it.

    Raises `UserError` where the run turns by less than 1.05 laps after `start`, or has no
    positions or heading.
    """
    run = run.counted()
    run = run.rows(run.t >= start)
    t, x, y, psi = run.t, run.x, run.y, run.psi
    at, turned = _turned(t, psi)
    laps = turned[-1] / LAP if len(turned) else 0.0
    if laps < 1 + LEAST or not (np.isfinite(x).any() and np.isfinite(y).any()):
        raise UserError(
            f"{run.name}: a drift needs positions and more than {1 + LEAST:.2f} laps after "
            f"t = {start:g} s, and there are {laps:.2f}; record the circle for longer"
        )
    first = np.linspace(0.0, turned[-1] - LAP, _PAIRS)
    before, after = (np.interp(turn, turned, at) for turn in (first, first + LAP))
    way = np.stack([_at(after, t, z) - _at(before, t, z) for z in (x, y)], axis=-1)
    velocity = way / (after - before)[:, None]
    mean = velocity.mean(0)
    scatter = float(np.sqrt(np.mean(np.sum((velocity - mean) ** 2, axis=-1))))
    return Drift(float(mean[0]), float(mean[1]), scatter, float(laps))


def _turned(t: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times of known headings and the angle turned by then, which never falls."""
    known = np.isfinite(psi)
    if known.sum() < 2:
        return t[known], np.zeros(int(known.sum()))
    turned = np.unwrap(psi[known]) - psi[known][0]
    return t[known], np.maximum.accumulate(math.copysign(1.0, turned[-1]) * turned)


def _at(
    times: Float[np.ndarray, "pair"], t: np.ndarray, values: np.ndarray
) -> Float[np.ndarray, "pair"]:
    known = np.isfinite(values)
    return np.interp(times, t[known], values[known])
