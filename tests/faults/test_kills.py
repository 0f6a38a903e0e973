"""A sweep killed at any moment and begun again; a longer run is `python -m tests.faults.kill`."""

import random

import pytest
from tests.faults.kill import Kills


pytestmark = pytest.mark.slow


def test_a_killed_sweep_that_is_begun_again_ends_as_one_left_alone(tmp_path):
    kills, draw = Kills(tmp_path), random.Random(0)
    found = [kills.breach(draw.uniform(0.3, 1.05) * kills.seconds) for _ in range(3)]
    assert not [wrong for _, wrong in found if wrong]
