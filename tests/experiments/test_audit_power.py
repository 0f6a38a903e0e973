"""The audit's power: the tables of the page are those of its results."""

import json

from experiments.audit_power import run


def test_the_tables_of_the_page_are_those_of_the_results():
    results = json.loads(run.RESULTS.read_text(encoding="utf-8"))
    assert set(results) == {"simulated", *run.REAL}
    page = (run.HERE / "README.md").read_text(encoding="utf-8")
    for line in run.report(results, run.GRADED).splitlines():
        assert line in page.splitlines()
