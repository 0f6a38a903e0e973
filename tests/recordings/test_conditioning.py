"""What is done to recordings before they are used."""

import numpy as np

from diffsea import Trajectory
from diffsea.recordings.conditioning import in_sequence


def lasting(seconds, start) -> Trajectory:
    """A run of 1 m/s to the north, with a row each second."""
    t = start + np.arange(seconds + 1.0)
    nothing = np.zeros(t.size)
    return Trajectory(
        t=t, x=t - start, y=nothing, psi=nothing, u=nothing + 1.0, v=nothing, r=nothing,
        commanded={}, executed={}, valid=np.ones(t.size, bool), extra={},
    )  # fmt: skip


def test_recordings_made_one_after_another_share_a_clock():
    logs = [lasting(300, 40.0), lasting(800, 20.0), lasting(250, 900.0)]
    moved = in_sequence(logs)
    assert [float(one.t[0]) for one in moved] == [0.0, 1000.0, 2000.0]
    for before, after in zip(logs, moved, strict=True):
        np.testing.assert_allclose(np.diff(after.t), np.diff(before.t), atol=1e-9)
        assert np.array_equal(before.x, after.x) and "on the clock" in after.provenance[-1]
    longer = in_sequence([lasting(1000, 0.0), lasting(20, 0.0)])
    assert float(longer[1].t[0]) == 10_000.0


def test_recordings_on_one_clock_stay_as_they_are():
    assert in_sequence([]) == []
    logs = [lasting(300, 1_795_000_000.0), lasting(20, 1_795_000_400.0)]
    kept = in_sequence(logs)
    assert all(one is other for one, other in zip(kept, logs, strict=True))
