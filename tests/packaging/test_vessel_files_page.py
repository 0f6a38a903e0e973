"""The page of the vessel file: its examples load, and it has the keys that the reader accepts."""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from tests.paths import ROOT

import diffsea
from diffsea import parameters
from diffsea.errors import UserError
from diffsea.vessel import files, tables
from diffsea.vessel.actuators import ACTUATORS, thrust_curve


Table = dict[str, Any]
PAGE = (ROOT / "docs" / "vessel-files.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
WHOLE = [block for block in BLOCKS if block.startswith("format = 1")]
HULL = {"length": 5.0, "beam": 2.0, "draught": 0.2, "mass": 180.0, "I_z": 400.0, "X_u": -50.0}
ACTUATOR, LOSSES, ORDERS = "Every actuator", "Losses", "Orders and thrust"


class Kind(NamedTuple):
    """A kind of table: the sections with its keys, and tables of it in a file that can be read."""

    sections: tuple[str, ...]
    document: Callable[[Table], Table]
    samples: tuple[Table, ...]


def in_hull(**more: Any) -> Table:
    return {"hull": HULL | more}


def actuator(kind: str, sections: tuple[str, ...], *samples: Table) -> Kind:
    """A kind of actuator, in a file with a non-dimensional hull."""
    return Kind(sections, lambda table: {**in_hull(nondimensional="mmg"), kind: [table]}, samples)


THRUSTS = {"max_force": 1.0}, {"curve": {"c": 0.0, "d": 1.0}}
KINDS = {
    "file": Kind(("The whole file",), lambda table: in_hull() | table, ({},)),
    "hull": Kind(
        ("Rigid body", "Added mass", "Derivatives", "Scaling"),
        lambda table: in_hull(**table),
        ({},),
    ),
    "hull.exponents": Kind(
        ("Power laws",),
        lambda table: in_hull(exponents=table, Y_v=-1.0, N_r=-1.0),
        ({"X_u": 1.5},),
    ),
    "thruster": actuator("thruster", (ACTUATOR, LOSSES, ORDERS, "Fixed thrusters"), *THRUSTS),
    "azimuth_thruster": actuator(
        "azimuth_thruster", (ACTUATOR, LOSSES, ORDERS, "Azimuth thrusters"), *THRUSTS
    ),
    "thruster.thrust_curve": Kind(
        ("Thrust curves",),
        lambda table: in_hull() | {"thruster": [{"unit": "us", "thrust_curve": table}]},
        ({"full_thrust": 1.0},),
    ),
    "tunnel_thruster": actuator("tunnel_thruster", (ACTUATOR, "Tunnel thrusters"), {"x": 1.0}),
    "propeller": actuator(
        "propeller", (ACTUATOR, LOSSES, "Propellers"), {"diameter": 1.0, "k_T": [0.3, 0.0, 0.0]}
    ),
    "rudder": actuator(
        "rudder",
        (ACTUATOR, "Rudders", "Rudders by their area", "Rudders by derivatives"),
        *({"area": 0.1}, {"N_d": 1.0}),
    ),
    "prior": Kind(
        ("Priors",), lambda table: in_hull() | {"prior": {"X_u": table}}, ({"spread": 0.5},)
    ),
}


def keys_by_section() -> dict[str, set[str]]:
    """The keys in the tables below each heading: the first column of those headed by `key`."""
    found = {}
    for heading in re.split(r"^#{2,3} ", PAGE, flags=re.MULTILINE)[1:]:
        title, _, text = heading.partition("\n")
        rows: list[str] = []
        for table in re.findall(r"^\| key \|.*\n\| --- .*\n((?:\|.*\n)+)", text, re.MULTILINE):
            rows += [row.split("|")[1] for row in table.splitlines()]
        found[title] = {key.strip("[]") for row in rows for key in re.findall(r"`(.+?)`", row)}
    return found


SECTIONS = keys_by_section()


def on_page(kind: Kind) -> set[str]:
    return set().union(*(SECTIONS[title] for title in kind.sections))


def refusal(document: Table, folder) -> str:
    """What the reader says of a vessel file; empty where it takes it."""
    path = folder / "vessel.toml"
    path.write_text(files.dump(document), encoding="utf-8")
    try:
        diffsea.read_vessel(path)
    except UserError as error:
        return str(error)
    return ""


@pytest.fixture
def compared(monkeypatch) -> list[set[str]]:
    """The names that the reader accepts in a place, each time that it looks for the nearest."""
    lists: list[set[str]] = []

    def nearest(name: str, known) -> str:
        lists.append(set(known))
        return ""

    for module in (files, tables, parameters, thrust_curve):
        monkeypatch.setattr(module, "nearest", nearest)
    return lists


def test_the_page_has_two_whole_files_and_they_load(tmp_path):
    assert len(WHOLE) == 2
    channels = []
    for number, block in enumerate(WHOLE):
        path = tmp_path / f"{number}.toml"
        path.write_text(block, encoding="utf-8")
        channels.append(diffsea.read_vessel(path).vessel.channels)
    assert channels == [("port", "starboard"), ("propeller", "rudder")]


@pytest.mark.parametrize("part", [block for block in BLOCKS if block not in WHOLE])
def test_a_part_of_a_file_on_the_page_loads_behind_the_first_example(part, tmp_path):
    path = tmp_path / "vessel.toml"
    path.write_text(WHOLE[0] + part, encoding="utf-8")
    diffsea.read_vessel(path)


@pytest.mark.parametrize("name", KINDS)
def test_the_page_has_every_key_that_the_reader_accepts(name, compared, tmp_path):
    kind, accepted = KINDS[name], set()
    for sample in kind.samples:
        assert refusal(kind.document(sample), tmp_path) == ""
        assert "unknown key 'no_key'" in refusal(kind.document(sample | {"no_key": 1.0}), tmp_path)
        accepted |= compared[-1]
    assert accepted - on_page(kind) == set()


@pytest.mark.parametrize("name", KINDS)
def test_the_reader_accepts_every_key_on_the_page(name, tmp_path):
    kind = KINDS[name]
    assert on_page(kind)
    for key in on_page(kind):
        # A value may be refused; a key that some table of the kind knows is not.
        said = [refusal(kind.document({key: 1.0} | sample), tmp_path) for sample in kind.samples]
        assert not all("unknown key" in words for words in said), f"{key}: {said}"


def test_no_kind_of_actuator_and_no_table_of_keys_is_left_out():
    assert ACTUATORS.keys() <= KINDS.keys()
    read = {title for kind in KINDS.values() for title in kind.sections} | {"Effects"}
    assert {title for title, keys in SECTIONS.items() if keys} == read


def test_the_page_has_every_unit_of_orders(compared, tmp_path):
    assert "unknown unit" in refusal(in_hull() | {"thruster": [{"unit": "no_unit"}]}, tmp_path)
    assert all(f'| `"{unit}"` |' in PAGE for unit in compared[-1])
