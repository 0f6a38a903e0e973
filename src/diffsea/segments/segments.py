"""Trials found in a long recording: what was run, from when to when, and how it was begun.

The onset of a trial is when the *executed* steering first leaves that of the approach by
more than a threshold, as Rezayan (2026) does; turning that no held order explains is found
in the yaw rate, after Gavrilin and Steen (2017). Segments of one kind, side, order and approach
speed are repeats of one another.
"""

import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from scipy.cluster import hierarchy

from diffsea.metrics.orders import departure_row
from diffsea.segments.free_motion import find_rest, find_turns, quarter_turn_window
from diffsea.segments.signals import MEASURED, NOTHING, Signals, signals_of
from diffsea.segments.spans import (
    ONSET_SCATTER,
    ONSET_SHARE,
    ApproachConditions,
    SegmentSettings,
    Span,
    approach_row,
    approach_to,
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
    speed.

    Attributes:
        kind: one of `SEGMENT_KINDS`.
        reference_heading: at the onset.
        manoeuvre: what the trial numbers call it.
        side: to which the vessel turned, first in a zig-zag; None where it did not.
        order: mean size of the orders; of turning without a held order, of the median angle.
        heading_change: from the onset to the end, positive to starboard.
        ordered: when the order was given, NaN where orders were not recorded or there was none.
        threshold: how far the executed angle is from that of the approach at the onset.
        switches: the onsets of all orders.
        actuation: where the executed angle is from, such as `measured`.
        why: what made the segment what it is, in words.
        group: label of the repeats that it belongs to.
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

    Raises:
        UserError: there is neither heading nor yaw rate, or hardly a row.
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
        earliest = float(signals.t[0])
        if found and found[-1].kind in _PASSIVE:
            earliest = found[-1].start
        elif found:
            after = signals.rows(0.0, found[-1].end).stop
            earliest = float(signals.t[min(after, len(signals.t) - 1)])
        segment = _segment(signals, settings, span, earliest)
        # What nothing begins gives way to an approach.
        if found and segment.start <= found[-1].end:
            last = found.pop()
            if segment.start - last.start >= settings.piece * settings.seconds:
                rows = signals.rows(last.start, segment.start)
                rest = Span(last.kind, rows.start, rows.stop - 2, "")
                shorter = dataclasses.replace(
                    last,
                    end=float(signals.t[rest.last]),
                    approach=_own_conditions(signals, settings, rest),
                    heading_change=float(signals.psi[rest.last] - signals.psi[rest.first]),
                )
                found.append(shorter)
        found.append(segment)
    return found


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
    change, side, order = float(psi[span.last] - psi[first]), None, math.nan
    if span.kind in ("turning", "zigzag"):
        begun = change
        if span.kind == "zigzag":
            begun = float(psi[span.plateaus[1].first] - psi[span.first])
        side = "starboard" if begun >= 0 else "port"
    if span.plateaus:
        order = float(np.mean([abs(plateau.level) for plateau in span.plateaus]))
    elif span.kind == "turning" and signals.steer is not None:
        order = float(abs(np.median(signals.steer[span.first : span.last + 1])))
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
        order=order,
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


def group_repeats(
    found: Sequence[Segment], settings: SegmentSettings | None = None
) -> list[Segment]:
    """The segments with `group` filled in: one label for those that repeat one another.

    All members of a group are alike: order and approach speed differ by no more than
    `settings.alike` of the larger (an order by less than `settings.order` in any case).
    What has no order or no speed is compared by what it has. The label says what is common.
    """
    settings = SegmentSettings() if settings is None else settings
    kinds: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for number, segment in enumerate(found):
        known = math.isfinite(segment.order), math.isfinite(segment.approach.speed)
        kinds[segment.kind, segment.manoeuvre, segment.side, *known].append(number)
    labels: dict[int, str] = {}
    for numbers in kinds.values():
        for cluster in _clusters([found[n] for n in numbers], settings):
            members = [numbers[k] for k in cluster]
            common = label = _common_label([found[n] for n in members])
            repeat = 2
            while label in labels.values():
                label, repeat = f"{common} ({repeat})", repeat + 1
            labels |= dict.fromkeys(members, label)
    return [dataclasses.replace(item, group=labels[n]) for n, item in enumerate(found)]


def _clusters(found: list[Segment], settings: SegmentSettings) -> list[list[int]]:
    """Complete linkage: the two members of a group that differ most are still alike."""
    if len(found) == 1:
        return [[0]]
    pairs = []  # how unlike two segments are; one is just alike
    for one, other in itertools.combinations(found, 2):
        pairs.append(0.0)
        if math.isfinite(one.order):
            allowed = max(settings.alike * max(one.order, other.order), settings.order)
            pairs[-1] = max(pairs[-1], abs(one.order - other.order) / allowed)
        speeds = one.approach.speed, other.approach.speed
        if math.isfinite(speeds[0]):
            allowed = settings.alike * max(*speeds, 1e-12)
            pairs[-1] = max(pairs[-1], abs(speeds[0] - speeds[1]) / allowed)
    numbers = hierarchy.fcluster(hierarchy.complete(np.array(pairs)), 1.0, "distance")
    return [np.flatnonzero(numbers == n).tolist() for n in dict.fromkeys(numbers)]


def _common_label(members: list[Segment]) -> str:
    first = members[0]
    words = [first.kind if first.manoeuvre == "unknown" else first.manoeuvre, first.side or ""]
    if math.isfinite(first.order):
        words.append(f"{math.degrees(np.mean([m.order for m in members])):.0f} deg")
    if math.isfinite(first.approach.speed):
        words.append(f"{np.mean([m.approach.speed for m in members]):.3g} m/s")
    return " ".join(word for word in words if word)
