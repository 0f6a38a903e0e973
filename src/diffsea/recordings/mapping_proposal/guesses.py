"""Latitude and longitude among the columns, and the positions in metres they stand for.

Guesses: one per channel, with how it is read, how sure that is, and why.
"""

import dataclasses
import math

import numpy as np

from diffsea.recordings.geodesy import local_position
from diffsea.recordings.mapping_proposal.clock import ColumnRecord, TimeColumn
from diffsea.recordings.mapping_proposal.names import Suggestion
from diffsea.recordings.mapping_proposal.readings import Hypothesis, HypothesisPrior, ratio_penalty
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis
from diffsea.recordings.mapping_proposal.units import SettledUnits
from diffsea.recordings.mapping_proposal.windows import ColumnWindows, relate_to_integral
from diffsea.recordings.mappings import UNITS, Column


_NAMED = 0.5  # weight of a label above which a name is believed
_WIDEST = 2.0  # deg that a run may span


def find_geographic(
    table: dict[str, np.ndarray], suggestions: dict[str, Suggestion]
) -> tuple[str, str] | None:
    """Columns of latitude and longitude in degrees, if the file has them and they move."""
    found = []
    for label, limit in (("lat", 90.0), ("lon", 180.0)):
        named = [name for name in table if suggestions[name].weights[label] > _NAMED]
        named = [n for n in named if 0 < np.nanmax(np.abs(table[n])) <= limit]
        named = [n for n in named if 0 < np.nanmax(table[n]) - np.nanmin(table[n]) < _WIDEST]
        if len(named) != 1:
            return None
        found += named
    return found[0], found[1]


def origin_of(table: dict[str, np.ndarray], place: tuple[str, str]) -> tuple[float, float]:
    """The first fix (deg) of a file, rounded to a millionth of a degree."""
    first = [table[name][np.isfinite(table[name])][0] for name in place]
    return round(float(first[0]), 6), round(float(first[1]), 6)


def with_metres(
    record: ColumnRecord, place: tuple[str, str] | None, origin: tuple[float, float]
) -> ColumnRecord:
    """The record with latitude and longitude (deg) replaced by metres north and east."""
    if place is None or not set(place) <= set(record.columns):
        return record
    latitude, longitude = (np.radians(record.columns[name]) for name in place)
    north, east = local_position(
        latitude, longitude, (float(np.radians(origin[0])), float(np.radians(origin[1])))
    )
    return ColumnRecord(record.t, record.columns | {place[0]: north, place[1]: east})


_CERTAIN = 0.999  # nothing is surer than the model of sensors that it rests on


@dataclasses.dataclass(frozen=True)
class ChannelGuess:
    """One proposed channel: how it is read, how sure that is (0 to 1), and why."""

    channel: str
    column: Column
    sure: float
    why: str


def hypothesis_columns(reading: Hypothesis) -> dict[str, str | None]:
    """The columns of a reading by channel."""
    return {channel: getattr(reading, channel) for channel in ("x", "y", "psi", "u", "v", "r")}


def probabilities(weighed: list[ScoredHypothesis]) -> np.ndarray:
    """Probabilities (N,) of readings that exclude one another."""
    odds = np.array([item.odds for item in weighed])
    weights = np.exp(odds - odds.max())
    return weights / weights.sum()


def _key(reading: Hypothesis, channel: str):
    """What a reading says of a channel, for the sum over all that say the same."""
    column = getattr(reading, channel)
    if column is None:
        return None
    return {
        "x": (column, reading.signs[0]),
        "y": (column, reading.signs[1]),
        "psi": (column, reading.period, reading.turn, reading.quarter),
        "u": (column, reading.speeds[0], reading.earth),
        "v": (column, reading.speeds[1], reading.earth),
        "r": (column, reading.spin),
    }[channel]


def motion_guesses(
    weighed: list[ScoredHypothesis],
    settled: SettledUnits,
    clock: TimeColumn,
    place: tuple[str, str] | None,
) -> list[ChannelGuess]:
    """Time and motion as the best reading has them, sure as all readings together make them.

    `place` names columns of latitude and longitude.
    """
    chances, best = probabilities(weighed), weighed[0]
    found = []
    if clock.column is not None:
        sure = min(clock.sure * settled.sure["t"], _CERTAIN)
        unit = None if settled.tick == "s" else settled.tick
        found.append(ChannelGuess("t", Column(clock.column, unit), sure, clock.why))
    columns = hypothesis_channels(best.reading, settled, place)
    for name, column in columns.items():
        channel = {"latitude": "x", "longitude": "y"}.get(name, name)
        key = _key(best.reading, channel)
        agree = [
            p for p, w in zip(chances, weighed, strict=True) if _key(w.reading, channel) == key
        ]
        sure = min(float(np.sum(agree)) * settled.sure[channel], _CERTAIN)
        found.append(ChannelGuess(name, column, sure, _why(best, channel)))
    return found


def hypothesis_channels(
    reading: Hypothesis, settled: SettledUnits, place: tuple[str, str] | None
) -> dict[str, Column]:
    """The channels of a mapping that reads motion so."""
    columns = {
        channel: _read_as(reading, channel, name, settled)
        for channel, name in hypothesis_columns(reading).items()
        if name is not None
    }
    if place is None or (reading.x, reading.y) != place:
        return columns
    fixes = {"latitude": Column(place[0], "deg"), "longitude": Column(place[1], "deg")}
    return fixes | {name: c for name, c in columns.items() if name not in ("x", "y")}


def _read_as(reading: Hypothesis, channel: str, name: str, settled: SettledUnits) -> Column:
    if channel in ("x", "y"):
        return Column(name, _plain(settled.x), reading.signs[channel == "y"])
    if channel == "psi":
        degrees = reading.period == 360.0
        size = 90.0 if degrees else 0.5 * math.pi
        # A quarter turn is added after the sign: sign * (number + offset).
        quarter = reading.quarter if reading.quarter < 3 else -1
        return Column(
            name, "deg" if degrees else "rad" if quarter else None, reading.turn,
            offset=reading.turn * quarter * size,
        )  # fmt: skip
    if channel == "r":
        return Column(name, _plain(settled.r), reading.spin)
    return Column(name, _plain(settled.u), reading.speeds[channel == "v"])


def _plain(unit: str) -> str | None:
    """None for a unit of SI, which needs no mention."""
    return None if not unit or UNITS[unit][1] == 1.0 else unit


def _why(best: ScoredHypothesis, channel: str) -> str:
    reading = best.reading
    if channel in ("psi", "r") and reading.psi and reading.r and best.yaw and best.yaw.evidence > 3:
        other = reading.r if channel == "psi" else reading.psi
        return f"heading is the integral of yaw rate: agrees with {other!r}"
    if channel != "r" and min(best.left) < 0.5:
        left = [max(100 * share, 0.01) for share in best.left]
        return (
            f"positions and velocities agree but for {left[0]:.2g} and {left[1]:.2g} % of "
            "squared displacement"
        )
    return "by its name"


def other_guesses(
    prior: HypothesisPrior, table, windows: ColumnWindows, used: set[str]
) -> list[ChannelGuess]:
    """Wind and roll, which nothing but their names and ranges tells."""
    found = []
    for channel in ("wind_speed", "wind_direction", "phi", "p"):
        named = [
            (prior.suggestions[n].weights[channel], n) for n in table if n not in used
            and prior.suggestions[n].weights[channel] > 0.5
        ]  # fmt: skip
        if not named:
            continue
        weight, name = max(named)
        unit, sure = _named_unit(prior.suggestions[name].unit, channel, table[name])
        if channel == "p" and prior.suggestions[name].unit not in UNITS:
            unit, sure = _roll_unit(found, name, windows)
        found.append(ChannelGuess(channel, Column(name, unit), weight * sure, "by its name"))
    return found


def _named_unit(stated: str, channel: str, values: np.ndarray) -> tuple[str | None, float]:
    if stated in UNITS:
        return _plain(stated), 0.97
    largest = float(np.nanmax(np.abs(values)))
    if channel in ("phi", "wind_direction"):
        limit = 1.0 if channel == "phi" else 2 * math.pi + 0.05
        return ("deg", 0.9) if largest > limit else (None, 0.6)
    return None, 0.7


def _roll_unit(
    found: list[ChannelGuess], name: str, windows: ColumnWindows
) -> tuple[str | None, float]:
    """The unit of roll rate, from its ratio to the change of roll."""
    roll = next((guess for guess in found if guess.channel == "phi"), None)
    if roll is None or not {name, roll.column.column} <= set(windows.records[0].columns):
        return None, 0.5
    relation = relate_to_integral(
        windows.increments(roll.column.column), windows.integrals(name), windows.duration
    )
    if relation.evidence < 3:
        return None, 0.5
    ratio = abs(relation.gain)
    degrees = ratio_penalty(ratio, 1.0, relation.error) < ratio_penalty(ratio, 57.3, relation.error)
    if roll.column.unit != "deg":
        degrees = not ratio_penalty(ratio, 1.0, relation.error) < 2.0
    return ("deg/s" if degrees else None), 0.9
