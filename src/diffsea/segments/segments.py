"""Trials found in a long recording: what was run, from when to when, and how it was begun.

The onset of a trial is when the *executed* steering first leaves that of the approach by
more than a threshold, as Rezayan (2026) does; turning that no held order explains is found
in the yaw rate, after Gavrilin and Steen (2017).
"""

import dataclasses
import math

import numpy as np

from diffsea.metrics.orders import departure_row
from diffsea.segments.approach import ApproachConditions, approach_to
from diffsea.segments.free_motion import find_rest, find_turns, quarter_turn_window
from diffsea.segments.settings import SegmentSettings
from diffsea.segments.signals import MEASURED, NOTHING, Signals, signals_of
from diffsea.segments.spans import (
    ONSET_SCATTER,
    ONSET_SHARE,
    Span,
    approach_row,
    robust_scatter,
)
from diffsea.segments.trials import find_trials, leaving_row, order_row, switch_rows
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
    approach: ApproachConditions
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
    run: Trajectory, vessel: Vessel | None = None, settings: SegmentSettings | None = None
) -> list[Segment]:
    """Every trial, turning motion, straight run, coasting and rest in a recording, in order.

    They do not overlap. What is too short to be anything is in none. Channels named after
    rudders, sides or azimuth angles steer, unless a vessel says which do.

    Raises `UserError` where there is neither heading nor yaw rate, or hardly a row.
    """
    return segments_of(signals_of(run, vessel), settings)


def with_window(signals: Signals, settings: SegmentSettings | None = None) -> SegmentSettings:
    """The settings with the window of this recording, if none was given."""
    settings = SegmentSettings() if settings is None else settings
    if settings.window is not None:
        return settings
    return dataclasses.replace(settings, window=quarter_turn_window(signals.t, signals.r))


def segments_of(signals: Signals, settings: SegmentSettings | None = None) -> list[Segment]:
    """The segments of a recording whose signals are at hand."""
    settings = with_window(signals, settings)
    spans = find_trials(signals, settings)
    spans = [*spans, *find_turns(signals, settings, spans)]
    spans = [*spans, *find_rest(signals, settings, spans)]
    found: list[Segment] = []
    for span in sorted(spans, key=lambda span: span.first):
        segment = _segment(signals, settings, span, _earliest_start(found, signals))
        # What nothing begins gives way to an approach.
        if found and segment.start <= found[-1].end:
            last = found.pop()
            if segment.start - last.start >= settings.piece * settings.seconds:
                rows = signals.rows(last.start, segment.start)
                end = Span(last.kind, rows.start, rows.stop - 2, "")
                change = float(signals.psi[end.last] - signals.psi[end.first])
                approach = _own_conditions(signals, settings, end)
                stop = float(signals.t[end.last])
                found.append(
                    dataclasses.replace(last, end=stop, approach=approach, heading_change=change)
                )
        found.append(segment)
    return found


def _earliest_start(found: list[Segment], signals: Signals) -> float:
    """From when on (s) a segment may begin; what nothing begins gives way to an approach."""
    if not found:
        return float(signals.t[0])
    if found[-1].kind in _PASSIVE:
        return found[-1].start
    return float(signals.t[min(signals.rows(0.0, found[-1].end).stop, len(signals.t) - 1)])


def _segment(signals: Signals, settings: SegmentSettings, span: Span, earliest: float) -> Segment:
    """The segment of a span: its onset, approach, orders and heading."""
    t, psi = signals.t, signals.psi
    first, threshold, ordered = span.first, math.nan, math.nan
    if span.kind == "coasting":
        first = _row_of_less_push(signals, settings, first, span.last)
        ordered = math.nan if signals.throttle is None else float(t[span.first])
    elif span.kind not in _PASSIVE and signals.steer is not None:
        first, threshold = _onset(signals, settings, span)
        if signals.commanded is not None and span.plateaus:
            ordered = float(t[order_row(signals, settings, span.plateaus[0])[0]])
    onset = float(t[first])
    if span.kind in _PASSIVE:
        start, approach = onset, _own_conditions(signals, settings, span)
    else:
        start = float(t[approach_row(signals, settings, first)])
        approach = approach_to(signals, start, onset, settings)
        start = max(start, earliest)
    change = float(psi[span.last] - psi[first])
    side = _side(signals, span, change)
    switches = switch_rows(signals, settings, span.plateaus) if span.plateaus else []
    return Segment(
        kind=span.kind,
        start=start,
        end=float(t[span.last]),
        onset=onset,
        reference_heading=float(psi[first]),
        approach=approach,
        manoeuvre=span.manoeuvre,
        side=side,
        order=_order_size(signals, span),
        heading_change=change,
        ordered=ordered,
        threshold=threshold,
        switches=tuple(float(t[row]) for row in switches),
        actuation=signals.origin,
        why=_why(signals, span, side, change),
        recording=signals.run.name,
    )


def _onset(signals: Signals, settings: SegmentSettings, span: Span) -> tuple[int, float]:
    """Row of the onset, and the threshold (rad) that the executed angle passes there."""
    if span.plateaus:
        return leaving_row(signals, settings, span.plateaus[0])
    angle = np.asarray(signals.steer)
    earliest = approach_row(signals, settings, span.first)
    level = float(np.median(angle[span.first : span.last + 1]))
    before = float(np.median(angle[earliest : span.first + 1]))
    scatter = robust_scatter(angle[earliest : span.first + 1])
    threshold = max(ONSET_SCATTER * scatter, ONSET_SHARE * abs(level - before), settings.order)
    # Steering that does not move before the vessel turns is not what turned it.
    if abs(angle[span.first] - before) <= threshold:
        return span.first, math.nan
    return departure_row(angle, before, threshold, span.first, earliest), threshold


def _row_of_less_push(signals: Signals, settings: SegmentSettings, first: int, last: int) -> int:
    """The row from which on the executed push falls, after the order to coast in row `first`."""
    drive = np.asarray(signals.drive)
    before = float(np.median(drive[max(first - 5, 0) : first])) if first else 0.0
    if signals.throttle is None or before <= settings.idle:
        return first
    fallen = np.flatnonzero(drive[first : last + 1] < (1 - ONSET_SHARE) * before)
    return first + int(fallen[0]) if fallen.size else first


def _own_conditions(signals: Signals, settings: SegmentSettings, span: Span) -> ApproachConditions:
    """The conditions of a piece that nothing begins, as if it were an approach."""
    t = signals.t
    end = float(t[span.last]) + float(t[span.last] - t[span.last - 1])
    return approach_to(signals, float(t[span.first]), end, settings, "of the piece")


def _side(signals: Signals, span: Span, change: float) -> str | None:
    """The side to which the vessel turned, first in a zig-zag."""
    if span.kind not in ("turning", "zigzag"):
        return None
    if span.kind == "zigzag":
        change = float(signals.psi[span.plateaus[1].first] - signals.psi[span.first])
    return "starboard" if change >= 0 else "port"


def _order_size(signals: Signals, span: Span) -> float:
    """Mean size of the orders (rad); of turning without a held order, the median angle."""
    if span.plateaus:
        return float(np.mean([abs(plateau.level) for plateau in span.plateaus]))
    if span.kind == "turning" and signals.steer is not None:
        return float(abs(np.median(signals.steer[span.first : span.last + 1])))
    return math.nan


def _why(signals: Signals, span: Span, side: str | None, change: float) -> str:
    """What made the span what it is, in words for people."""
    notes = [span.why]
    if span.plateaus:
        if span.plateaus[0].level * (1.0 if side == "starboard" else -1.0) < 0:
            notes.append(f"positive {signals.channel} turns to port")
        if signals.origin != MEASURED:
            notes.append(f"executed steering is {signals.origin}, not measured")
    elif span.kind == "turning":
        notes.append(f"heading changed by {math.degrees(change):.0f} deg")
    return "; ".join(notes)
