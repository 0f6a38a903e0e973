"""Numbers in the experiments' READMEs are numbers of their results files, rounded.

Looked at are those of three digits and more: shorter ones are found among many by chance. A number
of which the last digit is changed is found out in half to nearly all cases, by how many results
there are. Code and addresses are left out.
"""

import bisect
import csv
import json
import math
import re

import pytest
from tests.paths import ROOT


EXPERIMENTS = ROOT / "experiments"
# By experiment, numbers that are no results: of a paper, a set-up or the plant.
OF_NO_RESULT = {
    "blueboat": set(),
    "coverage": {"3000"},
    "design_sweep": {"540", "16.54"},
    "esso_osaka": {"0.135"},
    "estimate_check": set(),
    "kcs_marin": set(),
    "kvlcc2_hsva": set(),
    "metamodels": {"1983"},
    "null_calibration": set(),
    "online_estimation": {"240"},
    "overshoot_sensitivity": set(),
    "pytheas": {"102", "229.8", "475", "1801"},
    "real_fits": {"2015", "3.25", "3.34"},
    "unberthing": set(),
    "virtual_sea_trials": set(),
    "vrx_wamv": {"0.004422"},
}
# As results have them, in per cent, degrees and thousandths.
FACTORS = (1.0, 100.0, math.degrees(1.0), 1e3)
_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
_QUOTED = re.compile(r"```.*?```|`[^`]*`|\]\([^)]*\)|https?://\S+", re.DOTALL)
_IN_PROSE = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])|(?<![\w.])\d{3,}(?![\w.])")


def _numbers(content):
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list):
        for one in content:
            yield from _numbers(one)
    elif isinstance(content, str):
        yield from map(float, _NUMBER.findall(content))
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield float(content)


def _results(folder):
    """All numbers of the results files, by factor, sorted.

    Of an experiment in parts, whose files are large, those of the tables in its README alone.
    """
    found = set()
    for file in folder.rglob("*"):
        if file.suffix == ".json":
            content = json.loads(file.read_text())
            in_parts = isinstance(content, dict) and "parts" in content
            found.update(_numbers(content["tables"] if in_parts else content))
        elif file.suffix == ".jsonl":
            found.update(_numbers([json.loads(line) for line in file.read_text().splitlines()]))
        elif file.suffix == ".csv":
            with file.open(newline="") as opened:
                found.update(_numbers(list(csv.reader(opened))))
    sizes = {abs(value) for value in found if math.isfinite(value)}
    return [sorted(value * factor for value in sizes) for factor in FACTORS]


def _prose(folder):
    """Numbers of three digits and more in a README, as they are written."""
    text = _QUOTED.sub(" ", (folder / "README.md").read_text(encoding="utf-8"))
    written = [found[0] for found in _IN_PROSE.finditer(text)]
    return [one for one in written if len(one.replace(".", "").lstrip("0")) >= 3]


def _is_among(number, results):
    decimals = len(number.partition(".")[2])
    half = 0.5 * 10**-decimals * (1 + 1e-6)
    low, high = float(number) - half, float(number) + half
    return any(bisect.bisect_left(one, low) < bisect.bisect_right(one, high) for one in results)


@pytest.mark.parametrize("name, others", OF_NO_RESULT.items())
def test_numbers_of_a_readme_are_in_its_results(name, others):
    results = _results(EXPERIMENTS / name)
    strange = {number for number in _prose(EXPERIMENTS / name) if not _is_among(number, results)}
    assert strange == others
