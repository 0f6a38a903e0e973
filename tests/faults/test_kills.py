"""Long work killed at any moment and begun again; a longer run is `python -m tests.faults.kill`."""

import random

import pytest
from tests.faults.kill import WORKS, Kills


pytestmark = pytest.mark.proof


def test_a_killed_sweep_that_is_begun_again_ends_as_one_left_alone(tmp_path):
    kills, draw = Kills(tmp_path, WORKS["sweep"]), random.Random(0)
    moments = [(2, 0.0), (kills.count, 0.01), kills.moment(draw)]
    found = [kills.breach(*one) for one in moments]
    assert 2 <= found[0][0] < kills.count
    assert not [wrong for _, wrong in found if wrong]


def test_a_killed_diagnosis_that_is_begun_again_ends_as_one_left_alone(tmp_path):
    kills = Kills(tmp_path, WORKS["diagnosis"])
    assert kills.count > 2
    found = [kills.breach(1, 0.0), kills.breach(kills.count // 2, 0.0)]
    assert all(0 < parts for parts, _ in found)
    assert not [wrong for _, wrong in found if wrong]
