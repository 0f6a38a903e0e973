"""Every published figure, table and claim has its twin here, or a reason why there is none."""

import json
import re
import tomllib

import pytest
from tests.paths import EXPERIMENTS, ROOT


ITEMS = tomllib.loads((ROOT / "tests" / "experiments" / "paper_items.toml").read_text())
PAPERS = ITEMS["paper"]
KINDS = {"figure", "table", "equation-set", "claim"}
KEYS = {"paper", "kind", "name", "what", "twin", "missing", "differs", "result", "rows"}


def items(paper: str) -> list[dict]:
    """The items of a paper."""
    return [item for item in ITEMS["item"] if item["paper"] == paper]


def results(paper: str) -> dict:
    """results.json of the experiment that follows a paper."""
    return json.loads((EXPERIMENTS / PAPERS[paper]["experiment"] / "results.json").read_text())


def at(record, path: str):
    """What a dotted path leads to; an entry of a list is given by its position or `name`."""
    for part in path.split("."):
        if isinstance(record, dict):
            record = record[part]
        elif part.isdigit():
            record = record[int(part)]
        else:
            record = {entry["name"]: entry for entry in record}[part]
    return record


def test_every_item_is_of_a_paper_and_has_known_keys():
    for item in ITEMS["item"]:
        assert item["paper"] in PAPERS and item["kind"] in KINDS, item
        assert item["name"] and item["what"] and set(item) <= KEYS, item


@pytest.mark.parametrize("paper", PAPERS)
def test_an_item_has_a_twin_or_a_reason(paper):
    for item in items(paper):
        assert ("twin" in item) != ("missing" in item), item
        if "missing" in item:
            assert item["missing"].endswith("."), item
            assert not {"differs", "result", "rows"} & set(item), item
        else:
            assert (ROOT / item["twin"]).is_file(), item
            assert item.get("differs", ".").endswith("."), item


@pytest.mark.parametrize("paper", PAPERS)
def test_what_a_twin_obtained_is_among_the_results(paper):
    record = results(paper)
    for item in items(paper):
        if "result" in item:
            assert at(record, item["result"]) is not None, item
        for beginning in item.get("rows", []):
            rows = [row for row in record["comparison"] if row["quantity"].startswith(beginning)]
            assert any(row["obtained"] is not None for row in rows), (item["name"], beginning)
        if item["kind"] == "claim" and "twin" in item:
            assert "result" in item or "rows" in item, item


@pytest.mark.parametrize("paper", PAPERS)
def test_no_item_of_a_paper_is_left_out_or_there_twice(paper):
    names = [item["name"] for item in items(paper)]
    assert len(names) == len(set(names)) and any(i["kind"] == "claim" for i in items(paper))
    for kind in ("figure", "table"):
        found = [re.match(rf"{kind} (\d+)", i["name"]) for i in items(paper) if i["kind"] == kind]
        numbers = {int(match[1]) for match in found if match}
        assert numbers == set(range(1, PAPERS[paper][f"{kind}s"] + 1)), (paper, kind)
