"""Verdicts by the standards for ship manoeuvrability, IMO resolution MSC.137(76), 2002.

They are written for ships of 100 m and more at full load in deep, unrestricted and calm
water; for a smaller vessel they are a comparison and not a requirement.
"""

import math
from collections.abc import Mapping

from diffsea.scales import HARD_OVER


# An order or a heading counts as the one of the standard within this.
_SAME_ANGLE = math.radians(1.5)


def imo_verdicts(
    metrics: Mapping[str, float],
    length: float,
    speed: float,
    manoeuvre: str,
    angle: float | None = None,
    heading: float | None = None,
    hard_over: bool | None = None,
) -> dict[str, dict[str, float | str]]:
    """Value, limit, unit and verdict of every criterion that applies to a trial.

    **Arguments:** `metrics` of the trial; `length` L (m) and approach `speed` V (m/s), of
    the full-scale ship where the run is a model's; `manoeuvre` by name; `angle` (rad) of
    rudder ordered; `heading` (rad) at which a zig-zag reversed; `hard_over` whether the
    angle is the largest there is, by default whether it is about 35 deg or more; beyond
    90 deg the equivalent angle of thrusters means turning on the spot.

    **Returns:** by name of the metric; angles in rad, distances in ship lengths. Criteria
    whose trial this is not, or whose number is missing, are left out.
    """
    angle = None if angle is None else abs(angle)
    heading = None if heading is None else abs(heading)
    if hard_over is None:
        hard_over = angle is None or HARD_OVER - _SAME_ANGLE < angle < math.pi / 2
    ten = angle is not None and abs(angle - math.radians(10)) <= _SAME_ANGLE
    limits: dict[str, tuple[float, str]] = {}
    if manoeuvre == "turning-circle" and hard_over:
        limits |= {"advance": (4.5, "5.3.1"), "tactical_diameter": (5.0, "5.3.1")}
    if manoeuvre in ("turning-circle", "zigzag") and ten:
        limits["initial_turning_distance"] = (2.5, "5.3.2")
    if manoeuvre == "zigzag":
        limits |= _zigzag_limits(angle, heading, length / speed)
    if manoeuvre == "stopping":
        limits["track_reach"] = (15.0, "5.3.4")
    return {
        name: _verdict(name, metrics[name], limit, length, section)
        for name, (limit, section) in limits.items()
        if math.isfinite(metrics.get(name, math.nan))
    }


def first_overshoot_limit(seconds: float) -> float:
    """Limit (rad) of the first overshoot of the 10/10 zig-zag by L/V (s), 5.3.3.1."""
    return math.radians(_between(seconds, 10.0, 5 + 0.5 * seconds, 20.0))


def second_overshoot_limit(seconds: float) -> float:
    """Limit (rad) of the second overshoot of the 10/10 zig-zag by L/V (s), 5.3.3.2."""
    return math.radians(_between(seconds, 25.0, 17.5 + 0.75 * seconds, 40.0))


def _between(seconds: float, short: float, middle: float, long: float) -> float:
    if seconds < 10:
        return short
    return long if seconds >= 30 else middle


def _zigzag_limits(
    angle: float | None, heading: float | None, seconds: float
) -> dict[str, tuple[float, str]]:
    if _is_zigzag(angle, heading, 10):
        return {
            "overshoot_1": (first_overshoot_limit(seconds), "5.3.3.1"),
            "overshoot_2": (second_overshoot_limit(seconds), "5.3.3.2"),
        }
    if _is_zigzag(angle, heading, 20):
        return {"overshoot_1": (math.radians(25), "5.3.3.3")}
    return {}


def _is_zigzag(angle: float | None, heading: float | None, degrees: float) -> bool:
    if angle is None or heading is None:
        return False
    return max(abs(a - math.radians(degrees)) for a in (angle, heading)) <= _SAME_ANGLE


def _verdict(
    name: str, value: float, limit: float, length: float, section: str
) -> dict[str, float | str]:
    is_angle = name.startswith("overshoot")
    value = float(value) if is_angle else float(value) / length
    return {
        "value": value,
        "limit": limit,
        "unit": "rad" if is_angle else "L",
        "verdict": "pass" if value <= limit else "fail",
        "criterion": f"MSC.137(76) {section}",
    }
