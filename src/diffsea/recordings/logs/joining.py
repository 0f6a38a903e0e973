"""Channels with clocks of their own, put on one clock without inventing data."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from diffsea.errors import UserError
from diffsea.recordings.mappings import ACTUATOR_PREFIXES
from diffsea.series import between_samples, hold_at, median_interval, unwrap
from diffsea.trajectory import Samples


_ANGLES = ("psi", "phi", "wind_direction")
_BRIDGED_INTERVALS = 3.0  # of a channel's own: a straight line says little across more

Rows = Float[np.ndarray, "row"]  # the recording's, in s, or values in them


@dataclasses.dataclass(frozen=True)
class LogChannel:
    """Samples of one channel, in SI units, with their own times (s, increasing)."""

    topic: str
    t: Samples
    values: Samples


def join_channels(
    channels: dict[str, LogChannel], rows: Rows, turn: bool, where: str
) -> tuple[dict[str, Rows], list[str]]:
    """Every channel in the rows of one clock (s, increasing), and notes on what that cost.

    Motion: a sample has its value in one row, the nearest, where it is moved to the row's
    instant along the straight line to its neighbour; other rows stay NaN. So a slow sensor
    counts as often as it measured. Across more than three of a channel's own intervals, and
    beyond its ends, there is no line, and a sample that only such rows surround is left out.
    Actuation holds from its time stamp on. With `turn`, u and v are velocities north and east
    and are turned into body axes by the heading, interpolated in the same way.

    Raises `UserError`, beginning with `where`, for a channel that shares no time with the rows.
    """
    values, notes = {}, []
    lines: dict[str, Rows] = {}
    for name, channel in channels.items():
        _check_overlap(name, channel, rows, where)
    for name, channel in channels.items():
        finite = np.isfinite(channel.values)
        t, known = channel.t[finite], channel.values[finite]
        if name.startswith(ACTUATOR_PREFIXES):
            values[name] = hold_at(t, known, rows)
            continue
        lines[name], there = _straight_lines(t, unwrap(known) if name in _ANGLES else known, rows)
        nearest, lost = _nearest_rows(t, rows, there)
        values[name] = np.where(nearest, lines[name], np.nan)
        if lost:
            notes.append(f"{name}: {lost} samples beside gaps of the clocks are left out")
    if "wind_direction" in values:
        values["wind_direction"] = values["wind_direction"] % (2 * np.pi)
    if turn:
        body = (values["u"] + 1j * values["v"]) * np.exp(-1j * lines["psi"])
        values |= {"u": body.real, "v": body.imag}
        notes.append("u and v turned from earth into body axes by the heading")
    return values, notes


def _check_overlap(name: str, channel: LogChannel, rows: Rows, where: str) -> None:
    if channel.t[-1] < rows[0] or channel.t[0] > rows[-1]:
        raise UserError(
            f"{where}: the clocks do not overlap: the recording's runs from {rows[0]:.10g} s "
            f"to {rows[-1]:.10g} s, but {name} from {channel.topic} has samples from "
            f"{channel.t[0]:.10g} s to {channel.t[-1]:.10g} s; choose topics of one clock, in "
            'ROS bags perhaps with [file] stamps = "receive", or correct it by a delay'
        )


def _straight_lines(
    t: Samples, values: Samples, rows: Rows
) -> tuple[Rows, Bool[np.ndarray, "row"]]:
    """Linear interpolation in the rows, NaN where there is none, and where there is one."""
    if t.size < 2:
        return np.full(rows.shape, np.nan), np.zeros(rows.shape, dtype=bool)
    longest = _BRIDGED_INTERVALS * median_interval(t) * (1 + 1e-9)
    there = between_samples(t, rows, longest)
    return np.where(there, np.interp(rows, t, values), np.nan), there


def _nearest_rows(
    t: Samples, rows: Rows, usable: Bool[np.ndarray, "row"]
) -> tuple[Bool[np.ndarray, "row"], int]:
    """The usable rows that are nearest to a sample on either side, and how many have none."""
    after = np.searchsorted(rows, t, side="left")
    before = np.searchsorted(rows, t, side="right") - 1

    def distance(index: np.ndarray) -> Samples:
        inside = index.clip(0, rows.size - 1)
        return np.where((index == inside) & usable[inside], np.abs(rows[inside] - t), np.inf)

    ahead, behind = distance(after), distance(before)
    reached = np.isfinite(np.minimum(ahead, behind))
    nearest = np.zeros(rows.shape, dtype=bool)
    nearest[np.where(ahead < behind, after, before)[reached]] = True
    within = (t >= rows[0]) & (t <= rows[-1])
    return nearest, int(np.sum(within & ~reached))
