"""Orders of thinned recordings: their means over the rows that are kept, and when each is given."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from diffsea.vessel.servo import ORDERS_PER_STEP


SEPARATION = 1e4  # s from run to run on the data set's clock, at least: beyond any delay
ORDERS_PER_ROW = ORDERS_PER_STEP - 1  # that a servo can begin to follow within one row


class GivenOrders(NamedTuple):
    """When a channel is given which orders: each holds until the next."""

    t: Float[np.ndarray, "order"]  # s since the run's first row
    value: Float[np.ndarray, "order"]
    within_rows: bool  # whether any is given between two rows


def means_of_rows(
    t: Float[np.ndarray, "time"], series: Float[np.ndarray, "time"], keep: Int[np.ndarray, "row"]
) -> Float[np.ndarray, "row"]:
    """Mean of a held series from each kept row to the next.

    The first value would be late by half a row wherever an order moves between rows, and the
    vessel would seem to act before it.
    """
    if len(keep) == len(t):
        return series
    length = np.append(np.diff(t), 0.0)
    total = np.add.reduceat(series * length, keep)
    span = np.add.reduceat(length, keep)
    return np.where(span > 0, total / np.where(span > 0, span, 1.0), series[keep])


def orders_given(
    t: Float[np.ndarray, "time"], series: Float[np.ndarray, "time"], keep: Int[np.ndarray, "row"]
) -> GivenOrders:
    """Orders as they change; where they do so three times in a kept row, means over its thirds."""
    changes = np.flatnonzero(np.append(True, np.diff(series) != 0))
    row = np.searchsorted(keep, changes, side="right") - 1
    busy = np.bincount(row, minlength=len(keep)) >= ORDERS_PER_ROW
    length = np.diff(np.append(keep, len(t)))
    thirds = [keep + length * part // ORDERS_PER_ROW for part in range(1, ORDERS_PER_ROW)]
    parts = np.unique(np.concatenate([keep, changes[~busy[row]], *(at[busy] for at in thirds)]))
    held = np.maximum.reduceat(series, parts) == np.minimum.reduceat(series, parts)
    values = np.where(held, series[parts], means_of_rows(t, series, parts))
    new = np.append(True, np.diff(values) != 0)
    at = parts[new]
    return GivenOrders(t[at] - t[0], values[new], not np.isin(at, keep).all())


def order_table(
    runs: Iterable[tuple[float, GivenOrders]], length: int
) -> tuple[Float[np.ndarray, "order"], Float[np.ndarray, "order"]]:
    """Times (s) and values of a channel's orders on a data set's clock, filled up to a length.

    Arguments:
        runs: when each begins on that clock, and what it was ordered; the first order of each is
            in force long before it, too.
    """
    times, values = [], []
    for begin, orders in runs:
        times.append(np.append(begin - 0.5 * SEPARATION, begin + orders.t))
        values.append(np.append(orders.value[0], orders.value))
    filled = np.concatenate(times)
    spare = length - len(filled)
    late = filled[-1] + SEPARATION * np.arange(1, spare + 1)
    return np.append(filled, late), np.pad(np.concatenate(values), (0, spare), mode="edge")
