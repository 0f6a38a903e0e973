"""Trials told by their orders: zig-zags and turns under one held angle, and their onsets.

Orders show in the commanded steering, where that was recorded: actuators that are slow beside
the legs of a zig-zag hold nothing. When they were *executed* is then read from the executed
angle, so that a lag or a delay moves the onset.
"""

from collections.abc import Iterator

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
from diffsea.segments.settings import Settings
from diffsea.segments.signals import Samples, Signals
from diffsea.segments.spans import (
    NOISE,
    ONSET,
    Span,
    approach_row,
    hold_rows,
    scatter_of,
    window_of,
)
from diffsea.statistics import noise_scale
from diffsea.trajectory import Trajectory


def trials_in(signals: Signals, settings: Settings) -> list[Span]:
    """Zig-zags and turning circles."""
    angle = signals.orders
    if angle is None or signals.steer is None:
        return []
    least = max(settings.order, NOISE * noise_scale(angle))
    holds = find_plateaus(angle, hold_rows(signals, settings), signals.breaks)
    found = _named(signals, settings, alternating_chains(holds, signals.t, least))
    if signals.commanded is not None:
        return found
    swings = alternating_chains(find_swings(angle, least, signals.breaks), signals.t, least)
    more = _named(signals, settings, [chain for chain in swings if len(chain) > 1])
    apart = [m for m in more if all(m.last < f.first or m.first > f.last for f in found)]
    return [*found, *apart]


def _named(signals: Signals, settings: Settings, found: list[list[Plateau]]) -> list[Span]:
    parts = (part for chain in found for part in _parted(signals, settings, chain))
    trials = (_trial(signals, settings, part) for part in parts)
    return [span for span in trials if span is not None]


def _parted(
    signals: Signals, settings: Settings, chain: list[Plateau]
) -> Iterator[tuple[Plateau, ...]]:
    """A chain without its full turns, each of which is a trial of its own."""
    legs: list[Plateau] = []
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


def _trial(signals: Signals, settings: Settings, holds: tuple[Plateau, ...]) -> Span | None:
    if 1 < len(holds) < settings.legs:
        return None
    first, last = switches_of(signals, settings, holds[:1])[0], holds[-1].last
    # A slow rudder is executed long after the heading at which it was ordered.
    ordered = [given(signals, settings, hold)[0] for hold in holds]
    orders = Orders(
        times=tuple(float(signals.t[row]) for row in ordered),
        angles=tuple(hold.level for hold in holds),
        end=float(signals.t[last]),
        channel=signals.channel,
    )
    reversals = np.abs(signals.psi[ordered[1:]] - signals.psi[first])
    if len(holds) > 1 and np.mean(reversals) < settings.reversal:
        return None
    trial = recognise_trial(_excerpt(signals, settings, first, last), orders)
    if trial.segment is None:
        return None
    many = f"{len(holds)} alternating orders"
    why = "one order was held throughout" if len(holds) == 1 else many
    return Span(trial.segment, first, last, why, trial.name, holds)


def _excerpt(signals: Signals, settings: Settings, first: int, last: int) -> Trajectory:
    """The approach to a trial and the trial, complete as the metrics want it."""
    before = float(signals.t[first]) - window_of(settings)
    rows = signals.rows(before, float(signals.t[last]))
    t = signals.t[rows]
    speed = np.full(t.shape, np.nan) if signals.speed is None else signals.speed[rows]
    return Trajectory(
        t=t, x=t * np.nan, y=t * np.nan, psi=signals.psi[rows], u=speed, v=0 * speed,
        r=signals.r[rows], commanded={}, executed={"rudder": np.asarray(signals.steer)[rows]},
        extra={}, valid=np.ones(t.shape, bool),
    )  # fmt: skip


def switches_of(signals: Signals, settings: Settings, holds: tuple[Plateau, ...]) -> list[int]:
    """Rows in which the executed angle left for each of some holds."""
    return [leaving(signals, settings, hold, first=hold is holds[0])[0] for hold in holds]


def leaving(
    signals: Signals, settings: Settings, hold: Plateau, first: bool = True
) -> tuple[int, float]:
    """Row in which the executed angle left for a hold, and the threshold (rad) it passed.

    The threshold is three times the scatter of the steering before, but at least a twentieth of
    the step; of any but the first order only noise is scatter, as the steering moved before.
    """
    angle = np.asarray(signals.steer)
    ordered, began = given(signals, settings, hold)
    if signals.commanded is None:
        before, threshold = _before(signals, settings, hold, angle, began, first)
        return ordered, threshold
    # The executed angle may still be on its way to the order before.
    before, threshold = _before(signals, settings, hold, angle, max(ordered - 1, 0), first)
    beyond = np.abs(angle[ordered : hold.last + 2] - before) > threshold
    lasting = np.flatnonzero(beyond[:-1] & beyond[1:])
    return ordered + int(lasting[0]) if lasting.size else ordered, threshold


def _before(
    signals: Signals, settings: Settings, hold: Plateau, angle: Samples, row: int, first: bool
) -> tuple[float, float]:
    """The angle (rad) before a hold, up to a row, and the threshold of leaving it."""
    earliest = approach_row(signals, settings, hold.first)
    last = angle[max(earliest, row + 1 - hold_rows(signals, settings)) : row + 1]
    before = float(np.median(last)) if last.size else 0.0
    scatter = scatter_of(angle[earliest : row + 1]) if first else noise_scale(angle)
    step = abs(hold.level - before)
    return before, min(max(NOISE * scatter, ONSET * step), 0.5 * step)


def given(signals: Signals, settings: Settings, hold: Plateau) -> tuple[int, int]:
    """Row in which the order of a hold was given, and the last row before it moved at all."""
    angle, count = np.asarray(signals.orders), hold_rows(signals, settings)
    earliest = approach_row(signals, settings, hold.first)
    began = last_row_before_move(angle, hold, count, noise_scale(angle), earliest)
    before, threshold = _before(signals, settings, hold, angle, began, True)
    return departure_row(angle, before, threshold, hold.first, max(earliest, began - count)), began
