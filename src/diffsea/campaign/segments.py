"""Trials found in a long recording: what was run, from when to when, and how it was begun.

The onset of a trial is when the *executed* steering first leaves that of the approach by
more than a threshold, as Rezayan (2026) does; turning that no held order explains is found
in the yaw rate, after Gavrilin and Steen (2017).
"""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from diffsea.campaign.approach import Approach, approach_to
from diffsea.campaign.holds import (
    Hold,
    chains,
    departure,
    find_holds,
    find_lobes,
    foot,
    white_noise,
)
from diffsea.campaign.settings import Settings
from diffsea.campaign.signals import MEASURED, NOTHING, Signals, signals_of
from diffsea.campaign.turning import own_window, turning_motions, turning_rate
from diffsea.metrics.executes import Orders, identify
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel


SEGMENT_KINDS = ("turning", "zigzag", "straight", "coasting", "station", "unknown")
_PASSIVE = ("straight", "station")  # kinds that nothing begins
_ONSET = 0.05  # of the order: the least that the executed angle moves at an onset
_NOISE = 3.0  # standard deviations of the steering in the approach
_MUCH = 0.5  # of a turning motion must be steered to one side
_ONE_SIDED = 0.8  # of all turning goes to one side, to be a turn
_UNSTEERED = "heading changes without steering"


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


@dataclasses.dataclass(frozen=True)
class _Span:
    """Rows of one kind before their approach is known."""

    kind: str
    first: int
    last: int
    why: str
    manoeuvre: str = "unknown"
    holds: tuple[Hold, ...] = ()


def segments(
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
    trials = _trials(signals, settings)
    turns = _turns(signals, settings, trials)
    spans = sorted([*trials, *turns, *_rest(signals, settings, [*trials, *turns])], key=_first)
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


def _first(span: _Span) -> int:
    return span.first


def _window(settings: Settings) -> float:
    assert settings.window is not None
    return settings.window


# Trials: orders that were held


def _trials(signals: Signals, settings: Settings) -> list[_Span]:
    """Zig-zags and turning circles."""
    angle = signals.orders
    if angle is None or signals.steer is None:
        return []
    least = max(settings.order, _NOISE * white_noise(angle))
    holds = find_holds(angle, _count(signals, settings), signals.breaks)
    found = _named(signals, settings, chains(holds, signals.t, least))
    if signals.commanded is not None:
        return found
    swings = chains(find_lobes(angle, least, signals.breaks), signals.t, least)
    more = _named(signals, settings, [chain for chain in swings if len(chain) > 1])
    apart = [m for m in more if all(m.last < f.first or m.first > f.last for f in found)]
    return [*found, *apart]


def _named(signals: Signals, settings: Settings, found: list[list[Hold]]) -> list[_Span]:
    parts = (part for chain in found for part in _parted(signals, settings, chain))
    trials = (_trial(signals, settings, part) for part in parts)
    return [span for span in trials if span is not None]


def _parted(signals: Signals, settings: Settings, chain: list[Hold]) -> Iterator[tuple[Hold, ...]]:
    """A chain without its full turns, each of which is a trial of its own."""
    legs: list[Hold] = []
    for hold in chain:
        if abs(signals.psi[hold.last] - signals.psi[hold.first]) < settings.circle:
            legs.append(hold)
            continue
        if legs:
            yield tuple(legs)
        legs = []
        yield (hold,)
    if legs:
        yield tuple(legs)


def _trial(signals: Signals, settings: Settings, holds: tuple[Hold, ...]) -> _Span | None:
    if 1 < len(holds) < settings.legs:
        return None
    switches = _switches(signals, settings, holds)
    first, last = switches[0], holds[-1].last
    orders = Orders(
        times=tuple(float(signals.t[row]) for row in switches),
        angles=tuple(hold.level for hold in holds),
        end=float(signals.t[last]),
        channel=signals.channel,
    )
    reversals = np.abs(signals.psi[switches[1:]] - signals.psi[first])
    if len(holds) > 1 and np.mean(reversals) < settings.reversal:
        return None
    named = identify(_window_of(signals, settings, first, last), orders)
    if named == "zigzag":
        return _Span("zigzag", first, last, f"{len(holds)} alternating orders", named, holds)
    if named == "turning-circle":
        return _Span("turning", first, last, "one order was held throughout", named, holds)
    return None


def _window_of(signals: Signals, settings: Settings, first: int, last: int) -> Trajectory:
    """The approach to a trial and the trial, complete as the metrics want it."""
    before = float(signals.t[first]) - _window(settings)
    rows = signals.rows(before, float(signals.t[last]))
    t = signals.t[rows]
    speed = np.full(t.shape, np.nan) if signals.speed is None else signals.speed[rows]
    return Trajectory(
        t=t, x=t * np.nan, y=t * np.nan, psi=signals.psi[rows], u=speed, v=0 * speed,
        r=signals.r[rows], commanded={}, executed={"rudder": np.asarray(signals.steer)[rows]},
        extra={}, valid=np.ones(t.shape, bool),
    )  # fmt: skip


def _switches(signals: Signals, settings: Settings, holds: tuple[Hold, ...]) -> list[int]:
    """Rows in which the executed angle left for each of some holds."""
    return [_leaving(signals, settings, hold)[0] for hold in holds]


def _leaving(signals: Signals, settings: Settings, hold: Hold) -> tuple[int, float]:
    """Row in which the executed angle left for a hold, and the threshold (rad) it passed.

    The threshold is the scatter of the steering before, but at least a twentieth of the step.
    """
    angle = np.asarray(signals.steer)
    ordered, began = _given(signals, settings, hold)
    earliest = _approach_row(signals, settings, hold.first)
    last = angle[max(earliest, began + 1 - _count(signals, settings)) : began + 1]
    before, scatter = float(np.median(last)), _scatter(angle[earliest : began + 1])
    step = abs(hold.level - before)
    threshold = min(max(_NOISE * scatter, _ONSET * step), 0.5 * step)
    if signals.commanded is None:
        return ordered, threshold
    beyond = np.abs(angle[ordered : hold.last + 2] - before) > threshold
    lasting = np.flatnonzero(beyond[:-1] & beyond[1:])
    return ordered + int(lasting[0]) if lasting.size else ordered, threshold


def _given(signals: Signals, settings: Settings, hold: Hold) -> tuple[int, int]:
    """Row in which the order of a hold was given, and the last row before it moved at all."""
    angle, count = np.asarray(signals.orders), _count(signals, settings)
    earliest = _approach_row(signals, settings, hold.first)
    began = foot(angle, hold, count, white_noise(angle), earliest)
    last = angle[max(earliest, began + 1 - count) : began + 1]
    before, scatter = float(np.median(last)), _scatter(angle[earliest : began + 1])
    step = abs(hold.level - before)
    threshold = min(max(_NOISE * scatter, _ONSET * step), 0.5 * step)
    return departure(angle, before, threshold, hold.first, max(earliest, began - count)), began


def _count(signals: Signals, settings: Settings) -> int:
    """How many rows the steering must stay to be held."""
    return max(5, round(settings.holding * _window(settings) / signals.interval))


def _scatter(angle: np.ndarray) -> float:
    """Robust standard deviation (rad) of the steering, zero of fewer than three rows."""
    if angle.size < 3:
        return 0.0
    return float(np.median(np.abs(angle - np.median(angle))) / 0.6745)


def _approach_row(signals: Signals, settings: Settings, row: int) -> int:
    """The row in which the approach to a row begins, after any hole."""
    start = signals.rows(float(signals.t[row]) - _window(settings), float(signals.t[row])).start
    return max([start, *(b for b in signals.breaks if b <= row)])


# Turning motion that no held order explains


def _turns(signals: Signals, settings: Settings, trials: list[_Span]) -> list[_Span]:
    window = _window(settings)
    spans = []
    counts = signals.known & (signals.working | _moving(signals, settings))
    motions = turning_motions(signals.t, signals.psi, signals.r, counts, window, settings)
    for first, last in motions:
        for start, end, follows in _outside(first, last, trials, signals.breaks):
            span = _turn(signals, settings, start, end)
            if span is None or (follows and span.why == _UNSTEERED):
                continue
            spans.append(span)
    return spans


def _outside(
    first: int, last: int, trials: list[_Span], breaks: tuple[int, ...]
) -> Iterator[tuple[int, int, bool]]:
    """The parts of some rows that are in no trial and across no hole; whether a trial precedes."""
    cuts = [(s.first, s.last, True) for s in trials] + [(b, b - 1, False) for b in breaks]
    follows = False
    for begin, end, is_trial in sorted(cuts):
        if end < first - 1 or begin > last:
            continue
        if begin - 1 > first:
            yield first, begin - 1, follows
        first, follows = max(first, end + 1), is_trial
    if last > first:
        yield first, last, follows


def _turn(signals: Signals, settings: Settings, first: int, last: int) -> _Span | None:
    """The turning motion in some rows, without its slow ends."""
    fast = np.flatnonzero(
        np.abs(signals.r[first : last + 1]) > turning_rate(_window(settings), settings)
    )
    if fast.size < 2:
        return None
    first, last = first + int(fast[0]), first + int(fast[-1])
    psi = signals.psi[first : last + 1]
    if np.ptp(psi) < settings.least_turn:
        return None
    starboard, port = _steered(signals, settings, first, last)
    if starboard + port < _MUCH:
        return _Span("unknown", first, last, _UNSTEERED)
    one_sided = abs(psi[-1] - psi[0]) > _ONE_SIDED * _turned(signals, settings, first, last)
    if one_sided and max(starboard, port) >= _MUCH:
        return _Span("turning", first, last, "yaw rate keeps its side, no order was held")
    return _Span("unknown", first, last, "heading goes to and fro without the orders of a trial")


def _turned(signals: Signals, settings: Settings, first: int, last: int) -> float:
    """How much the vessel turned (rad), to either side, in steps that noise does not fill."""
    step = settings.averaging * _window(settings)
    times = np.arange(signals.t[first], signals.t[last] + step, step)
    psi = np.interp(np.minimum(times, signals.t[last]), signals.t, signals.psi)
    return float(np.sum(np.abs(np.diff(psi))))


def _steered(signals: Signals, settings: Settings, first: int, last: int) -> tuple[float, float]:
    """Shares of some rows in which the steering is to either side; one where it is not known."""
    if signals.steer is None:
        return 1.0, 0.0
    angle = signals.steer[first : last + 1]
    return float(np.mean(angle > settings.order)), float(np.mean(angle < -settings.order))


# Straight runs, coasting and rest


def _rest(signals: Signals, settings: Settings, taken: list[_Span]) -> list[_Span]:
    """What is left, by speed and push."""
    code = _codes(signals, settings)
    free = np.ones(signals.t.shape, bool)
    for span in taken:
        free[span.first : span.last + 1] = False
    edges = np.flatnonzero(np.diff(np.where(free & signals.known, code, -1))) + 1
    edges = np.unique([0, *edges, *signals.breaks, len(code)])
    spans = []
    for first, stop in zip(edges[:-1], edges[1:], strict=True):
        long = signals.t[stop - 1] - signals.t[first] >= settings.piece * _window(settings)
        if free[first] and signals.known[first] and long:
            kind, why, manoeuvre = _RESTS[code[first]]
            spans.append(_Span(kind, int(first), int(stop - 1), why, manoeuvre))
    return spans


_RESTS = (
    ("straight", "the vessel moves and does not turn", "straight"),
    ("station", "the vessel hardly moves", "unknown"),
    ("coasting", "the vessel moves without push", "unknown"),
    ("unknown", "the vessel is pushed astern while it moves ahead", "stopping"),
)


def _codes(signals: Signals, settings: Settings) -> np.ndarray:
    """The index into `_RESTS` of every row."""
    code = np.zeros(signals.t.shape, int)
    drive = signals.drive if signals.throttle is None else signals.throttle
    if drive is not None:
        code[np.abs(drive) <= settings.idle] = 2
        code[(drive < -settings.idle) & signals.ahead] = 3
    code[~_moving(signals, settings)] = 1
    return code


def _moving(signals: Signals, settings: Settings) -> np.ndarray:
    """Rows in which the vessel moves; a speed that only hovers about the limit does not count."""
    if signals.speed is None:
        return np.ones(signals.t.shape, bool)
    limit = settings.still * float(np.quantile(signals.speed, 0.98))
    limit = max(limit, 3 * white_noise(signals.speed))
    stretches, number = ndimage.label(signals.speed > limit)
    clear = np.unique(stretches[signals.speed > 1.5 * limit])
    return np.isin(stretches, clear[clear > 0])


# From spans to segments


def _segment(signals: Signals, settings: Settings, span: _Span, earliest: float) -> Segment:
    t, psi = signals.t, signals.psi
    begun = span.kind not in _PASSIVE
    first, threshold, ordered = span.first, math.nan, math.nan
    if begun and signals.steer is not None and span.kind != "coasting":
        first, threshold = _onset(signals, settings, span)
        ordered = _ordered(signals, settings, span)
    elif span.kind == "coasting":
        first = _pushed_less(signals, first, span.last)
        ordered = math.nan if signals.throttle is None else float(t[span.first])
    onset = float(t[first])
    if begun:
        start = float(t[_approach_row(signals, settings, first)])
        approach = approach_to(signals, start, onset, settings)
        start = max(start, earliest)
    else:
        start, approach = onset, _itself(signals, settings, span)
    change = float(psi[span.last] - psi[first])
    switches = _switches(signals, settings, span.holds) if span.holds else []
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


def _onset(signals: Signals, settings: Settings, span: _Span) -> tuple[int, float]:
    """Row of the onset, and the threshold (rad) that the executed angle passes there."""
    if span.holds:
        return _leaving(signals, settings, span.holds[0])
    angle = np.asarray(signals.steer)
    earliest = _approach_row(signals, settings, span.first)
    level = float(np.median(angle[span.first : span.last + 1]))
    before, scatter = float(np.median(angle[earliest : span.first + 1])), 0.0
    scatter = _scatter(angle[earliest : span.first + 1])
    threshold = max(_NOISE * scatter, _ONSET * abs(level - before), settings.order)
    # Steering that does not move before the vessel turns is not what turned it.
    if abs(angle[span.first] - before) <= threshold:
        return span.first, math.nan
    return departure(angle, before, threshold, span.first, earliest), threshold


def _ordered(signals: Signals, settings: Settings, span: _Span) -> float:
    """When the order that the onset answers was given (s)."""
    if signals.commanded is None or not span.holds:
        return math.nan
    return float(signals.t[_given(signals, settings, span.holds[0])[0]])


def _pushed_less(signals: Signals, first: int, last: int) -> int:
    """The row from which on the executed push falls, after the order to coast in row `first`."""
    drive = np.asarray(signals.drive)
    before = float(np.median(drive[max(first - 5, 0) : first])) if first else 0.0
    fallen = np.flatnonzero(drive[first : last + 1] < (1 - _ONSET) * before)
    return first + int(fallen[0]) if fallen.size and signals.throttle is not None else first


def _itself(signals: Signals, settings: Settings, span: _Span) -> Approach:
    """The conditions of a piece that nothing begins."""
    t = signals.t
    step = float(t[span.last] - t[span.last - 1])
    own = approach_to(signals, float(t[span.first]), float(t[span.last]) + step, settings)
    return dataclasses.replace(own, why=own.why.replace("before the onset ", "of the piece "))


def _side(signals: Signals, span: _Span, change: float) -> str | None:
    """The side to which the vessel turned, first in a zig-zag."""
    if span.kind not in ("turning", "zigzag"):
        return None
    if span.kind == "zigzag":
        hold = span.holds[1]
        change = float(signals.psi[hold.first] - signals.psi[span.first])
    return "starboard" if change >= 0 else "port"


def _order(signals: Signals, span: _Span) -> float:
    """Mean size of the orders (rad); of turning without a held order, the median angle."""
    if span.holds:
        return float(np.mean([abs(hold.level) for hold in span.holds]))
    if span.kind == "turning" and signals.steer is not None:
        return float(abs(np.median(signals.steer[span.first : span.last + 1])))
    return math.nan


def _why(signals: Signals, span: _Span, change: float) -> str:
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
    if end - last.start < settings.piece * _window(settings):
        return found[:-1]
    rows = signals.rows(last.start, end)
    span = _Span(last.kind, rows.start, rows.stop - 2, "")
    return [
        *found[:-1],
        dataclasses.replace(
            last, end=float(signals.t[span.last]), approach=_itself(signals, settings, span),
            heading_change=float(signals.psi[span.last] - signals.psi[span.first]),
        ),
    ]  # fmt: skip
