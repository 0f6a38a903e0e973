"""The page of the catalogue of effects: as it is generated, whole, and what it says is read."""

import copy
import functools
import re
import runpy

import pytest
from tests.paths import ORACLE, ROOT

from diffsea import EFFECTS
from diffsea.errors import UserError
from diffsea.outside.documents import read_toml
from diffsea.vessel.effects import Effect, catalogue_name
from diffsea.vessel.files import build, dump, read_vessel, shipped_vessels


PAGE = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
SECTIONS = {
    text.split("\n", 1)[0]: text.split("\n## ")[0] for text in re.split(r"^### ", PAGE, flags=re.M)
}
NAMES = sorted({catalogue_name(name) for name in EFFECTS})
VALUES = {
    "degrees_of_freedom": ["surge"],
    "channels": ["psi"],
    "depth": 50.0,
}  # what is not 0.5 where it is tried
CHANNELS = {"lever-arm": ["x", "y"]}  # by effect, where others are asked for
RECEIVED = {"turned_by": ["psi"], "channels": ["x", "y", "u", "v"]}  # keys that go together


@functools.cache
def documents() -> list[dict]:
    """The example vessel, the shipped ones, and a ship whose rudder stands free of its hull."""
    ship = read_toml(ORACLE / "ship.toml", "the vessel")
    ship["rudder"][0] |= {"a_H": 0.0, "gamma_R_port": 1.0, "gamma_R_starboard": 1.0}
    example = read_toml(ROOT / "examples/demo/usv.toml", "the vessel")
    shipped = [read_toml(path, "the vessel") for path in shipped_vessels().values()]
    return [example, *shipped, ship]


def variants(name: str) -> list[Effect]:
    return [effect for effect in EFFECTS.values() if catalogue_name(effect.name) == name]


def keys_on_page(name: str) -> list[str]:
    return re.findall(r"^\| `(.+?)` \|", SECTIONS.get(name, ""), re.MULTILINE)


def document_for(name: str, key: str) -> dict:
    """A copy of the first vessel that could have the effect, by a variant with the key if any has.

    A place or a property of the superstructure belongs to all variants.
    """
    own = [one for one in variants(name) if key in one.units] or variants(name)
    able = (d for d in documents() if any(one.possible(build(d)) for one in own))
    return copy.deepcopy(next(able))


def test_the_page_is_what_the_generator_gives():
    made = runpy.run_path(str(ROOT / "docs/site/effects_page.py"))["page"]()
    assert made == PAGE, "run .venv/bin/python docs/site/effects_page.py"


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_has_a_section_with_its_variants_and_what_resembles_it(name):
    for effect in variants(name):
        assert effect.name == name or f"`{effect.name}`" in SECTIONS[name]
        for other in {*effect.confusables, *effect.parts} - {name}:
            assert f"[{other}](#{other})" in SECTIONS[name] and other in SECTIONS
        channels = " and ".join(f"`{one}`" for one in effect.needs)
        assert not effect.needs or f"Recordings: {channels}" in SECTIONS[name]
        assert not effect.needs_feedback or "Recordings: `exec_`" in SECTIONS[name]


def test_the_page_has_no_effect_but_those_of_the_catalogue():
    assert sorted(list(SECTIONS)[1:]) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_where_not_all_vessels_are_asked_the_page_says_which(name):
    vessels = [build(document) for document in documents()]
    if not all(one.possible(vessel) for one in variants(name) for vessel in vessels):
        assert "\n- Vessels: " in SECTIONS[name]


@pytest.mark.parametrize("name, key", [(name, key) for name in NAMES for key in keys_on_page(name)])
def test_a_key_of_the_page_is_read(name, key, tmp_path):
    document = document_for(name, key)
    names = VALUES | {"actuators": [next(iter(build(document).channels))]}
    names |= {"channels": CHANNELS.get(name, VALUES["channels"])}
    chosen = dict.fromkeys((keys_on_page(name)[0], key))
    table = {"name": name} | {one: names.get(one, 0.5) for one in chosen}
    table |= RECEIVED if key == "turned_by" else {}
    path = tmp_path / "vessel.toml"
    path.write_text(dump(document | {"effect": [*document.get("effect", []), table]}))
    assert read_vessel(path).document["effect"][-1] == table


@pytest.mark.parametrize("name", NAMES)
def test_the_reader_refuses_other_keys_and_knows_all_that_the_page_has(name):
    document = document_for(name, "")
    document["effect"] = [{"name": name, "?": 0.5}]
    with pytest.raises(UserError, match=r"unknown key '\?' in .*; known are (.*)") as refused:
        build(document)
    known = str(refused.value).split("; known are ")[1].split(", ")
    assert sorted(known) == sorted(["name", *keys_on_page(name)])


def test_the_table_that_the_page_begins_with_is_read(tmp_path):
    table = PAGE.split("```toml\n")[1].split("```")[0]
    path = tmp_path / "vessel.toml"
    path.write_text(dump(documents()[0]) + table)
    assert read_vessel(path).vessel.servos["port"].delay == 0.4
