"""A sweep killed at any moment and begun again; a longer run is `python -m tests.faults.kill`."""

import random

import pytest
from tests.faults.kill import Kills


pytestmark = pytest.mark.proof


def test_a_killed_sweep_that_is_begun_again_ends_as_one_left_alone(tmp_path):
    kills, draw = Kills(tmp_path), random.Random(0)
    moments = [(2, 0.0), (kills.count, 0.01), kills.moment(draw)]
    found = [kills.breach(*one) for one in moments]
    assert 2 <= found[0][0] < kills.count
    assert not [wrong for _, wrong in found if wrong]
