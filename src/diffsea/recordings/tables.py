"""Tables as they stand in files: names, rows and numbers, before anybody knows what they mean."""

import csv
import itertools
import mmap
import re
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from diffsea.errors import UserError, nearest
from diffsea.outside.sizes import check_size
from diffsea.recordings.mappings import CHANNEL_DIMENSIONS, Column, Mapping
from diffsea.recordings.rotations import angles_in, quaternions_in
from diffsea.trajectory import Samples


PARQUET_SUFFIXES = (".parquet", ".pq")
MOST_COLUMNS = 20_000
LARGEST_QUANTITY = 1e100  # in any unit; sums of larger squares are no numbers
# pandas 2 ends the process on it: its parser of numbers counts the exponent in 32 bits.
_LONG_EXPONENT = re.compile(rb"[0-9.][eE][+-]?[0-9]{9,}")
_LAST_LINES = 1 << 20  # bytes that hold them
_NEARLY_ONE = 0.01  # off which the length of a rotation may be
_HALF_A_DAY = 43_200.0  # s by which a time of day falls where the next day begins


class TableFile(NamedTuple):
    """A table as it stands in a file.

    Attributes:
        first_line: the number that its first row has in messages.
        cut_off: that the file ends within a row, which is left out, in words; else empty.
    """

    table: pd.DataFrame
    first_line: int
    cut_off: str = ""


def read_table(path: Path, mapping: Mapping | None) -> TableFile:
    """The table in a file: Parquet by the suffix, else CSV as `mapping` says, or comma-separated.

    Quaternions among its columns give further columns, of roll, pitch and yaw. Raises `UserError`
    for what is no file, no text or no table.
    """
    found = _read_file(path, mapping)
    return found._replace(table=_with_angles(found.table))


def _with_angles(table: pd.DataFrame) -> pd.DataFrame:
    """A table with the angles (rad) of its rotations after its own columns."""
    parts: dict[str, Samples] = {}
    quaternions = quaternions_in(table.columns) if table.columns.is_unique else {}
    for several in quaternions.values():
        numbers = {name: to_numbers(pd.Series(table[name])) for name in several}
        with np.errstate(over="ignore"):
            square = np.sum(np.square([*numbers.values()]), axis=0)
        known = np.isfinite(square)
        if known.any() and abs(np.median(np.sqrt(square[known])) - 1) < _NEARLY_ONE:
            parts |= numbers
    angles = {name: angle for name, angle in angles_in(parts).items() if name not in table}
    if not angles:
        return table
    return pd.concat([table, pd.DataFrame(angles, index=table.index)], axis=1)


def _read_file(path: Path, mapping: Mapping | None) -> TableFile:
    """The table as it stands there."""
    _check_file(path)
    if path.suffix.lower() in PARQUET_SUFFIXES:
        try:
            table = _read_parquet(path)
        except (UserError, MemoryError):
            raise
        except Exception as error:  # pyarrow raises many kinds for a broken file
            raise UserError(f"{path} cannot be read as Parquet: {error}") from error
        return TableFile(table.rename(columns=str), 1)
    mapping = Mapping(channels={}) if mapping is None else mapping
    names, skipped = _find_header(path, mapping)
    table = _read_csv(path, mapping, names, skipped)
    if not _ends_within_a_row(path, mapping.delimiter, mapping.encoding):
        return TableFile(table, skipped + 1)
    told = f"{path.name} ends within a row, which is left out; what is before it is used"
    return TableFile(table.iloc[:-1], skipped + 1, told)


def _read_parquet(path: Path) -> pd.DataFrame:
    """The table of a Parquet file, whose size is known before it is expanded.

    Columns of text are read as the distinct texts and numbers of them, so that one long text in
    many rows is seen before it is repeated. Columns of lists and structures, of which none is a
    series of numbers and rows do not tell the size, are not read. Raises `UserError` above the
    limit.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    parts = pq.ParquetFile(path).metadata
    # Of groups of rows alone: a damaged statistic of a column would end the process there.
    groups = [parts.row_group(k) for k in range(parts.num_row_groups)]
    rows = max(parts.num_rows, sum(group.num_rows for group in groups))
    numbers = max(sum(group.total_byte_size for group in groups), 8 * rows * parts.num_columns)
    check_size(path, numbers)
    whole = pq.read_schema(path)
    fields = [field for field in whole if not pa.types.is_nested(field.type)]
    is_flat = len(fields) == len(whole)
    schema = whole if is_flat else pa.schema(fields)
    read = None if is_flat else schema.names
    is_text = lambda kind: pa.types.is_string(kind) or pa.types.is_binary(kind)
    texts = [field.name for field in schema if is_text(field.type)]
    table = pq.ParquetFile(path, read_dictionary=texts).read(columns=read)
    size = numbers
    for name in set(texts):
        for column in (table.column(k) for k in table.schema.get_all_field_indices(name)):
            for chunk in column.chunks:
                if pa.types.is_dictionary(chunk.type):
                    lengths = pc.call_function("binary_length", [chunk.dictionary]).take(
                        chunk.indices
                    )
                    size += (pc.call_function("sum", [lengths]).as_py() or 0) + 64 * len(chunk)
    check_size(path, size)
    return table.cast(schema).to_pandas()


def numeric_column(table: pd.DataFrame, name: str, place: str, first_line: int) -> Samples:
    """A column as floats, empty cells as NaN.

    `first_line` is the number of the first row in the messages on the `place`. Raises `UserError`
    for text and infinities.
    """
    column = pd.Series(table[name])
    if column.dtype == bool or pd.api.types.is_numeric_dtype(column):
        values = column.to_numpy(dtype=float, na_value=np.nan)
    else:
        values = to_numbers(column)
        bad = np.flatnonzero(np.isnan(values) & ~column.isna().to_numpy())
        if bad.size:
            cell = column.iloc[bad[0]]
            hint = (
                '; if the decimal sign is a comma, say so with [file] decimal = ","'
                if isinstance(cell, str) and cell.replace(",", "", 1).lstrip("-").isdigit()
                else "; leave the cell empty where a sample is missing"
            )
            raise UserError(
                f"{place}, line {bad[0] + first_line}, column {name!r}: {cell!r} is not "
                f"a number ({bad.size} such cells){hint}"
            )
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise UserError(
            f"{place}, line {infinite[0] + first_line}, column {name!r}: the value is "
            "infinite; leave the cell empty where a sample is missing"
        )
    return values


def to_numbers(column: pd.Series) -> Samples:
    """Cells of text as floats, NaN where one is no number."""
    text = column.astype(str)
    long = text.str.contains(_LONG_EXPONENT.pattern.decode(), regex=True, na=False)
    return np.asarray(pd.to_numeric(column.mask(long), errors="coerce"), dtype=float)


def clock_column(table: pd.DataFrame, column: Column, place: str, first_line: int) -> Samples:
    """A column of time as floats: numbers as they are, stamps of text or dates in seconds.

    Raises `UserError` as `numeric_column` does, and for stamps that a mapping has in another unit.
    """
    stamps = stamp_seconds(pd.Series(table[column.column]))
    if stamps is None:
        return numeric_column(table, column.column, place, first_line)
    if column.unit not in (None, "s"):
        raise UserError(
            f"{place}, column {column.column!r} has stamps of dates or times, which are read in "
            f"seconds; leave unit = {column.unit!r} out of the mapping"
        )
    return stamps


def stamp_seconds(column: pd.Series) -> Samples | None:
    """Seconds of stamps of text or dates, empty cells as NaN; None where any cell is no stamp.

    Times of day, which go on beyond midnight, durations (`0 days 00:00:01.5`), and dates with
    times, from 1970 on.
    """
    if column.dtype == bool or pd.api.types.is_numeric_dtype(column):
        return None
    if pd.api.types.is_datetime64_any_dtype(column):
        stamps = column
    else:
        text = column.dropna().astype(str)
        if text.empty or not text.str.contains(":").all():
            return None
        spans = pd.to_timedelta(text, errors="coerce")
        if spans.notna().all():
            return _beyond_midnight(spans.dt.total_seconds().reindex(column.index))
        stamps = _dates_of(text)
        if stamps is None:
            return None
    since = stamps - pd.Timestamp(0, tz=stamps.dt.tz)
    return since.dt.total_seconds().reindex(column.index).to_numpy(dtype=float)


def _beyond_midnight(of_day: pd.Series) -> Samples:
    """Times of day (s) that go on where the next day begins; durations as they are."""
    seconds = np.array(of_day, dtype=float)
    known = np.isfinite(seconds)
    back = np.diff(seconds[known], prepend=seconds[known][0]) < -_HALF_A_DAY
    seconds[known] += 2 * _HALF_A_DAY * np.cumsum(back)
    return seconds


def _dates_of(text: pd.Series) -> pd.Series | None:
    """Dates with times, of months or of days first, whichever makes the run shorter."""
    found = []
    for days_first in (False, True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # pandas' remarks on days before months
            stamps = pd.to_datetime(text, errors="coerce", dayfirst=days_first, utc=True)
            if stamps.isna().any():  # not all written alike: slower, one by one
                stamps = pd.to_datetime(
                    text, errors="coerce", format="mixed", dayfirst=days_first, utc=True
                )
        if stamps.notna().all():
            found.append(stamps)
    return min(found, key=lambda stamps: stamps.max() - stamps.min(), default=None)


def _check_file(path: Path) -> None:
    """Raises `UserError` for a folder, a file that is missing, unreadable or empty, or no text."""
    if path.is_dir():
        raise UserError(f"{path} is a folder; name a CSV or Parquet file in it")
    if not path.exists():
        siblings = [item.name for item in path.parent.glob("*")] if path.parent.is_dir() else []
        raise UserError(f"there is no recording {path}{nearest(path.name, siblings)}")
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(4096)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error
    check_size(path, size)
    if size == 0:
        raise _empty_error(path)
    if path.suffix.lower() not in PARQUET_SUFFIXES and b"\x00" in start:
        raise UserError(
            f"{path} is not text, so it cannot be read as CSV; export it as CSV (UTF-8) or Parquet"
        )


def _empty_error(path: Path) -> UserError:
    return UserError(f"{path} is empty; a recording has a line of names and rows of numbers")


def split_cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line without their quotes; a delimiter within quotes parts none.

    Raises:
        UserError: a cell in quotes that is longer than any text of a table.
    """
    if '"' in line and len(delimiter) == 1:
        try:
            cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
        except csv.Error as error:
            raise UserError(f"the line that begins {line[:40]!r} cannot be read: {error}") from None
    else:
        cells = line.split(None if delimiter == "whitespace" else delimiter)
    return [cell.strip().strip('"').strip() for cell in cells]


def _find_header(path: Path, mapping: Mapping) -> tuple[list[str], int]:
    """Column names, and how many lines stand before the first row of numbers.

    Raises `UserError` for text in another encoding, for no text at all (a byte order mark is none)
    and for a wanted name that stands twice. Where the file names its columns, the line that holds
    most of the wanted names is taken: units often stand on a line of their own, before or after.
    """
    if mapping.columns is not None:
        return list(mapping.columns), mapping.header_lines or 0
    count = 1 if mapping.header_lines is None else mapping.header_lines
    try:
        with path.open(encoding=mapping.encoding) as file:
            first = list(itertools.islice(file, count + 1))
    except UnicodeError as error:
        raise _encoding_error(path, mapping, error) from error
    if not first:
        raise _empty_error(path)
    lines = [split_cells(line, mapping.delimiter) for line in first]
    mapped = (column.names for column in mapping.channels.values())
    wanted = set(itertools.chain(*mapped)) or CHANNEL_DIMENSIONS
    hits = [sum(name in wanted for name in names) for names in lines]
    best = max(range(len(lines)), key=lambda index: hits[index])
    if hits[best] == 0:
        best = max(0, min(count, len(lines)) - 1)
    names = lines[best]
    times = Counter(names)
    repeated = [name for name in names if name in wanted and times[name] > 1]
    if repeated:
        raise UserError(
            f"{path}, line {best + 1}: the column {repeated[0]!r} appears twice; rename one, "
            "or list all names under [file] columns of a mapping"
        )
    skipped = max(count, best + 1)
    _check_width(path, mapping, names, skipped)
    return names, skipped


def _check_width(path: Path, mapping: Mapping, names: list[str], skipped: int) -> None:
    """Raises `UserError` where the first row has values beyond the names: which is whose?

    A delimiter at the end of every line is common and harmless.
    """
    with path.open(encoding=mapping.encoding) as file:
        line = next(itertools.islice(file, skipped, None), "")
    cells = split_cells(line, mapping.delimiter)
    if any(cells[len(names) :]):
        raise UserError(
            f"{path}, line {skipped + 1}: {len(cells)} values, and {len(names)} names above them: "
            "which value has which name? Complete the names, or list all of them under [file] "
            "columns of a mapping"
        )


def _ends_within_a_row(path: Path, delimiter: str, encoding: str) -> bool:
    """Whether the last line has no end and fewer cells than the one before it.

    One that was cut off within its last cell cannot be told from one that ends there.
    """
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - _LAST_LINES, 0))
        last = file.read().decode(encoding, errors="replace").split("\n")[-2:]
    if len(last) < 2 or not last[1]:
        return False
    before, cut = (split_cells(line, delimiter) for line in last)
    return len(cut) < len(before) or (not cut[-1] and bool(before[-1]))


def _check_exponents(path: Path) -> None:
    """Raises `UserError` for a number whose exponent has more digits than any number means."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        found = _LONG_EXPONENT.search(content)
        if found is not None:
            line = content[: found.start()].count(b"\n") + 1
            raise UserError(
                f"{path}, line {line}: {found[0][:20].decode()} has an exponent that no number "
                "has; leave the cell empty where a sample is missing"
            )


def _encoding_error(path: Path, mapping: Mapping, error: UnicodeError) -> UserError:
    name = mapping.encoding.removesuffix("-sig")
    at = f"byte {error.start}: " if isinstance(error, UnicodeDecodeError) else ""
    reason = error.reason if isinstance(error, UnicodeDecodeError) else str(error)
    return UserError(
        f"{path} is not {name} text ({at}{reason}); say which with "
        "[file] encoding of a mapping, often 'cp1252'"
    )


def _read_csv(path: Path, mapping: Mapping, names: list[str], skipped: int) -> pd.DataFrame:
    """The rows below the header; a name that stands there twice gets its place as a suffix."""
    counts = Counter(names)
    if len(names) > MOST_COLUMNS:
        raise UserError(
            f"{path} has {len(names)} columns, and this reads at most {MOST_COLUMNS}; check the "
            f"delimiter ({mapping.delimiter!r})"
        )
    labels = [name if counts[name] == 1 else f"{name} #{i}" for i, name in enumerate(names)]
    _check_exponents(path)
    delimiter = mapping.delimiter if len(mapping.delimiter) == 1 else re.escape(mapping.delimiter)
    try:
        with warnings.catch_warnings():
            # A delimiter at the end of every line is common and harmless.
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            return pd.read_csv(
                path,
                sep=r"\s+" if mapping.delimiter == "whitespace" else delimiter,
                skiprows=skipped,
                header=None,
                names=labels,
                index_col=False,
                decimal=mapping.decimal,
                encoding=mapping.encoding,
                skip_blank_lines=False,
                skipinitialspace=True,
            )
    except UnicodeError as error:
        raise _encoding_error(path, mapping, error) from error
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OverflowError) as error:
        raise UserError(
            f"{path} cannot be read as a table: {str(error).strip()}; check the delimiter "
            f"({mapping.delimiter!r}) and the number of header lines ({skipped})"
        ) from error
