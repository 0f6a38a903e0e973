"""A folder of tables of one run: every table a stream on its own rows, all on one clock."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea.errors import UserError
from diffsea.recordings.logs.streams import Stream, list_fields
from diffsea.recordings.mappings import Column, Mapping
from diffsea.recordings.tables import (
    PARQUET_SUFFIXES,
    clock_column,
    numeric_column,
    read_table,
    stamp_seconds,
)


_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", *PARQUET_SUFFIXES)


def is_folder(path: Path) -> bool:
    """Whether a folder holds at least two tables."""
    return len(_tables(path)) > 1


def contents(path: Path) -> dict[str, list[str]]:
    """The columns of numbers or of stamps of every table; none of a table that is broken."""
    found = {}
    for topic, file in _tables(path).items():
        try:
            table = read_table(file, None).table
        except UserError:
            found[topic] = []
            continue
        found[topic] = [
            str(name)
            for name, column in table.items()
            if pd.api.types.is_numeric_dtype(column) or stamp_seconds(column) is not None
        ]
    return found


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the tables that the folder has, by the names of their files.

    A table's time is its own column of the name that the mapping's t has, in the unit of t, or
    what [file] times says for the table. All times count from one zero.

    Raises:
        UserError: a table cannot be read or lacks a mapped column or its time, or has cells
            that are no numbers.
    """
    tables = _tables(path)
    return {topic: _stream(tables[topic], topic, mapping) for topic in topics if topic in tables}


def _tables(path: Path) -> dict[str, Path]:
    """The tables of a folder by topic: the file's name, without what follows its last dot.

    Where two files would have one name, each has its whole one.
    """
    files = [file for file in sorted(path.iterdir()) if file.suffix.lower() in _SUFFIXES]
    stems = [file.stem for file in files]
    return {file.stem if stems.count(file.stem) == 1 else file.name: file for file in files}


def _stream(file: Path, topic: str, mapping: Mapping) -> Stream:
    """The columns of a table that the mapping names, over the table's time in s."""
    fields = {
        name.rpartition(":")[2]
        for column in mapping.channels.values()
        for name in column.names
        if name.rpartition(":")[0] == topic
    }
    clock = _clock(topic, mapping)
    names = sorted({*fields, clock.column})
    wanted = {name: Column(name) for name in names}
    table, first_line, cut_off = read_table(file, dataclasses.replace(mapping, channels=wanted))
    missing = [name for name in names if name not in table.columns]
    if missing:
        has = list_fields({topic: [str(name) for name in table.columns]})
        how = (
            f'; if its time has another name, say so under [file]: times = {{ {topic} = "..." }}'
            if missing == [clock.column]
            else ""
        )
        raise UserError(f"{file} has no column {missing[0]!r}{how}. It has\n{has}")
    t = clock_column(table, clock, str(file), first_line) * clock.gain + clock.shift
    known = np.isfinite(t)
    series = {name: numeric_column(table, name, str(file), first_line)[known] for name in fields}
    said = f"the column {clock.column!r}"
    return Stream(topic, t[known], series, said, _left_out(topic, known), cut_off=cut_off)


def _left_out(topic: str, known: np.ndarray) -> tuple[str, ...]:
    rows = int(np.sum(~known))
    return (f"{topic}: {rows} rows without a time are left out",) if rows else ()


def _clock(topic: str, mapping: Mapping) -> Column:
    """The column of a table's time.

    Raises:
        UserError: the mapping names none.
    """
    if topic in mapping.times:
        return mapping.times[topic]
    if "t" not in mapping.channels:
        raise UserError(
            f"{mapping.name}: {topic} is a table and needs its time: give the channel t, for "
            f'instance t = "time", or under [file] times = {{ {topic} = "time" }}'
        )
    shared = mapping.channels["t"]
    return Column(shared.topic_and_field[1], shared.unit, shared.sign, shared.scale, shared.offset)
