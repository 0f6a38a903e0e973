"""Numbers of TOML tables, checked: every message names the table and the key.

`where` is the table's name in messages, such as `[hull]`.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from diffsea.errors import UserError, nearest


Table = dict[str, Any]


def check_keys(table: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    """Raise `UserError` for a key that is not known, with the nearest one, or else all."""
    for key in table:
        if key not in keys:
            hint = nearest(key, keys) or f"; known are {', '.join(keys)}"
            raise UserError(f"unknown key {key!r} in {where}{hint}")


def tables_of(document: Table, kind: str) -> list[Table]:
    """The tables of an array `[[kind]]`; none where there is no such array.

    Raises `UserError` for a table in single brackets.
    """
    tables = document.get(kind, [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise UserError(f"write [[{kind}]] with double brackets: there can be several")
    return tables


def optional_number(table: Mapping[str, Any], key: str, where: str) -> float | None:
    """A finite number, None where the key is missing. Raises `UserError` for anything else."""
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"{where}: {key} = {value!r} is not a finite number")
    return float(value)


def needed(table: Mapping[str, Any], key: str, where: str) -> float:
    """A finite number that must be there."""
    value = optional_number(table, key, where)
    if value is None:
        raise UserError(f"{where}: {key} is missing")
    return value


def numbers(table: Mapping[str, Any], keys: Iterable[str], where: str) -> dict[str, float]:
    """Those of some numbers that a table has. Raises `UserError` for one that is not finite."""
    return {key: needed(table, key, where) for key in keys if key in table}


def positive(table: Mapping[str, Any], key: str, where: str) -> float:
    """A number above zero that must be there."""
    value = needed(table, key, where)
    if not value > 0:
        raise UserError(f"{where}: {key} = {value:g} must be positive")
    return value
