"""The layout of a foreign table: encoding, delimiter, decimal sign, header and units.

Rows of numbers are told from a header by what they are, not by where they stand: the layout
is the combination of delimiter and decimal sign under which most cells of the file's body
are numbers, in rows of equal length.
"""

import codecs
import dataclasses
import itertools
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from diffsea.errors import UserError
from diffsea.recordings import logs
from diffsea.recordings.mapping_proposal.names import UNIT_WORDS, unit_in
from diffsea.recordings.mappings import Column, Mapping
from diffsea.recordings.rotations import ANGLES, quaternions_in
from diffsea.recordings.tables import (
    LARGEST_QUANTITY,
    PARQUET_SUFFIXES,
    read_table,
    split_cells,
    stamp_seconds,
    to_numbers,
)
from diffsea.trajectory import Samples


_DELIMITERS = (",", ";", "\t", "|", "whitespace")
_MISSING = {"", "nan", "na", "n/a", "null", "none"}
_JUDGED_LINES = 400  # of the body: enough to tell a delimiter, and read at once
_LONGEST_HEADER = 100  # lines; towing tanks write some dozens
_NUMBER = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"),
    ",": re.compile(r"[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?"),
}


@dataclasses.dataclass(frozen=True)
class TableLayout:
    """How one file is laid out.

    Attributes:
        names: one per column, empty where a column has none.
        units: what the header says of the unit of each column, empty where nothing.
        mapping: reads the table, every named column as a channel. It lists `columns` only where
            the header cannot be split as the rows are.
        named: false where the names were made up.
        text: false for Parquet and logs.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    mapping: Mapping
    named: bool = True
    text: bool = True


def sniff_layout(path: Path) -> TableLayout:
    """The layout of a CSV-like or Parquet file, or of a log that is one table.

    Raises:
        UserError: it is no file, or no table of numbers of at least two columns.
    """
    logged = logs.log_table(path)
    if logged is not None or path.suffix.lower() in PARQUET_SUFFIXES:
        columns = read_table(path, None).table.columns if logged is None else logged
        names = tuple(map(str, columns))
        mapping = Mapping({name: Column(name) for name in names})
        return TableLayout(names, tuple(unit_in(name) for name in names), mapping, text=False)
    lines, encoding = _first_lines(path)
    ways = [_parse_as(lines, delimiter, sign) for delimiter in _DELIMITERS for sign in ".,"]
    best = max(ways, key=lambda way: (way.share, way.width))
    if best.width < 2 or best.share <= 0:
        raise UserError(
            f"{path} has no table of numbers that could be recognised; a mapping with [file] "
            "delimiter, header_lines and columns can say how to read it"
        )
    return _layout_of_header(lines[: best.start], best, encoding)


def numeric_columns(path: Path, layout: TableLayout) -> dict[str, Samples]:
    """Every named column as floats, rows as in the file; cells that are no numbers are NaN.

    So are those that are too large to calculate with. Stamps of text are in seconds. Columns
    without any number are left out. Of rotations there are the angles, in rad, and not the parts
    of their quaternions.
    """
    logged = logs.log_table(path)
    table = read_table(path, layout.mapping).table if logged is None else pd.DataFrame(logged)
    turned = {
        start: parts
        for start, parts in quaternions_in(table.columns).items()
        if f"{start}yaw" in table
    }
    parts = set(itertools.chain(*turned.values()))
    angles = [f"{start}{name}" for start in turned for name in ANGLES]
    found = {}
    for name in dict.fromkeys([*(one for one in layout.names if one not in parts), *angles]):
        column = table[name] if name and name in table.columns else None
        if not isinstance(column, pd.Series):
            continue
        stamps = stamp_seconds(column)
        values = np.array(_numbers(column) if stamps is None else stamps, dtype=float)
        values[np.abs(values) > LARGEST_QUANTITY] = np.nan
        if np.any(np.isfinite(values)):
            found[name] = values
    return found


def _numbers(column: pd.Series) -> Samples:
    return column.to_numpy(float) if pd.api.types.is_numeric_dtype(column) else to_numbers(column)


def _first_lines(path: Path) -> tuple[list[str], str]:
    """The first lines of the file and its encoding: UTF-8 if it is that, else cp1252."""
    try:
        with path.open("rb") as file:
            start = file.read(1 << 20)
    except OSError as error:
        if path.is_file():
            raise UserError(f"cannot read {path}: {error.strerror}") from error
        start = b""
    if not start or b"\x00" in start[:4096]:
        read_table(path, None)  # says what is wrong with the file
    # The end of a part of a file may lie within a character.
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        text, encoding = decoder.decode(start), "utf-8-sig"
    except UnicodeDecodeError:
        text, encoding = start.decode("cp1252", errors="replace"), "cp1252"
    return text.splitlines()[: _JUDGED_LINES + _LONGEST_HEADER], encoding


class _WayToParse(NamedTuple):
    """What the lines of a file are under a delimiter and a decimal sign."""

    delimiter: str
    decimal: str
    share: float = 0.0  # of the body's cells that are numbers, in rows of equal length
    width: int = 0  # columns
    start: int = 0  # line at which the body starts


def _parse_as(lines: list[str], delimiter: str, decimal: str) -> _WayToParse:
    failed = _WayToParse(delimiter, decimal)
    if delimiter == decimal:
        return failed
    rows = [split_cells(line, delimiter) for line in lines]
    numeric = [[_NUMBER[decimal].fullmatch(cell) is not None for cell in row] for row in rows]
    full = [sum(flags) for flags in numeric]
    widths = [len(row) for row, count in zip(rows, full, strict=True) if count >= 2]
    if not widths:
        return failed
    width = int(np.bincount(widths).argmax())
    usual = float(np.median([c for c, row in zip(full, rows, strict=True) if len(row) == width]))
    body = [len(row) == width and c >= 0.6 * usual for row, c in zip(rows, full, strict=True)]
    start = body.index(True) if any(body) else len(rows)
    filled = [i for i in range(start, len(rows)) if lines[i].strip()]
    if not filled:
        return failed
    fitting = sum(
        1.0
        for i in filled
        for cell, flag in zip(rows[i], numeric[i], strict=True)
        if flag or cell.lower() in _MISSING
    )
    regular = float(np.mean([body[i] for i in filled]))
    # A comma within numbers makes more columns than there are, of the same cells.
    share = round(fitting / sum(len(rows[i]) for i in filled) * regular, 2)
    return _WayToParse(delimiter, decimal, share, width, start)


def _layout_of_header(header: list[str], way: _WayToParse, encoding: str) -> TableLayout:
    """The layout, with the names and units that the lines above the body have."""
    cells = {i: _header_cells(line, way) for i, line in enumerate(header)}
    named = {i: line for i, line in cells.items() if line and _has_words(line)}
    if named:
        # Units stand below the names, or above them; names are longer on the whole.
        is_unit = {i: np.mean([_is_unit(cell) for cell in row]) > 0.7 for i, row in named.items()}
        index = next((i for i in reversed(named) if not is_unit[i]), max(named))
        below = next((line for i, line in named.items() if is_unit[i] and i != index), None)
        units = [unit_in(cell) for cell in named[index]]
        if below is not None:
            units = [own or unit_in(cell) or cell for own, cell in zip(units, below, strict=True)]
        names = _unique_names(named[index])
        # A mapping finds the line of names by the names that it uses; several may have them.
        listed = split_cells(header[index], way.delimiter) != names
    else:
        names, units, listed = _unique_names([""] * way.width), [""] * way.width, True
    mapping = Mapping(
        channels={name: Column(name) for name in names if name},
        delimiter=way.delimiter,
        header_lines=len(header),
        encoding=encoding,
        decimal=way.decimal,
        columns=tuple(names) if listed else None,
    )
    return TableLayout(tuple(names), tuple(units), mapping, named=bool(named))


def _header_cells(line: str, way: _WayToParse) -> list[str] | None:
    """The cells of a header line, one per column, or None where it does not split so."""
    line = line.strip().lstrip("#%!").strip() if line.lstrip()[:1] in "#%!" else line
    splits = [split_cells(line, way.delimiter)]
    if way.delimiter == "whitespace":
        splits.append([cell.strip() for cell in re.split(r"\s{2,}|\t", line.strip())])
        splits.append(re.sub(r"\s+(?=[\[(])", "", line).split())
    splits += [split_cells(line, other) for other in ",;\t|"]
    for cells in splits:
        if len(cells) == way.width and sum(bool(cell) for cell in cells) >= 0.5 * way.width:
            return cells
    return None


def _has_words(cells: list[str]) -> bool:
    words = [cell for cell in cells if cell]
    named = [any(c.isalpha() or c in "[(°%" for c in cell) for cell in words]
    return bool(np.mean(named) > 0.6)


def _is_unit(cell: str) -> bool:
    bare = re.sub(r"[\[\](){}<>]", "", cell).strip().lower()
    return not bare or bare in UNIT_WORDS or cell.strip()[:1] in "[("


def _unique_names(cells: list[str]) -> list[str]:
    """The cells as names that are all different; empty ones stay empty if there is but one."""
    names: dict[str, None] = {}  # in order, and looked up at once: a line may have 10^5 of them
    one_empty = cells.count("") == 1
    for i, cell in enumerate(cells):
        name = cell if cell or one_empty else f"column {i + 1}"
        while name in names:
            name += f" #{i + 1}"
        names[name] = None
    return list(names)
