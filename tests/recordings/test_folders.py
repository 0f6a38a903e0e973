"""Folders of tables with clocks of their own, read as one run."""

import datetime

import numpy as np
import pandas as pd
import pytest
from tests.paths import DATA

from diffsea import UserError, read_mapping, read_recording
from diffsea.recordings.auditing.mapping_rows import mapping_text


OWN_CLOCKS = """
[file]
times = { motors = { column = "stamp", unit = "ms" } }
[columns]
t = "t"
x = "gps:north"
y = "gps:east"
psi = { column = "imu:sin", cosine = "imu:cos", scale = 2 }
r = { column = "imu:rate", unit = "deg/s" }
cmd_port = "motors:left"
"""


def path_at(t):
    """A vessel on a circle of 20 m: north, east, heading, yaw rate."""
    rate = 0.05
    psi = rate * t
    return 20 * np.sin(psi), 20 * (1 - np.cos(psi)), psi, np.full_like(t, rate)


@pytest.fixture
def folder(tmp_path):
    """A run of 300 s in three tables: at 5 Hz, at 20 Hz, and where an order changes."""
    place = tmp_path / "run"
    place.mkdir()
    t = np.arange(0.03, 300, 0.2)
    north, east, _, _ = path_at(t)
    pd.DataFrame({"t": t, "north": north, "east": east}).to_csv(place / "gps.csv", index=False)
    t = np.arange(0.0, 300, 0.05)
    _, _, psi, rate = path_at(t)
    half = {"sin": np.sin(psi / 2), "cos": np.cos(psi / 2), "rate": np.degrees(rate)}
    pd.DataFrame({"t": t} | half).to_parquet(place / "imu.parquet")
    orders = pd.DataFrame({"stamp": [1000.0, 40_010.0, 90_000.0], "left": [5.0, 9.0, 0.0]})
    orders.to_csv(place / "motors.csv", index=False)
    return place


@pytest.fixture
def mapped(tmp_path):
    def read(place, text):
        mapping = tmp_path / "boat.toml"
        mapping.write_text(text)
        return read_recording(place, mapping)

    return read


def test_tables_of_a_folder_meet_on_one_clock(folder, mapped):
    run = mapped(folder, OWN_CLOCKS)
    assert run.t.size == 6000  # the table with the most rows
    north, east, psi, rate = path_at(run.t)
    assert np.max(np.abs(run.psi - psi)) < 1e-9  # half angles, through several whole turns
    assert np.max(np.abs(run.r - rate)) < 1e-12
    there = np.isfinite(run.x)
    assert 1490 < np.sum(there) <= 1500  # a slow sensor counts as often as it measured
    assert np.max(np.hypot(run.x - north, run.y - east)[there]) < 1e-2
    port = run.commanded["port"]
    half = 0.5 * float(np.median(np.diff(run.t)))  # orders hold from the nearest row on
    assert np.isnan(port[run.t < 1.0 - half - 1e-9]).all()
    assert np.all(port[(run.t >= 1.0) & (run.t < 40.01 - half)] == 5.0)
    assert np.all(port[(run.t > 40.02) & (run.t < 90.0)] == 9.0)
    assert any("motors: 3 samples by the column 'stamp'" in note for note in run.provenance)


def test_stamps_of_text_and_a_clock_that_is_off(folder, mapped):
    gps = pd.read_csv(folder / "gps.csv")
    zero = datetime.datetime(2026, 5, 12, 10, tzinfo=datetime.UTC)
    gps["t"] = [(zero + datetime.timedelta(seconds=t)).isoformat() for t in gps["t"]]
    gps.to_csv(folder / "gps.csv", index=False)
    seconds = zero.timestamp()
    text = OWN_CLOCKS.replace(
        "times = {", f'times = {{ imu = {{ column = "t", offset = {seconds + 0.5} }},'
    ).replace('unit = "ms" }', f'unit = "ms", offset = {1000 * seconds} }}')
    run = mapped(folder, text)
    _, _, psi, _ = path_at(run.t - 0.5)
    assert np.max(np.abs(run.psi - psi)) < 1e-6
    there = np.isfinite(run.x)
    assert np.max(np.abs(run.x - path_at(run.t)[0])[there]) < 1e-2


def test_what_is_wrong_with_a_folder_is_said(folder, mapped):
    with pytest.raises(UserError, match="is a folder of tables .*each is a run.*\n.*gps: t, north"):
        read_recording(folder)
    with pytest.raises(UserError, match="motors.csv has no column 't'; if its time has another"):
        mapped(folder, OWN_CLOCKS.replace("times", "# times"))
    with pytest.raises(UserError, match="has no 'gpss', which .* maps to x; did you mean 'gps'"):
        mapped(folder, OWN_CLOCKS.replace("gps:north", "gpss:north"))
    with pytest.raises(UserError, match="psi: its columns must come from one topic"):
        mapped(folder, OWN_CLOCKS.replace('cosine = "imu:cos"', 'cosine = "gps:cos"'))
    with pytest.raises(UserError, match="times.motors: time itself cannot be delayed"):
        mapped(folder, OWN_CLOCKS.replace('unit = "ms"', 'unit = "ms", delay = 1.0'))
    with pytest.raises(UserError, match='times must be a table such as { gps = "stamp" }'):
        mapped(folder, OWN_CLOCKS.replace("times = {", 'times = "stamp" #'))
    with pytest.raises(UserError, match="gps is a table and needs its time"):
        mapped(folder, OWN_CLOCKS.replace('t = "t"', "").replace("times", "# times"))
    (folder / "motors.csv").write_text("stamp,left\n1000,five\n2000,6\n")
    with pytest.raises(
        UserError, match="motors.csv, line 2, column 'left': 'five' is not a number"
    ):
        mapped(folder, OWN_CLOCKS)
    (folder / "motors.csv").write_bytes(b"")
    with pytest.raises(UserError, match="motors.csv is empty"):
        mapped(folder, OWN_CLOCKS)


@pytest.mark.parametrize(
    "fields, row",
    [
        (["azimuth_deg"], 'psi = { column = "topic:field", unit = "rad" }'),
        (["azimuth_deg", "yaw_deg"], 'psi = { column = "imu:yaw_deg", unit = "deg" }'),
        (["heading"], 'psi = { column = "imu:heading", unit = "rad" }  # or its unit in the log'),
        (["angle_deg", "yaw_rate_deg_s"], 'r = { column = "imu:yaw_rate_deg_s", unit = "deg/s" }'),
    ],
)
def test_the_example_of_a_mapping_is_of_a_field_that_is_called_so(folder, fields, row):
    """An azimuth thruster's angle is no heading, and what is called deg is not in radians."""
    (folder / "imu.parquet").unlink()
    (folder / "gps.csv").unlink()
    table = pd.DataFrame({"t": [0.0, 1.0]} | dict.fromkeys(fields, [1.0, 2.0]))
    table.to_csv(folder / "imu.csv", index=False)
    with pytest.raises(UserError) as told:
        read_recording(folder)
    assert f"\n  {row}\n" in str(told.value)


def test_a_mapping_of_a_folder_is_written_and_read_back(tmp_path):
    first, again = tmp_path / "boat.toml", tmp_path / "again.toml"
    first.write_text(OWN_CLOCKS)
    mapping = read_mapping(first)
    again.write_text(mapping_text(mapping))
    read = read_mapping(again)
    assert (read.channels, read.times) == (mapping.channels, mapping.times)
    assert read.times["motors"].unit == "ms"


FERRY = """
[file]
clock = "gnss_10hz"
velocity_axes = "earth"
[columns]
t = "t"
latitude = { column = "gnss_10hz:latitude", unit = "deg" }
longitude = { column = "gnss_10hz:longitude", unit = "deg" }
psi = { column = "gnss_10hz:quaternion_z", cosine = "gnss_10hz:quaternion_w", scale = 2 }
u = "gnss_10hz:twist_linear_y"
v = "gnss_10hz:twist_linear_x"
"cmd_a1.angle" = { column = "ref_1:angle_reference", unit = "deg" }
"exec_a1.angle" = { column = "azimuth_1:azimuth_deg", unit = "deg" }
"""


@pytest.mark.parametrize("name", ["nlp1", "qp1", "maneuvering1"])
def test_a_ferry_s_folder_is_one_run(mapped, name):
    place = DATA / "milliampere1_2025" / name
    if not place.is_dir():
        pytest.skip(f"needs {place}")
    run = mapped(place, FERRY)
    fixes = pd.read_csv(place / "gnss_10hz.csv").dropna(subset=["quaternion_z", "twist_linear_x"])
    row = np.searchsorted(run.t, fixes["t"] - 1e-9)
    psi = 2 * np.arctan2(fixes["quaternion_z"], fixes["quaternion_w"])
    assert np.max(np.abs(np.sin((run.psi[row] - psi) / 2))) < 1e-6
    east, north = fixes["twist_linear_x"], fixes["twist_linear_y"]
    assert np.allclose(run.u[row], north * np.cos(psi) + east * np.sin(psi), atol=1e-9)
    metres = 6_371_000 * np.radians(fixes["latitude"] - fixes["latitude"].iloc[0])
    assert np.max(np.abs(run.x[row] - run.x[row][0] - metres)) < 0.005 * np.ptp(metres) + 1e-3
    given = pd.read_csv(place / "ref_1.csv")
    steps = np.diff(run.t, append=np.inf)
    halfway = run.t + 0.5 * np.minimum(steps, np.median(steps))  # the nearest row to an order
    last = np.searchsorted(given["t"], halfway, side="right") - 1
    known = last >= 0
    ordered = np.radians(given["angle_reference"].to_numpy()[last])
    assert np.allclose(run.commanded["a1.angle"][known], ordered[known])
