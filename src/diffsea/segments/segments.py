"""Trials found in a long recording: what was run, from when to when, and how it was begun.

The onset of a trial is when the *executed* steering first leaves that of the approach by
more than a threshold, as Rezayan (2026) does; turning that no held order explains is found
in the yaw rate, after Gavrilin and Steen (2017).
"""

import dataclasses
import math

import numpy as np

from diffsea.metrics.orders import departure_row
from diffsea.segments.approach import Approach, approach_to
from diffsea.segments.settings import Settings
from diffsea.segments.signals import MEASURED, NOTHING, Signals, signals_of
from diffsea.segments.spans import NOISE, ONSET, Span, approach_row, scatter_of, window_of
from diffsea.segments.trials import given, leaving, switches_of, trials_in
from diffsea.segments.unordered import own_window, rest_in, turns_in
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


SEGMENT_KINDS = ("turning", "zigzag", "straight", "coasting", "station", "unknown")
_PASSIVE = ("straight", "station")  # kinds that nothing begins


@dataclasses.dataclass(frozen=True)
class Segment:
    """One piece of a recording. Times in s on its clock, angles in rad, speeds in m/s.

    `start` to `onset` is the approach, `onset` to `end` what was run; a piece that nothing
    begins (straight, station) has its onset at the start, and its own speed as approach
    speed. `manoeuvre` is what the trial numbers call it. `ordered` is when the order was
    given, NaN where orders were not recorded or there was none. `threshold` is how far the
    executed angle is from that of the approach at the onset. `switches` are the onsets of
    all orders, `actuation` says where the executed angle is from.
    """

    kind: str
    start: float
    end: float
    onset: float
    reference_heading: float
    approach: Approach
    manoeuvre: str = "unknown"
    side: str | None = None
    order: float = math.nan
    heading_change: float = math.nan
    ordered: float = math.nan
    threshold: float = math.nan
    switches: tuple[float, ...] = ()
    actuation: str = NOTHING
    why: str = ""
    recording: str = "run"
    group: str = ""

    @property
    def steady(self) -> bool:
        """Whether the approach was steady."""
        return self.approach.verdict == "steady"


def find_segments(
    run: Trajectory, vessel: Vessel | None = None, settings: Settings | None = None
) -> list[Segment]:
    """Every trial, turning motion, straight run, coasting and rest in a recording, in order.

    They do not overlap. What is too short to be anything is in none. Channels named after
    rudders, sides or azimuth angles steer, unless a vessel says which do.

    Raises `UserError` where there is neither heading nor yaw rate, or hardly a row.
    """
    return segments_of(signals_of(run, vessel), settings)


def segments_of(signals: Signals, settings: Settings | None = None) -> list[Segment]:
    """The segments of a recording whose signals are at hand."""
    settings = fitted(signals, settings)
    trials = trials_in(signals, settings)
    turns = turns_in(signals, settings, trials)
    spans = sorted(
        [*trials, *turns, *rest_in(signals, settings, [*trials, *turns])],
        key=lambda span: span.first,
    )
    found: list[Segment] = []
    for span in spans:
        segment = _segment(signals, settings, span, _taken(found, signals))
        if found and segment.start <= found[-1].end:
            found = _shortened(signals, settings, found, segment.start)
        found.append(segment)
    return found


def _taken(found: list[Segment], signals: Signals) -> float:
    """From when on (s) a segment may begin; what nothing begins gives way to an approach."""
    if not found:
        return float(signals.t[0])
    if found[-1].kind in _PASSIVE:
        return found[-1].start
    return float(signals.t[min(signals.rows(0.0, found[-1].end).stop, len(signals.t) - 1)])


def fitted(signals: Signals, settings: Settings | None = None) -> Settings:
    """The settings with the window of this recording, if none was given."""
    settings = Settings() if settings is None else settings
    if settings.window is not None:
        return settings
    return dataclasses.replace(settings, window=own_window(signals.t, signals.r))


def _segment(signals: Signals, settings: Settings, span: Span, earliest: float) -> Segment:
    t, psi = signals.t, signals.psi
    begun = span.kind not in _PASSIVE
    first, threshold, ordered = span.first, math.nan, math.nan
    if begun and signals.steer is not None and span.kind != "coasting":
        first, threshold = _onset(signals, settings, span)
        ordered = _ordered(signals, settings, span)
    elif span.kind == "coasting":
        first = _pushed_less(signals, settings, first, span.last)
        ordered = math.nan if signals.throttle is None else float(t[span.first])
    onset = float(t[first])
    if begun:
        start = float(t[approach_row(signals, settings, first)])
        approach = approach_to(signals, start, onset, settings)
        start = max(start, earliest)
    else:
        start, approach = onset, _itself(signals, settings, span)
    change = float(psi[span.last] - psi[first])
    switches = switches_of(signals, settings, span.holds) if span.holds else []
    return Segment(
        kind=span.kind,
        start=start,
        end=float(t[span.last]),
        onset=onset,
        reference_heading=float(psi[first]),
        approach=approach,
        manoeuvre=span.manoeuvre,
        side=_side(signals, span, change),
        order=_order(signals, span),
        heading_change=change,
        ordered=ordered,
        threshold=threshold,
        switches=tuple(float(t[row]) for row in switches),
        actuation=signals.origin,
        why=_why(signals, span, change),
        recording=signals.run.name,
    )


def _onset(signals: Signals, settings: Settings, span: Span) -> tuple[int, float]:
    """Row of the onset, and the threshold (rad) that the executed angle passes there."""
    if span.holds:
        return leaving(signals, settings, span.holds[0])
    angle = np.asarray(signals.steer)
    earliest = approach_row(signals, settings, span.first)
    level = float(np.median(angle[span.first : span.last + 1]))
    before, scatter = float(np.median(angle[earliest : span.first + 1])), 0.0
    scatter = scatter_of(angle[earliest : span.first + 1])
    threshold = max(NOISE * scatter, ONSET * abs(level - before), settings.order)
    # Steering that does not move before the vessel turns is not what turned it.
    if abs(angle[span.first] - before) <= threshold:
        return span.first, math.nan
    return departure_row(angle, before, threshold, span.first, earliest), threshold


def _ordered(signals: Signals, settings: Settings, span: Span) -> float:
    """When the order that the onset answers was given (s)."""
    if signals.commanded is None or not span.holds:
        return math.nan
    return float(signals.t[given(signals, settings, span.holds[0])[0]])


def _pushed_less(signals: Signals, settings: Settings, first: int, last: int) -> int:
    """The row from which on the executed push falls, after the order to coast in row `first`."""
    drive = np.asarray(signals.drive)
    before = float(np.median(drive[max(first - 5, 0) : first])) if first else 0.0
    if signals.throttle is None or before <= settings.idle:
        return first
    fallen = np.flatnonzero(drive[first : last + 1] < (1 - ONSET) * before)
    return first + int(fallen[0]) if fallen.size else first


def _itself(signals: Signals, settings: Settings, span: Span) -> Approach:
    """The conditions of a piece that nothing begins."""
    t = signals.t
    step = float(t[span.last] - t[span.last - 1])
    own = approach_to(signals, float(t[span.first]), float(t[span.last]) + step, settings)
    return dataclasses.replace(own, why=own.why.replace("before the onset ", "of the piece "))


def _side(signals: Signals, span: Span, change: float) -> str | None:
    """The side to which the vessel turned, first in a zig-zag."""
    if span.kind not in ("turning", "zigzag"):
        return None
    if span.kind == "zigzag":
        hold = span.holds[1]
        change = float(signals.psi[hold.first] - signals.psi[span.first])
    return "starboard" if change >= 0 else "port"


def _order(signals: Signals, span: Span) -> float:
    """Mean size of the orders (rad); of turning without a held order, the median angle."""
    if span.holds:
        return float(np.mean([abs(hold.level) for hold in span.holds]))
    if span.kind == "turning" and signals.steer is not None:
        return float(abs(np.median(signals.steer[span.first : span.last + 1])))
    return math.nan


def _why(signals: Signals, span: Span, change: float) -> str:
    notes = [span.why]
    if span.holds:
        side = 1.0 if _side(signals, span, change) == "starboard" else -1.0
        if span.holds[0].level * side < 0:
            notes.append(f"positive {signals.channel} turns to port")
    elif span.kind == "turning":
        notes.append(f"heading changed by {math.degrees(change):.0f} deg")
    if span.holds and signals.origin != MEASURED:
        notes.append(f"executed steering is {signals.origin}, not measured")
    return "; ".join(notes)


def _shortened(
    signals: Signals, settings: Settings, found: list[Segment], end: float
) -> list[Segment]:
    """The segments with the last, passive one giving up its end to an approach."""
    last = found[-1]
    if end - last.start < settings.piece * window_of(settings):
        return found[:-1]
    rows = signals.rows(last.start, end)
    span = Span(last.kind, rows.start, rows.stop - 2, "")
    return [
        *found[:-1],
        dataclasses.replace(
            last, end=float(signals.t[span.last]), approach=_itself(signals, settings, span),
            heading_change=float(signals.psi[span.last] - signals.psi[span.first]),
        ),
    ]  # fmt: skip
