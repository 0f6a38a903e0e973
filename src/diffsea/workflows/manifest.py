"""The manifest of a fleet: which recordings are of which boat, and what each is for."""

import csv
import pathlib
from collections.abc import Iterator
from typing import Any

import pandas as pd

from diffsea.errors import UserError
from diffsea.vessel.files import shipped_vessels


COLUMNS = ("boat", "vessel", "recording", "mapping", "role")
ROLES = ("train", "test")


def read_manifest(given: pd.DataFrame | str | pathlib.Path) -> list[dict[str, Any]]:
    """A task for each boat: `boat`, `vessel` and `recordings`, each `recording` with its `name`
    among those of the boat, `mapping` or None, and `role`.

    Raises:
        UserError: it cannot be read, lacks a column or a cell, has an unknown role, a boat of two
            vessels or without a recording to fit, or a recording twice.
    """
    is_table = isinstance(given, pd.DataFrame)
    where = "the manifest" if is_table else str(given)
    folder = pathlib.Path() if is_table else pathlib.Path(given).parent
    tasks: dict[str, dict[str, Any]] = {}
    paths: set[tuple[str, str]] = set()  # of each boat
    names: set[tuple[str, str]] = set()
    shipped = shipped_vessels()
    for number, row in _table_cells(given) if is_table else _file_cells(given):
        cells = {name: row.get(name, "").strip() for name in COLUMNS}
        line = f"{where}, line {number}"
        empty = [name for name in COLUMNS[:3] if not cells[name]]
        if empty:
            raise UserError(f"{line}: {empty[0]} is empty")
        role = cells["role"] or ROLES[0]
        if role not in ROLES:
            raise UserError(f"{line}: the role is {' or '.join(ROLES)}, not {role!r}")
        boat, vessel = cells["boat"], cells["vessel"]  # a file beside it, or one that ships
        vessel = vessel if vessel in shipped else str(folder / vessel)
        task = tasks.setdefault(boat, {"boat": boat, "vessel": vessel, "recordings": []})
        if task["vessel"] != vessel:
            raise UserError(f"{line}: boat {boat!r} has another vessel before")
        path = str(folder / cells["recording"])
        if (boat, path) in paths:
            raise UserError(f"{line}: boat {boat!r} has {cells['recording']} twice")
        mapping = str(folder / cells["mapping"]) if cells["mapping"] else None
        name = pathlib.Path(path).name
        name = path if (boat, name) in names else name
        paths.add((boat, path))
        names.add((boat, name))
        one = {"recording": path, "name": name, "mapping": mapping, "role": role}
        task["recordings"].append(one)
    if not tasks:
        raise UserError(f"{where} names no recording")
    for task in tasks.values():
        if all(one["role"] == "test" for one in task["recordings"]):
            raise UserError(f"{where}: boat {task['boat']!r} has no recording of the role train")
    return list(tasks.values())


def _table_cells(table: pd.DataFrame) -> Iterator[tuple[int, dict[str, str]]]:
    """Rows of a table as text, numbered as lines of a file would be."""
    _require_columns(list(table.columns), "the manifest")
    names = [name for name in COLUMNS if name in table]
    text = table[names].astype(object)
    for number, row in enumerate(text.where(text.notna(), "").astype(str).to_numpy(), 2):
        yield number, dict(zip(names, row, strict=True))


def _file_cells(path: str | pathlib.Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Rows of a CSV with the numbers of their lines."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, skipinitialspace=True)
            names = [name.strip() for name in next(reader, [])]
            _require_columns(names, str(path))
            for row in filter(None, reader):
                if any(cell.strip() for cell in row[len(names) :]):
                    raise UserError(
                        f"{path}, line {reader.line_num}: more cells than columns; write a name "
                        'with a comma in quotation marks: "one, early.csv"'
                    )
                yield reader.line_num, dict(zip(names, row, strict=False))
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, csv.Error) as error:
        raise UserError(f"{path} cannot be read as CSV: {error}") from None


def _require_columns(names: list[str], where: str) -> None:
    twice = [name for name in COLUMNS if names.count(name) > 1]
    if twice:
        raise UserError(f"{where} has two columns {twice[0]!r}")
    missing = [name for name in COLUMNS[:3] if name not in names]
    if missing:
        raise UserError(
            f"{where} has no column {missing[0]!r}; a manifest has the columns {', '.join(COLUMNS)}"
        )
