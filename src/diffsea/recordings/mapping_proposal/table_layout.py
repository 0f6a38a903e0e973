"""The layout of a foreign table: encoding, delimiter, decimal sign, header and units.

Rows of numbers are told from a header by what they are, not by where they stand: the layout
is the combination of delimiter and decimal sign under which most cells of the file's body
are numbers, in rows of equal length.
"""

import codecs
import dataclasses
import re
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea.errors import UserError
from diffsea.recordings.mappings import Column, Mapping
from diffsea.recordings.tables import PARQUET_SUFFIXES, read_table


_DELIMITERS = (",", ";", "\t", "|", "whitespace")
_MISSING = {"", "nan", "na", "n/a", "null", "none"}
_LINES = 400  # of the body that the layout is judged by
_LONGEST_HEADER = 100
_NUMBER = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"),
    ",": re.compile(r"[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?"),
}
_BRACKETS = re.compile(r"[\[(<{]\s*([^\])>}]*?)\s*[\])>}]")


@dataclasses.dataclass(frozen=True)
class TableLayout:
    """How one file is laid out.

    `names` has one name per column, `units` what the header says of each (`""` where nothing);
    `named` is false where the names were made up. `listed` says that a mapping has to list the
    names because the header cannot be split as the rows are.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    delimiter: str = ","
    decimal: str = "."
    encoding: str = "utf-8-sig"
    header_lines: int = 1
    listed: bool = False
    named: bool = True
    text: bool = True  # false: Parquet

    @property
    def mapping(self) -> Mapping:
        """A mapping of no channels that reads the table."""
        return Mapping(
            channels={name: Column(name) for name in self.names if name},
            delimiter=self.delimiter,
            decimal=self.decimal,
            encoding=self.encoding,
            header_lines=self.header_lines,
            columns=self.names if self.listed else None,
        )


def sniff_layout(path: Path) -> TableLayout:
    """The layout of a CSV-like or Parquet file.

    Raises `UserError` for what is no file or no table of numbers.
    """
    path = Path(path)
    if path.suffix.lower() in PARQUET_SUFFIXES:
        table, _ = read_table(path, None)
        names = tuple(map(str, table.columns))
        return TableLayout(names, tuple(unit_in(name) for name in names), text=False)
    lines, encoding = _first_lines(path)
    best = max(
        (_judged(lines, delimiter, decimal) for delimiter in _DELIMITERS for decimal in ".,"),
        key=lambda judged: judged[0],
    )
    (share, columns), delimiter, decimal, start = best
    if columns < 2 or share <= 0:
        raise UserError(
            f"{path} has no table of numbers that could be recognised; a mapping with [file] "
            "delimiter, header_lines and columns can say how to read it"
        )
    return _layout(lines[:start], delimiter, decimal, encoding, columns)


def columns_of(path: Path, layout: TableLayout) -> dict[str, np.ndarray]:
    """Every named column as floats, rows as in the file; cells that are no numbers are NaN.

    Columns without any number are left out.
    """
    table, _ = read_table(path, layout.mapping if layout.text else None)
    found = {}
    for name in layout.names:
        if name not in table.columns or not name:
            continue
        column = table[name]
        if not isinstance(column, pd.Series):
            continue
        values = np.array(pd.to_numeric(column, errors="coerce"), dtype=float)
        values[np.isinf(values)] = np.nan
        if np.any(np.isfinite(values)):
            found[name] = values
    return found


def unit_in(name: str) -> str:
    """What stands in the last brackets of a header cell, such as `deg/s`."""
    found = _BRACKETS.findall(name)
    return found[-1] if found else ""


def _first_lines(path: Path) -> tuple[list[str], str]:
    """The first lines of the file and its encoding: UTF-8 if it is that, else cp1252."""
    read_table_error = Mapping(channels={})
    try:
        with path.open("rb") as file:
            start = file.read(1 << 20)
    except OSError:
        start = b""
    if not start or b"\x00" in start[:4096]:
        read_table(path, read_table_error)  # says what is wrong with the file
    # The end of a part of a file may lie within a character.
    decoder = codecs.getincrementaldecoder("utf-8-sig")()
    try:
        text, encoding = decoder.decode(start), "utf-8-sig"
    except UnicodeDecodeError:
        text, encoding = start.decode("cp1252", errors="replace"), "cp1252"
    return text.splitlines()[: _LINES + _LONGEST_HEADER], encoding


def cells_of(line: str, delimiter: str) -> list[str]:
    separator = None if delimiter == "whitespace" else delimiter
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def _judged(
    lines: list[str], delimiter: str, decimal: str
) -> tuple[tuple[float, int], str, str, int]:
    """Share of numeric cells in the body, columns, and where the body starts."""
    if delimiter == decimal:
        return (0.0, 0), delimiter, decimal, 0
    rows = [cells_of(line, delimiter) for line in lines]
    numeric = [[_is_number(cell, decimal) for cell in row] for row in rows]
    full = [sum(flags) for flags in numeric]
    widths = [len(row) for row, count in zip(rows, full, strict=True) if count >= 2]
    if not widths:
        return (0.0, 0), delimiter, decimal, 0
    width = int(np.bincount(widths).argmax())
    usual = float(np.median([c for c, row in zip(full, rows, strict=True) if len(row) == width]))
    body = [len(row) == width and c >= 0.6 * usual for row, c in zip(rows, full, strict=True)]
    start = body.index(True) if any(body) else len(rows)
    filled = [i for i in range(start, len(rows)) if lines[i].strip()]
    if not filled:
        return (0.0, 0), delimiter, decimal, 0
    missing = sum(
        1.0
        for i in filled
        for cell, flag in zip(rows[i], numeric[i], strict=True)
        if flag or cell.lower() in _MISSING
    )
    whole = sum(len(rows[i]) for i in filled)
    regular = float(np.mean([body[i] for i in filled]))
    # A comma within numbers makes more columns than there are, of the same cells.
    return (round(missing / whole * regular, 2), width), delimiter, decimal, start


def _is_number(cell: str, decimal: str) -> bool:
    return _NUMBER[decimal].fullmatch(cell) is not None


def _layout(
    header: list[str], delimiter: str, decimal: str, encoding: str, width: int
) -> TableLayout:
    split = [_header_cells(line, delimiter, width) for line in header]
    named = [(i, cells) for i, cells in enumerate(split) if cells and _looks_named(cells)]
    if not named:
        names = tuple(f"column {i + 1}" for i in range(width))
        return TableLayout(
            names, ("",) * width, delimiter, decimal, encoding, len(header), True, named=False
        )
    # Units stand below the names, or above them; names are longer on the whole.
    is_unit = {i: np.mean([_is_unit(cell) for cell in cells]) > 0.7 for i, cells in named}
    index, cells = next(((i, c) for i, c in reversed(named) if not is_unit[i]), named[-1])
    below = next((c for i, c in named if is_unit[i] and i != index), None)
    units = [unit_in(cell) for cell in cells]
    if below is not None:
        units = [own or unit_in(cell) or cell for own, cell in zip(units, below, strict=True)]
    names = _unique(cells)
    as_rows = cells_of(header[index], delimiter) == list(names)
    # A mapping finds the line of names by the names that it uses; several lines may have them.
    return TableLayout(
        names, tuple(units), delimiter, decimal, encoding, len(header), listed=not as_rows
    )


def _header_cells(line: str, delimiter: str, width: int) -> list[str] | None:
    """The cells of a header line, one per column, or None where it does not split so."""
    line = line.strip().lstrip("#%!").strip() if line.lstrip()[:1] in "#%!" else line
    ways = [cells_of(line, delimiter)]
    if delimiter == "whitespace":
        ways.append([cell.strip() for cell in re.split(r"\s{2,}|\t", line.strip())])
        ways.append(re.sub(r"\s+(?=[\[(])", "", line).split())
    ways += [cells_of(line, other) for other in ",;\t|"]
    for cells in ways:
        if len(cells) == width - 1 and ways[0] is cells and not cells[-1]:
            continue
        if len(cells) == width and sum(bool(cell) for cell in cells) >= 0.5 * width:
            return cells
    return None


def _looks_named(cells: list[str]) -> bool:
    words = [cell for cell in cells if cell]
    return np.mean([any(c.isalpha() or c in "[(°%" for c in cell) for cell in words]) > 0.6


def _is_unit(cell: str) -> bool:
    bare = re.sub(r"[\[\](){}<>]", "", cell).strip().lower()
    return not bare or bare in UNIT_WORDS or cell.strip()[:1] in "[("


# What stands for a unit in headers -> the unit of a mapping; what no mapping knows is "?".
UNIT_WORDS = {
    "s": "s", "sec": "s", "second": "s", "seconds": "s", "sek": "s", "ms": "ms", "msec": "ms",
    "us": "us", "µs": "us", "usec": "us", "ns": "ns", "min": "min", "h": "h",
    "m": "m", "metre": "m", "meter": "m", "metres": "m", "meters": "m", "mm": "mm", "cm": "cm",
    "km": "km", "ft": "ft", "nm": "nmi", "nmi": "nmi", "rad": "rad", "radian": "rad",
    "radians": "rad", "deg": "deg", "degs": "deg", "degree": "deg", "degrees": "deg",
    "grad": "deg", "°": "deg", "º": "deg", "rad/s": "rad/s", "rad/sec": "rad/s", "radps": "rad/s",
    "rads": "rad/s", "rad s-1": "rad/s", "rad.s-1": "rad/s", "deg/s": "deg/s", "°/s": "deg/s",
    "º/s": "deg/s", "deg/sec": "deg/s", "degps": "deg/s", "dps": "deg/s", "deg s-1": "deg/s",
    "deg/min": "deg/min", "°/min": "deg/min", "degpm": "deg/min", "m/s": "m/s", "mps": "m/s",
    "m/sec": "m/s", "m s-1": "m/s", "m.s-1": "m/s", "km/h": "km/h", "kmh": "km/h",
    "kph": "km/h", "kn": "kn", "kt": "kn", "kts": "kn", "knot": "kn", "knots": "kn",
    "knoten": "kn", "ft/s": "ft/s", "n": "N", "newton": "N", "kn force": "kN", "kgf": "kgf",
    "lbf": "lbf", "rev/s": "rev/s", "1/s": "rev/s", "rps": "rps", "hz": "Hz", "rpm": "rpm",
    "1/min": "rpm", "rev/min": "rpm", "u/min": "rpm", "%": "%", "percent": "%", "pct": "%",
    "-": "1", "1": "1", "m/s2": "?", "m/s^2": "?", "m/s²": "?", "nm torque": "?", "n.m": "?",
    "v": "?", "volt": "?", "a": "?", "w": "?", "kw": "?", "deg/s2": "?", "rad/s2": "?",
    "deg/s^2": "?", "rad/s^2": "?",
}  # fmt: skip


def _unique(cells: list[str]) -> tuple[str, ...]:
    """The cells as names that are all different; empty ones stay empty if there is but one."""
    names: list[str] = []
    for i, cell in enumerate(cells):
        name = cell if cell or cells.count("") == 1 else f"column {i + 1}"
        while name in names:
            name += f" #{i + 1}"
        names.append(name)
    return tuple(names)
