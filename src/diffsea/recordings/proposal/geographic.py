"""Latitude and longitude among the columns, and the positions in metres they stand for."""

import numpy as np

from diffsea.recordings.geodesy import local_position
from diffsea.recordings.proposal.clock import Record
from diffsea.recordings.proposal.names import Suggestion


_NAMED = 0.5  # weight of a label above which a name is believed
_WIDEST = 2.0  # deg that a run may span


def geographic(
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


def in_metres(record: Record, place: tuple[str, str] | None, origin: tuple[float, float]) -> Record:
    """The record with latitude and longitude (deg) replaced by metres north and east."""
    if place is None or not set(place) <= set(record.columns):
        return record
    latitude, longitude = (np.radians(record.columns[name]) for name in place)
    north, east = local_position(
        latitude, longitude, (float(np.radians(origin[0])), float(np.radians(origin[1])))
    )
    return Record(record.t, record.columns | {place[0]: north, place[1]: east})
