"""Stretches of rows of one kind, and what finding them shares."""

import dataclasses

import numpy as np

from diffsea.metrics.orders import Plateau
from diffsea.segments.settings import Settings
from diffsea.segments.signals import Signals
from diffsea.statistics import noise_scale


NOISE = 3.0  # standard deviations of the steering before, which an onset exceeds
ONSET = 0.05  # of a step: the least that executed actuation moves at its onset


@dataclasses.dataclass(frozen=True)
class Span:
    """Rows of one kind before their approach is known."""

    kind: str
    first: int
    last: int
    why: str
    manoeuvre: str = "unknown"
    holds: tuple[Plateau, ...] = ()


def window_of(settings: Settings) -> float:
    """The window (s), which `fitted` has seen to."""
    assert settings.window is not None
    return settings.window


def hold_rows(signals: Signals, settings: Settings) -> int:
    """How many rows the steering must stay to be held."""
    return max(5, round(settings.holding * window_of(settings) / signals.interval))


def scatter_of(angle: np.ndarray) -> float:
    """Robust standard deviation (rad) of the steering, zero of fewer than three rows."""
    if angle.size < 3:
        return 0.0
    return noise_scale(angle - np.median(angle), 0)


def approach_row(signals: Signals, settings: Settings, row: int) -> int:
    """The row in which the approach to a row begins, after any hole."""
    start = signals.rows(float(signals.t[row]) - window_of(settings), float(signals.t[row])).start
    return max([start, *(b for b in signals.breaks if b <= row)])
