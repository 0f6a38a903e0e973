"""Recordings in and out: CSV and Parquet files, native or through a mapping, and robots' logs.

Everything that leaves this module is in SI units and radians and NED axes as far as the
file's labels are right; whether they are is for the audit to find out.
"""

import dataclasses
import hashlib
import math
import os
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea.errors import UserError, nearest
from diffsea.recordings import logs
from diffsea.recordings.geodesy import placed
from diffsea.recordings.mappings import (
    Column,
    Mapping,
    is_channel,
    read_mapping,
)
from diffsea.recordings.tables import PARQUET_SUFFIXES, numbers, read_table
from diffsea.recordings.vocabulary import EMPTY_ROWS as EMPTY_ROWS
from diffsea.recordings.vocabulary import REPEATED_TIMES as REPEATED_TIMES
from diffsea.series import unwrap
from diffsea.trajectory import MOTION_CHANNELS, Series, Trajectory


_EPOCH = 1e8  # s: a clock that has run for three years counts from an epoch

EXTRA_CHANNELS = ("wind_speed", "wind_direction", "phi", "p")


def read_recording(path: str | Path, mapping: Mapping | str | Path | None = None) -> Trajectory:
    """Read one run from a CSV or Parquet file, or from a log.

    Logs are ROS bags (`.bag`, `.db3`, `.mcap` or the folder of a ROS 2 bag), ArduPilot's `.bin`,
    PX4's `.ulg` and MATLAB's `.mat`; they need a mapping, and `logs.read_log` says what becomes
    of their several clocks.

    Without a mapping a table must have the native columns (`t`, `x`, `psi`, `cmd_...`).
    Time keeps its zero, unless that is the epoch of a calendar: such clocks count from the first
    row's second, which the provenance names. Heading is unwrapped, empty cells of motion channels
    become NaN, and a command holds through empty cells. Rows without any value are dropped, and
    rows of one time stamp become one, of the last value of each channel: an order that changes at
    an instant counts from that instant on. The provenance says how many.

    Raises `UserError` naming file, line and column for anything that cannot be read as a
    recording: no time, no motion, cells that are no numbers, time that runs backwards.
    """
    path = Path(path)
    if isinstance(mapping, str | Path):
        mapping = read_mapping(mapping)
    if logs.is_log(path):
        values, told = logs.read_log(path, mapping)
        return _assemble(values, path, 1, [*_source(path, mapping), *told])
    table, first_line = read_table(path, mapping)
    channels = _channels(table, mapping, path)
    values: dict[str, np.ndarray] = {}
    for name, column in channels.items():
        raw = numbers(table, column.column, path, first_line)
        values[name] = raw * column.gain + column.shift
    if mapping is not None and mapping.time_step is not None:
        values["t"] = np.arange(len(table)) * mapping.time_step
    notes = _source(path, mapping)
    used = {column.column for column in channels.values()}
    unused = [str(name) for name in table.columns if name not in used and str(name).strip()]
    if unused:
        notes.append("columns not used: " + ", ".join(unused))
    if mapping is not None and mapping.frame != "NED":
        notes.append(f"turned from {mapping.frame} into NED axes")
    if "latitude" in values and mapping is not None:
        fixes = values.pop("latitude"), values.pop("longitude")
        values["x"], values["y"], note = placed(*fixes, mapping.origin, str(path))
        notes.append(note)
    run = _assemble(values, path, first_line, notes)
    return run if mapping is None else _repaired(run, mapping)


def write_recording(trajectory: Trajectory, path: str | Path) -> None:
    """Write the valid rows of a run with native columns at full precision.

    The suffix chooses CSV or Parquet. The file appears whole or not at all: it is written
    beside its destination and renamed. Channels without any value are left out.

    Raises `UserError` for a suffix that is neither, or a folder that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", *PARQUET_SUFFIXES):
        raise UserError(f"cannot write {path}: the name must end in .csv or .parquet")
    table = _native_table(trajectory)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from error
    try:
        if path.suffix.lower() == ".csv":
            table.to_csv(temporary, index=False)
        else:
            table.to_parquet(temporary, index=False)
        os.chmod(temporary, 0o644)  # mkstemp makes files that only their owner can read
        os.replace(temporary, path)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def _native_table(trajectory: Trajectory) -> pd.DataFrame:
    columns = {name: getattr(trajectory, name) for name in MOTION_CHANNELS}
    columns |= {f"cmd_{name}": series for name, series in trajectory.commanded.items()}
    columns |= {f"exec_{name}": series for name, series in trajectory.executed.items()}
    columns |= trajectory.extra
    valid = np.asarray(trajectory.valid, dtype=bool)
    kept = {"t": np.asarray(trajectory.t)[valid]}
    for name, series in columns.items():
        values = np.asarray(series)[valid]
        if np.any(np.isfinite(values)):
            kept[name] = values
    return pd.DataFrame(kept)


def _source(path: Path, mapping: Mapping | None) -> list[str]:
    notes = [f"read {path.name}, sha256 {_digest(path)}"]
    return notes if mapping is None else [*notes, f"through mapping {mapping.name}"]


def _digest(path: Path) -> str:
    """SHA-256 of a file; of a folder, that of the names and digests of the files in it."""
    if path.is_dir():
        parts = [f"{item.name} {_digest(item)}\n" for item in sorted(path.iterdir())]
        return hashlib.sha256("".join(parts).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _channels(table: pd.DataFrame, mapping: Mapping | None, path: Path) -> dict[str, Column]:
    """Which column every channel comes from, checked against what the file has."""
    present = ", ".join(str(name) for name in table.columns)
    if mapping is None:
        channels = {name: Column(name) for name in table.columns if is_channel(name)}
        if "t" not in channels:
            raise UserError(
                f"{path} has no column 't' with time in seconds; it has {present}. Rename it, "
                "or write a mapping that says which columns are which and in which unit"
            )
    else:
        channels = mapping.ned_channels
        if "t" not in channels and mapping.time_step is None:
            raise UserError(
                f"{path} needs a channel t in {mapping.name}: name its time column under "
                "[columns], or give [file] time_step in seconds"
            )
        for channel, column in channels.items():
            if column.column not in table.columns:
                raise UserError(
                    f"{path} has no column {column.column!r}, which {mapping.name} maps to "
                    f"{channel}; it has {present}" + nearest(column.column, map(str, table.columns))
                )
    if not any(name in channels for name in (*MOTION_CHANNELS, "latitude")):
        raise UserError(
            f"{path} has no motion channel ({', '.join(MOTION_CHANNELS)}); it has {present}. "
            "Write a mapping that says which columns are which"
        )
    return channels


def _assemble(
    values: dict[str, np.ndarray], path: Path, first_line: int, notes: list[str]
) -> Trajectory:
    """Drop rows that say nothing, check the clock, and build the record."""
    time = values.pop("t")
    lines = np.arange(time.size) + first_line
    empty = np.all([np.isnan(series) for series in values.values()], axis=0)
    # Rows that hold nothing but a counted time stamp are padding too, but a file's own time
    # stamp is a statement that a sample is missing, so such a row stays.
    dropped = empty & np.isnan(time)
    if np.any(dropped):
        notes.append(f"{EMPTY_ROWS}: {np.sum(dropped)}, first in line {lines[dropped][0]}")
    _check_clock(time[~dropped], lines[~dropped], path)
    time, lines = time[~dropped], lines[~dropped]
    repeated = np.flatnonzero(np.diff(time) == 0) + 1
    if repeated.size:
        notes.append(
            f"{REPEATED_TIMES}: {repeated.size} of {time.size}, first at "
            f"t = {time[repeated[0]]:g} s in line {lines[repeated[0]]}"
        )
    if time.size and time[0] > _EPOCH:
        zero = math.floor(time[0])
        notes.append(f"times count from {zero} s on the file's clock, the first row's second")
        time = time - zero
    table = pd.DataFrame({name: series[~dropped] for name, series in values.items()})
    table = table.groupby(time).last()
    if len(table) < 2:
        raise UserError(f"{path} has {len(table)} usable row(s); a recording needs at least two")
    values = {name: table[name].to_numpy() for name in values}
    if not any(np.any(np.isfinite(values[name])) for name in MOTION_CHANNELS if name in values):
        raise UserError(f"{path} has no finite value in any motion channel")
    return _trajectory(table.index.to_numpy(), values, path.name, notes)


def _check_clock(time: np.ndarray, lines: np.ndarray, path: Path) -> None:
    missing = np.flatnonzero(np.isnan(time))
    if missing.size:
        raise UserError(
            f"{path}, line {lines[missing[0]]}: the time is missing in a row that has data "
            f"({missing.size} such rows); fill it in, delete the row, or give [file] time_step "
            "in a mapping if the samples are equally spaced"
        )
    backwards = np.flatnonzero(np.diff(time) < 0)
    if backwards.size:
        at = backwards[0]
        raise UserError(
            f"{path}, line {lines[at + 1]}: time runs backwards, from {time[at]:.10g} s to "
            f"{time[at + 1]:.10g} s; sort the rows, or split the file if two runs were joined"
        )


def _trajectory(
    time: np.ndarray, values: dict[str, np.ndarray], name: str, notes: list[str]
) -> Trajectory:
    missing = np.full(time.shape, np.nan)
    x, y, psi, u, v, r = (values.get(channel, missing) for channel in MOTION_CHANNELS)
    actuation = {"cmd_": {}, "exec_": {}}
    for channel, series in values.items():
        for prefix, group in actuation.items():
            if channel.startswith(prefix):
                group[channel.removeprefix(prefix)] = _held(channel, series, time, notes)
    actuation = {
        prefix: {key: series for key, series in group.items() if np.any(np.isfinite(series))}
        for prefix, group in actuation.items()
    }
    return Trajectory(
        t=time,
        x=x,
        y=y,
        psi=unwrap(psi),
        u=u,
        v=v,
        r=r,
        commanded=actuation["cmd_"],
        executed=actuation["exec_"],
        extra={key: values[key] for key in EXTRA_CHANNELS if key in values},
        valid=np.ones(time.shape, dtype=bool),
        name=name,
        provenance=tuple(notes),
    )


def _repaired(run: Trajectory, mapping: Mapping) -> Trajectory:
    """The run with late channels shifted and earth velocities turned into body axes."""
    late = {
        {"latitude": "x", "longitude": "y"}.get(name, name): column.delay
        for name, column in mapping.ned_channels.items()
        if column.delay
    }
    notes = [f"{name} shifted by {-delay:g} s" for name, delay in late.items()]

    def earlier(prefix: str, group: dict) -> dict:
        return {
            name: _shifted(run.t, series, late.get(prefix + name, 0.0), holds=bool(prefix))
            for name, series in group.items()
        }

    motion = earlier("", {name: getattr(run, name) for name in MOTION_CHANNELS})
    if mapping.velocity_axes == "earth":
        body = (motion["u"] + 1j * motion["v"]) * np.exp(-1j * motion["psi"])
        motion |= {"u": body.real, "v": body.imag}
        notes.append("u and v turned from earth into body axes by the heading")
    return dataclasses.replace(
        run,
        **motion,
        commanded=earlier("cmd_", run.commanded),
        executed=earlier("exec_", run.executed),
        extra=earlier("", run.extra),
        provenance=(*run.provenance, *notes),
    )


def _shifted(t: Series, series: Series, delay: float, holds: bool) -> Series:
    """What a channel read `delay` s later; NaN beyond its ends, where actuation holds."""
    if delay == 0:
        return series
    t, series = np.asarray(t), np.asarray(series)
    if not holds:
        return np.interp(t + delay, t, series, left=np.nan, right=np.nan)
    rows = np.searchsorted(t, t + delay, side="right") - 1
    return np.where(rows < 0, np.nan, series[rows.clip(0)])


def _held(channel: str, series: np.ndarray, time: np.ndarray, notes: list[str]) -> np.ndarray:
    """The series with empty cells taking the value before; leading ones stay NaN."""
    finite = np.isfinite(series)
    if np.all(finite):
        return series
    if not np.any(finite):
        notes.append(f"{channel} has no value and is left out")
        return series
    source = np.maximum.accumulate(np.where(finite, np.arange(series.size), -1))
    leading = source < 0
    if np.any(leading):
        notes.append(f"{channel} is unknown before t = {time[finite][0]:g} s")
    filled = np.sum(~finite & ~leading)
    if filled:
        notes.append(f"{channel}: {filled} empty cells hold the value before")
    return np.where(leading, np.nan, series[source])
