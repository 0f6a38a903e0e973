"""Tables in which every sensor writes rows of its own: the others' cells are empty there."""

import numpy as np
import pandas as pd
import pytest

from diffsea import read_recording
from diffsea.recordings import thin


SECONDS = 40.0
MAPPING = """
[file]
velocity_axes = "earth"

[columns]
t = "time"
psi = { column = "heading", unit = "deg" }
r = "rate"
x = "north"
y = "east"
u = { column = "speed", course = "course" }
v = { column = "speed", course = "course" }
cmd_port = "port"
"""


def heading(t):
    """rad; runs over north twice."""
    return 2.5 * np.pi * t / SECONDS + 0.3


@pytest.fixture
def run(tmp_path):
    """A boat that goes ahead at 2 m/s with 0.3 m/s to starboard, and turns."""
    imu, fix, motor = (
        np.arange(0, SECONDS, 0.05),
        np.arange(0.02, SECONDS, 0.2),
        np.arange(0, 40, 0.1),
    )
    motor = motor + 0.013
    course = np.degrees(heading(fix) + np.arctan2(0.3, 2.0)) % 360
    tables = [
        {"time": imu, "heading": np.degrees(heading(imu)) % 360, "rate": 0 * imu + 0.2},
        {"time": fix, "north": fix, "east": fix, "speed": 0 * fix + np.hypot(2.0, 0.3),
         "course": course},
        {"time": motor, "port": np.floor(motor / 5.0)},
    ]  # fmt: skip
    pd.concat(map(pd.DataFrame, tables)).sort_values("time").to_csv(
        tmp_path / "run.csv", index=False
    )
    (tmp_path / "m.toml").write_text(MAPPING)
    return read_recording(tmp_path / "run.csv", tmp_path / "m.toml")


def test_velocities_are_turned_by_the_heading_between_its_own_rows(run):
    at = np.isfinite(run.x)
    assert at.sum() == 200 and not np.isfinite(run.psi[at]).any()
    np.testing.assert_allclose(run.u[at][1:], 2.0, atol=1e-3)
    np.testing.assert_allclose(run.v[at][1:], 0.3, atol=1e-3)
    assert not np.isfinite(run.u[~at]).any()


def test_where_the_heading_was_lost_there_is_no_velocity(run, tmp_path):
    table = pd.read_csv(tmp_path / "run.csv")
    table.loc[table["time"].between(10.0, 12.0), "heading"] = np.nan
    table.to_csv(tmp_path / "lost.csv", index=False)
    lost = read_recording(tmp_path / "lost.csv", tmp_path / "m.toml")
    pause = np.isfinite(lost.x) & (lost.t > 10.1) & (lost.t < 11.9)
    assert pause.any() and not np.isfinite(lost.u[pause]).any()
    assert np.isfinite(lost.u[np.isfinite(lost.x) & (lost.t > 12.2)]).all()


def test_thinned_every_sensor_keeps_readings_so_far_apart(run):
    found = thin(run, 0.4)
    for channel, least in (("x", 90), ("u", 90), ("psi", 90), ("r", 90)):
        known = np.isfinite(found.motion[channel])
        assert least <= known.sum() <= 220, channel
        assert np.diff(found.t[known]).max() < 0.6, channel
    assert len(found.t) < 0.4 * len(run.t)
    changes = np.flatnonzero(np.diff(run.commanded["port"])) + 1
    assert set(run.t[changes[1:]]) <= set(found.t)  # the first one is where orders begin
