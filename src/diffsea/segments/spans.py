"""Stretches of rows of one kind, and what finding them shares."""

import dataclasses

import numpy as np

from diffsea.metrics.orders import Plateau
from diffsea.segments.settings import SegmentSettings
from diffsea.segments.signals import Signals
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples


ONSET_SCATTER = 3.0  # standard deviations of the steering before, which an onset exceeds
ONSET_SHARE = 0.05  # of a step: the least that executed actuation moves at its onset


@dataclasses.dataclass(frozen=True)
class Span:
    """Rows of one kind, both ends included, before their approach is known.

    `plateaus` are the held orders of a trial. `steered` is false of turning that no steering
    explains. `why` is for people.
    """

    kind: str
    first: int
    last: int
    why: str
    manoeuvre: str = "unknown"
    plateaus: tuple[Plateau, ...] = ()
    steered: bool = True


def plateau_rows(signals: Signals, settings: SegmentSettings) -> int:
    """How many rows the steering must stay to be held."""
    return max(5, round(settings.holding * settings.seconds / signals.interval))


def robust_scatter(angle: Samples) -> float:
    """Robust standard deviation (rad) of the steering, zero of fewer than three rows."""
    return noise_scale(angle - np.median(angle), 0) if angle.size >= 3 else 0.0


def approach_row(signals: Signals, settings: SegmentSettings, row: int) -> int:
    """The row in which the approach to a row begins, after any hole."""
    start = signals.rows(float(signals.t[row]) - settings.seconds, float(signals.t[row])).start
    return max([start, *(b for b in signals.breaks if b <= row)])
