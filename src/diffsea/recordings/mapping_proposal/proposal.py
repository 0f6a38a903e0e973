"""A mapping proposed for files that nobody has mapped: guessed, weighed, and written down."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.mapping_proposal.actuators import ActuatorColumn, find_actuators
from diffsea.recordings.mapping_proposal.clock import (
    ColumnRecord,
    TimeColumn,
    columns_over_time,
    find_time_column,
    time_from_text_stamps,
)
from diffsea.recordings.mapping_proposal.guesses import (
    ChannelGuess,
    find_geographic,
    hypothesis_channels,
    hypothesis_columns,
    motion_guesses,
    origin_of,
    other_guesses,
    with_metres,
)
from diffsea.recordings.mapping_proposal.names import Suggestion, suggest_labels
from diffsea.recordings.mapping_proposal.readings import (
    FrameConvention,
    Hypothesis,
    HypothesisPrior,
    mirror_image,
)
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis, search_hypotheses
from diffsea.recordings.mapping_proposal.table_layout import TableLayout, columns_of, sniff_layout
from diffsea.recordings.mapping_proposal.units import SettledUnits
from diffsea.recordings.mapping_proposal.windows import ColumnWindows, windows_of
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
class ProposalEvidence:
    """What a proposal rests on, for the text that is written of it."""

    layout: TableLayout
    clock: TimeColumn
    suggestions: dict[str, Suggestion]
    best: ScoredHypothesis
    convention: FrameConvention
    mirror: float  # probability that the whole record is mirrored
    guesses: tuple[ChannelGuess, ...]
    actuators: tuple[ActuatorColumn, ...]
    origin: tuple[float, float] | None  # deg, where positions are geographic
    constant: frozenset[str]


@dataclasses.dataclass(frozen=True)
class _Source:
    """Files of one layout, as they are before anything is decided."""

    paths: tuple[Path, ...]
    layout: TableLayout
    tables: tuple[dict[str, np.ndarray], ...]
    clock: TimeColumn
    place: tuple[str, str] | None  # columns of latitude and longitude
    windows: ColumnWindows
    prior: HypothesisPrior


def gather_evidence(paths: Sequence[Path]) -> ProposalEvidence:
    """What can be said of files of one layout.

    Raises `UserError` for files that are no tables of numbers, or that differ in columns.
    """
    source = _source(paths)
    weighed = search_hypotheses(source.windows, source.prior, source.clock, source.place)
    best = weighed[0]
    actuators = _actuators(source, best)
    weighed = _with_actuator_evidence(weighed, best, actuators)
    if _turn_sign(weighed[0].reading) != _turn_sign(best.reading):
        actuators = [dataclasses.replace(a, push=-a.push) if a.turns else a for a in actuators]
    best, table = weighed[0], source.tables[0]
    settled = SettledUnits(source.prior, source.clock, best)
    guesses = motion_guesses(weighed, settled, source.clock, source.place)
    used = {guess.column.column for guess in guesses} | {a.column for a in actuators}
    guesses += other_guesses(source.prior, table, source.windows, used)
    geodetic = any(guess.channel == "latitude" for guess in guesses)
    return ProposalEvidence(
        layout=source.layout,
        clock=dataclasses.replace(source.clock, units={settled.tick: 1.0}, step=settled.step),
        suggestions=source.prior.suggestions,
        best=best,
        convention=source.prior.convention(best.reading),
        mirror=_mirror_probability(weighed),
        guesses=tuple(guesses),
        actuators=tuple(actuators),
        origin=origin_of(table, source.place) if geodetic and source.place else None,
        constant=frozenset(n for n, v in table.items() if np.nanmax(v) == np.nanmin(v)),
    )


def _source(paths: Sequence[Path]) -> _Source:
    layout = sniff_layout(paths[0])
    kept = _check_same_layout(paths, layout)
    tables = tuple(columns_of(path, layout) for path in kept)
    suggestions = {
        name: suggest_labels(name if layout.named else "", unit)
        for name, unit in zip(layout.names, layout.units, strict=True)
        if name
    }
    clock = find_time_column(tables[0], suggestions) or time_from_text_stamps(kept[0], layout)
    place = find_geographic(tables[0], suggestions)
    records = [columns_over_time(table, clock) for table in tables]
    if place:
        records = [with_metres(record, place, origin_of(tables[0], place)) for record in records]
    shared = set.intersection(*(set(record.columns) for record in records))
    if not shared or min(record.t.size for record in records) < _FEWEST:
        raise UserError(
            f"{kept[0]} has too few rows or no column that changes, so nothing can be guessed; "
            "write a mapping that says which columns are which"
        )
    records = tuple(
        ColumnRecord(r.t, {n: v for n, v in r.columns.items() if n in shared}) for r in records
    )
    prior = HypothesisPrior(suggestions, _compasses(records))
    return _Source(tuple(kept), layout, tables, clock, place, windows_of(records), prior)


def _check_same_layout(paths: Sequence[Path], layout: TableLayout) -> list[Path]:
    """The first files, checked against the layout of the first of all."""
    for path in paths[1:]:
        other = sniff_layout(path)
        if other.names != layout.names:
            raise UserError(
                f"{path} has other columns than {paths[0]}: a mapping fits files of one layout; "
                "audit each layout by itself"
            )
    return list(paths[:_FILES])


def _compasses(records: tuple[ColumnRecord, ...]) -> frozenset[str]:
    """Columns that run from 0 to 360 and wrap, as a compass does."""
    found = set()
    for record in records:
        for name, values in record.columns.items():
            low, high = float(np.min(values)), float(np.max(values))
            if low >= 0 and 300 < high <= 360.5 and np.any(np.abs(np.diff(values)) > 300):
                found.add(name)
    return frozenset(found)


def _actuators(source: _Source, best: ScoredHypothesis) -> list[ActuatorColumn]:
    """Actuators among the columns that the best reading leaves free."""
    used = {*hypothesis_columns(best.reading).values(), source.clock.column}
    free = [name for name in source.tables[0] if name not in used]
    suggestions = source.prior.suggestions
    unnamed = [
        name
        for name in free
        if suggestions[name].best == "other" and suggestions[name].weights["other"] < _TELLING
    ]
    runs = _trial_runs(source, best, free)
    return find_actuators(runs, suggestions, unnamed) if runs and free else []


def _turn_sign(reading: Hypothesis) -> int:
    """The sign that decides which way a turn to starboard goes."""
    return reading.spin if reading.r is not None else reading.turn


def _with_actuator_evidence(
    weighed: list[ScoredHypothesis], best: ScoredHypothesis, actuators: list[ActuatorColumn]
) -> list[ScoredHypothesis]:
    """Weights after the actuators: of two mirrored records, labels that are right count."""
    gain = sum(_RUDDER * a.push for a in actuators if a.role == "rudder" and a.sure > _NAMED)
    gain += sum(_THRUSTERS * a.push for a in actuators if a.role == "port")
    if gain == 0:
        return weighed
    hand = _turn_sign(best.reading)
    heard = []
    for item in weighed:
        # Of other columns nothing was asked.
        same = (item.reading.r, item.reading.psi) == (best.reading.r, best.reading.psi)
        agrees = 1 if _turn_sign(item.reading) == hand else -1
        heard.append(dataclasses.replace(item, odds=item.odds + same * agrees * 0.5 * gain))
    return sorted(heard, key=lambda item: -item.odds)


def _mirror_probability(weighed: list[ScoredHypothesis]) -> float:
    """Probability of the best reading's mirror image, against the two of them."""
    image = mirror_image(weighed[0].reading)
    alike = [item for item in weighed if item.reading == image]
    if not alike:
        return 0.0
    return 1 / (1 + math.exp(weighed[0].odds - alike[0].odds))


def _trial_runs(source: _Source, best: ScoredHypothesis, free: list[str]) -> list[Trajectory]:
    """The first files read through the best reading, every free column as an order."""
    clock = source.clock
    settled = SettledUnits(source.prior, clock, best)
    channels = hypothesis_channels(best.reading, settled, source.place)
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
