"""What no order of a trial explains: turning motion, straight runs, coasting and rest."""

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from diffsea.campaign.holds import white_noise
from diffsea.campaign.settings import Settings
from diffsea.campaign.signals import Signals
from diffsea.campaign.spans import Span, hold_rows, window_of
from diffsea.campaign.turning import turning_motions, turning_rate, turning_rows


_NOISE = 3.0  # standard deviations: less push than this is none
_MUCH = 0.5  # of a turning motion must be steered to one side
_ONE_SIDED = 0.8  # of all turning goes to one side, to be a turn
_UNSTEERED = "heading changes without steering"


def turns_in(signals: Signals, settings: Settings, trials: list[Span]) -> list[Span]:
    window = window_of(settings)
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
    first: int, last: int, trials: list[Span], breaks: tuple[int, ...]
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


def _turn(signals: Signals, settings: Settings, first: int, last: int) -> Span | None:
    """The turning motion in some rows, without its slow ends."""
    fast = np.flatnonzero(
        np.abs(signals.r[first : last + 1]) > turning_rate(window_of(settings), settings)
    )
    if fast.size < 2:
        return None
    first, last = first + int(fast[0]), first + int(fast[-1])
    psi = signals.psi[first : last + 1]
    if np.ptp(psi) < settings.least_turn:
        return None
    starboard, port = _steered(signals, settings, first, last)
    if starboard + port < _MUCH:
        return Span("unknown", first, last, _UNSTEERED)
    one_sided = abs(psi[-1] - psi[0]) > _ONE_SIDED * _turned(signals, settings, first, last)
    if one_sided and max(starboard, port) >= _MUCH:
        return Span("turning", first, last, "yaw rate keeps its side, no order was held")
    return Span("unknown", first, last, "heading goes to and fro without the orders of a trial")


def _turned(signals: Signals, settings: Settings, first: int, last: int) -> float:
    """How much the vessel turned (rad), to either side, in steps that noise does not fill."""
    step = settings.averaging * window_of(settings)
    times = np.arange(signals.t[first], signals.t[last] + step, step)
    psi = np.interp(np.minimum(times, signals.t[last]), signals.t, signals.psi)
    return float(np.sum(np.abs(np.diff(psi))))


def _steered(signals: Signals, settings: Settings, first: int, last: int) -> tuple[float, float]:
    """Shares of some rows in which the steering is to either side; one where it is not known."""
    if signals.steer is None:
        return 1.0, 0.0
    angle = signals.steer[first : last + 1]
    return float(np.mean(angle > settings.order)), float(np.mean(angle < -settings.order))


def rest_in(signals: Signals, settings: Settings, taken: list[Span]) -> list[Span]:
    """What is left, by speed and push."""
    code = _codes(signals, settings)
    turning = turning_rows(signals.t, signals.r, window_of(settings), settings)
    swing = max(1, round(settings.piece * window_of(settings) / signals.interval))
    turning = np.asarray(ndimage.binary_closing(turning, np.ones(swing)), bool)
    free = np.ones(signals.t.shape, bool)
    for span in taken:
        free[span.first : span.last + 1] = False
        # What is left of the turning belongs to what turned the vessel, not to a straight run.
        calm = np.flatnonzero(~turning[span.last + 1 :])
        free[span.last + 1 : span.last + 1 + (int(calm[0]) if calm.size else 0)] = False
    edges = np.flatnonzero(np.diff(np.where(free & signals.known, code, -1))) + 1
    edges = np.unique([0, *edges, *signals.breaks, len(code)])
    spans = []
    for first, stop in zip(edges[:-1], edges[1:], strict=True):
        long = signals.t[stop - 1] - signals.t[first] >= settings.piece * window_of(settings)
        if free[first] and signals.known[first] and long:
            kind, why, manoeuvre = _RESTS[code[first]]
            spans.append(Span(kind, int(first), int(stop - 1), why, manoeuvre))
    return spans


_RESTS = (
    ("straight", "the vessel moves and does not turn", "straight"),
    ("station", "the vessel hardly moves", "unknown"),
    ("coasting", "the vessel moves without push", "unknown"),
    ("unknown", "the vessel is pushed astern while it moves ahead", "stopping"),
)


def _codes(signals: Signals, settings: Settings) -> np.ndarray:
    """The index into `_RESTS` of every row. Push is that of the orders, else as executed."""
    code = np.zeros(signals.t.shape, int)
    drive = signals.throttle
    if drive is None and signals.drive is not None:
        count = 2 * hold_rows(signals, settings) + 1
        drive = ndimage.median_filter(signals.drive, count, mode="nearest")
    if drive is not None:
        idle = max(settings.idle, _NOISE * white_noise(drive))
        code[np.abs(drive) <= idle] = 2
        code[(drive < -idle) & signals.ahead] = 3
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
