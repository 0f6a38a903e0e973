"""Recordings in and out: CSV and Parquet files, data frames, and robots' logs.

Everything that leaves this module is in SI units and radians and NED axes as far as the
file's labels are right; whether they are is for the audit to find out.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int

from diffsea.errors import UserError, nearest
from diffsea.outside.digests import content_digest
from diffsea.outside.durable import written_beside
from diffsea.recordings import logs
from diffsea.recordings.conditioning import cut_between
from diffsea.recordings.geodesy import place_fixes
from diffsea.recordings.known import recognise
from diffsea.recordings.mappings import (
    ACTUATOR_PREFIXES,
    CHANNEL_DIMENSIONS,
    EMPTY_ROWS,
    EXTRA_CHANNELS,
    REPEATED_TIMES,
    Column,
    Mapping,
    check_span,
    is_channel,
    mapping_for,
    native_channels,
    read_mapping,
    with_channels,
)
from diffsea.recordings.motion import fresh_samples
from diffsea.recordings.tables import (
    LARGEST_QUANTITY,
    PARQUET_SUFFIXES,
    clock_column,
    numeric_column,
    read_table,
)
from diffsea.recordings.wind import with_true_wind
from diffsea.series import (
    BRIDGED_INTERVALS,
    CALENDAR,
    between_samples,
    hold_at,
    hold_last,
    median_interval,
    unwrap,
)
from diffsea.trajectory import MOTION_CHANNELS, ReadReport, RowsLeftOut, Samples, Trajectory


_LONGEST_NAME = 40  # letters, of a column in a message
_MOST_NAMES = 40  # of columns in a message
_SAMPLED_TOGETHER = (("latitude", "longitude"), ("x", "y"), ("u", "v"), ("psi",), ("r",))
_FRAME = "<DataFrame>"  # the place that messages name for a table in memory


def read_recording(
    source: str | Path | pd.DataFrame,
    mapping: Mapping | str | Path | None = None,
    start: float | None = None,
    end: float | None = None,
) -> Trajectory:
    """Read one run from a CSV or Parquet file, from a log, or from a data frame in memory.

    Logs are ROS bags (`.bag`, `.db3`, `.mcap` or the folder of a ROS 2 bag), ArduPilot's `.bin`
    and, as text, `.log`, MAVLink's `.tlog`, or `.csv` as Mission Planner converts it, PX4's `.ulg`
    and MATLAB's `.mat`; without a mapping that for their format is chosen by what they contain,
    and `read` says which. `logs.read_log`
    says what becomes of their several clocks. Only rows from `start` to `end` (s on the
    recording's clock) are kept, by default those that the mapping says.

    Without a mapping a table must have the native columns (`t`, `x`, `psi`, `cmd_...`); the
    index of a data frame is a column where it has a name.
    Time keeps its zero, unless that is the epoch of a calendar: such clocks count from the first
    row's second, which the provenance names. Heading is unwrapped, empty cells of motion channels
    become NaN, and a command holds through empty cells. Rows without any value are dropped, and
    rows of one time stamp become one, of the last value of each channel: an order that changes at
    an instant counts from that instant on. The provenance says how many, and so does `read`.

    Numbers beyond 1e100 are missing samples. A mapping may be a folder that has
    `STEM.mapping.toml` for each file that needs one.

    Raises `UserError` naming file, line and column for anything that cannot be read as a
    recording: no time, no motion, cells that are no numbers, time that runs backwards.
    """
    folder = mapping if isinstance(mapping, str | Path) and Path(mapping).is_dir() else None
    if not isinstance(source, pd.DataFrame):
        mapping = mapping_for(mapping, source)
    elif folder is not None:
        raise UserError(f"{folder} is a folder of mappings by file name; a DataFrame has none")
    elif isinstance(mapping, str | Path):
        mapping = read_mapping(mapping)
    if mapping is not None:
        start = mapping.start if start is None else start
        end = mapping.end if end is None else end
    check_span(start, end, "what is to be read:")
    try:
        whole = _read_whole(source, mapping)
    except UserError as error:
        if isinstance(source, pd.DataFrame) or folder is None or mapping is not None:
            raise
        if not Path(source).exists():
            raise
        told = f"{error}; {folder} has no {Path(source).stem}.mapping.toml for it"
        raise UserError(told) from error
    if mapping is not None and mapping.constants:
        whole = _with_constants(whole, mapping)
    return cut_between(with_true_wind(whole), start, end)


def _read_whole(source: str | Path | pd.DataFrame, mapping: Mapping | None) -> Trajectory:
    """The run of a file, a log or a data frame, through a mapping where there is one."""
    through = [] if mapping is None else [f"through mapping {mapping.name}"]
    if isinstance(source, pd.DataFrame):
        table = source if source.index.name is None else source.reset_index()
        origin = f"read {_FRAME} of {len(table)} rows"
        return _from_table(table.rename(columns=str), mapping, _FRAME, 1, [origin, *through])
    path = Path(source)
    if not logs.is_log(path):
        found = read_table(path, mapping)
        notes = [f"read {path.name}, sha256 {content_digest(path)}", *through]
        notes += [found.cut_off] if found.cut_off else []
        run = _from_table(found.table, mapping, str(path), found.first_line, notes, path.name)
        return dataclasses.replace(run, read=dataclasses.replace(run.read, cut_off=found.cut_off))
    known = recognise(path) if mapping is None else None
    log = logs.read_log(path, known.mapping if known else mapping)
    told = (known.sentence, *known.others, *known.missing.values()) if known else ()
    notes = [f"read {path.name}, sha256 {content_digest(path)}", *through, *told, *log.notes]
    run = _assemble(log.values, str(path), 1, notes, path.name, log.repeated_times)
    read = dataclasses.replace(run.read, recognised=told, rates=log.rates, cut_off=log.cut_off)
    epoch = run.read.epoch if log.epoch is None else log.epoch
    return dataclasses.replace(run, read=dataclasses.replace(read, epoch=epoch))


def _with_constants(run: Trajectory, mapping: Mapping) -> Trajectory:
    """The run with the channels that never changed, as the mapping says."""
    groups = {"cmd_": dict(run.commanded), "exec_": dict(run.executed), "": dict(run.extra)}
    told = []
    for channel, value in mapping.constants.items():
        prefix = next(one for one in groups if channel.startswith(one))
        groups[prefix][channel.removeprefix(prefix)] = np.full(run.t.shape, value)
        unit = {"speed": " m/s", "angle": " rad"}.get(CHANNEL_DIMENSIONS.get(channel, ""), "")
        told.append(f"{channel} is {value:g}{unit} throughout, as {mapping.name} says")
    return dataclasses.replace(
        run,
        commanded=groups["cmd_"],
        executed=groups["exec_"],
        extra=groups[""],
        provenance=(*run.provenance, *told),
    )


def to_frame(trajectory: Trajectory) -> pd.DataFrame:
    """The rows of a run that count as a data frame with native columns, in SI units.

    Channels without any value are left out. `read_recording` makes it a recording again.
    """
    columns = native_channels(trajectory.counted())
    known = [name for name, s in columns.items() if name == "t" or np.any(np.isfinite(s))]
    return pd.DataFrame({name: columns[name] for name in known})


def write_recording(trajectory: Trajectory, path: str | Path) -> None:
    """Write the valid rows of a run with native columns at full precision.

    The suffix chooses CSV or Parquet. The file appears whole or not at all, even after a
    power cut: it is written beside its destination, flushed and renamed. Channels without any
    value are left out.

    Raises `UserError` for a suffix that is neither, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", *PARQUET_SUFFIXES):
        raise UserError(f"cannot write {path}: the name must end in .csv or .parquet")
    table = to_frame(trajectory)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_beside(path) as beside:
            if path.suffix.lower() == ".csv":
                table.to_csv(beside, index=False)
            else:
                table.to_parquet(beside, index=False)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from error


def _from_table(
    table: pd.DataFrame,
    mapping: Mapping | None,
    place: str,
    first_line: int,
    notes: list[str],
    name: str = _FRAME,
) -> Trajectory:
    """The run in a table, whose first row is `first_line` of the `place` in messages."""
    channels = _channel_columns(table, mapping, place)
    values: dict[str, Samples] = {}
    for channel, column in channels.items():
        if channel == "t":
            raw = clock_column(table, column, place, first_line)
        else:
            parts = [numeric_column(table, name, place, first_line) for name in column.names]
            raw = column.made_of(channel, parts)
        values[channel] = raw * column.gain + column.shift
    notes += _leave_out_held(values)
    used = {name for column in channels.values() for name in column.names}
    unused = [str(name) for name in table.columns if name not in used and str(name).strip()]
    if unused:
        notes.append(f"columns not used: {', '.join(unused)}")
    if mapping is None:
        return _with_unused(_assemble(values, place, first_line, notes, name), unused)
    if mapping.time_step is not None:
        values["t"] = np.arange(len(table)) * mapping.time_step
    if mapping.frame != "NED":
        notes.append(f"turned from {mapping.frame} into NED axes")
    if "latitude" in values:
        fixes = values.pop("latitude"), values.pop("longitude")
        values["x"], values["y"], note = place_fixes(*fixes, mapping.origin, place)
        notes.append(note)
    run = _with_mapped_repairs(_assemble(values, place, first_line, notes, name), mapping)
    return _with_unused(run, unused)


def _leave_out_held(values: dict[str, Samples]) -> list[str]:
    """Empty what a slower sensor's column only holds until its next sample; and what is told of it.

    A fix that is held is none: it would be late by as long as it is held, and turn with the vessel
    where velocities are along earth axes.
    """
    told = []
    for channels in _SAMPLED_TOGETHER:
        there = [name for name in channels if name in values]
        if not there:
            continue
        known = np.any([np.isfinite(values[name]) for name in there], axis=0)
        fresh = known & fresh_samples(*(values[name] for name in there))
        if np.array_equal(fresh, known):
            continue
        for name in there:
            values[name] = np.where(fresh, values[name], np.nan)
        share = f"{np.count_nonzero(fresh)} of {np.count_nonzero(known)} rows"
        told.append(f"{', '.join(there)} held between samples: new in {share}, empty in the others")
    return told


def _with_unused(run: Trajectory, unused: Sequence[str]) -> Trajectory:
    return dataclasses.replace(run, read=dataclasses.replace(run.read, unused_columns=(*unused,)))


def _listed(names: Iterable[object]) -> str:
    """Names of columns for a message, long ones and long lists of them cut."""
    told = [str(name) or "(no name)" for name in names]
    short = [f"{n[:_LONGEST_NAME]}..." if len(n) > _LONGEST_NAME else n for n in told]
    more = len(short) - _MOST_NAMES
    return ", ".join(short[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def _channel_columns(table: pd.DataFrame, mapping: Mapping | None, place: str) -> dict[str, Column]:
    """Which column every channel comes from, checked against what the table has.

    Raises `UserError` where there is no time, no motion, or a column that is mapped is missing.
    """
    present = _listed(table.columns)
    if mapping is None:
        channels = {name: Column(name) for name in table.columns if is_channel(name)}
        if "t" not in channels:
            raise UserError(
                f"{place} has no column 't' with time in seconds; it has {present}. Rename it, "
                "or write a mapping that says which columns are which and in which unit"
            )
    else:
        channels = mapping.ned_channels
        if "t" not in channels and mapping.time_step is None:
            raise UserError(
                f"{place} needs a channel t in {mapping.name}: name its time column under "
                "[columns], or give [file] time_step in seconds"
            )
        for channel, column in channels.items():
            for name in column.names:
                if name not in table.columns:
                    raise UserError(
                        f"{place} has no column {name!r}, which {mapping.name} maps to "
                        f"{channel}; it has {present}" + nearest(name, map(str, table.columns))
                    )
    if not any(name in channels for name in (*MOTION_CHANNELS, "latitude")):
        raise UserError(
            f"{place} has no motion channel ({', '.join(MOTION_CHANNELS)}); it has {present}. "
            "Write a mapping that says which columns are which"
        )
    return channels


def _assemble(
    values: dict[str, Samples],
    place: str,
    first_line: int,
    notes: list[str],
    name: str,
    repeated_times: tuple[RowsLeftOut, ...] = (),
) -> Trajectory:
    """Drop rows that say nothing, check the clock, and build the record.

    `values` are the channels by native names, SI units; `first_line` is the number of the first
    row of the `place` in messages; `notes` become the provenance. Raises `UserError` for times
    that are missing or run backwards, and where less than two rows or no motion are left.
    """
    time = values.pop("t")
    values = _without_the_absurd(values, notes)
    lines = np.arange(time.size) + first_line
    # Rows that hold nothing but a counted time stamp are padding too, but a file's own time
    # stamp is a statement that a sample is missing, so such a row stays.
    empty = np.all([np.isnan(series) for series in values.values()], axis=0) & np.isnan(time)
    empty_rows = None
    if np.any(empty):
        note = f"{EMPTY_ROWS}: {np.sum(empty)}, first in line {lines[empty][0]}"
        empty_rows = RowsLeftOut(int(np.sum(empty)), note)
        notes.append(note)
    time, lines = time[~empty], lines[~empty]
    _check_clock(time, lines, place)
    repeated = np.flatnonzero(np.diff(time) == 0) + 1
    if repeated.size:
        note = (
            f"{REPEATED_TIMES}: {repeated.size} of {time.size}, first at "
            f"t = {time[repeated[0]]:g} s in line {lines[repeated[0]]}"
        )
        repeated_times = (*repeated_times, RowsLeftOut(repeated.size, note))
        notes.append(note)
    epoch = float(math.floor(time[0])) if time.size and time[0] > CALENDAR else None
    if epoch is not None:
        notes.append(f"times count from {epoch:.0f} s on the file's clock, the first row's second")
        time = time - epoch
    table = pd.DataFrame({channel: series[~empty] for channel, series in values.items()})
    table = table.groupby(time).last()
    if len(table) < 2:
        raise UserError(f"{place} has {len(table)} usable row(s); a recording needs at least two")
    time, values = table.index.to_numpy(), {channel: table[channel].to_numpy() for channel in table}
    missing = np.full(time.shape, np.nan)
    motion = {channel: values.get(channel, missing) for channel in MOTION_CHANNELS}
    if not any(np.any(np.isfinite(series)) for series in motion.values()):
        raise UserError(f"{place} has no finite value in any motion channel")
    return Trajectory(
        t=time,
        **motion | {"psi": unwrap(motion["psi"])},
        commanded=_held_actuation("cmd_", values, time, notes),
        executed=_held_actuation("exec_", values, time, notes),
        extra={channel: values[channel] for channel in EXTRA_CHANNELS if channel in values},
        valid=np.ones(time.shape, dtype=bool),
        name=name,
        provenance=tuple(notes),
        read=ReadReport(empty_rows, repeated_times, epoch=epoch),
    )


def _check_clock(time: Samples, lines: Int[np.ndarray, "time"], place: str) -> None:
    """Raises `UserError` for times (s) that are missing or run backwards, with their lines."""
    missing = np.flatnonzero(np.isnan(time))
    if missing.size:
        raise UserError(
            f"{place}, line {lines[missing[0]]}: the time is missing in a row that has data "
            f"({missing.size} such rows); fill it in, delete the row, or give [file] time_step "
            "in a mapping if the samples are equally spaced"
        )
    backwards = np.flatnonzero(np.diff(time) < 0)
    if backwards.size:
        at = backwards[0]
        raise UserError(
            f"{place}, line {lines[at + 1]}: time runs backwards, from {time[at]:.10g} s to "
            f"{time[at + 1]:.10g} s; sort the rows, or split the file if two runs were joined"
        )


def _without_the_absurd(values: dict[str, Samples], notes: list[str]) -> dict[str, Samples]:
    """Channels without numbers that no quantity has: programs write them where nothing is known."""
    kept = {}
    for channel, series in values.items():
        absurd = np.abs(series) > LARGEST_QUANTITY
        if np.any(absurd):
            count = f"{np.sum(absurd)} values beyond {LARGEST_QUANTITY:g}"
            notes.append(f"{channel}: {count} are missing samples")
        kept[channel] = np.where(absurd, np.nan, series)
    return kept


def _held_actuation(
    prefix: str, values: dict[str, Samples], time: Samples, notes: list[str]
) -> dict[str, Samples]:
    """Actuation held through empty cells, by actuator; NaN before the first value."""
    group = {}
    for channel, series in values.items():
        if not channel.startswith(prefix):
            continue
        finite = np.isfinite(series)
        if not np.any(finite):
            notes.append(f"{channel} has no value and is left out")
            continue
        first = np.argmax(finite)
        if first > 0:
            notes.append(f"{channel} is unknown before t = {time[first]:g} s")
        filled = np.sum(~finite[first:])
        if filled:
            notes.append(f"{channel}: {filled} empty cells hold the value before")
        group[channel.removeprefix(prefix)] = hold_last(series, leading="missing")
    return group


def _between_its_samples(t: Samples, psi: Samples) -> Samples:
    """A heading, along straight lines in the rows of other sensors; NaN across long pauses."""
    known = np.isfinite(psi)
    if known.all() or known.sum() < 2:
        return psi
    longest = BRIDGED_INTERVALS * median_interval(t[known]) * (1 + 1e-9)
    line = np.interp(t, t[known], psi[known])
    return np.where(known | between_samples(t[known], t, longest), line, np.nan)


def _with_mapped_repairs(run: Trajectory, mapping: Mapping) -> Trajectory:
    """The run with late channels shifted and earth velocities turned into body axes.

    Shifted motion is interpolated, NaN beyond its ends; shifted actuation holds.
    """
    position = {"latitude": "x", "longitude": "y"}
    channels = native_channels(run)
    t, notes = run.t, []
    for name, column in mapping.ned_channels.items():
        if not column.delay:
            continue
        name, later = position.get(name, name), t + column.delay
        notes.append(f"{name} shifted by {-column.delay:g} s")
        if name.startswith(ACTUATOR_PREFIXES) and name in channels:
            channels[name] = hold_at(t, channels[name], later)
        elif name in channels:
            channels[name] = np.interp(later, t, channels[name], left=np.nan, right=np.nan)
    if mapping.velocity_axes == "earth":
        heading = _between_its_samples(t, channels["psi"])
        body = (channels["u"] + 1j * channels["v"]) * np.exp(-1j * heading)
        channels |= {"u": body.real, "v": body.imag}
        notes.append("u and v turned from earth into body axes by the heading")
    return with_channels(run, channels, provenance=(*run.provenance, *notes))
