"""Recordings as ROS 2 bags (MCAP) with standard messages, which ROS tools and rosbags read.

`/odometry` (nav_msgs/Odometry), `/pose` (geometry_msgs/PoseStamped) and `/tf` (tf2_msgs/TFMessage)
have the axes of REP 103: x east, y north, z up; in the body x ahead, y to port, z up. The native
channels, x north, y east, are std_msgs/Float64 each, under `/diffsea`.
"""

import math
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.exports.recordings import BODY, MAP, groups_of, in_viewers_axes, on_a_clock_of_mcap
from diffsea.recordings.known.recognition import OWN_PREFIXES, OWN_TOPICS
from diffsea.trajectory import Trajectory


VERSION = 9  # of the bag's description, as ROS 2 Jazzy writes it
_NOT_IN_TOPICS = re.compile(r"[^A-Za-z0-9_/]")


def write_ros_bag(run: Trajectory, path: Path) -> None:
    """Write a run as the MCAP file of a ROS 2 bag.

    A row without place or velocity has no message of it; a native channel has not-a-number there.

    Raises:
        UserError: the extra `ros` is not installed, times that the format cannot have, or two
            channels that would share a topic.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise UserError("a ROS 2 bag needs the extra: pip install 'diffsea[ros]'") from None
    run = on_a_clock_of_mcap(run)
    store = get_typestore(Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / path.stem
        connections: dict[str, Any] = {}
        with Writer(bag, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            for t, topic, message in _messages(run, store.types):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                data = bytes(store.serialize_cdr(message, kind))
                writer.write(connections[topic], round(t * 1e9), data)
        path.write_bytes(next(bag.glob("*.mcap")).read_bytes())


def topic_of(group: str, channel: str) -> str:
    """The topic of a native channel: dots part names as slashes do, other signs become `_`.

    A part that begins with a digit, which ROS refuses, gets one in front.
    """
    name = channel.removeprefix(OWN_PREFIXES.get(group, "")).replace(".", "/")
    topic = f"{OWN_TOPICS}{group}/{_NOT_IN_TOPICS.sub('_', name)}"
    return re.sub(r"/(?=\d)", "/_", topic)


def _native(run: Trajectory) -> dict[str, np.ndarray]:
    """The native channels that have values, by topic."""
    found: dict[str, np.ndarray] = {}
    for group, channels in groups_of(run).items():
        for name, series in channels.items():
            topic = topic_of(group, name)
            if topic in found:
                raise UserError(f"{run.name}: {name} and another channel would both be {topic}")
            if np.isfinite(series).any():
                found[topic] = series
    return found


def _messages(run: Trajectory, types: dict[str, Any]) -> Iterator[tuple[float, str, Any]]:
    """Times, topics and messages, row by row."""
    number, unknown = types["std_msgs/msg/Float64"], np.zeros(36)
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    native = _native(run)
    for row, t in enumerate(run.t):
        seconds, rest = divmod(round(t * 1e9), 10**9)
        stamp = types["builtin_interfaces/msg/Time"](seconds, rest)
        head = types["std_msgs/msg/Header"](stamp, MAP)
        if placed := in_viewers_axes(run, row):
            at, turn = placed
            point, attitude = types["geometry_msgs/msg/Point"](**at), quaternion(**turn)
            pose = types["geometry_msgs/msg/Pose"](point, attitude)
            yield t, "/pose", types["geometry_msgs/msg/PoseStamped"](head, pose)
            transform = types["geometry_msgs/msg/Transform"](vector(**at), attitude)
            stamped = types["geometry_msgs/msg/TransformStamped"](head, BODY, transform)
            yield t, "/tf", types["tf2_msgs/msg/TFMessage"]([stamped])
            u, v, r = (float(run.motion[channel][row]) for channel in ("u", "v", "r"))
            if all(map(math.isfinite, (u, v, r))):
                speeds = types["geometry_msgs/msg/Twist"](vector(u, -v, 0.0), vector(0.0, 0.0, -r))
                twist = types["geometry_msgs/msg/TwistWithCovariance"](speeds, unknown)
                place = types["geometry_msgs/msg/PoseWithCovariance"](pose, unknown)
                yield t, "/odometry", types["nav_msgs/msg/Odometry"](head, BODY, place, twist)
        for topic, series in native.items():
            yield t, topic, number(float(series[row]))
