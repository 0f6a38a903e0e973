"""The numbers that trials are summed up by: their units, and how they stand in `metrics.json`."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple


# Distances are given over L, too, and scaled with a model.
LENGTHS = (
    *("advance", "transfer", "tactical_diameter", "max_advance", "max_transfer"),
    *("steady_turning_diameter", "initial_turning_distance", "track_reach", "head_reach"),
    *("lateral_deviation", "distance"),
)
OVER_LENGTH = "_over_L"
_UNITS: dict[str, str] = dict.fromkeys(LENGTHS, "m")
_UNITS |= dict.fromkeys(
    (
        *("execute_time", "initial_turning_time", "reach_time", "period", "time_to_90"),
        *("time_to_180", "time_to_check_yaw", "stopping_time", "time_to_half_speed"),
        "time_to_90_percent",
    ),
    "s",
)
_UNITS |= dict.fromkeys(("overshoot", "order_angle", "switching_heading", "heading_change"), "rad")
_UNITS |= dict.fromkeys(
    ("peak_yaw_rate", "steady_yaw_rate", "yaw_rate", "yaw_rate_at_release", "residual_yaw_rate"),
    "rad/s",
)
_UNITS |= dict.fromkeys(("approach_speed", "final_speed", "mean_speed"), "m/s")
_UNITS |= {"speed_loss": "1"}
_COUNTED = re.compile(r"_\d+$")  # of numbers that a trial has several of: `overshoot_2`


class TrialNumber(NamedTuple):
    """A number of `metrics.json`, in SI units; `over_length` of distances where L is known."""

    name: str
    value: float
    unit: str
    over_length: float | None


def trial_unit(name: str) -> str:
    """The SI unit of a number of a trial, `1` where it has none.

    Raises:
        KeyError: no number of a trial is called so.
    """
    unit = _UNITS.get(name) or _UNITS.get(_COUNTED.sub("", name))
    if unit is None:
        raise KeyError(f"{name}: give the number its unit in diffsea.metrics.numbers")
    return unit


def over_length(numbers: Mapping[str, Any], length: float) -> dict[str, float]:
    """The distances among some numbers in lengths, as `<name>_over_L`."""
    return {f"{name}{OVER_LENGTH}": numbers[name] / length for name in LENGTHS if name in numbers}


def numbers_of(metrics: Mapping[str, Any]) -> Iterator[TrialNumber]:
    """The numbers among the entries of `metrics.json`.

    Raises:
        KeyError: one has no unit.
    """
    for name, value in metrics.items():
        if isinstance(value, float) and not name.endswith(OVER_LENGTH):
            over = metrics.get(f"{name}{OVER_LENGTH}")
            yield TrialNumber(name, value, trial_unit(name), over)
