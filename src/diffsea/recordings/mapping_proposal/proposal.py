"""A mapping proposed for files that nobody has mapped: guessed, weighed, and written down."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.mapping_proposal.actuators import Actuator, find_actuators
from diffsea.recordings.mapping_proposal.clock import (
    Clock,
    Record,
    find_clock,
    record_of,
    stamped_clock,
)
from diffsea.recordings.mapping_proposal.guesses import (
    Guess,
    channels_read,
    columns_read,
    geographic,
    in_metres,
    motion_guesses,
    origin_of,
    other_guesses,
)
from diffsea.recordings.mapping_proposal.names import Suggestion, suggestion
from diffsea.recordings.mapping_proposal.readings import Convention, Prior, Reading, mirrored
from diffsea.recordings.mapping_proposal.search import Weighed, search
from diffsea.recordings.mapping_proposal.table_layout import Layout, columns_of, sniff
from diffsea.recordings.mapping_proposal.units import SettledUnits
from diffsea.recordings.mapping_proposal.windows import Windows, windows_of
from diffsea.recordings.mappings import Column
from diffsea.recordings.readers import read_recording
from diffsea.trajectory import Trajectory


_FILES = 6  # that the evidence is taken from
_ANSWERS = 3  # files that actuators are tried on
_FEWEST = 20  # rows
_NAMED = 0.55  # how sure a rudder must be to have a say in what is starboard
_TELLING = 0.5  # weight of "other" above which a name says that it is something else
# Log odds for a rudder, and for a pair of thrusters, that act the way their labels say.
_RUDDER, _THRUSTERS = math.log(0.75 / 0.25), math.log(0.95 / 0.05)


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What a proposal rests on, for the text that is written of it."""

    layout: Layout
    clock: Clock
    suggestions: dict[str, Suggestion]
    best: Weighed
    convention: Convention
    mirror: float  # probability that the whole record is mirrored
    guesses: tuple[Guess, ...]
    actuators: tuple[Actuator, ...]
    origin: tuple[float, float] | None  # deg, where positions are geographic
    constant: frozenset[str]


@dataclasses.dataclass(frozen=True)
class _Source:
    """Files of one layout, as they are before anything is decided."""

    paths: tuple[Path, ...]
    layout: Layout
    tables: tuple[dict[str, np.ndarray], ...]
    clock: Clock
    place: tuple[str, str] | None  # columns of latitude and longitude
    windows: Windows
    prior: Prior


def propose_evidence(paths: Sequence[Path]) -> Evidence:
    """What can be said of files of one layout.

    Raises `UserError` for files that are no tables of numbers, or that differ in columns.
    """
    source = _source(paths)
    weighed = search(source.windows, source.prior, source.clock, source.place)
    best = weighed[0]
    actuators = _actuators(source, best)
    weighed = _answered(weighed, best, actuators)
    if _hand(weighed[0].reading) != _hand(best.reading):
        actuators = [dataclasses.replace(a, push=-a.push) if a.turns else a for a in actuators]
    best, table = weighed[0], source.tables[0]
    settled = SettledUnits(source.prior, source.clock, best)
    guesses = motion_guesses(weighed, settled, source.clock, source.place)
    used = {guess.column.column for guess in guesses} | {a.column for a in actuators}
    guesses += other_guesses(source.prior, table, source.windows, used)
    geodetic = any(guess.channel == "latitude" for guess in guesses)
    return Evidence(
        layout=source.layout,
        clock=dataclasses.replace(source.clock, units={settled.tick: 1.0}, step=settled.step),
        suggestions=source.prior.suggestions,
        best=best,
        convention=source.prior.convention(best.reading),
        mirror=_mirror(weighed),
        guesses=tuple(guesses),
        actuators=tuple(actuators),
        origin=origin_of(table, source.place) if geodetic and source.place else None,
        constant=frozenset(n for n, v in table.items() if np.nanmax(v) == np.nanmin(v)),
    )


def _source(paths: Sequence[Path]) -> _Source:
    layout = sniff(paths[0])
    kept = _alike(paths, layout)
    tables = tuple(columns_of(path, layout) for path in kept)
    suggestions = {
        name: suggestion(name if layout.named else "", unit)
        for name, unit in zip(layout.names, layout.units, strict=True)
        if name
    }
    clock = find_clock(tables[0], suggestions) or stamped_clock(kept[0], layout)
    place = geographic(tables[0], suggestions)
    records = [record_of(table, clock) for table in tables]
    if place:
        records = [in_metres(record, place, origin_of(tables[0], place)) for record in records]
    shared = set.intersection(*(set(record.columns) for record in records))
    if not shared or min(record.t.size for record in records) < _FEWEST:
        raise UserError(
            f"{kept[0]} has too few rows or no column that changes, so nothing can be guessed; "
            "write a mapping that says which columns are which"
        )
    records = tuple(
        Record(r.t, {n: v for n, v in r.columns.items() if n in shared}) for r in records
    )
    prior = Prior(suggestions, _compasses(records))
    return _Source(tuple(kept), layout, tables, clock, place, windows_of(records), prior)


def _alike(paths: Sequence[Path], layout: Layout) -> list[Path]:
    """The first files, checked against the layout of the first of all."""
    for path in paths[1:]:
        other = sniff(path)
        if other.names != layout.names:
            raise UserError(
                f"{path} has other columns than {paths[0]}: a mapping fits files of one layout; "
                "audit each layout by itself"
            )
    return list(paths[:_FILES])


def _compasses(records: tuple[Record, ...]) -> frozenset[str]:
    """Columns that run from 0 to 360 and wrap, as a compass does."""
    found = set()
    for record in records:
        for name, values in record.columns.items():
            low, high = float(np.min(values)), float(np.max(values))
            if low >= 0 and 300 < high <= 360.5 and np.any(np.abs(np.diff(values)) > 300):
                found.add(name)
    return frozenset(found)


def _actuators(source: _Source, best: Weighed) -> list[Actuator]:
    """Actuators among the columns that the best reading leaves free."""
    used = {*columns_read(best.reading).values(), source.clock.column}
    free = [name for name in source.tables[0] if name not in used]
    suggestions = source.prior.suggestions
    unnamed = [
        name
        for name in free
        if suggestions[name].best == "other" and suggestions[name].weights["other"] < _TELLING
    ]
    runs = _runs(source, best, free)
    return find_actuators(runs, suggestions, unnamed) if runs and free else []


def _hand(reading: Reading) -> int:
    """The sign that decides which way a turn to starboard goes."""
    return reading.spin if reading.r is not None else reading.turn


def _answered(weighed: list[Weighed], best: Weighed, actuators: list[Actuator]) -> list[Weighed]:
    """Weights after the actuators: of two mirrored records, labels that are right count."""
    gain = sum(_RUDDER * a.push for a in actuators if a.role == "rudder" and a.sure > _NAMED)
    gain += sum(_THRUSTERS * a.push for a in actuators if a.role == "port")
    if gain == 0:
        return weighed
    hand = _hand(best.reading)
    heard = []
    for item in weighed:
        # Of other columns nothing was asked.
        same = (item.reading.r, item.reading.psi) == (best.reading.r, best.reading.psi)
        agrees = 1 if _hand(item.reading) == hand else -1
        heard.append(dataclasses.replace(item, odds=item.odds + same * agrees * 0.5 * gain))
    return sorted(heard, key=lambda item: -item.odds)


def _mirror(weighed: list[Weighed]) -> float:
    """Probability of the best reading's mirror image, against the two of them."""
    image = mirrored(weighed[0].reading)
    alike = [item for item in weighed if item.reading == image]
    if not alike:
        return 0.0
    return 1 / (1 + math.exp(weighed[0].odds - alike[0].odds))


def _runs(source: _Source, best: Weighed, free: list[str]) -> list[Trajectory]:
    """The first files read through the best reading, every free column as an order."""
    clock = source.clock
    settled = SettledUnits(source.prior, clock, best)
    channels = channels_read(best.reading, settled, source.place)
    if not channels:
        return []
    if clock.column is not None:
        channels["t"] = Column(clock.column, settled.tick)
    channels |= {f"cmd_{name}": Column(name) for name in free}
    mapping = dataclasses.replace(
        source.layout.mapping,
        channels=channels,
        time_step=None if clock.column else settled.step if math.isfinite(settled.step) else 1.0,
        velocity_axes="earth" if best.reading.earth and best.reading.psi else "body",
    )
    runs = [read_recording(path, mapping) for path in source.paths[:_ANSWERS]]
    kept = set.intersection(*(set(run.commanded) for run in runs))
    return [
        dataclasses.replace(run, commanded={n: run.commanded[n] for n in free if n in kept})
        for run in runs
    ]
