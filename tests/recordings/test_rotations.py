"""Quaternions among the columns of tables and logs: their names, and the angles they become."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from diffsea.recordings.mapping_proposal import propose_mapping
from diffsea.recordings.mappings import Column, Mapping, read_mapping
from diffsea.recordings.readers import read_recording
from diffsea.recordings.rotations import quaternions_in
from diffsea.recordings.tables import read_table


@pytest.mark.parametrize(
    "names, start",
    [
        (("pose.orientation.w", "pose.orientation.x", "pose.orientation.y",
          "pose.orientation.z"), "pose.orientation."),
        (("/odom/orientation/w", "/odom/orientation/x", "/odom/orientation/y",
          "/odom/orientation/z"), "/odom/orientation/"),
        (("quat_w", "quat_x", "quat_y", "quat_z"), "quat_"),
        (("imu_qw", "imu_qx", "imu_qy", "imu_qz"), "imu_q_"),
        (("Q_W", "Q_X", "Q_Y", "Q_Z"), "Q_"),
        (("q[0]", "q[1]", "q[2]", "q[3]"), "q."),
        (("pose.q.0", "pose.q.1", "pose.q.2", "pose.q.3"), "pose.q."),
        (("q_d[0]", "q_d[1]", "q_d[2]", "q_d[3]"), "q_d."),
    ],
)  # fmt: skip
def test_parts_of_a_quaternion_are_told_by_their_names(names, start):
    assert quaternions_in(["t", *reversed(names), "speed"]) == {start: names}


@pytest.mark.parametrize(
    "names",
    [
        ("position.x", "position.y", "position.z"),
        ("yaw", "yax", "yay", "yaz"),
        ("w", "x", "y", "z"),
        ("sq[0]", "sq[1]", "sq[2]", "sq[3]"),
        ("a.w", "a.x", "a.y", "b.z"),
    ],
)
def test_what_is_no_quaternion_is_none(names):
    assert quaternions_in(names) == {}


def exported(length: float = 1.0) -> pd.DataFrame:
    """A run to the north-east, turning, as an export of ROS has it: east, north, up; y to port."""
    t = 0.1 * np.arange(600)
    yaw, rate = 0.5 * np.pi - 0.4 * np.sin(0.3 * t), -0.12 * np.cos(0.3 * t)
    to_port = -3.0 * rate
    step = 0.1 * (1.5 + 1j * to_port) * np.exp(1j * yaw)
    place = np.cumsum(np.concatenate([[0.0], 0.5 * (step[1:] + step[:-1])]))
    x, y, z, w = (length * Rotation.from_euler("ZYX", np.stack(
        [yaw, 0.01 + 0 * t, 0.05 * np.sin(t)], axis=-1)).as_quat()).T  # fmt: skip
    rng = np.random.default_rng(0)
    noise = lambda size: size * rng.standard_normal(t.size)
    return pd.DataFrame(
        {
            "header.stamp": 1.7e9 + t,
            "pose.position.x": place.real + noise(0.02),
            "pose.position.y": place.imag + noise(0.02),
            "pose.position.z": noise(0.05),
            "pose.orientation.x": x,
            "pose.orientation.y": y,
            "pose.orientation.z": z,
            "pose.orientation.w": w,
            "twist.linear.x": 1.5 + noise(0.02),
            "twist.linear.y": to_port + noise(0.02),
            "twist.angular.z": rate + noise(0.005),
        }
    )


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_has_the_angles_of_its_rotations(tmp_path, suffix):
    run, path = exported(), tmp_path / f"run{suffix}"
    run.to_csv(path, index=False) if suffix == ".csv" else run.to_parquet(path)
    psi = {"t": Column("header.stamp"), "psi": Column("pose.orientation.yaw")}
    read = read_recording(path, Mapping(channels=psi))
    yaw = 0.5 * np.pi - 0.4 * np.sin(0.3 * read.t)
    np.testing.assert_allclose(read.psi, yaw, atol=1e-6)


@pytest.mark.parametrize("length", [0.9, np.nan])
def test_four_columns_that_are_no_rotation_give_no_angles(tmp_path, length):
    path = tmp_path / "run.csv"
    exported(length).to_csv(path, index=False)
    assert "pose.orientation.yaw" not in read_table(path, None).table


def test_columns_of_one_name_are_no_parts(tmp_path):
    path, run = tmp_path / "run.parquet", exported()
    columns = {name: pa.array(run[name]) for name in run}
    twice = [*columns.values(), columns["pose.orientation.w"]]
    pq.write_table(pa.Table.from_arrays(twice, [*columns, "pose.orientation.w"]), path)
    assert "pose.orientation.yaw" not in read_table(path, None).table


def test_a_column_of_the_name_of_an_angle_stays_as_it_is(tmp_path):
    path = tmp_path / "run.csv"
    exported().assign(**{"pose.orientation.yaw": 7.0}).to_csv(path, index=False)
    assert set(read_table(path, None).table["pose.orientation.yaw"]) == {7.0}


def test_an_export_of_ros_is_understood(tmp_path):
    path = tmp_path / "run.csv"
    exported().to_csv(path, index=False)
    proposal = propose_mapping(path)
    written = tmp_path / "run.mapping.toml"
    written.write_text(proposal.text, encoding="utf-8")
    columns = {c: column.column for c, column in read_mapping(written).channels.items()}
    assert columns == {
        "t": "header.stamp", "x": "pose.position.y", "y": "pose.position.x",
        "psi": "pose.orientation.yaw", "u": "twist.linear.x", "v": "twist.linear.y",
        "r": "twist.angular.z", "phi": "pose.orientation.roll",
    }  # fmt: skip
    read = read_recording(path, read_mapping(written))
    np.testing.assert_allclose(read.v, -3.0 * 0.12 * np.cos(0.3 * read.t), atol=0.1)
    np.testing.assert_allclose(read.psi, 0.4 * np.sin(0.3 * read.t), atol=1e-6)
    assert min(proposal.sure[c] for c in ("x", "y", "psi", "u", "r")) > 0.6
