"""Turning motion, by the moving average of yaw rate (after Gavrilin and Steen 2017).

They mark what exceeds 0.2 deg/s in a moving average over 30 s and merge what is less than
90 s apart, for one ferry. Here these three follow from how fast the vessel turns.

What no order of a trial explains: turning motion, straight runs, coasting and rest.
"""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from diffsea.segments.settings import Settings
from diffsea.segments.signals import Signals
from diffsea.segments.spans import Span, hold_rows, window_of
from diffsea.statistics import noise_scale


_FASTEST = 0.995  # quantile of the averaged yaw rate that stands for the fastest turn
_SIGNIFICANT = 4.0  # standard deviations of noise that turning exceeds

Samples = Float[np.ndarray, "time"]


def own_window(t: Samples, r: Samples) -> float:
    """Time (s) in which the vessel turns by 90 deg at the fastest rate of the recording.

    At least ten time steps, at most a fifth of the recording.
    """
    step = float(np.median(np.diff(t)))
    rates = np.abs(_average(ndimage.median_filter(r, 5, mode="nearest"), 5))
    fastest = max(float(np.quantile(rates, _FASTEST)), 1e-12)
    return float(np.clip(math.pi / 2 / fastest, 10 * step, max((t[-1] - t[0]) / 5, 10 * step)))


def turning_motions(
    t: Samples,
    psi: Samples,
    r: Samples,
    counts: Bool[np.ndarray, "time"],
    window: float,
    settings: Settings,
) -> list[tuple[int, int]]:
    """First and last rows of every turning motion.

    Yaw rate averaged over a part of the window exceeds a part of the fastest rate, and four
    standard deviations of its own noise; pieces nearer than the window are merged, and those
    stay in which the heading changes by `settings.least_turn`. Only rows that count do: a vessel
    that drifts turns too.
    """
    turning = turning_rows(t, r, window, settings) & counts
    pieces: list[tuple[int, int]] = []
    numbers, number = ndimage.label(turning)
    for (rows,) in ndimage.find_objects(numbers, number):
        if pieces and t[rows.start] - t[pieces[-1][1]] < settings.merging * window:
            pieces[-1] = (pieces[-1][0], rows.stop - 1)
        else:
            pieces.append((rows.start, rows.stop - 1))
    return [
        (first, last)
        for first, last in pieces
        if np.ptp(psi[first : last + 1]) >= settings.least_turn
    ]


def turning_rows(
    t: Samples, r: Samples, window: float, settings: Settings
) -> Bool[np.ndarray, "time"]:
    """Where yaw rate, averaged over a part of the window, is that of turning."""
    count = max(1, round(settings.averaging * window / float(np.median(np.diff(t)))))
    noise = noise_scale(r) / math.sqrt(count)
    return np.abs(_average(r, count)) > max(turning_rate(window, settings), _SIGNIFICANT * noise)


def turning_rate(window: float, settings: Settings) -> float:
    """Yaw rate (rad/s) above which a vessel of this window is turning."""
    return settings.turning_share * math.pi / 2 / window


def _average(values: Samples, count: int) -> Samples:
    return ndimage.uniform_filter1d(values, count, mode="nearest")


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
        idle = max(settings.idle, _NOISE * noise_scale(drive))
        code[np.abs(drive) <= idle] = 2
        code[(drive < -idle) & signals.ahead] = 3
    code[~_moving(signals, settings)] = 1
    return code


def _moving(signals: Signals, settings: Settings) -> np.ndarray:
    """Rows in which the vessel moves; a speed that only hovers about the limit does not count."""
    if signals.speed is None:
        return np.ones(signals.t.shape, bool)
    limit = settings.still * float(np.quantile(signals.speed, 0.98))
    limit = max(limit, 3 * noise_scale(signals.speed))
    stretches, number = ndimage.label(signals.speed > limit)
    clear = np.unique(stretches[signals.speed > 1.5 * limit])
    return np.isin(stretches, clear[clear > 0])
