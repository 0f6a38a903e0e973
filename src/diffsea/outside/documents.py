"""TOML and JSON files from outside: one loader each, bounded, with one-line messages.

A document is refused as a whole where it is larger than `LARGEST`, nested deeper than `DEEPEST`,
or has a value that none of the package's files can mean: a date, an integer beyond 64 bits, a
number too large or too small for arithmetic. What a key may be is for its reader to say.
"""

import datetime
import json
import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from diffsea.errors import UserError


LARGEST = 4_000_000  # bytes of a TOML file; sheets and vessels have some kilobytes
LARGEST_RESULT = 200_000_000  # bytes of a JSON file, a result of this package
DEEPEST = 24  # tables and lists within one another
_LONGEST_KEY = 60  # letters that a message has of one
_GREATEST, _LEAST = 1e100, 1e-100  # beyond them squares and products overflow or vanish


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """The tables of a TOML file.

    `what` is the file in messages, such as `the mapping`. `nan` and `inf` pass: the readers of
    numbers refuse them by name.

    Raises:
        UserError: the file cannot be read, is too large, no TOML, nested too deep, or has a value
            that no file of this package has; in one line, with the file and the key.
    """
    where = f"cannot read {what} {path}"
    return parse_toml(_text(path, where, LARGEST), where)


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises `UserError` as `read_toml`, beginning with `where`."""
    return _parsed(lambda: tomllib.loads(text), where, "TOML")


def read_json(path: str | Path, what: str) -> Any:
    """The content of a JSON file, such as a result that is read back.

    Raises:
        UserError: as `read_toml`.
    """
    where = f"cannot read {what} {path}"
    text = _text(path, where, LARGEST_RESULT)
    return _parsed(lambda: json.loads(text), where, "JSON")


def _text(path: str | Path, where: str, largest: int) -> str:
    """The text of a file of UTF-8. Raises `UserError`, beginning with `where`."""
    try:
        if Path(path).is_dir():
            raise UserError(f"{where}: it is a folder; name a file")
        with Path(path).open("rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise UserError(f"{where}: {error.strerror}") from error
    if len(content) > largest:
        raise UserError(f"{where}: it is larger than {largest / 1e6:g} MB; name another file")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{where}: it is not a text file in UTF-8 (byte {error.start}); save it as that"
        ) from error


def _parsed(parse: Callable[[], Any], where: str, language: str) -> Any:
    said = f"is not valid {language}" if language == "TOML" else f"is not {language}"
    try:
        document = parse()
    except RecursionError as error:
        raise UserError(
            f"{where}: it is nested deeper than {DEEPEST} brackets; write it flat"
        ) from error
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise UserError(f"{where}: it {said}: {error}") from error
    except ValueError as error:  # an integer or a date that Python does not make
        reason = "an integer has thousands of digits" if "digits" in str(error) else str(error)
        raise UserError(f"{where}: it {said}: {reason}") from error
    for key, value, depth in _values(document):
        place = f"{where}: {key[:_LONGEST_KEY]}"
        if depth > DEEPEST:
            raise UserError(f"{place} is nested deeper than {DEEPEST} tables; write it flat")
        if isinstance(value, datetime.date | datetime.time):
            raise UserError(f"{place} = {value} is a date or time, and none is due there")
        if language == "JSON" or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise UserError(f"{place} is an integer beyond 64 bits")
        if math.isfinite(value) and value != 0 and not _LEAST <= abs(value) <= _GREATEST:
            raise UserError(
                f"{place} = {value:g} is too large or too small to calculate with; numbers are "
                f"zero or between {_LEAST:g} and {_GREATEST:g}"
            )
    return document


def _values(document: Any) -> Iterator[tuple[str, Any, int]]:
    """Every value with its dotted key and its depth, without recursion."""
    waiting = [("", document, 0)]
    while waiting:
        key, value, depth = waiting.pop()
        yield key, value, depth
        if depth > DEEPEST:
            continue
        if isinstance(value, dict):
            waiting += [(f"{key}.{k}".lstrip("."), item, depth + 1) for k, item in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{key}[{k}]", item, depth + 1) for k, item in enumerate(value)]
