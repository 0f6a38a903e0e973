"""Recordings for viewers and tables: read back by other libraries, by diffsea, and by hand."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

import diffsea
from diffsea.cli import main


ROWS = 7


@pytest.fixture
def recording(tmp_path):
    """A run with a missing heading, an order, what was executed, and wind."""
    t = 100.0 + 0.1 * np.arange(ROWS)
    table = pd.DataFrame(
        {
            "t": t,
            "x": np.linspace(0.0, 3.0, ROWS),
            "y": np.linspace(5.0, 4.0, ROWS),
            "psi": np.linspace(0.3, 0.9, ROWS),
            "u": np.full(ROWS, 1.25),
            "v": np.full(ROWS, -0.1),
            "r": np.full(ROWS, 0.05),
            "cmd_port": np.linspace(-3.0, 8.0, ROWS),
            "exec_port": np.linspace(-2.0, 7.0, ROWS),
            "wind_speed": np.full(ROWS, 4.0),
        }
    )
    table.loc[2, "psi"] = np.nan
    path = tmp_path / "run.csv"
    table.to_csv(path, index=False)
    return path, table


def messages(path):
    """Content by topic, and the name of each topic's schema."""
    found, names = {}, {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            content = json.loads(message.data)
            assert schema is not None
            stamp = content["timestamp"]
            assert message.log_time == stamp["sec"] * 10**9 + stamp["nsec"]
            found.setdefault(channel.topic, []).append(content)
            names[channel.topic] = schema.name
            assert json.loads(schema.data)["title"] == schema.name
    return found, names


def test_viewers_get_poses_in_their_axes(recording, tmp_path):
    path, table = recording
    assert main(["export", str(path), "--to", "mcap", "-o", str(tmp_path / "out")]) == 0
    found, names = messages(tmp_path / "out" / "run.mcap")
    assert names["/pose"] == "foxglove.PoseInFrame"
    assert names["/tf"] == "foxglove.FrameTransform"
    assert len(found["/pose"]) == len(found["/tf"]) == ROWS - 1  # one has no heading
    last, pose = table.iloc[-1], found["/pose"][-1]["pose"]
    assert pose["position"] == {"x": last["y"], "y": last["x"], "z": 0.0}
    turn = pose["orientation"]
    # The bow, seen in x east and y north: rotate (1, 0) by the quaternion about z.
    east, north = turn["w"] ** 2 - turn["z"] ** 2, 2 * turn["w"] * turn["z"]
    assert math.atan2(east, north) == pytest.approx(last["psi"])
    assert found["/tf"][0]["translation"] == found["/pose"][0]["pose"]["position"]


def test_native_channels_come_back_as_they_were(recording, tmp_path):
    path, table = recording
    assert main(["export", str(path), "--to", "mcap", "-o", str(tmp_path / "out")]) == 0
    found, names = messages(tmp_path / "out" / "run.mcap")
    assert names["/diffsea/motion"] == "diffsea.Motion"
    assert "psi" not in found["/diffsea/motion"][2] and len(found["/diffsea/motion"]) == ROWS
    again = diffsea.read_recording(tmp_path / "out" / "run.mcap")  # without a mapping
    np.testing.assert_allclose(again.t - again.t[0], table["t"] - table["t"][0], atol=1e-9)
    for channel in ("x", "y", "u", "v", "r"):
        np.testing.assert_array_equal(getattr(again, channel), table[channel])
    np.testing.assert_array_equal(again.commanded["port"], table["cmd_port"])
    np.testing.assert_array_equal(again.executed["port"], table["exec_port"])
    np.testing.assert_array_equal(again.extra["wind_speed"], table["wind_speed"])


def test_what_is_missing_is_missing_when_it_is_read_back(recording, tmp_path):
    path, table = recording
    table.loc[table.index % 3 != 0, ["x", "y"]] = np.nan
    table.to_csv(path, index=False)
    assert main(["export", str(path), "--to", "mcap", "-o", str(tmp_path / "out")]) == 0
    again = diffsea.read_recording(tmp_path / "out" / "run.mcap")
    for channel in ("x", "y", "psi", "u"):
        np.testing.assert_array_equal(getattr(again, channel), table[channel])


def test_an_export_is_recognised_as_such(recording, tmp_path, capsys):
    path, _ = recording
    assert main(["export", str(path), "--to", "mcap", "-o", str(tmp_path / "out")]) == 0
    log = str(tmp_path / "out" / "run.mcap")
    assert main(["audit", log, "-o", str(tmp_path / "audit")]) == 0
    assert "read as an export of diffsea (mcap-json)" in capsys.readouterr().err


def bag_messages(path):
    """Messages of a bag by topic, read by rosbags alone; each with its receive time (s)."""
    from rosbags.highlevel import AnyReader

    found = {}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((1e-9 * time, message))
    return found


def test_a_bag_has_odometry_in_the_axes_of_ros(recording, tmp_path):
    path, table = recording
    assert main(["export", str(path), "--to", "ros2", "-o", str(tmp_path / "out")]) == 0
    found = bag_messages(tmp_path / "out" / "run-ros2.mcap")
    assert len(found["/odometry"]) == len(found["/pose"]) == len(found["/tf"]) == ROWS - 1
    (time, odometry), last = found["/odometry"][-1], table.iloc[-1]
    stamp = odometry.header.stamp
    assert time == pytest.approx(last["t"]) == stamp.sec + 1e-9 * stamp.nanosec
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert (place.x, place.y, place.z) == (last["y"], last["x"], 0.0)
    east, north = turn.w**2 - turn.z**2, 2 * turn.w * turn.z  # the bow: (1, 0) turned about z
    assert math.atan2(east, north) == pytest.approx(last["psi"])
    ahead, port = odometry.twist.twist.linear.x, odometry.twist.twist.linear.y
    assert (ahead, port) == (last["u"], -last["v"])
    assert odometry.twist.twist.angular.z == -last["r"]
    transform = found["/tf"][-1][1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    assert transform.transform.translation.x == last["y"]


@pytest.mark.parametrize("missing", [False, True])
def test_a_bag_comes_back_as_it_was(missing, recording, tmp_path):
    path, table = recording
    table = table.rename(columns={"cmd_port": "cmd_a1.force", "exec_port": "exec_a1.force"})
    if missing:
        table.loc[table.index % 3 != 0, ["x", "y"]] = np.nan
    table.to_csv(path, index=False)
    assert main(["export", str(path), "--to", "ros2", "-o", str(tmp_path / "out")]) == 0
    again = diffsea.read_recording(tmp_path / "out" / "run-ros2.mcap")  # without a mapping
    np.testing.assert_allclose(again.t - again.t[0], table["t"] - table["t"][0], atol=1e-9)
    for channel in ("x", "y", "psi", "u", "v", "r"):
        np.testing.assert_array_equal(getattr(again, channel), table[channel])
    np.testing.assert_array_equal(again.commanded["a1.force"], table["cmd_a1.force"])
    np.testing.assert_array_equal(again.executed["a1.force"], table["exec_a1.force"])
    np.testing.assert_array_equal(again.extra["wind_speed"], table["wind_speed"])


def test_topics_of_a_bag_have_no_sign_that_ros_refuses():
    from diffsea.exports.ros_bags import topic_of

    assert topic_of("orders", "cmd_a 1.force") == "/diffsea/orders/a_1/force"
    assert topic_of("motion", "psi") == "/diffsea/motion/psi"
    assert topic_of("executed", "exec_2.angle") == "/diffsea/executed/_2/angle"


def test_two_channels_of_one_topic_are_refused(recording, tmp_path, capsys):
    path, table = recording
    table.assign(**{"cmd_a b": 1.0, "cmd_a_b": 2.0}).to_csv(path, index=False)
    assert main(["export", str(path), "--to", "ros2", "-o", str(tmp_path / "out")]) == 1
    assert "would both be /diffsea/orders/a_b" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_long_table_has_a_row_for_each_value_with_its_unit(recording, tmp_path):
    path, table = recording
    assert main(["export", str(path), "--to", "parquet", "-o", str(tmp_path / "out")]) == 0
    long = pd.read_parquet(tmp_path / "out" / "run.parquet")
    assert list(long) == ["run", "t", "channel", "value", "unit"]
    assert len(long) == table.drop(columns="t").notna().to_numpy().sum()
    units = dict(zip(long["channel"], long["unit"], strict=True))
    assert units["psi"] == "rad" and units["wind_speed"] == "m/s" and units["cmd_port"] == ""
    wide = long.pivot(index="t", columns="channel", values="value")
    np.testing.assert_array_equal(wide["exec_port"], table["exec_port"])


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (["--to", "mcap", "--allow-loss"], 1, "--allow-loss is for vessels"),
        (["--to", "gazebo", "--start", "3"], 1, "are for recordings"),
        (["--to", "mcap", "--speed", "2"], 1, "are for --to ardupilot"),
    ],
)
def test_options_of_other_tools_are_refused(words, status, told, recording, tmp_path, capsys):
    assert main(["export", str(recording[0]), *words, "-o", str(tmp_path / "out")]) == status
    assert told in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("tool", ["mcap", "ros2"])
def test_times_before_zero_are_refused(tool, recording, tmp_path, capsys):
    path, table = recording
    table.assign(t=table["t"] - 200.0).to_csv(path, index=False)
    assert main(["export", str(path), "--to", tool, "-o", str(tmp_path / "out")]) == 1
    assert "has times from 0 s on" in capsys.readouterr().err and not (tmp_path / "out").exists()
