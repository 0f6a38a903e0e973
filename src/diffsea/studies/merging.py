"""One table of the parts of a sweep, and its summary, one part in memory at a time."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float

from diffsea.errors import UserError
from diffsea.studies.parts import Parts


BINS = 4096  # of a histogram that narrows down where a median is
COLLECTED = 1_000_000  # values among which it is looked for at last
_TOLD = 6  # numbers of missing parts

Chunks = Callable[[], Iterator[Float[np.ndarray, "value"]]]


def merge(parts: Parts, target: Path) -> None:
    """Write the table of all parts; columns that hold nothing in any are left out.

    Raises:
        UserError: parts are missing, or one cannot be read.
    """
    missing = list(parts.missing())
    if missing:
        some = ", ".join(map(str, missing[:_TOLD])) + (", ..." if len(missing) > _TOLD else "")
        raise UserError(
            f"{len(missing)} of {parts.count} parts are missing in {parts.folder} (numbers {some} "
            "from 0 on): run the sweep again, or the shards that did not end"
        )
    schema = _schema(parts)
    with target.open("wb") as opened, pq.ParquetWriter(opened, schema) as writer:
        for number in range(parts.count):
            table = _read(parts, number)
            columns = [
                table[field.name] if field.name in table.column_names else _nulls(table, field)
                for field in schema
            ]
            writer.write_table(pa.table(columns, schema=schema))


def _nulls(table: pa.Table, field: pa.Field) -> pa.Array:
    return pa.nulls(table.num_rows, field.type)


def _read(parts: Parts, number: int) -> pa.Table:
    try:
        return pq.read_table(parts.file(number))
    except (OSError, pa.ArrowException) as error:
        raise UserError(
            f"cannot read {parts.file(number)}: {error}; delete it and run the sweep again"
        ) from None


def _schema(parts: Parts) -> pa.Schema:
    """Parameters, numbers, verdicts by name and the outcome: what holds anything in any part."""
    types: dict[str, pa.DataType] = {}
    filled = set(parts.manifest["parameters"])
    for number in range(parts.count):
        file = pq.ParquetFile(parts.file(number))
        types |= dict(zip(file.schema_arrow.names, file.schema_arrow.types, strict=True))
        for group in range(file.metadata.num_row_groups):
            row_group = file.metadata.row_group(group)
            for k in range(row_group.num_columns):
                column = row_group.column(k)
                if column.statistics is None or column.statistics.null_count < row_group.num_rows:
                    filled.add(column.path_in_schema)
    verdicts = sorted(name for name in types if name.startswith("imo_"))
    others = [name for name in types if name not in (*verdicts, "outcome")]
    names = [name for name in (*others, *verdicts, "outcome") if name in filled]
    return pa.schema([(name, types[name]) for name in names])


def summarise(table: Path, parameters: list[str]) -> dict[str, Any]:
    """The content of sweep.json but what was swept: counts of outcomes and of IMO verdicts; least,
    median and most of each number, with the designs of its ends, and the ends of each parameter, in
    SI units."""
    file = pq.ParquetFile(table)

    def values(name: str) -> Chunks:
        def chunks() -> Iterator[np.ndarray]:
            for batch in file.iter_batches(columns=[name]):
                column = batch.column(0).to_numpy(zero_copy_only=False).astype(float)
                yield column[~np.isnan(column)]

        return chunks

    def counts(name: str) -> Counter[str]:
        found: Counter[str] = Counter()
        for batch in file.iter_batches(columns=[name]):
            found.update(batch.column(0).drop_null().to_pylist())
        return found

    names = file.schema_arrow.names
    numbers = [
        name
        for name in names
        if name not in parameters and file.schema_arrow.field(name).type == pa.float64()
    ]
    verdicts = {name: counts(name) for name in names if name.startswith("imo_")}
    ends = {name: extent(values(name)) for name in parameters}
    return {
        "designs": file.metadata.num_rows,
        "parameters": {n: {"from": one["least"], "to": one["most"]} for n, one in ends.items()},
        "outcomes": dict(counts("outcome").most_common()),
        "metrics": {
            name: extent(values(name)) | _designs_of_ends(file, name, parameters)
            for name in numbers
        },
        "imo": {
            name.removeprefix("imo_"): {word: found[word] for word in ("pass", "fail")}
            for name, found in verdicts.items()
        },
    }


def row_batches(table: Path) -> Iterator[pd.DataFrame]:
    """A merged table, a part of its rows at a time."""
    for batch in pq.ParquetFile(table).iter_batches():
        yield batch.to_pandas()


def every_nth(table: Path, step: int) -> pd.DataFrame:
    """Every `step`-th row of a merged table, from the first on."""
    kept, begun = [], 0
    for rows in row_batches(table):
        kept.append(rows.iloc[-begun % step :: step])
        begun += len(rows)
    return pd.concat(kept, ignore_index=True)


def extent(chunks: Chunks) -> dict[str, Any]:
    """Least, median and most of some values, and how many `designs` have one."""
    count, low, high = 0, np.inf, -np.inf
    for chunk in filter(len, chunks()):
        count, low, high = count + len(chunk), min(low, chunk.min()), max(high, chunk.max())
    middle = [_of_rank(chunks, rank, low, high) for rank in ((count - 1) // 2, count // 2)]
    return {
        "least": float(low),
        "median": float(np.mean(middle)),
        "most": float(high),
        "designs": count,
    }


def _designs_of_ends(
    file: pq.ParquetFile, number: str, parameters: list[str]
) -> dict[str, dict[str, float] | None]:
    """The parameters of the designs with the least and the most of a number, the first of several.

    None where no design has it.
    """
    found: dict[str, tuple[float, dict[str, float]]] = {}
    for batch in file.iter_batches(columns=[number, *parameters]):
        rows = batch.to_pandas().dropna(subset=[number])
        for end, sign in (("least", 1.0), ("most", -1.0)):
            if len(rows) == 0:
                continue
            row = rows.iloc[int(np.argmin(sign * rows[number].to_numpy()))]
            if end not in found or sign * row[number] < sign * found[end][0]:
                found[end] = float(row[number]), {name: float(row[name]) for name in parameters}
    return {f"{end}_design": found[end][1] if end in found else None for end in ("least", "most")}


def _of_rank(chunks: Chunks, rank: int, low: float, high: float) -> float:
    """The value of a rank, from 0 on, among values that all lie between two.

    Bins narrow them down until those left can be held.
    """
    below, left = 0, np.inf  # values less than `low`, and those from `low` to `high`
    while high > low and left > COLLECTED:
        edges = np.linspace(low, high, BINS + 1)
        counts = np.zeros(BINS, int)
        for chunk in chunks():
            counts += np.histogram(chunk, edges)[0]
        place = int(np.searchsorted(np.cumsum(counts), rank - below, side="right"))
        below += int(np.sum(counts[:place]))
        narrowed = float(edges[place]), float(edges[place + 1])
        left = sum(np.count_nonzero(_between(chunk, *narrowed)) for chunk in chunks())
        if narrowed == (low, high):  # neighbouring numbers: nothing lies between them
            return low
        low, high = narrowed
    if not high > low:
        return float(low)
    inside = np.concatenate([chunk[_between(chunk, low, high)] for chunk in chunks()])
    return float(np.partition(inside, rank - below)[rank - below])


def _between(chunk: np.ndarray, low: float, high: float) -> Bool[np.ndarray, "value"]:
    return (chunk >= low) & (chunk <= high)
