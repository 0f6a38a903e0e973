"""The true wind of an apparent one: by hand, and as the publisher of a real set made it."""

import numpy as np
import pandas as pd
import pytest
from tests.paths import DATA, EXPERIMENTS

from diffsea import Mapping, propose_mapping, read_mapping, read_recording
from diffsea.recordings.mappings import Column
from diffsea.recordings.readers import to_frame


ROWS = 40


def table(**channels):
    """A recording at a steady heading and speed, with an apparent wind."""
    t = 0.2 * np.arange(ROWS)
    steady = {"psi": 0.0, "u": 3.0, "v": 0.0}
    wind = {"apparent_wind_speed": 5.0, "apparent_wind_angle": 0.0}
    return pd.DataFrame({"t": t} | dict.fromkeys(("x", "y"), 0.0 * t) | steady | wind | channels)


def true_wind(frame, mapping=None):
    run = read_recording(frame, mapping)
    return run.extra["wind_speed"], np.degrees(run.extra["wind_direction"]), run


@pytest.mark.parametrize(
    ("channels", "speed", "comes_from"),
    [
        ({}, 2.0, 0.0),  # 5 m/s on the bow, of which 3 are her own speed
        ({"apparent_wind_speed": 1.0}, 2.0, 180.0),  # she overtakes a wind from astern
        ({"u": 0.0, "apparent_wind_angle": np.pi / 2}, 5.0, 90.0),  # to starboard of a bow to north
        ({"u": 0.0, "apparent_wind_angle": -np.pi / 2, "psi": np.pi / 2}, 5.0, 0.0),
        ({"apparent_wind_speed": 3.0 * np.sqrt(2), "apparent_wind_angle": np.pi / 4}, 3.0, 90.0),
        ({"u": 0.0, "v": 2.0}, np.sqrt(29), 360 - np.degrees(np.arctan2(2, 5))),
    ],
)
def test_the_air_moves_as_past_the_vessel_and_as_she_does_herself(channels, speed, comes_from):
    found, direction, run = true_wind(table(**channels))
    np.testing.assert_allclose(found, speed)
    np.testing.assert_allclose((direction - comes_from + 180) % 360, 180, atol=1e-9)
    assert run.provenance[-1].startswith("true wind from the apparent one")


def test_a_wind_that_is_true_already_stays_as_it_is():
    speed, direction, run = true_wind(table(wind_speed=9.0, wind_direction=1.0))
    assert set(speed) == {9.0} and direction == pytest.approx(np.degrees(1.0))
    assert not any("apparent" in note for note in run.provenance)


@pytest.mark.parametrize("lacking", ["psi", "u"])
def test_without_heading_or_speed_it_is_said_that_the_apparent_wind_is_of_no_use(lacking):
    run = read_recording(table().drop(columns=lacking))
    assert "wind_speed" not in run.extra and "apparent_wind_speed" in run.extra
    assert "the apparent wind is not used: a heading and u are needed" in run.provenance[-1]


def test_a_sway_that_is_not_measured_is_none_and_a_gap_of_the_heading_leaves_no_wind():
    frame = table().drop(columns="v")
    frame.loc[10:29, "psi"] = np.nan
    speed, _, _ = true_wind(frame)
    assert np.array_equal(np.isnan(speed), (frame.index >= 10) & (frame.index <= 29))
    np.testing.assert_allclose(speed[:10], 2.0)


def test_degrees_knots_and_axes_of_a_file_are_its_mapping_s():
    there = {"t": "t", "psi": "psi", "u": "u", "v": "v"}
    channels = {name: Column(column) for name, column in there.items()}
    channels["apparent_wind_speed"] = Column("AWS", "kn")
    channels["apparent_wind_angle"] = Column("AWA", "deg")
    frame = table(u=0.0, AWS=5.0 / 0.514444, AWA=30.0)
    frame = frame.drop(columns=["apparent_wind_speed", "apparent_wind_angle"])
    speed, direction, _ = true_wind(frame, Mapping(channels))
    np.testing.assert_allclose(speed, 5.0, rtol=1e-5)
    np.testing.assert_allclose(direction, 30.0)
    # Of forward-port-up axes, anticlockwise: to port of a bow to the east.
    _, direction, _ = true_wind(frame, Mapping(channels, frame="ENU"))
    np.testing.assert_allclose(direction, 60.0)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (("AWS_kn", "AWA_deg"), "kn"),
        (("wind_rel_ms", "wind_rel_deg"), "m/s"),
        (("wind_app_speed_ms", "wind_app_angle_deg"), "m/s"),
        (("apparent wind speed [m/s]", "apparent wind angle [deg]"), "m/s"),
        (("wind_velo_relative_mid [m/s]", "wind_dir_relative_mid [deg]"), "m/s"),
    ],
)
def test_columns_of_an_apparent_wind_are_found_by_their_names(names, unit, tmp_path):
    t = 0.2 * np.arange(400)
    psi, u = 0.8 * np.sin(0.1 * t), 2.0 + 0.5 * np.sin(0.07 * t)
    motion = {"heading_rad": psi, "surge_ms": u, "sway_ms": 0.1 * np.cos(0.1 * t)}
    over_ground = np.cumsum(0.2 * (u + 1j * motion["sway_ms"]) * np.exp(1j * psi))
    motion |= {"north_m": over_ground.real, "east_m": over_ground.imag}
    wind = dict(zip(names, (6.0 + np.sin(t), 40.0 * np.cos(0.1 * t)), strict=True))
    path = tmp_path / "log.csv"
    pd.DataFrame({"time_s": t} | motion | wind).to_csv(path, index=False)
    channels = propose_mapping([path]).mapping.channels
    speed, angle = (channels[f"apparent_wind_{one}"] for one in ("speed", "angle"))
    assert (speed.column, angle.column) == names
    assert (speed.unit or "m/s", angle.unit) == (unit, "deg")


def test_it_is_the_true_wind_that_the_publisher_of_real_recordings_made_of_it():
    folder = DATA / "esso_osaka"
    files = sorted((folder / "recordings").glob("*.csv"))
    if not files:
        pytest.skip(f"no recordings in {folder}")
    mapping = read_mapping(EXPERIMENTS / "esso_osaka" / "mapping_repaired.toml")
    for file in files[:3]:
        wind = pd.read_csv(folder / "measured_wind" / file.name)
        frame = to_frame(read_recording(file, mapping)).assign(
            apparent_wind_speed=wind["wind_velo_relative_mid [m/s]"],
            apparent_wind_angle=wind["wind_dir_relative_mid [rad]"],
        )
        run = read_recording(frame)
        found, true = (
            speed * np.exp(1j * np.asarray(direction))
            for speed, direction in (
                (run.extra["wind_speed"], run.extra["wind_direction"]),
                (wind["wind_velo_true [m/s]"], wind["wind_dir_true [rad]"]),
            )
        )
        missed = np.abs(found - np.asarray(true))
        assert np.median(missed) < 1e-3 and np.median(np.abs(true)) > 1.0
