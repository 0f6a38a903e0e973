"""Channels with clocks of their own, put on one clock without inventing data."""

import dataclasses

import numpy as np

from diffsea.errors import UserError
from diffsea.series import unwrap


_ANGLES = ("psi", "phi", "wind_direction")
_GAP = 3.0  # of a channel's own intervals: what lies between is not interpolated


@dataclasses.dataclass(frozen=True)
class Channel:
    """Samples of one channel, in SI units, with their own times (s, increasing)."""

    topic: str
    t: np.ndarray
    values: np.ndarray

    @property
    def known(self) -> "Channel":
        """The samples that have a value."""
        finite = np.isfinite(self.values)
        return dataclasses.replace(self, t=self.t[finite], values=self.values[finite])


def joined(
    channels: dict[str, Channel], rows: np.ndarray, turn: bool, where: str
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Every channel in the rows of one clock (s, increasing), and notes on what that cost.

    Motion: a sample has its value in one row, the nearest, where it is moved to the row's
    instant along the straight line to its neighbour; other rows stay NaN. So a slow sensor
    counts as often as it measured. Across more than three of a channel's own intervals, and
    beyond its ends, there is no line, and a sample that only such rows surround is left out.
    Actuation holds from its time stamp on. With `turn`, u and v are velocities north and east
    and are turned into body axes by the heading, interpolated in the same way.

    Raises `UserError`, beginning with `where`, for a channel that shares no time with the rows.
    """
    _check_overlap(channels, rows, where)
    values, notes = {}, []
    for name, channel in channels.items():
        if name.startswith(("cmd_", "exec_")):
            values[name] = _held(channel.known, rows)
            continue
        values[name], lost = _marked(_continuous(name, channel), rows)
        if lost:
            notes.append(f"{name}: {lost} samples beside gaps of the clocks are left out")
    if "wind_direction" in values:
        values["wind_direction"] = values["wind_direction"] % (2 * np.pi)
    if turn:
        heading, _ = _lines(_continuous("psi", channels["psi"]), rows)
        body = (values["u"] + 1j * values["v"]) * np.exp(-1j * heading)
        values |= {"u": body.real, "v": body.imag}
        notes.append("u and v turned from earth into body axes by the heading")
    return values, notes


def _check_overlap(channels: dict[str, Channel], rows: np.ndarray, where: str) -> None:
    for name, channel in channels.items():
        if channel.t[-1] < rows[0] or channel.t[0] > rows[-1]:
            raise UserError(
                f"{where}: the clocks do not overlap: the recording's runs from {rows[0]:.10g} s "
                f"to {rows[-1]:.10g} s, but {name} from {channel.topic} has samples from "
                f"{channel.t[0]:.10g} s to {channel.t[-1]:.10g} s; choose topics of one clock, in "
                'ROS bags perhaps with [file] stamps = "receive", or correct it by a delay'
            )


def _continuous(name: str, channel: Channel) -> Channel:
    known = channel.known
    if name not in _ANGLES:
        return known
    return dataclasses.replace(known, values=unwrap(known.values))


def _held(channel: Channel, rows: np.ndarray) -> np.ndarray:
    if not channel.t.size:
        return np.full(rows.shape, np.nan)
    last = np.searchsorted(channel.t, rows, side="right") - 1
    return np.where(last < 0, np.nan, channel.values[last.clip(0)])


def _lines(channel: Channel, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear interpolation in the rows, NaN where there is none, and where there is one."""
    t = channel.t
    if t.size < 2:
        return np.full(rows.shape, np.nan), np.zeros(rows.shape, dtype=bool)
    after = np.searchsorted(t, rows, side="left").clip(0, t.size - 1)
    before = (np.searchsorted(t, rows, side="right") - 1).clip(0, t.size - 1)
    longest = _GAP * float(np.median(np.diff(t))) * (1 + 1e-9)
    there = (rows >= t[0]) & (rows <= t[-1]) & (t[after] - t[before] <= longest)
    return np.where(there, np.interp(rows, t, channel.values), np.nan), there


def _marked(channel: Channel, rows: np.ndarray) -> tuple[np.ndarray, int]:
    """The channel in the row nearest to each sample, and how many samples have no such row."""
    line, there = _lines(channel, rows)
    after = np.searchsorted(rows, channel.t, side="left")
    before = np.searchsorted(rows, channel.t, side="right") - 1

    def distance(index: np.ndarray) -> np.ndarray:
        inside = index.clip(0, rows.size - 1)
        usable = (index == inside) & there[inside]
        return np.where(usable, np.abs(rows[inside] - channel.t), np.inf)

    ahead, behind = distance(after), distance(before)
    nearest = np.where(ahead < behind, after, before)[np.isfinite(np.minimum(ahead, behind))]
    marked = np.zeros(rows.shape, dtype=bool)
    marked[nearest] = True
    within = (channel.t >= rows[0]) & (channel.t <= rows[-1])
    lost = np.sum(within & ~np.isfinite(np.minimum(ahead, behind)))
    return np.where(marked, line, np.nan), int(lost)
