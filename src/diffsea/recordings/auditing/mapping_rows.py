"""Mappings as text, and the repair of a fault as the rows that a mapping would have instead."""

import dataclasses
import json
import textwrap
from collections.abc import Iterable
from typing import Any

import numpy as np

from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.mappings import Column, Mapping


def mapping_text(mapping: Mapping, notes: Iterable[str] = ()) -> str:
    """The mapping as TOML, under comments; only what is not as usual is written.

    Text, numbers and lists of them are written alike in TOML and JSON.
    """
    wrap = lambda line: textwrap.wrap(line, 92, initial_indent="# ", subsequent_indent="# ")
    lines = [part for note in notes for line in note.splitlines() for part in wrap(line)]
    lines += ["format = 1", "", "[file]"]
    usual = Mapping(mapping.channels, mapping.name, constants=mapping.constants)
    for name, value in _unusual_fields(mapping, usual):
        if name == "origin":
            value = [float(np.degrees(angle)) for angle in value]
        if name == "times":
            lines.append(f"times = {{ {', '.join(_column_lines(mapping.times))} }}")
        else:
            lines.append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    lines += ["", "[columns]", *_column_lines(mapping.channels)]
    lines += [
        f"{_key(name)} = {{ constant = {value!r} }}" for name, value in mapping.constants.items()
    ]
    return "\n".join(lines) + "\n"


def _column_lines(columns: dict[str, Column]) -> list[str]:
    """Columns by name, as a mapping has them."""
    lines = []
    for name, column in columns.items():
        pairs = [("column", column.column), *_unusual_fields(column, Column(column.column))]
        entry = ", ".join(
            f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in pairs
        )
        lines.append(f"{_key(name)} = {{ {entry} }}")
    return lines


def _key(name: str) -> str:
    """A key of TOML, quoted where it must be."""
    plain = all(letter.isascii() and (letter.isalnum() or letter in "_-") for letter in name)
    return name if plain else json.dumps(name, ensure_ascii=False)


def with_rows_of_mapping(finding: Finding, mapping: Mapping) -> Finding:
    """The finding with its repair as rows of the mapping that the recording was read through.

    Offsets are then in the units of the mapping, before its sign. As it is where no mapping in
    these axes can say the repair by columns alone.
    """
    if not finding.edits or mapping.frame != "NED":
        return finding
    amended: Mapping | None = mapping
    for edit in finding.edits:
        amended = None if amended is None else edit.amend_mapping(amended)
    if amended is None or dataclasses.replace(amended, channels=mapping.channels) != mapping:
        return finding
    changed = {
        name: dataclasses.replace(column, offset=float(f"{column.offset:.5g}"))
        for name, column in amended.channels.items()
        if column != mapping.channels.get(name)
    }
    dropped = set(mapping.channels) - set(amended.channels)
    if not changed or dropped or any(c.scale != 1 or c.delay for c in changed.values()):
        return finding
    rows = "; ".join(_column_lines(changed))
    return dataclasses.replace(finding, repair=f"{rows} in the mapping")


def _unusual_fields(record: Mapping | Column, usual: Mapping | Column) -> list[tuple[str, Any]]:
    """Names and values of the fields in which two records of a kind differ."""
    pairs = [(f.name, getattr(record, f.name)) for f in dataclasses.fields(record)]
    return [(name, value) for name, value in pairs if value != getattr(usual, name)]
