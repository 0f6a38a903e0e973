"""Pulse widths (us), by which servos and speed controllers are ordered."""

import math

import numpy as np
from jaxtyping import Float


Pulses = Float[np.ndarray, "_"]

SHORTEST, LONGEST = 700.0, 2300.0  # trimmed at will
NEUTRAL, SPAN = 1500.0, 400.0  # what is usual, and how far full order is from it
SERVO_ANGLE = math.radians(35)  # of a rudder, usually, at full order
_NEAR_NEUTRAL = 60.0  # of a pulse that stands for a twentieth of the time: the neutral one
_COMMON = 0.05


def are_pulses(values: Pulses) -> bool:
    """Whether orders look like pulse widths; those of no length, which order nothing, aside."""
    ordered = values[values != 0]
    return bool(ordered.size and ordered.min() >= SHORTEST and ordered.max() <= LONGEST)


def neutral_pulse(values: Pulses) -> float:
    """The pulse width that orders nothing: the commonest one near the usual, if it is common."""
    near = values[np.abs(values - NEUTRAL) <= _NEAR_NEUTRAL]
    levels, counts = np.unique(near, return_counts=True)
    is_common = counts.size > 0 and counts.max() >= _COMMON * np.count_nonzero(values)
    return float(levels[np.argmax(counts)]) if is_common else NEUTRAL
