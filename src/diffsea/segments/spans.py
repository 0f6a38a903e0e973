"""Stretches of rows of one kind, the thresholds that find them, and the approach to them."""

import dataclasses
import math

import numpy as np

from diffsea.errors import UserError
from diffsea.metrics.orders import Plateau
from diffsea.segments.signals import Signals
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples


ONSET_SCATTER = 3.0  # standard deviations of the steering before, which an onset exceeds
ONSET_SHARE = 0.05  # of a step: the least that executed actuation moves at its onset
_FEWEST_ROWS = 5  # that an approach must have to be judged


@dataclasses.dataclass(frozen=True)
class SegmentSettings:
    """Thresholds that no statistic of the recording can give. Angles in rad.

    Times follow from one of the vessel's own, the `window`: as long as it takes to turn by 90
    deg at the fastest rate that the recording shows.

    Raises:
        UserError: one is not above zero.
    """

    window: float | None = None  # s; None takes it from the recording
    turning_share: float = 1 / 15  # of the fastest yaw rate: 6 deg per window is turning
    averaging: float = 1 / 3  # windows over which yaw rate is averaged to find turning
    merging: float = 1.0  # windows; turning motions nearer than this are one
    least_turn: float = math.radians(20)  # change of heading that makes a turning motion
    circle: float = math.radians(120)  # change of heading under one order that makes a trial
    legs: int = 3  # alternating orders that make a zig-zag
    reversal: float = math.radians(3)  # heading at its reversals, on average, to be one
    holding: float = 1 / 20  # windows that the steering must stay to count as held
    piece: float = 0.25  # windows: straight runs, coasting and rest that are shorter do not count
    order: float = math.radians(2)  # smaller angles are no order
    still: float = 0.1  # of the fastest speed: slower is on station
    idle: float = 0.05  # of the largest push: less is none
    steady_speed: float = 0.05  # of the speed, may be gained or lost, or scatter, in an approach
    steady_heading: float = math.radians(2)  # the heading may wander in an approach
    alike: float = 0.15  # relative difference of order and speed among repeats

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UserError(f"{field.name} must be above zero, not {value}")

    @property
    def seconds(self) -> float:
        """The window (s), which must be known by now, see `with_window`."""
        assert self.window is not None
        return self.window


@dataclasses.dataclass(frozen=True)
class Span:
    """Rows of one kind, both ends included, before their approach is known.

    Attributes:
        kind: one of `SEGMENT_KINDS`.
        why: what made it that, in words.
        manoeuvre: what the trial numbers call it.
        plateaus: the held orders of a trial.
        steered: false of turning that no steering explains.
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class ApproachConditions:
    """Conditions over the window before an onset; NaN where they are not known.

    Attributes:
        seconds: length of the approach that was judged.
        speed: mean resultant speed over ground (m/s).
        spread: standard deviation of speed (m/s) about its trend.
        trend: gain of speed over the window (m/s), by a straight line.
        yaw_rate: the largest recorded one (rad/s), either way.
        wander: the range of heading (rad).
        verdict: `steady`, `unsteady` or `unknown`.
        why: what the verdict rests on, in words.
    """

    seconds: float = 0.0
    speed: float = math.nan
    spread: float = math.nan
    trend: float = math.nan
    yaw_rate: float = math.nan
    wander: float = math.nan
    verdict: str
    why: str


def approach_to(
    signals: Signals,
    start: float,
    onset: float,
    settings: SegmentSettings,
    period: str = "before the onset",
) -> ApproachConditions:
    """The approach from `start` to just before `onset` (s); `period` names that time for people.

    Unsteady where speed gains, loses or scatters by more than `steady_speed` of its mean, or
    heading ranges over more than `steady_heading`.
    """
    rows = signals.rows(start, onset)
    rows = slice(rows.start, max(rows.stop - 1, rows.start))
    t, psi = signals.t[rows], signals.psi[rows]
    if len(t) < _FEWEST_ROWS:
        why = f"{len(t)} rows {period} are too few to judge the approach"
        return ApproachConditions(verdict="unknown", why=why)
    known = ApproachConditions(
        seconds=float(t[-1] - t[0]),
        yaw_rate=float(np.max(np.abs(signals.r[rows]))),
        wander=float(np.ptp(psi)),
        verdict="unknown",
        why="the speed is not known",
    )
    if signals.speed is None:
        return known
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
    if known.wander > settings.steady_heading:
        faults.append(f"heading wanders over {math.degrees(known.wander):.1f} deg")
    why = f"over {known.seconds:.3g} s {period} " + (", ".join(faults) or "nothing changes")
    verdict = "unsteady" if faults else "steady"
    return dataclasses.replace(
        known, speed=mean, spread=spread, trend=trend, verdict=verdict, why=why
    )
