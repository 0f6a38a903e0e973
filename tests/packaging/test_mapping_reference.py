"""The reference on the page of mappings: keys that the reader takes, all channels, all units."""

import re
from pathlib import Path

import pytest
from tests.paths import ROOT

from diffsea import UserError
from diffsea.recordings.mappings import CHANNEL_DIMENSIONS, UNITS, Column, mapping_from
from diffsea.trajectory import CHANNEL_UNITS


PAGE = (ROOT / "docs" / "mappings.md").read_text(encoding="utf-8")
M = Path("m.toml")
SOUND = {"file": {"time_step": 0.1}, "columns": {"psi": {"column": "yaw"}}}


def rows(title: str) -> list[list[str]]:
    """Cells of the table below a heading of the reference, without its head."""
    section = PAGE.split("## All keys\n")[1].split(f"### {title}\n")[1].split("\n### ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def words(cell: str) -> list[str]:
    """What stands in backticks."""
    return re.findall(r"`([^`]+)`", cell)


def refused(mapping: dict) -> str:
    """The message on a mapping."""
    with pytest.raises(UserError) as found:
        mapping_from(mapping, M)
    return str(found.value)


@pytest.mark.parametrize(
    "title, mapping",
    [
        ("`[file]`", SOUND | {"file": {"?": 1}}),
        ("`[columns]`", SOUND | {"columns": {"psi": {"column": "yaw", "?": 1}}}),
    ],
)
def test_all_keys_that_the_reader_takes_are_on_the_page_and_no_others(title, mapping):
    known = refused(mapping).split("known keys are ")[1].split(", ")
    assert [key for row in rows(title) for key in words(row[0])] == known


def test_all_channels_are_on_the_page_with_their_units():
    told = {key: row[1] for row in rows("Channels") for key in words(row[0])}
    message = refused({"columns": {"?": "yaw"}})
    assert sorted(told) == sorted(message.split("channels are ")[1].split(", "))
    assert told["t"] == "s" and told.items() >= CHANNEL_UNITS.items()
    for channel, dimension in CHANNEL_DIMENSIONS.items():
        assert UNITS[told[channel]] == (dimension, 1.0)


def test_all_units_are_on_the_page_with_their_dimensions_the_one_of_si_first():
    told = {row[0]: words(row[1]) for row in rows("Units")}
    found = {}
    for unit, (dimension, _) in UNITS.items():
        found.setdefault(dimension, []).append(unit)
    assert {name: sorted(units) for name, units in told.items()} == {
        name: sorted(units) for name, units in found.items()
    }
    assert all(UNITS[units[0]][1] == 1.0 for units in told.values())


def test_texts_that_the_page_gives_as_defaults_and_as_allowed_are_read():
    columns = {"psi": "yaw", "u": "surge", "v": "sway"}
    for key, _, default, allowed in rows("`[file]`"):
        (name,) = words(key)
        texts = re.findall(r"`\"([^`\"]+)\"`", f"{default} {allowed}")
        for text in texts:
            mapping = mapping_from({"columns": columns, "file": {"time_step": 0.1, name: text}}, M)
            assert getattr(mapping, name) == text
        if default.startswith('`"'):
            assert getattr(mapping_from(SOUND, M), name) == texts[0]


def test_the_defaults_of_an_entry_are_those_of_the_page():
    plain = Column("yaw")
    defaults = {words(row[0])[0]: words(row[2]) for row in rows("`[columns]`")}
    told = {key: default[0] for key, default in defaults.items() if default}
    assert told.pop("course_unit") == plain.course_unit
    numbers = {key: float(default) for key, default in told.items()}
    assert numbers == {key: getattr(plain, key) for key in ("sign", "scale", "offset", "delay")}
