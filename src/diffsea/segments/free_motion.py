"""What no order of a trial explains: turning motion, straight runs, coasting and rest.

Turning is found by the moving average of yaw rate, after Gavrilin and Steen (2017). They mark
what exceeds 0.2 deg/s in a moving average over 30 s and merge what is less than 90 s apart, for
one ferry. Here these three follow from how fast the vessel turns.
"""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int
from scipy import ndimage

from diffsea.segments.signals import Signals
from diffsea.segments.spans import SegmentSettings, Span, plateau_rows
from diffsea.series import median_interval, stretches
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples


_FASTEST = 0.995  # quantile of the averaged yaw rate that stands for the fastest turn
_SIGNIFICANT = 4.0  # standard deviations of noise that turning exceeds
_NO_PUSH = 3.0  # standard deviations of noise: less push than this is none
_STEERED_SHARE = 0.5  # of a turning motion must be steered to one side
_ONE_SIDED = 0.8  # of all turning goes to one side, to be a turn
_UNSTEERED = "heading changes without steering"
_STRAIGHT, _STATION, _COASTING, _STOPPING = range(4)
_RESTS = (
    ("straight", "the vessel moves and does not turn", "straight"),
    ("station", "the vessel hardly moves", "unknown"),
    ("coasting", "the vessel moves without push", "unknown"),
    ("unknown", "the vessel is pushed astern while it moves ahead", "stopping"),
)


def quarter_turn_window(t: Samples, r: Samples) -> float:
    """Time (s) in which the vessel turns by 90 deg at the fastest rate of the recording.

    At least ten time steps, at most a fifth of the recording.
    """
    step = median_interval(t)
    rates = ndimage.median_filter(r, 5, mode="nearest")
    rates = ndimage.uniform_filter1d(rates, 5, mode="nearest")
    fastest = max(float(np.quantile(np.abs(rates), _FASTEST)), 1e-12)
    return float(np.clip(math.pi / 2 / fastest, 10 * step, max((t[-1] - t[0]) / 5, 10 * step)))


def turning_motions(
    t: Samples,
    psi: Samples,
    r: Samples,
    counts: Bool[np.ndarray, "time"],
    settings: SegmentSettings,
) -> list[tuple[int, int]]:
    """First and last rows of every turning motion.

    Yaw rate averaged over a part of the window exceeds a part of the fastest rate, and four
    standard deviations of its own noise; pieces nearer than the window are merged, and those
    stay in which the heading changes by `settings.least_turn`. Only rows that count do: a vessel
    that drifts turns too.
    """
    turning = turning_rows(t, r, settings) & counts
    pieces: list[tuple[int, int]] = []
    for rows in stretches(turning):
        if pieces and t[rows.start] - t[pieces[-1][1]] < settings.merging * settings.seconds:
            pieces[-1] = (pieces[-1][0], rows.stop - 1)
        else:
            pieces.append((rows.start, rows.stop - 1))
    return [
        (first, last)
        for first, last in pieces
        if np.ptp(psi[first : last + 1]) >= settings.least_turn
    ]


def turning_rows(t: Samples, r: Samples, settings: SegmentSettings) -> Bool[np.ndarray, "time"]:
    """Where yaw rate, averaged over a part of the window, is that of turning."""
    count = max(1, round(settings.averaging * settings.seconds / median_interval(t)))
    noise = noise_scale(r) / math.sqrt(count)
    average = ndimage.uniform_filter1d(r, count, mode="nearest")
    return np.abs(average) > max(turning_rate(settings), _SIGNIFICANT * noise)


def turning_rate(settings: SegmentSettings) -> float:
    """Yaw rate (rad/s) above which a vessel of this window is turning."""
    return settings.turning_share * math.pi / 2 / settings.seconds


def find_turns(signals: Signals, settings: SegmentSettings, trials: list[Span]) -> list[Span]:
    """Turning motions outside the trials: turns steered to one side, and what cannot be named."""
    counts = signals.known & (signals.working | _is_moving(signals, settings))
    motions = turning_motions(signals.t, signals.psi, signals.r, counts, settings)
    spans = []
    for first, last in motions:
        for start, end, follows in _parts_outside(first, last, trials, signals.breaks):
            span = _turn(signals, settings, start, end)
            if span is not None and (span.steered or not follows):
                spans.append(span)
    return spans


def _parts_outside(
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


def _turn(signals: Signals, settings: SegmentSettings, first: int, last: int) -> Span | None:
    """The turning motion in some rows, without its slow ends."""
    rates = np.abs(signals.r[first : last + 1])
    fast = np.flatnonzero(rates > turning_rate(settings))
    if fast.size < 2:
        return None
    first, last = first + int(fast[0]), first + int(fast[-1])
    psi = signals.psi[first : last + 1]
    if np.ptp(psi) < settings.least_turn:
        return None
    starboard, port = 1.0, 0.0
    if signals.steer is not None:
        angle = signals.steer[first : last + 1]
        starboard = float(np.mean(angle > settings.order))
        port = float(np.mean(angle < -settings.order))
    if starboard + port < _STEERED_SHARE:
        return Span("unknown", first, last, _UNSTEERED, steered=False)
    # All turning, to either side, in steps that noise does not fill.
    step = settings.averaging * settings.seconds
    times = np.arange(signals.t[first], signals.t[last] + step, step)
    headings = np.interp(np.minimum(times, signals.t[last]), signals.t, signals.psi)
    one_sided = abs(psi[-1] - psi[0]) > _ONE_SIDED * float(np.sum(np.abs(np.diff(headings))))
    if one_sided and max(starboard, port) >= _STEERED_SHARE:
        return Span("turning", first, last, "yaw rate keeps its side, no order was held")
    return Span("unknown", first, last, "heading goes to and fro without the orders of a trial")


def find_rest(signals: Signals, settings: SegmentSettings, taken: list[Span]) -> list[Span]:
    """What is left, by speed and push."""
    shortest = settings.piece * settings.seconds
    turning = turning_rows(signals.t, signals.r, settings)
    swing = max(1, round(shortest / signals.interval))
    turning = np.asarray(ndimage.binary_closing(turning, np.ones(swing)), bool)
    free = np.ones(signals.t.shape, bool)
    for span in taken:
        free[span.first : span.last + 1] = False
        # What is left of the turning belongs to what turned the vessel, not to a straight run.
        calm = np.flatnonzero(~turning[span.last + 1 :])
        free[span.last + 1 : span.last + 1 + (int(calm[0]) if calm.size else 0)] = False
    free &= signals.known
    code = _rest_codes(signals, settings)
    changes = (np.flatnonzero(np.diff(np.where(free, code, -1))) + 1).tolist()
    edges = np.unique([0, *changes, *signals.breaks, len(code)])
    spans = []
    for first, stop in zip(edges[:-1], edges[1:], strict=True):
        if free[first] and signals.t[stop - 1] - signals.t[first] >= shortest:
            kind, why, manoeuvre = _RESTS[code[first]]
            spans.append(Span(kind, int(first), int(stop - 1), why, manoeuvre))
    return spans


def _rest_codes(signals: Signals, settings: SegmentSettings) -> Int[np.ndarray, "time"]:
    """The index into `_RESTS` of every row. Push is that of the orders, else as executed."""
    code = np.full(signals.t.shape, _STRAIGHT)
    drive = signals.throttle
    if drive is None and signals.drive is not None:
        count = 2 * plateau_rows(signals, settings) + 1
        drive = ndimage.median_filter(signals.drive, count, mode="nearest")
    if drive is not None:
        idle = max(settings.idle, _NO_PUSH * noise_scale(drive))
        code[np.abs(drive) <= idle] = _COASTING
        code[(drive < -idle) & signals.ahead] = _STOPPING
    code[~_is_moving(signals, settings)] = _STATION
    return code


def _is_moving(signals: Signals, settings: SegmentSettings) -> Bool[np.ndarray, "time"]:
    """Rows in which the vessel moves; a speed that only hovers about the limit does not count."""
    if signals.speed is None:
        return np.ones(signals.t.shape, bool)
    limit = settings.still * float(np.quantile(signals.speed, 0.98))
    limit = max(limit, 3 * noise_scale(signals.speed))
    moving = signals.speed > limit
    for rows in stretches(moving):
        moving[rows] = (signals.speed[rows] > 1.5 * limit).any()
    return moving
