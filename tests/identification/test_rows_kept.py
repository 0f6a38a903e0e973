"""Which rows of a recording a data set keeps: what docs/recordings.md says of thinning."""

import tomllib

import numpy as np
import pytest
from tests.boats import BOAT

from diffsea.identification.data.dataset import make_dataset
from diffsea.trajectory import Trajectory
from diffsea.vessel.files import build


RATE, EVERY = 50, 10  # rows per second, and rows between two that are kept: 0.19 s of 0.639 s


def recorded(positions):
    """60 s of yaw rate in every row, and positions every so many rows from the fourth on."""
    t = np.arange(60 * RATE) / RATE
    wave, nothing = np.sin(0.3 * t), np.full(t.shape, np.nan)
    fixes = np.where(np.arange(t.size) % positions == 3, t, np.nan)
    orders = {side: np.full(t.shape, 100.0) for side in ("port", "starboard")}
    motion = (fixes, fixes, nothing, nothing, nothing, wave)
    return Trajectory(t, *motion, orders, {}, {}, np.ones(t.shape, bool))


@pytest.mark.parametrize(
    ("positions", "kept"),
    [
        (50, 60),  # of 1 Hz: every one
        (10, 300),  # as many as rows are kept
        (7, 429),  # in 1.43 of a kept row: still slow
        (6, 300),  # in 1.67: fast, and of each ten rows one, though none lies in a kept row
    ],
)
def test_samples_of_slow_channels_are_all_kept_and_of_fast_ones_those_in_kept_rows(positions, kept):
    data = make_dataset(build(tomllib.loads(BOAT)), [recorded(positions)])
    times = np.round(np.asarray(data.run_time)[data.recorded_rows], 6)
    assert np.sum(np.asarray(data.known)[:, 0]) == kept
    assert np.isin(np.round(np.arange(300) * EVERY / RATE, 6), times).all()
    assert times.size <= 300 + kept
