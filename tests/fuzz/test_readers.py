"""Hostile inputs to every reader: none ends the process, none is a bug, nothing is left behind."""

import json
import pathlib
import re

import pytest
from tests.fuzz.harness import Harness, breach
from tests.fuzz.seeds import KINDS, seed
from tests.fuzz.server import COMMANDS, DOCUMENTS


CORPUS = pathlib.Path(__file__).parents[1] / "corpus"
INPUTS = 20  # of each reader, in half a minute; `make fuzz` tries as many as wished
WHY = dict(line.split("\t") for line in (CORPUS / "why.tsv").read_text().splitlines())
READ = [  # corpus files, by each command that reads such ones
    (name, command)
    for name in WHY
    for command in COMMANDS[: 1 if name.partition("-")[0] in DOCUMENTS else None]
]


@pytest.fixture(scope="module")
def harness(tmp_path_factory):
    running = Harness(tmp_path_factory.mktemp("fuzz"))
    yield running
    running.close()


@pytest.mark.parametrize("kind", KINDS)
def test_the_valid_file_is_read(kind, harness):
    for command in COMMANDS[: 1 if kind in DOCUMENTS else None]:
        ended = harness.ended(kind, seed(kind), command=command)
        assert ended["status"] == 0 and not breach(ended), ended["said"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_hostile_file_breaks_a_reader(kind, harness):
    pytest.importorskip("hypothesis", reason="needs the group dev")
    from hypothesis import HealthCheck, Phase, given, settings
    from tests.fuzz.changes import hostile

    @settings(
        max_examples=INPUTS,
        derandomize=True,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(hostile(kind))
    def try_one(content):
        ended = harness.ended(kind, content)
        assert not breach(ended), (breach(ended), ended["said"])

    try_one()  # pyright: ignore[reportCallIssue]  # Hypothesis gives the content


@pytest.mark.parametrize("name, command", READ)
def test_what_once_broke_a_reader_does_not(name, command, harness):
    kind = name.partition("-")[0]
    ended = harness.ended(kind, (CORPUS / name).read_bytes(), command=command)
    assert not breach(ended), (breach(ended), ended["said"])


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("names", ["{ a = 1 }", "x"])
def test_a_line_of_very_many_names_alike_is_answered_in_time(names, command, harness):
    line = ",".join(["t"] + 100_000 * [names])
    row = ",".join(100_001 * ["1"])
    for content in (f"{line}\n{row}\n", line):
        ended = harness.ended("csv", content.encode(), command=command)
        assert not breach(ended), (breach(ended), ended["said"])


def test_the_corpus_is_small_and_each_file_says_why():
    files = {path.name: path.stat().st_size for path in CORPUS.iterdir() if path.name != "why.tsv"}
    assert files.keys() == WHY.keys() and all(WHY.values())
    assert len(files) <= 200 and sum(files.values()) <= 2_000_000


def test_the_oracle_sees_what_it_is_for():
    fine = {"status": 1, "said": "diffsea: error: no\n", "megabytes": 200.0, "left": []}
    assert not breach(fine)
    for worse in (
        {"status": -11},
        {"status": -14},
        {"status": 3},
        {"said": "this is a bug: error: "},
        {"said": "Traceback error: "},
        {"said": ""},
        {"said": "error: \x1b[31m"},
        {"megabytes": 2001.0},
        {"left": ["metrics.json"]},
    ):
        assert breach(fine | worse), worse


def test_the_page_on_trust_names_tests_that_exist_and_the_numbers_of_the_last_run():
    root = CORPUS.parents[1]
    page = (root / "docs" / "what-diffsea-trusts.md").read_text()
    tests = "".join(file.read_text() for file in (root / "tests").rglob("test_*.py"))
    named = re.findall(r"`(test_\w+)`", page)
    assert len(named) > 10 and all(f"def {name}(" in tests for name in named)
    results = json.loads((root / "tests" / "fuzz" / "results.json").read_text())
    inputs = sum(one["inputs"] for one in results.values())
    breaches = sum(one["breaches"] for one in results.values())
    readers = {name.split()[-1] for name in results}
    told = f"{inputs} inputs to {len(readers)} readers, found {breaches} breaches"
    assert told in " ".join(page.split()) and f"tries {INPUTS} of each reader" in page
    assert readers == set(KINDS)
    faults = json.loads((root / "tests" / "faults" / "results.json").read_text())
    commands = faults["commands"].values()
    kills = [one for name, one in faults.items() if name.startswith("kills of a ")]
    total = lambda key, rows: sum(row[key] for row in rows)
    told = (
        f"{total('tried', commands)} failing calls of {len(commands)} commands were tried, with "
        f"{total('breaches', commands)} breaches, and {total('rounds', kills)} kills, "
        f"{total('within_the_parts', kills)} of them amid the parts, with "
        f"{total('breaches', kills)}"
    )
    assert told in " ".join(page.split())
