"""What is done to recordings before they are used."""

import numpy as np
import pandas as pd
import pytest

from diffsea import Trajectory, read_recording
from diffsea.recordings.conditioning import in_sequence, on_one_clock, share_a_calendar


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


def test_recordings_that_say_when_they_were_made_share_that_clock(tmp_path):
    """A clock of Unix time begins anew in each file; what changed in one has changed after it."""
    began = 1_795_000_000.25
    for name, start in (("late", began + 400.0), ("early", began)):
        rows = pd.DataFrame({"t": start + np.arange(30.0), "x": np.arange(30.0), "u": 1.0})
        rows.to_csv(tmp_path / f"{name}.csv", index=False)
    logs = [read_recording(tmp_path / f"{name}.csv") for name in ("late", "early")]
    assert all(one.t[0] == 0.25 for one in logs) and share_a_calendar(logs)
    assert not share_a_calendar(logs[:1])
    late, early = on_one_clock(logs)
    assert float(early.t[0]) == pytest.approx(0.25) and float(late.t[0]) == pytest.approx(400.25)
    assert late.read.epoch == early.read.epoch
    mixed = [*logs, lasting(20, 0.0)]
    assert not share_a_calendar(mixed) and all(
        one is other for one, other in zip(on_one_clock(mixed), mixed, strict=True)
    )
