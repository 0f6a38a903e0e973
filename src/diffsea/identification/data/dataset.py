# pyright: reportArgumentType=false
# A data set is of NumPy where it is made, of JAX within programs.
"""The data set: recordings laid end to end on one clock, ready for a filter to run along."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.identification.data.batching import BatchLayout, batch_layout
from diffsea.identification.data.heel import predicted_heel
from diffsea.identification.data.orders import (
    ORDERS_PER_ROW,
    SEPARATION,
    GivenOrders,
    means_of_rows,
    order_table,
    orders_given,
)
from diffsea.scales import time_scale
from diffsea.series import median_interval
from diffsea.simulation.actuation import measured_disturbance, over_rows, recorded_actuation
from diffsea.trajectory import MOTION_CHANNELS, Trajectory
from diffsea.types import MeasuredDisturbance
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.coordinates import TimeSpan


STEP = 0.3  # of sqrt(L / g), that rows are thinned to: it blurs nothing of the motion
LONGEST_STEP = 0.45  # of sqrt(L / g), that is integrated in one: thinning comes as near as this
LONGEST_GAP = 3.0  # usual rows, or sqrt(L / g) where longer, without any: the filter begins anew
PADDING = 256  # rows are padded to a multiple, so that similar cases share a program
LEAST_ROWS = 10  # of a run: with fewer nothing can be estimated
LEAD_IN = 3.0  # sqrt(L / g) before each part, of which a delayed channel's first samples are
FIRST_VALUES = 20  # of a position, from which a first velocity is estimated


_PSI = MOTION_CHANNELS.index("psi")
_LATERAL = np.array([name not in ("x", "u") for name in MOTION_CHANNELS])


class DatasetShape(NamedTuple):
    """What data sets must have in common to share compiled programs."""

    rows: int = 0
    runs: int = 0
    steps: int = 0
    batches: int = 0
    orders_within_rows: bool = False

    def both(self, other: "DatasetShape") -> "DatasetShape":
        """The larger of each number."""
        return DatasetShape(*map(max, self, other))


ANY_SHAPE = DatasetShape()


class Dataset(eqx.Module):
    """All rows of all runs. Row k covers the interval from its time to the next row's."""

    t: Float[Array, "row"]  # s on the data set's clock
    run_time: Float[Array, "row"]  # s on the run's own clock
    dt: Float[Array, "row"]  # s
    measured: Float[Array, "row 6"]  # x, y, psi, u, v, r; zero where missing
    known: Bool[Array, "row 6"]
    heading: Float[Array, "row"]  # rad, as read last, whether or not it is known as a measurement
    heading_between: Float[Array, "row"]  # rad, on straight lines between the readings
    run: Int[Array, "row"]
    part: Int[Array, "row"]  # of a run without long gaps; its lead-in has no samples of that time
    starts: Bool[Array, "row"]  # first recorded row of a part
    first: Float[Array, "row 6"]  # the part's first state, a rough guess
    disturbance: MeasuredDisturbance  # heel as predicted from before
    orders: dict[str, Float[Array, "row"]]
    executed: dict[str, Float[Array, "row"]]  # measured actuation; only channels that have it
    order_times: dict[str, Float[Array, "order"]]  # s, with one order long before each run
    order_values: dict[str, Float[Array, "order"]]
    batches: BatchLayout
    runs: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    orders_within_rows: bool = eqx.field(static=True)  # whether any is given within a row

    @property
    def recorded_rows(self) -> Bool[np.ndarray, "row"]:
        """Which rows have any measurement; the others fill the data set up."""
        return np.count_nonzero(np.asarray(self.known), axis=1) > 0

    @property
    def lead_in(self) -> Bool[np.ndarray, "row"]:
        """Which rows come before the first recorded one of their part."""
        return np.cumsum(np.asarray(self.starts)) <= np.asarray(self.part)

    @property
    def shows_turning(self) -> Bool[Array, "run"]:
        """Which runs have any measurement that tells of drift, heading or turning."""
        lateral = jnp.any(self.known[:, _LATERAL], axis=1)
        return jnp.zeros(self.runs, bool).at[self.run].max(lateral)

    @property
    def straight_runs(self) -> int:
        """How many recorded runs tell nothing of it, and are taken as straight ahead."""
        shown = np.asarray(self.shows_turning)
        return sum(len(rows) > 0 and not shown[k] for k, rows in enumerate(self.rows_of_runs))

    @property
    def rows_of_runs(self) -> list[Int[np.ndarray, "own"]]:
        """Numbers of the recorded rows of each run, none of a spare one."""
        run, recorded = np.asarray(self.run), self.recorded_rows
        return [np.flatnonzero((run == number) & recorded) for number in range(self.runs)]

    def parts_of_runs(self, count: int) -> list[Int[np.ndarray, "_"]]:
        """Numbers of the recorded rows in each of so many parts of every run, those with any."""
        parts = [part for rows in self.rows_of_runs for part in np.array_split(rows, count)]
        return [part for part in parts if len(part)]

    @property
    def recorded_channels(self) -> Bool[np.ndarray, "6"]:
        """Which motion channels have any measurement."""
        return np.count_nonzero(np.asarray(self.known), axis=0) > 0

    @property
    def spans(self) -> list[TimeSpan]:
        """When anything was recorded, on the runs' clocks."""
        known = self.recorded_rows
        run, time = np.asarray(self.run)[known], np.asarray(self.run_time)[known]
        return merge_spans(
            (float(time[run == k].min()), float(time[run == k].max())) for k in set(run)
        )

    @property
    def shape(self) -> DatasetShape:
        """The numbers that its compiled programs depend on."""
        return DatasetShape(self.t.size, self.runs, *self.batches.shape, self.orders_within_rows)


def merge_spans(spans: Iterable[TimeSpan]) -> list[TimeSpan]:
    """Spans in the order of time, those that overlap made one."""
    out: list[TimeSpan] = []
    for start, end in sorted(spans):
        if out and start <= out[-1][1]:
            out[-1] = out[-1][0], max(out[-1][1], end)
        else:
            out.append((start, end))
    return out


def make_dataset(
    vessel: Vessel, recordings: Sequence[Trajectory], least: DatasetShape = ANY_SHAPE
) -> Dataset:
    """Lay recordings on a data set of at least this shape, spare rows and runs empty.

    Recordings sampled much faster than the vessel moves are thinned to about 0.3 sqrt(L / g), all
    rows that hold a slowly sampled channel kept, and a value of each other channel in every such
    time that has one; over the rows between, orders and measured
    actuation are averaged. A servo meets orders at their own times, as `orders_given` has them.

    Raises:
        UserError: a recording lacks a channel's orders, or has fewer than ten rows.
    """
    time = time_scale(float(vessel.rigid_body.length))
    runs = [_rows_of_run(vessel, recording, k) for k, recording in enumerate(recordings)]
    apart = max(SEPARATION, *(2 * float(np.ptp(run.columns["t"])) for run in runs))
    begins, parts = [apart * number for number in range(1, len(runs) + 1)], 0
    for begin, run in zip(begins, runs, strict=True):
        run.columns["t"] = run.columns["t"] + begin
        run.columns["part"] = run.columns["part"] + parts
        parts = int(run.columns["part"][-1]) + 1
    longest = max(float(np.median(run.columns["dt"][:-1])) for run in runs)
    used = sum(len(run.columns["t"]) for run in runs)
    spare = max(least.rows, used + PADDING - used % PADDING) - used
    count = max(least.runs, len(runs))

    def lay_out(columns: Iterable[np.ndarray]) -> np.ndarray:
        """One column of all runs, with spare rows: nothing measured, no time passing."""
        column = np.concatenate(list(columns))
        if column.dtype == bool:
            return np.concatenate([column, np.zeros((spare, *column.shape[1:]), bool)])
        last = np.zeros_like(column[-1:]) if column.ndim > 1 else column[-1:]
        return np.concatenate([column, np.repeat(last, spare, axis=0)])

    channels = vessel.channels
    measured = [c for c in channels if all(c in run.executed for run in runs)]
    room = ORDERS_PER_ROW * (used + spare) + count
    tables = {
        c: order_table(zip(begins, (run.given[c] for run in runs), strict=True), room)
        for c in channels
    }
    whole = np.concatenate([run.columns["run"] for run in runs])
    return Dataset(
        **{name: lay_out(run.columns[name] for run in runs) for name in runs[0].columns},
        disturbance=jax.tree.map(lambda *parts: lay_out(parts), *(run.disturbance for run in runs)),
        orders={c: lay_out(run.orders[c] for run in runs) for c in channels},
        executed={c: lay_out(run.executed[c] for run in runs) for c in measured},
        order_times={c: times for c, (times, _) in tables.items()},
        order_values={c: values for c, (_, values) in tables.items()},
        batches=batch_layout(whole, used + spare, (least.steps, least.batches)),
        runs=count,
        substeps=max(1, math.ceil(longest / (LONGEST_STEP * time) - 1e-9)),
        orders_within_rows=least.orders_within_rows
        or any(given.within_rows for run in runs for given in run.given.values()),
    )


class _RunRows(NamedTuple):
    """The rows of one run: columns of a `Dataset` by name, orders and actuation by channel."""

    columns: dict[str, np.ndarray]
    disturbance: MeasuredDisturbance
    orders: dict[str, Float[np.ndarray, "row"]]
    executed: dict[str, Float[np.ndarray, "row"]]
    given: dict[str, GivenOrders]


def _rows_of_run(vessel: Vessel, recording: Trajectory, number: int) -> _RunRows:
    run = recording.counted()
    t, motion = run.t, np.stack([*run.motion.values()], -1)
    if len(t) < LEAST_ROWS:
        raise UserError(
            f"{recording.name}: {len(t)} samples are too few to estimate anything; record at "
            "least ten, better a whole manoeuvre"
        )
    time = time_scale(float(vessel.rigid_body.length))
    every = _rows_in_one(median_interval(t) / time)
    keep = _rows_kept(np.isfinite(motion), every)
    if len(keep) < LEAST_ROWS:
        raise UserError(
            f"{recording.name}: {t[-1] - t[0]:.3g} s are too short to estimate anything, "
            f"{len(keep)} steps of the vessel's own time; record a whole manoeuvre"
        )
    all_times, t, motion = t, t[keep], motion[keep]
    known = np.isfinite(motion)
    if not known.any():
        raise UserError(f"{recording.name}: no motion channel has any value")
    # The first row, and rows after a gap so long that no integration should bridge it.
    steps = np.diff(t)
    starts = np.append(True, steps > LONGEST_GAP * max(time, float(np.median(steps))))
    part = np.cumsum(starts) - 1
    firsts = [_first_state(t[part == k], motion[part == k]) for k in range(part[-1] + 1)]
    orders, executed = recorded_actuation(vessel, recording)
    executed = over_rows(recording, orders, executed)
    row, ahead = _with_lead_ins(t, starts, LEAD_IN * time)
    recorded = ahead == 0
    steps = np.where(np.append(starts[1:], True), 0.0, np.append(steps, 0.0))[row]
    columns = {
        "t": t[row] - ahead - t[0],
        "run_time": t[row] - ahead,
        "dt": np.where(recorded, steps, ahead - np.append(ahead[1:], 0.0)),
        "measured": np.where(known[row] & recorded[:, None], motion[row], 0.0),
        "known": known[row] & recorded[:, None],
        "heading": held_headings(motion[:, _PSI], known[:, _PSI], starts)[row],
        "heading_between": _between_readings(t[row] - ahead, all_times, run.psi),
        "run": np.full(len(row), number),
        "part": part[row],
        "starts": starts[row] & recorded,
        "first": np.stack(firsts)[part[row]],
    }
    disturbance = dataclasses.replace(
        measured_disturbance(recording), heel=predicted_heel(recording)
    )
    return _RunRows(
        columns,
        jax.tree.map(lambda one: means_of_rows(all_times, one, keep)[row], disturbance),
        {c: means_of_rows(all_times, one, keep)[row] for c, one in orders.items()},
        {c: means_of_rows(all_times, one, keep)[row] for c, one in executed.items()},
        {c: orders_given(all_times, one, keep) for c, one in orders.items()},
    )


def held_headings(
    psi: Float[np.ndarray, "row"], known: Bool[np.ndarray, "row"], begins: Bool[np.ndarray, "row"]
) -> Float[np.ndarray, "row"]:
    """The heading (rad) that was read last in every row; before the first of a part, that one.

    `begins` are the first rows of parts. Zero where none is known.
    """
    rows = np.arange(psi.size)
    last = np.maximum.accumulate(np.where(known, rows, -1))
    following = np.minimum.accumulate(np.where(known, rows, rows.size - 1)[::-1])[::-1]
    first = np.maximum.accumulate(np.where(begins, rows, 0))
    return np.where(known, psi, 0.0)[np.where(last >= first, last, following)]


def _between_readings(
    t: Float[np.ndarray, "row"], read: Float[np.ndarray, "time"], psi: Float[np.ndarray, "time"]
) -> Float[np.ndarray, "row"]:
    """The heading (rad) at times t (s), on straight lines between readings; zero without any."""
    known = np.isfinite(psi)
    return np.interp(t, read[known], psi[known]) if known.any() else np.zeros(t.size)


def _with_lead_ins(
    t: Float[np.ndarray, "row"], starts: Bool[np.ndarray, "row"], seconds: float
) -> tuple[Int[np.ndarray, "longer"], Float[np.ndarray, "longer"]]:
    """Rows with so many seconds more before each start, spaced as rows are; none into the last row.

    The recorded row that each is a copy of, and how long (s) before it.
    """
    step = float(np.median(np.diff(t)))
    rows, ahead = [], []
    for first in np.flatnonzero(starts):
        room = seconds if first == 0 else min(seconds, t[first] - t[first - 1] - step)
        count = max(0, math.ceil(room / step - 1e-9))
        rows.append(np.full(count, first))
        ahead.append(step * np.arange(count, 0, -1))
    before = np.concatenate(rows)
    place = np.searchsorted(np.arange(len(t)), before)
    row = np.insert(np.arange(len(t)), place, before)
    return row, np.insert(np.zeros(len(t)), place, np.concatenate(ahead))


def _rows_kept(given: Bool[np.ndarray, "time 6"], every: int) -> Int[np.ndarray, "row"]:
    """One row in so many, and what channels would lose that have no value in each row.

    Of a channel that is sampled slowly all values; of another the first of each block of so many
    rows, which stands in another row where sensors write rows by turns.
    """
    rows = np.arange(len(given))
    keep = rows % every == 0
    if every == 1:
        return rows
    slow = given.sum(0) * every < 1.5 * len(given)
    keep |= given[:, slow].any(1)
    for channel in given.T:
        _, first = np.unique(rows[channel] // every, return_index=True)
        keep[rows[channel][first]] = True
    return np.flatnonzero(keep)


def _rows_in_one(step: float) -> int:
    """How many rows (each a `step` of sqrt(L / g)) make one that is nearest to `STEP`."""
    fewer = max(1, int(STEP / step * (1 + 1e-9)))
    more = (fewer + 1) * step
    return fewer + 1 if more <= LONGEST_STEP and more / STEP < STEP / (fewer * step) else fewer


def _first_state(
    t: Float[np.ndarray, "row"], motion: Float[np.ndarray, "row 6"]
) -> Float[np.ndarray, "6"]:
    """First finite value of each channel; speeds that are not measured, from differences.

    Without a heading, ahead is where the positions go.
    """
    finite = [np.flatnonzero(np.isfinite(motion[:, k])) for k in range(6)]
    first = np.array([motion[rows[0], k] if len(rows) else 0.0 for k, rows in enumerate(finite)])

    def first_slope(k: int) -> float:
        rows = finite[k][:FIRST_VALUES]
        if len(rows) < 2:
            return 0.0
        return float(np.polyfit(t[rows] - t[rows[0]], motion[rows, k], 1)[0])

    if len(finite[0]) and len(finite[1]) and not len(finite[3]):
        north, east = first_slope(0), first_slope(1)
        if not len(finite[2]):
            first[2] = np.arctan2(east, north)
        first[3] = np.cos(first[2]) * north + np.sin(first[2]) * east
        first[4] = np.cos(first[2]) * east - np.sin(first[2]) * north
    return first
