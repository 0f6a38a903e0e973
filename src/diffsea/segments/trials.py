"""Trials recognised by their orders: zig-zags and turns under one held angle, and their onsets.

Orders show in the commanded steering, where that was recorded: actuators that are slow beside
the legs of a zig-zag hold nothing. When they were *executed* is then read from the executed
angle, so that a lag or a delay moves the onset.
"""

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from diffsea.metrics import recognise_trial
from diffsea.metrics.orders import (
    Orders,
    Plateau,
    alternating_chains,
    departure_row,
    find_plateaus,
    find_swings,
    last_row_before_move,
)
from diffsea.segments.signals import Signals
from diffsea.segments.spans import (
    ONSET_SCATTER,
    ONSET_SHARE,
    SegmentSettings,
    Span,
    approach_row,
    plateau_rows,
    robust_scatter,
)
from diffsea.statistics import noise_scale


def find_trials(signals: Signals, settings: SegmentSettings) -> list[Span]:
    """Zig-zags and turning circles."""
    angle = signals.orders
    if angle is None or signals.steer is None:
        return []
    least = max(settings.order, ONSET_SCATTER * noise_scale(angle))
    plateaus = find_plateaus(angle, plateau_rows(signals, settings), signals.breaks)
    chains = alternating_chains(plateaus, signals.t, least)
    found = _trials_among(signals, settings, chains)
    if signals.commanded is not None:
        return found
    swings = alternating_chains(find_swings(angle, least, signals.breaks), signals.t, least)
    more = _trials_among(signals, settings, [chain for chain in swings if len(chain) > 1])
    apart = [m for m in more if all(m.last < f.first or m.first > f.last for f in found)]
    return [*found, *apart]


def _trials_among(
    signals: Signals, settings: SegmentSettings, chains: Iterable[list[Plateau]]
) -> list[Span]:
    parts = (part for chain in chains for part in _without_turns(signals, settings, chain))
    trials = (_recognised_trial(signals, settings, part) for part in parts)
    return [span for span in trials if span is not None]


def _without_turns(
    signals: Signals, settings: SegmentSettings, chain: list[Plateau]
) -> Iterator[tuple[Plateau, ...]]:
    """The parts of a chain between its full turns, each of which is a trial of its own."""
    legs: list[Plateau] = []
    for plateau in chain:
        if abs(signals.psi[plateau.last] - signals.psi[plateau.first]) < settings.circle:
            legs.append(plateau)
            continue
        if legs:
            yield tuple(legs)
        legs = []
        yield (plateau,)
    if legs:
        yield tuple(legs)


def _recognised_trial(
    signals: Signals, settings: SegmentSettings, plateaus: tuple[Plateau, ...]
) -> Span | None:
    """The trial that was run with these orders, judged as the metrics judge a recording of it."""
    if 1 < len(plateaus) < settings.legs:
        return None
    first, last = switch_rows(signals, settings, plateaus[:1])[0], plateaus[-1].last
    # A slow rudder is executed long after the heading at which it was ordered.
    ordered = [order_row(signals, settings, plateau)[0] for plateau in plateaus]
    orders = Orders(
        times=tuple(float(signals.t[row]) for row in ordered),
        angles=tuple(plateau.level for plateau in plateaus),
        end=float(signals.t[last]),
    )
    reversals = np.abs(signals.psi[ordered[1:]] - signals.psi[first])
    if len(plateaus) > 1 and np.mean(reversals) < settings.reversal:
        return None
    rows = signals.rows(float(signals.t[first]) - settings.seconds, float(signals.t[last]))
    t = signals.t[rows]
    speed = np.full(t.shape, np.nan) if signals.speed is None else signals.speed[rows]
    excerpt = dataclasses.replace(
        signals.run.rows(np.arange(rows.start, rows.stop)),
        x=t * np.nan,
        y=t * np.nan,
        psi=signals.psi[rows],
        u=speed,
        v=0 * speed,
        r=signals.r[rows],
        commanded={},
        executed={"rudder": np.asarray(signals.steer)[rows]},
        extra={},
    )
    trial = recognise_trial(excerpt, orders)
    if trial.segment is None:
        return None
    many = f"{len(plateaus)} alternating orders"
    why = "one order was held throughout" if len(plateaus) == 1 else many
    return Span(trial.segment, first, last, why, trial.name, plateaus)


def switch_rows(
    signals: Signals, settings: SegmentSettings, plateaus: tuple[Plateau, ...]
) -> list[int]:
    """Rows in which the executed angle left for each of some plateaus."""
    return [
        leaving_row(signals, settings, plateau, first=plateau is plateaus[0])[0]
        for plateau in plateaus
    ]


def leaving_row(
    signals: Signals, settings: SegmentSettings, plateau: Plateau, first: bool = True
) -> tuple[int, float]:
    """Row in which the executed angle left for a plateau, and the threshold (rad) it passed.

    The threshold is three times the scatter of the steering before, but at least a twentieth of
    the step; of any but the first order only noise is scatter, as the steering moved before.
    """
    angle = np.asarray(signals.steer)
    ordered, began = order_row(signals, settings, plateau)
    if signals.commanded is None:
        return ordered, _angle_before(signals, settings, plateau, angle, began, first)[1]
    # The executed angle may still be on its way to the order before.
    row = max(ordered - 1, 0)
    before, threshold = _angle_before(signals, settings, plateau, angle, row, first)
    beyond = np.abs(angle[ordered : plateau.last + 2] - before) > threshold
    lasting = np.flatnonzero(beyond[:-1] & beyond[1:])
    return ordered + int(lasting[0]) if lasting.size else ordered, threshold


def order_row(signals: Signals, settings: SegmentSettings, plateau: Plateau) -> tuple[int, int]:
    """Row in which the order of a plateau was given, and the last row before it moved at all."""
    angle, count = np.asarray(signals.orders), plateau_rows(signals, settings)
    earliest = approach_row(signals, settings, plateau.first)
    began = last_row_before_move(angle, plateau, count, noise_scale(angle), earliest)
    before, threshold = _angle_before(signals, settings, plateau, angle, began, True)
    earliest = max(earliest, began - count)
    return departure_row(angle, before, threshold, plateau.first, earliest), began


def _angle_before(
    signals: Signals,
    settings: SegmentSettings,
    plateau: Plateau,
    angle: np.ndarray,
    row: int,
    first: bool,
) -> tuple[float, float]:
    """The angle (rad) before a plateau, up to a row, and the threshold of leaving it."""
    earliest = approach_row(signals, settings, plateau.first)
    last = angle[max(earliest, row + 1 - plateau_rows(signals, settings)) : row + 1]
    before = float(np.median(last)) if last.size else 0.0
    scatter = robust_scatter(angle[earliest : row + 1]) if first else noise_scale(angle)
    step = abs(plateau.level - before)
    return before, min(max(ONSET_SCATTER * scatter, ONSET_SHARE * step), 0.5 * step)
