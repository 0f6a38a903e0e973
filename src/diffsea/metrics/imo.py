"""Verdicts by the standards for ship manoeuvrability, IMO resolution MSC.137(76), 2002.

They are written for ships of 100 m and more at full load in deep, unrestricted and calm
water; for a smaller vessel they are a comparison and not a requirement.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping

from diffsea.metrics.numbers import trial_unit
from diffsea.scales import HARD_OVER


# An order or a heading counts as the one of the standard within this.
_SAME_ANGLE = math.radians(1.5)
SHORTEST_SHIP = 100.0  # m, from which MSC.137(76) applies


@dataclasses.dataclass(frozen=True)
class TrialConditions:
    """What the standards ask of a trial before they judge it."""

    length: float  # L, m
    speed: float  # V, m/s, of the approach
    angle: float  # rad, the size of what was ordered; NaN where it is not known
    heading: float  # rad, the size of the change at which a zig-zag was reversed, or NaN

    @property
    def hard_over(self) -> bool:
        """Whether the angle is about 35 deg or more, as it is taken to be where it is not known.

        Beyond 90 deg the equivalent angle of thrusters means turning on the spot.
        """
        return math.isnan(self.angle) or HARD_OVER - _SAME_ANGLE < self.angle < math.pi / 2

    def has_angle(self, degrees: float) -> bool:
        """Whether the angle ordered is so many degrees."""
        return abs(self.angle - math.radians(degrees)) <= _SAME_ANGLE

    def is_zigzag(self, degrees: float) -> bool:
        """Whether angle and heading are both so many degrees."""
        same_heading = abs(self.heading - math.radians(degrees)) <= _SAME_ANGLE
        return self.has_angle(degrees) and same_heading


# By name of the number: the limit (rad, or ship lengths) and the section of MSC.137(76).
Limits = dict[str, tuple[float, str]]
Criteria = Callable[[TrialConditions], Limits]


def turning_criteria(trial: TrialConditions) -> Limits:
    """Limits of a turning circle: hard over (5.3.1), and initial turning at 10 deg (5.3.2)."""
    limits = {"advance": (4.5, "5.3.1"), "tactical_diameter": (5.0, "5.3.1")}
    return (limits if trial.hard_over else {}) | _initial_turning(trial)


def zigzag_criteria(trial: TrialConditions) -> Limits:
    """Limits of the 10/10 and the 20/20 zig-zag (5.3.3), and of initial turning (5.3.2)."""
    limits = _initial_turning(trial)
    if trial.is_zigzag(10):
        seconds = trial.length / trial.speed
        limits["overshoot_1"] = (first_overshoot_limit(seconds), "5.3.3.1")
        limits["overshoot_2"] = (second_overshoot_limit(seconds), "5.3.3.2")
    elif trial.is_zigzag(20):
        limits["overshoot_1"] = (math.radians(25), "5.3.3.3")
    return limits


def stopping_criteria(trial: TrialConditions) -> Limits:
    """Limit of the track reach of a full astern stop (5.3.4)."""
    return {"track_reach": (15.0, "5.3.4")}


def _initial_turning(trial: TrialConditions) -> Limits:
    return {"initial_turning_distance": (2.5, "5.3.2")} if trial.has_angle(10) else {}


def first_overshoot_limit(seconds: float) -> float:
    """Limit (rad) of the first overshoot of the 10/10 zig-zag by L/V (s), 5.3.3.1."""
    return math.radians(10.0 if seconds < 10 else min(5 + 0.5 * seconds, 20.0))


def second_overshoot_limit(seconds: float) -> float:
    """Limit (rad) of the second overshoot of the 10/10 zig-zag by L/V (s), 5.3.3.2."""
    return math.radians(25.0 if seconds < 10 else min(17.5 + 0.75 * seconds, 40.0))


def imo_verdicts(
    metrics: Mapping[str, float],
    length: float,
    speed: float,
    criteria: Criteria | None,
    angle: float | None = None,
    heading: float | None = None,
) -> dict[str, dict[str, float | str]]:
    """Value, limit, unit and verdict of every criterion that applies to a trial.

    Arguments:
        metrics: the numbers of the trial, in SI units.
        length: L (m), of the full-scale ship where the run is a model's.
        speed: V (m/s), of the approach, likewise.
        criteria: those of the trial's kind, such as `zigzag_criteria`; None where the standards
            do not know it.
        angle: rudder angle ordered (rad), of either sign.
        heading: change of heading (rad) at which a zig-zag was reversed.

    Returns:
        By name of the number; angles in rad, distances in ship lengths. Criteria that do not
        apply, or whose number is missing, are left out.
    """
    angle, heading = (math.nan if size is None else abs(size) for size in (angle, heading))
    trial = TrialConditions(length, speed, angle, heading)
    verdicts = {}
    for name, (limit, section) in criteria(trial).items() if criteria else ():
        if not math.isfinite(metrics.get(name, math.nan)):
            continue
        is_angle = trial_unit(name) == "rad"
        value = float(metrics[name]) if is_angle else float(metrics[name]) / length
        verdicts[name] = {
            "value": value,
            "limit": limit,
            "unit": "rad" if is_angle else "L",
            "verdict": "pass" if value <= limit else "fail",
            "criterion": f"MSC.137(76) {section}",
        }
    return verdicts
