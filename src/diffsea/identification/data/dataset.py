"""Recordings laid end to end on one clock, ready for a filter to run along."""

import math
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.identification.data.batching import BatchLayout, batch_layout
from diffsea.identification.data.heel import predicted_heel
from diffsea.identification.expansion_points import TimeSpan, merge_spans
from diffsea.scales import time_scale
from diffsea.series import median_interval
from diffsea.simulation.actuation import over_rows, recorded_actuation
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


SEPARATION = 1e4  # s from run to run on the dataset's clock, at least: beyond any delay
LONGEST_STEP = 0.3  # of sqrt(L / g)
GAP = 3.0  # usual rows, or sqrt(L / g) where that is longer, without any: the filter begins anew
PADDING = 256  # rows are padded to a multiple, so that similar cases share a program


class Dataset(eqx.Module):
    """All rows of all runs. Row k covers the interval from its time to the next row's."""

    t: Float[Array, "row"]  # s on the dataset's clock
    run_time: Float[Array, "row"]  # s on the run's own clock
    dt: Float[Array, "row"]  # s
    measured: Float[Array, "row 6"]  # x, y, psi, u, v, r; zero where missing
    known: Bool[Array, "row 6"]
    run: Int[Array, "row"]
    starts: Bool[Array, "row"]  # first row of a run, or after a gap in it
    first: Float[Array, "row 6"]  # the first state since then, a rough guess
    heel: Float[Array, "row"]  # rad, as predicted from before; zero where none was recorded
    orders: dict[str, Float[Array, "row"]]
    executed: dict[str, Float[Array, "row"]]  # measured actuation; only channels that have it
    order_times: Float[Array, "order"]  # s, with one order long before each run
    order_values: dict[str, Float[Array, "order"]]
    lanes: BatchLayout
    runs: int = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    memory: int = eqx.field(static=True)  # rows that late channels may reach back

    @property
    def count(self) -> Float[Array, ""]:
        """Number of measured values."""
        return self.known.sum()

    @property
    def spans(self) -> list[TimeSpan]:
        """When anything was recorded, on the runs' clocks."""
        known = np.asarray(self.known).any(1)
        run, time = np.asarray(self.run)[known], np.asarray(self.run_time)[known]
        return merge_spans(
            (float(time[run == k].min()), float(time[run == k].max())) for k in set(run)
        )

    @property
    def shape(self) -> "DatasetShape":
        """The numbers that its compiled programs depend on."""
        return DatasetShape(self.t.size, self.runs, *self.lanes.shape)


def thinning_factor(vessel: Vessel, interval: float) -> int:
    """How many samples at `interval` s may be skipped without blurring the vessel's motion."""
    return max(
        1, int(LONGEST_STEP * time_scale(float(vessel.rigid_body.length)) / interval * (1 + 1e-9))
    )


class DatasetShape(NamedTuple):
    """What tapes must have in common to share compiled programs."""

    rows: int = 0
    runs: int = 0
    steps: int = 0
    lanes: int = 0

    def both(self, other: "DatasetShape") -> "DatasetShape":
        """The larger of each number."""
        return DatasetShape(*map(max, self, other))


ANY_SHAPE = DatasetShape()


def make_dataset(
    vessel: Vessel, recordings: list[Trajectory], least: DatasetShape = ANY_SHAPE
) -> Dataset:
    """Lay recordings on a dataset of at least this shape, spare rows and runs empty.

    Recordings sampled much faster than the vessel moves are thinned to 0.3 sqrt(L / g), all
    rows that hold a slowly sampled channel kept; over the rows between, orders and measured
    actuation are averaged.

    Raises:
        UserError: a recording lacks a channel's orders, or has fewer than ten rows.
    """
    pieces = [_piece(vessel, recording, k) for k, recording in enumerate(recordings)]
    apart = max(SEPARATION, *(2 * float(np.ptp(piece["t"])) for piece in pieces))
    for number, piece in enumerate(pieces, start=1):
        piece["t"] = piece["t"] + apart * number
    longest = max(float(np.median(piece["dt"][:-1])) for piece in pieces)
    substeps = max(
        1, math.ceil(longest / (LONGEST_STEP * time_scale(float(vessel.rigid_body.length))) - 1e-9)
    )
    columns = {key: np.concatenate([piece[key] for piece in pieces]) for key in _ROWS}
    used = len(columns["t"])
    spare = max(least.rows, used + PADDING - used % PADDING) - used
    runs = max(least.runs, len(recordings))
    padded = {key: _padded(column, spare) for key, column in columns.items()}
    channels = vessel.channels
    measured = [c for c in channels if all(c in piece["executed"] for piece in pieces)]
    order_times, order_values = _order_table(pieces, channels, used + spare + runs)

    def gathered(kind: str, names: list[str] | tuple[str, ...]) -> dict[str, np.ndarray]:
        return {
            c: _padded(np.concatenate([piece[kind][c] for piece in pieces]), spare) for c in names
        }

    return Dataset(
        **padded,
        orders=gathered("orders", channels),
        executed=gathered("executed", measured),
        order_times=order_times,
        order_values=order_values,
        lanes=batch_layout(columns["run"], used + spare, (least.steps, least.lanes)),
        runs=runs,
        substeps=substeps,
        memory=_memory(vessel, longest),
    )


_ROWS = ("t", "run_time", "dt", "measured", "known", "run", "starts", "first", "heel")


def _memory(vessel: Vessel, longest: float) -> int:
    """Rows within 1.5 sqrt(L / g): eight or sixteen, so that programs are shared."""
    return 8 if 1.5 * time_scale(float(vessel.rigid_body.length)) <= 8 * longest else 16


def _padded(column: np.ndarray, spare: int) -> np.ndarray:
    """Spare rows at the end: nothing measured, no time passing."""
    if column.dtype == bool:
        return np.concatenate([column, np.zeros((spare, *column.shape[1:]), bool)])
    last = np.zeros_like(column[-1:]) if column.ndim > 1 else column[-1:]
    return np.concatenate([column, np.repeat(last, spare, axis=0)])


def _piece(vessel: Vessel, recording: Trajectory, number: int) -> dict:
    run = recording.counted()
    t, motion = run.t, np.stack([*run.motion.values()], -1)
    if len(t) < 10:
        raise UserError(
            f"{recording.name}: {len(t)} samples are too few to estimate anything; record at "
            "least ten, better a whole manoeuvre"
        )
    keep = _kept(np.isfinite(motion), thinning_factor(vessel, median_interval(t)))
    if len(keep) < 10:
        raise UserError(
            f"{recording.name}: {t[-1] - t[0]:.3g} s are too short to estimate anything, "
            f"{len(keep)} steps of the vessel's own time; record a whole manoeuvre"
        )
    every, t, motion = t, t[keep], motion[keep]
    known = np.isfinite(motion)
    if not known.any():
        raise UserError(f"{recording.name}: no motion channel has any value")
    starts = _begins(t, time_scale(float(vessel.rigid_body.length)))
    dt = np.where(np.append(starts[1:], True), 0.0, np.append(np.diff(t), 0.0))
    orders, executed = recorded_actuation(vessel, recording)
    executed = over_rows(recording, executed)
    return {
        "t": t - t[0],
        "run_time": t,
        "dt": dt,
        "measured": np.where(known, motion, 0.0),
        "known": known,
        "run": np.full(len(t), number),
        "starts": starts,
        "first": _first_states(t, motion, starts),
        "heel": _means(every, predicted_heel(recording), keep),
        "orders": {c: _means(every, series, keep) for c, series in orders.items()},
        "executed": {c: _means(every, series, keep) for c, series in executed.items()},
    }


def _means(t: np.ndarray, series: np.ndarray, keep: np.ndarray) -> np.ndarray:
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


def _kept(known: np.ndarray, every: int) -> np.ndarray:
    """Rows to keep: one in `every`, and those with a value of a channel that is sampled slowly."""
    rows = np.zeros(len(known), bool)
    rows[::every] = True
    slow = (known.sum(0) * every < 1.5 * len(known)) & (every > 1)
    return np.flatnonzero(rows | known[:, slow].any(1))


def _begins(t: np.ndarray, natural: float) -> np.ndarray:
    """The first row, and rows after a gap so long that no integration should bridge it."""
    steps = np.diff(t)
    return np.append(True, steps > GAP * max(natural, float(np.median(steps))))


def _first_states(t: np.ndarray, motion: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """The first state since the last start, for every row."""
    part = np.cumsum(starts) - 1
    firsts = [_first_state(t[part == k], motion[part == k]) for k in range(part[-1] + 1)]
    return np.stack(firsts)[part]


def _first_state(t: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """First finite value of each channel; speeds that are not measured, from differences.

    Without a heading, ahead is where the positions go.
    """
    first = np.zeros(6)
    for k in range(6):
        finite = np.flatnonzero(np.isfinite(motion[:, k]))
        first[k] = motion[finite[0], k] if len(finite) else 0.0
    unknown = [not np.isfinite(motion[:, k]).any() for k in range(6)]
    if unknown[3] and not (unknown[0] or unknown[1]):
        north, east = (_first_slope(t, motion[:, k]) for k in (0, 1))
        first[2] = np.arctan2(east, north) if unknown[2] else first[2]
        first[3] = np.cos(first[2]) * north + np.sin(first[2]) * east
        first[4] = np.cos(first[2]) * east - np.sin(first[2]) * north
    return first


def _first_slope(t: np.ndarray, values: np.ndarray) -> float:
    finite = np.flatnonzero(np.isfinite(values))[:20]
    if len(finite) < 2:
        return 0.0
    return float(np.polyfit(t[finite] - t[finite[0]], values[finite], 1)[0])


def _order_table(
    pieces: list[dict], channels: tuple[str, ...], length: int
) -> tuple[np.ndarray, dict]:
    times = [np.append(p["t"][0] - 0.5 * SEPARATION, p["t"]) for p in pieces]
    values = {
        c: np.concatenate([np.append(p["orders"][c][0], p["orders"][c]) for p in pieces])
        for c in channels
    }
    filled = np.concatenate(times)
    spare = length - len(filled)
    late = filled[-1] + SEPARATION * np.arange(1, spare + 1)
    return np.append(filled, late), {
        c: np.pad(v, (0, spare), mode="edge") for c, v in values.items()
    }
