"""The approach to a trial: was the vessel steady before the steering moved?"""

import dataclasses
import math

import numpy as np

from diffsea.segments.settings import SegmentSettings
from diffsea.segments.signals import Signals


_FEWEST_ROWS = 5  # that an approach must have to be judged


@dataclasses.dataclass(frozen=True)
class ApproachConditions:
    """Conditions over the window before an onset; NaN where they are not known.

    `speed` is the mean resultant speed over ground (m/s), `spread` its standard deviation
    about its trend, `trend` its gain over the window (m/s, by a straight line), `yaw_rate`
    the largest recorded yaw rate (rad/s), `wander` the range of heading (rad).
    """

    seconds: float
    speed: float
    spread: float
    trend: float
    yaw_rate: float
    wander: float
    verdict: str  # "steady", "unsteady" or "unknown"
    why: str


def approach_to(
    signals: Signals,
    start: float,
    onset: float,
    settings: SegmentSettings,
    period: str = "before the onset",
) -> ApproachConditions:
    """The approach from `start` to just before `onset` (s); `period` names that time for people."""
    rows = signals.rows(start, onset)
    rows = slice(rows.start, max(rows.stop - 1, rows.start))
    t, psi = signals.t[rows], signals.psi[rows]
    if len(t) < _FEWEST_ROWS:
        why = f"{len(t)} rows {period} are too few to judge the approach"
        return ApproachConditions(0.0, *(math.nan,) * 5, verdict="unknown", why=why)
    wander, fastest = float(np.ptp(psi)), float(np.max(np.abs(signals.r[rows])))
    seconds = float(t[-1] - t[0])
    if signals.speed is None:
        return ApproachConditions(
            seconds,
            *(math.nan,) * 3,
            yaw_rate=fastest,
            wander=wander,
            verdict="unknown",
            why="the speed is not known",
        )
    speed = signals.speed[rows]
    mean = float(np.mean(speed))
    slope, offset = np.polyfit(t - t[0], speed, 1)
    spread = float(np.std(speed - offset - slope * (t - t[0])))
    trend = float(slope * (t[-1] - t[0]))
    faults = []
    if abs(trend) > settings.steady_speed * mean:
        faults.append(f"speed {'rises' if trend > 0 else 'falls'} by {abs(trend) / mean:.0%}")
    if spread > settings.steady_speed * mean:
        faults.append(f"speed scatters by {spread / mean:.0%}")
    if wander > settings.steady_heading:
        faults.append(f"heading wanders over {math.degrees(wander):.1f} deg")
    why = f"over {seconds:.3g} s {period} " + (", ".join(faults) or "nothing changes")
    verdict = "unsteady" if faults else "steady"
    return ApproachConditions(seconds, mean, spread, trend, fastest, wander, verdict, why)
