"""The evidence on files that nobody has mapped, gathered and weighed for a proposal."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.mapping_proposal.actuators import ActuatorColumn, find_actuators
from diffsea.recordings.mapping_proposal.columns import (
    ColumnRecord,
    ColumnWindows,
    TimeColumn,
    columns_over_time,
    find_geographic,
    find_time_column,
    origin_of,
    time_from_text_stamps,
    windows_of,
    with_metres,
)
from diffsea.recordings.mapping_proposal.guesses import (
    ChannelGuess,
    SettledUnits,
    motion_columns,
    motion_guesses,
    wind_and_roll_guesses,
)
from diffsea.recordings.mapping_proposal.hypotheses import (
    ColumnHypothesis,
    FrameConvention,
    HypothesisPrior,
)
from diffsea.recordings.mapping_proposal.names import Suggestion, suggest_labels
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis, search_hypotheses
from diffsea.recordings.mapping_proposal.table_layout import (
    TableLayout,
    numeric_columns,
    sniff_layout,
)
from diffsea.recordings.mappings import Column
from diffsea.recordings.readers import read_recording
from diffsea.trajectory import Samples, Trajectory


_MOST_FILES = 6  # that the evidence is taken from: more would cost time and add little
_MOST_ACTUATOR_FILES = 3  # that actuators are tried on, each of which is audited
_FEWEST_ROWS = 20  # fewer tell nothing of how columns are related
_NAMED = 0.55  # how sure a rudder must be to have a say in what is starboard
_TELLING = 0.5  # weight of "other" above which a name says that it is something else
# Log odds for a rudder, and for a pair of thrusters, that act the way their labels say.
_RUDDER_LABEL, _THRUSTER_LABELS = math.log(0.75 / 0.25), math.log(0.95 / 0.05)


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
    table: dict[str, Samples]  # of the first file
    clock: TimeColumn
    place: tuple[str, str] | None  # columns of latitude and longitude
    windows: ColumnWindows
    prior: HypothesisPrior


def gather_evidence(paths: Sequence[Path]) -> ProposalEvidence:
    """What can be said of files of one layout.

    Raises `UserError` for files that are no tables of numbers, or that differ in columns.
    """
    source = _read_source(paths)
    scored = search_hypotheses(source.windows, source.prior, source.clock, source.place)
    first = scored[0]
    actuators = _find_actuators(source, first)
    scored = _with_actuator_evidence(scored, actuators)
    best = scored[0]
    if _starboard_sign(best.hypothesis) != _starboard_sign(first.hypothesis):
        actuators = [dataclasses.replace(a, push=-a.push) if a.turns else a for a in actuators]
    settled = SettledUnits(source.prior, source.clock, best)
    guesses = motion_guesses(scored, settled, source.clock, source.place)
    used = {guess.column.column for guess in guesses} | {a.column for a in actuators}
    guesses += wind_and_roll_guesses(source.prior, source.table, source.windows, used)
    geodetic = any(guess.channel == "latitude" for guess in guesses)
    image = best.hypothesis.mirror_image
    mirrored = next((item for item in scored if item.hypothesis == image), None)
    return ProposalEvidence(
        layout=source.layout,
        clock=dataclasses.replace(source.clock, units={settled.units.tick: 1.0}, step=settled.step),
        suggestions=source.prior.suggestions,
        best=best,
        convention=source.prior.convention(best.hypothesis),
        mirror=0.0 if mirrored is None else 1 / (1 + math.exp(best.log_odds - mirrored.log_odds)),
        guesses=tuple(guesses),
        actuators=tuple(actuators),
        origin=origin_of(source.table, source.place) if geodetic and source.place else None,
        constant=frozenset(n for n, v in source.table.items() if np.nanmax(v) == np.nanmin(v)),
    )


def _read_source(paths: Sequence[Path]) -> _Source:
    layout = sniff_layout(paths[0])
    for path in paths[1:]:
        if sniff_layout(path).names != layout.names:
            raise UserError(
                f"{path} has other columns than {paths[0]}: a mapping fits files of one layout; "
                "audit each layout by itself"
            )
    kept = paths[:_MOST_FILES]
    tables = [numeric_columns(path, layout) for path in kept]
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
    if not shared or min(record.t.size for record in records) < _FEWEST_ROWS:
        raise UserError(
            f"{kept[0]} has too few rows or no column that changes, so nothing can be guessed; "
            "write a mapping that says which columns are which"
        )
    records = tuple(
        ColumnRecord(r.t, {n: v for n, v in r.columns.items() if n in shared}) for r in records
    )
    prior = HypothesisPrior(suggestions, _wrapped_compasses(records))
    return _Source(tuple(kept), layout, tables[0], clock, place, windows_of(records), prior)


def _wrapped_compasses(records: tuple[ColumnRecord, ...]) -> frozenset[str]:
    """Columns that run from 0 to 360 and wrap, as a compass does."""
    found = set()
    for record in records:
        for name, values in record.columns.items():
            low, high = float(np.min(values)), float(np.max(values))
            if low >= 0 and 300 < high <= 360.5 and np.any(np.abs(np.diff(values)) > 300):
                found.add(name)
    return frozenset(found)


def _find_actuators(source: _Source, best: ScoredHypothesis) -> list[ActuatorColumn]:
    """Actuators among the columns that the best hypothesis leaves free."""
    used = {*best.hypothesis.columns.values(), source.clock.column}
    free = [name for name in source.table if name not in used]
    runs = _runs_with_orders(source, best, free)
    suggestions = source.prior.suggestions
    unnamed = [
        name
        for name in free
        if suggestions[name].best == "other" and suggestions[name].weights["other"] < _TELLING
    ]
    return find_actuators(runs, suggestions, unnamed) if runs and free else []


def _runs_with_orders(source: _Source, best: ScoredHypothesis, free: list[str]) -> list[Trajectory]:
    """The first files read through the best hypothesis, every free column as an order."""
    clock = source.clock
    settled = SettledUnits(source.prior, clock, best)
    channels = motion_columns(best.hypothesis, settled, source.place)
    if not channels:
        return []
    if clock.column is not None:
        channels["t"] = Column(clock.column, settled.units.tick)
    channels |= {f"cmd_{name}": Column(name) for name in free}
    turned = best.hypothesis.earth and best.hypothesis.psi
    mapping = dataclasses.replace(
        source.layout.mapping,
        channels=channels,
        time_step=None if clock.column else settled.step if math.isfinite(settled.step) else 1.0,
        velocity_axes="earth" if turned else "body",
    )
    runs = [read_recording(path, mapping) for path in source.paths[:_MOST_ACTUATOR_FILES]]
    kept = set.intersection(*(set(run.commanded) for run in runs))
    return [
        dataclasses.replace(run, commanded={n: run.commanded[n] for n in free if n in kept})
        for run in runs
    ]


def _starboard_sign(h: ColumnHypothesis) -> int:
    """The sign that decides which way a turn to starboard goes."""
    return h.spin if h.r is not None else h.turn


def _with_actuator_evidence(
    scored: list[ScoredHypothesis], actuators: list[ActuatorColumn]
) -> list[ScoredHypothesis]:
    """Log odds after the actuators: of two mirrored records, labels that are right count."""
    gain = sum(_RUDDER_LABEL * a.push for a in actuators if a.role == "rudder" and a.sure > _NAMED)
    gain += sum(_THRUSTER_LABELS * a.push for a in actuators if a.role == "port")
    if gain == 0:
        return scored
    best, heard = scored[0].hypothesis, []
    for item in scored:
        # Of other columns nothing was asked.
        same = (item.hypothesis.r, item.hypothesis.psi) == (best.r, best.psi)
        agrees = 1 if _starboard_sign(item.hypothesis) == _starboard_sign(best) else -1
        odds = item.log_odds + same * agrees * 0.5 * gain
        heard.append(dataclasses.replace(item, log_odds=odds))
    return sorted(heard, key=lambda item: -item.log_odds)
