"""Logs of robots and of MATLAB: what they hold comes out in SI, NED and on one clock."""

import sqlite3
import struct
import sys

import numpy as np
import pytest
from scipy.io import savemat

from diffsea import UserError, read_mapping, read_recording
from diffsea.cli import main
from diffsea.recordings import audit
from diffsea.recordings.geodesy import local_position
from diffsea.recordings.logs import contents, is_log
from diffsea.recordings.logs.reading import LogChannel, join_channels
from diffsea.recordings.rotations import euler_angles


SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND  # ns


@pytest.fixture
def mapped(tmp_path):
    """A function that reads a log through the text of a mapping."""

    def read(path, text):
        file = tmp_path / "map.toml"
        file.write_text(text)
        return read_recording(path, file)

    return read


# ROS bags, written by the writers of rosbags


@pytest.fixture
def bag(tmp_path):
    """A function that writes messages (topic, receive time in s, message) as a bag."""
    pytest.importorskip("rosbags", reason="needs diffsea[ros]")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    def write(messages, kind="mcap"):
        store = types(kind)
        if kind == "ros1":
            path, writer = tmp_path / "run.bag", Writer1(tmp_path / "run.bag")
        else:
            plugin = {"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}[kind]
            path = tmp_path / "run"
            writer = Writer2(path, version=9, storage_plugin=plugin)
        with writer as file:
            connections = {}
            for topic, received, message in messages:
                name = message.__msgtype__
                if topic not in connections:
                    connections[topic] = file.add_connection(topic, name, typestore=store)
                encode = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
                data = encode(message, name)
                file.write(connections[topic], EPOCH + round(received * SECOND), data)
        return path

    return write


def types(kind):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    thrust = "std_msgs/Header header\nfloat64[] thrusters\n"
    store.register(get_types_from_msg(thrust, "boat_msgs/msg/Thrust"))
    return store


class Messages:
    """Messages of a type store, with header stamps in seconds after the epoch of the tests."""

    def __init__(self, kind):
        self.store, self.first = types(kind), kind == "ros1"

    def make(self, name, **fields):
        return self.store.types[name](**fields)

    def header(self, stamp):
        ns = 0 if stamp is None else EPOCH + round(stamp * SECOND)
        time = self.make("builtin_interfaces/msg/Time", sec=ns // SECOND, nanosec=ns % SECOND)
        extra = {"seq": 0} if self.first else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id="map", **extra)

    def vector(self, x=0.0, y=0.0, z=0.0, kind="Vector3"):
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def turned(self, yaw):
        return self.make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2)
        )

    def odometry(self, stamp, x, y, yaw, u=0.0, v=0.0, r=0.0):
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(x, y, kind="Point"),
            orientation=self.turned(yaw),
        )
        twist = self.make(
            "geometry_msgs/msg/Twist", linear=self.vector(u, v), angular=self.vector(z=r)
        )
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp),
            child_frame_id="base",
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )

    def imu(self, stamp, r, yaw=0.0, unknown=False):
        covariance = np.zeros(9)
        orientation = np.array([-1.0 if unknown else 0.0, *[0.0] * 8])
        return self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp),
            orientation=self.turned(yaw),
            orientation_covariance=orientation,
            angular_velocity=self.vector(z=r),
            angular_velocity_covariance=covariance,
            linear_acceleration=self.vector(),
            linear_acceleration_covariance=covariance,
        )

    def fix(self, stamp, latitude, longitude, status=0):
        return self.make(
            "sensor_msgs/msg/NavSatFix",
            header=self.header(stamp),
            status=self.make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=0.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def thrust(self, stamp, forces):
        return self.make(
            "boat_msgs/msg/Thrust", header=self.header(stamp), thrusters=np.array(forces)
        )

    def number(self, value):
        return self.make("std_msgs/msg/Float64", data=float(value))


ROS = """
[file]
frame = "ENU"
[columns]
x = "/odom:pose.pose.position.x"
y = "/odom:position.y"
psi = "/odom:yaw"
u = "/odom:twist.twist.linear.x"
v = "/odom:twist.twist.linear.y"
r = "/imu:angular_velocity.z"
cmd_port = "/thrust:thrusters.0"
cmd_starboard = "/thrust:thrusters.1"
"""


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_bags_of_both_ros_are_read_turned_and_joined(bag, mapped, kind):
    """A boat that circles: the truth is written in NED, the bag as ROS does, in ENU and FLU."""
    make = Messages(kind)
    fast, slow = np.arange(200) * 0.02, 0.013 + np.arange(20) * 0.2
    psi, radius = lambda t: 3.0 + 0.5 * t, 8.0
    messages = [("/imu", t + 0.001, make.imu(t, -0.5)) for t in fast]
    for t in slow:
        north, east = radius * np.sin(psi(t)), -radius * np.cos(psi(t))
        odometry = make.odometry(t, east, north, np.pi / 2 - psi(t), 4.0, -0.25, -0.5)
        messages.append(("/odom", t + 0.05, odometry))
    messages += [("/thrust", t, make.thrust(t, [10.0 * t, 5.0])) for t in (0.5, 1.513, 3.0)]
    run = mapped(bag(sorted(messages, key=lambda item: item[1]), kind), ROS)
    np.testing.assert_allclose(run.t, fast, atol=1e-6)
    np.testing.assert_allclose(run.r, 0.5)
    marked = np.flatnonzero(np.isfinite(run.x))
    # 0.013 s is nearest to the row at 0.02 s; the last sample's row would lie beyond it.
    np.testing.assert_array_equal(marked, [*range(1, 191, 10), 190])
    rows = run.t[marked]
    np.testing.assert_allclose(run.psi[marked], psi(rows), atol=1e-6)
    # Chords of the circle are off by their sagitta, (r dt)^2 / 8 of the radius.
    np.testing.assert_allclose(run.x[marked], radius * np.sin(psi(rows)), atol=0.011)
    np.testing.assert_allclose(run.y[marked], -radius * np.cos(psi(rows)), atol=0.011)
    np.testing.assert_allclose(run.u[marked], 4.0)
    np.testing.assert_allclose(run.v[marked], 0.25)
    port = np.select([fast < 0.5, fast < 1.513, fast < 3], [np.nan, 5.0, 15.13], 30.0)
    np.testing.assert_allclose(run.commanded["port"], port)
    assert "rows are the 200 samples of /imu (the most samples)" in run.provenance
    assert "turned from ENU into NED axes" in run.provenance
    told = "\n".join(run.provenance)
    assert "/odom: 20 samples by header stamps, from 1700000000.000000000 s" in told
    assert "psi from pose.pose.orientation.yaw" in told and "sha256" in run.provenance[0]


def test_orders_are_neither_late_nor_early_on_the_clock_of_other_topics(bag, mapped):
    """Held from the next row on they would be 0.05 s late on average; a hole of the clock stays."""
    make = Messages("mcap")
    given = np.arange(0.0, 40.0, 0.137)
    clock = np.r_[np.arange(0.0, 20.0, 0.1), np.arange(30.0, 40.0, 0.1)]
    messages = [("/plain", float(t), make.number(k)) for k, t in enumerate(given)]
    messages += [("/stamped", float(t), make.imu(float(t), 0.1)) for t in clock]
    path = bag(sorted(messages, key=lambda one: one[1]))
    columns = '[columns]\nr = "/stamped:angular_velocity.z"\ncmd_a = "/plain:data"\n'
    run = mapped(path, f'[file]\nclock = "/stamped"\n{columns}')
    order = np.asarray(run.commanded["a"])
    new = np.flatnonzero(np.diff(order) != 0) + 1
    late = np.asarray(run.t)[new] - given[order[new].astype(int)]
    inside = np.abs(np.asarray(run.t)[new] - 30.0) > 0.01
    assert abs(np.mean(late[inside])) < 0.005 and np.max(np.abs(late[inside])) <= 0.0501
    before_the_hole = order[np.searchsorted(np.asarray(run.t), 20.0) - 1]
    assert given[int(before_the_hole)] < 20.0


def test_a_bag_says_when_it_was_made(bag, mapped):
    """Its own times begin at zero; two bags can be put on one clock by their epochs."""
    make = Messages("mcap")
    path = bag([("/stamped", t, make.imu(t, 0.1)) for t in 5.5 + np.arange(10.0)])
    run = mapped(path, '[columns]\nr = "/stamped:angular_velocity.z"\n')
    assert run.t[0] == pytest.approx(0.0, abs=1e-6)
    assert run.read.epoch == pytest.approx(EPOCH / SECOND + 5.5, abs=1e-3)


def test_clocks_are_header_stamps_receive_times_or_what_the_mapping_says(bag, mapped):
    make = Messages("mcap")
    messages = []
    for i in range(10):
        messages += [
            ("/stamped", i + 0.4, make.imu(float(i), 0.1 * i)),
            ("/unset", i + 0.5, make.imu(None, 0.2 * i)),
            ("/plain", i + 0.6, make.number(i)),
        ]
    path = bag(messages)
    text = '[columns]\nr = "/stamped:angular_velocity.z"\ncmd_a = "/plain:data"\n'
    run = mapped(path, text)
    np.testing.assert_allclose(run.t, np.arange(10), atol=1e-6)
    np.testing.assert_allclose(run.commanded["a"], [np.nan, *range(9)])
    assert any("/plain: 10 samples by receive time" in note for note in run.provenance)
    run = mapped(path, '[file]\nstamps = "receive"\n' + text)
    np.testing.assert_allclose(run.commanded["a"], range(10))  # each 0.2 s after the nearest row
    assert any("/stamped: 10 samples by receive time" in note for note in run.provenance)
    run = mapped(path, '[columns]\nr = "/unset:angular_velocity.z"\n')
    assert any("header stamps not set in 10 of 10" in note for note in run.provenance)
    run = mapped(path, '[file]\nclock = "/plain"\n' + text)
    np.testing.assert_allclose(run.t, 0.6 + np.arange(10), atol=1e-6)
    np.testing.assert_allclose(run.r, [*(0.1 * (np.arange(9) + 0.6)), np.nan], atol=1e-6)


def test_fixes_become_metres_and_what_is_no_fix_is_missing(bag, mapped):
    make = Messages("mcap")
    places = [(0.0, 0.0, -1), (60.0, 179.9999, 0), (60.001, -179.9999, 0), (0.0, 0.0, -1)]
    messages = [
        ("/fix", i, make.fix(i, *place[:2], status=place[2])) for i, place in enumerate(places)
    ]
    messages += [("/imu", i, make.imu(i, 0.0, 1.0, unknown=i == 2)) for i in range(4)]
    text = """
    latitude = { column = "/fix:latitude", unit = "deg" }
    longitude = { column = "/fix:longitude", unit = "deg" }
    psi = "/imu:yaw"
    """
    path = bag(sorted(messages, key=lambda item: item[1]))
    run = mapped(path, "[columns]" + text)
    # Second of latitude at 60 degrees: 111412 m per degree; of longitude: 55800 m.
    np.testing.assert_allclose(run.x, [np.nan, 0, 111.412, np.nan], atol=1e-3)
    np.testing.assert_allclose(run.y, [np.nan, 0, 11.16, np.nan], atol=1e-3)
    np.testing.assert_allclose(run.psi, [1, 1, np.nan, 1])
    assert any("of the first valid fix, 60, 179.9999 deg" in note for note in run.provenance)
    run = mapped(path, "[file]\norigin = [60.001, 180]\n[columns]" + text)
    np.testing.assert_allclose(run.x, [np.nan, -111.412, 0, np.nan], atol=1e-3)
    np.testing.assert_allclose(run.y[1:3], [-5.58, 5.58], atol=1e-3)


def test_messages_received_late_are_put_in_order_and_jumps_refused(bag, mapped):
    make = Messages("mcap")
    text = '[columns]\nr = "/imu:angular_velocity.z"\n'
    stamps = [0.0, 0.1, 0.3, 0.2, 0.4, 0.5]
    messages = [("/imu", i, make.imu(stamp, stamp)) for i, stamp in enumerate(stamps)]
    run = mapped(bag(messages), text)
    np.testing.assert_allclose(run.r, run.t, atol=1e-6)
    assert "/imu: 1 messages received late, put in the order of their stamps" in run.provenance


def test_a_clock_that_was_set_back_is_refused(bag, mapped):
    make = Messages("mcap")
    stamps = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.1, 0.2]
    path = bag([("/imu", i, make.imu(stamp, stamp)) for i, stamp in enumerate(stamps)])
    text = '[columns]\nr = "/imu:angular_velocity.z"\n'
    with pytest.raises(UserError, match="/imu jump back by 0.5 s, 0.1 s being.*receive"):
        mapped(path, text)
    assert mapped(path, '[file]\nstamps = "receive"\n' + text).t.size == 9


def test_arrays_that_change_length_and_types_without_definition(bag, mapped):
    make = Messages("mcap")
    forces = [[], [1.0], [1.0, 2.0], [3.0, 4.0]]
    messages = [("/thrust", i, make.thrust(i, force)) for i, force in enumerate(forces)]
    messages += [("/odom", i + 0.1, make.odometry(i, i, 0.0, 0.0)) for i in range(4)]
    path = bag(sorted(messages, key=lambda item: item[1]))
    run = mapped(path, '[columns]\nx = "/odom:position.x"\ncmd_b = "/thrust:thrusters.1"\n')
    np.testing.assert_array_equal(run.commanded["b"], [np.nan, np.nan, 2, 4])
    assert contents(path)["/thrust"] == ["thrusters.0", "thrusters.1"]


def test_bags_that_define_no_messages(bag, mapped):
    """Those of the usual packages are known, others are refused by name."""
    make = Messages("db3")
    messages = [("/imu", i, make.imu(i, 0.5)) for i in range(4)]
    path = bag([*messages, *(("/thrust", 4 + i, make.thrust(i, [1.0])) for i in range(4))], "db3")
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("DELETE FROM message_definitions")
    text = '[columns]\nr = "/imu:angular_velocity.z"\n'
    np.testing.assert_array_equal(mapped(path, text).r, 0.5)
    assert contents(path)["/thrust"] == []
    with pytest.raises(UserError, match="/thrust has messages of type boat_msgs/msg/Thrust, which"):
        mapped(path, text + 'cmd_a = "/thrust:thrusters.0"\n')


# ArduPilot: a writer of the published format. Each message is A3 95, its number, its fields;
# number 128 (FMT) defines the others: number, length, name, characters of the types, names.

_KINDS = {"Q": "Q", "f": "f", "d": "d", "B": "B", "H": "H", "L": "i", "c": "h", "C": "H", "I": "I"}
_KINDS |= {"Z": "64s", "b": "b"}


def bin_log(definitions, rows, start=b""):
    """Bytes of a log; `definitions` name -> (types, fields), `rows` (name, values)."""
    numbers = {name: 130 + i for i, name in enumerate(definitions)}
    layouts = {
        name: struct.Struct("<" + "".join(_KINDS[kind] for kind in kinds))
        for name, (kinds, _) in definitions.items()
    }
    log = [start, _definition(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for name, (kinds, fields) in definitions.items():
        log.append(_definition(numbers[name], layouts[name].size + 3, name, kinds, fields))
    for name, values in rows:
        log.append(bytes([0xA3, 0x95, numbers[name]]) + layouts[name].pack(*values))
    return b"".join(log)


def text_log(definitions, rows):
    """The same as text, a line each, in the units that fields are told in."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    for i, (name, (kinds, fields)) in enumerate(definitions.items()):
        lines.append(f"FMT, {130 + i}, 89, {name}, {kinds}, {fields}")
    scales = {**dict.fromkeys("cCeE", 100), "L": 10_000_000}
    for name, values in rows:
        told = [
            value.decode()
            if isinstance(value, bytes)
            else str(value / scales[kind] if kind in scales else value)
            for kind, value in zip(definitions[name][0], values, strict=True)
        ]
        lines.append(", ".join([name, *told]))
    return "\n".join([*lines, ""]).encode()


def _definition(number, length, name, kinds, fields):
    texts = [text.encode() for text in (name, kinds, fields)]
    return bytes([0xA3, 0x95, 128]) + struct.pack("<BB4s16s64s", number, length, *texts)


ARDUPILOT = {
    "ATT": ("QccC", "TimeUS,Roll,Pitch,Yaw"),
    "GPS": ("QBIHLLf", "TimeUS,Status,GMS,GWk,Lat,Lng,Spd"),
    "IMU": ("QBf", "TimeUS,I,GyrZ"),
    "RCOU": ("QHH", "TimeUS,C1,C3"),
    # Units by message: the character # marks the field that numbers instances.
    "FMTU": ("QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    "NOTE": ("B", "Level"),
}
_KINDS["N"] = "16s"
BOAT = """
[columns]
psi = { column = "ATT:Yaw", unit = "deg" }
latitude = { column = "GPS:Lat", unit = "deg" }
longitude = { column = "GPS:Lng", unit = "deg" }
u = "GPS:Spd"
r = "IMU[1]:GyrZ"
cmd_port = { column = "RCOU:C1", scale = 0.002, offset = -3 }
"""


def ardupilot_rows():
    imu = 132
    rows: list[tuple[str, tuple]] = [("FMTU", (0, imu, b"s#E", b"F--"))]
    for i in range(100):
        t = 5_000_000 + 20_000 * i
        rows.append(("ATT", (t, 100, -200, (35800 + 100 * i) % 36000)))
        rows += [("IMU", (t, 0, 9.0)), ("IMU", (t, 1, 0.5))]
        if i % 10 == 0:
            status = 1 if i == 0 else 3
            place = 634400000 + 100 * i, 103900000
            rows.append(("GPS", (t + 4000, status, 20 * i, 2300, *place, 1.5)))
        if i in (30, 60):
            rows.append(("RCOU", (t, 1500 + i, 1500)))
    return rows


@pytest.fixture
def dataflash(tmp_path):
    """A function that writes an ArduPilot log."""
    pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")

    def write(data):
        path = tmp_path / "00000042.bin"
        path.write_bytes(data)
        return path

    return write


def test_ardupilot_logs_are_read_by_message_and_instance(dataflash, mapped):
    run = mapped(dataflash(bin_log(ARDUPILOT, ardupilot_rows())), BOAT)
    np.testing.assert_allclose(run.t, 5 + 0.02 * np.arange(100))
    degrees = np.degrees(run.psi)
    np.testing.assert_allclose(degrees, 358 + np.arange(100), atol=1e-9)
    np.testing.assert_allclose(run.r, 0.5)
    marked = np.flatnonzero(np.isfinite(run.x))
    # The first fix is none; the next lies 4 ms after row 10, whose nearest inside is row 11.
    np.testing.assert_array_equal(marked, [11, 20, 30, 40, 50, 60, 70, 80, 90])
    # 1e-5 deg of latitude per row are 1.11469 m at this latitude; the sample is 0.2 rows late.
    np.testing.assert_allclose(run.x[marked], 1.11469 * (marked - 10.2), atol=2e-3)
    np.testing.assert_allclose(run.y[marked], 0, atol=1e-3)
    port = np.repeat([np.nan, 0.06, 0.12], [30, 30, 40])
    np.testing.assert_allclose(run.commanded["port"], port, atol=1e-9)
    assert any("by the autopilot's time since boot; psi from Yaw" in n for n in run.provenance)


@pytest.mark.parametrize("header", [b"", b"42\nLog of a boat\n"])
def test_ardupilot_logs_as_text_are_read_as_binary_ones(dataflash, mapped, tmp_path, header):
    modes = {"MODE": ("QMB", "TimeUS,Mode,Rsn")}
    rows = [*ardupilot_rows(), ("MODE", (6_000_000, b"MANUAL", 1))]
    path = tmp_path / "00000042.log"
    path.write_bytes(header + text_log(ARDUPILOT | modes, rows))
    binary = dataflash(bin_log(ARDUPILOT, ardupilot_rows()))
    assert contents(path) == contents(binary) | {"MODE": ["Rsn"]}
    one, other = mapped(path, BOAT), mapped(binary, BOAT)
    np.testing.assert_array_equal(one.t, other.t)
    for name, series in other.motion.items():
        np.testing.assert_allclose(one.motion[name], series, rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(one.commanded["port"], other.commanded["port"])


def test_the_last_line_of_a_text_log_counts_where_it_has_an_end(tmp_path, mapped):
    pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
    whole = text_log(ARDUPILOT, [row for row in ardupilot_rows() if row[0] != "RCOU"])
    lines = whole.splitlines(keepends=True)
    last = max(k for k, line in enumerate(lines) if line.startswith(b"ATT"))
    path, text = tmp_path / "boat.log", '[columns]\npsi = { column = "ATT:Yaw", unit = "deg" }\n'
    path.write_bytes(b"".join(lines[:last]) + lines[last].rstrip()[:-1])
    run = mapped(path, text)
    assert run.t.size == 99
    assert "boat.log ends within a message; what is before it is used" in run.provenance
    path.write_bytes(b"".join([*lines[:9], b"XX, 3, 4, a damaged line\n", *lines[9 : last + 1]]))
    run = mapped(path, text)
    assert run.t.size == 100 and "boat.log: 1 line belongs to no message" in run.provenance
    path.write_bytes(b"".join(lines[: last + 1]))
    run = mapped(path, text)
    assert run.t.size == 100 and not any("belong" in note for note in run.provenance)


def test_a_file_of_that_ending_that_is_no_ardupilot_log_is_a_table(tmp_path):
    path = tmp_path / "run.log"
    path.write_text("t,psi,r\n" + "".join(f"{k},{0.1 * k},0.1\n" for k in range(9)))
    assert read_recording(path).t.size == 9


def test_ardupilot_contents_and_first_instance(dataflash, mapped):
    path = dataflash(bin_log(ARDUPILOT, ardupilot_rows()))
    found = contents(path)
    assert set(found) >= {"ATT", "GPS", "IMU[0]", "IMU[1]", "RCOU"} and "NOTE" not in found
    assert found["GPS"] == ["Status", "GMS", "GWk", "Lat", "Lng", "Spd"]
    np.testing.assert_allclose(mapped(path, '[columns]\nr = "IMU:GyrZ"\n').r, 9.0)


def test_ardupilot_logs_cut_off_or_with_foreign_bytes_say_so(dataflash, mapped):
    text = '[columns]\npsi = { column = "ATT:Yaw", unit = "deg" }\n'
    whole = bin_log(ARDUPILOT, ardupilot_rows())
    run = mapped(dataflash(whole[:-5]), text)
    assert run.t.size in (99, 100)
    assert "00000042.bin ends within a message; what is before it is used" in run.provenance
    run = mapped(dataflash(bin_log(ARDUPILOT, ardupilot_rows(), start=b"\x00" * 40)), text)
    assert any("40 of" in note and "belong to no message" in note for note in run.provenance)
    back = [("ATT", (t, 0, 0, 0)) for t in (10, 30, 20)]
    with pytest.raises(UserError, match="ATT: time runs backwards at sample 3, from 3e-05 s"):
        mapped(dataflash(bin_log(ARDUPILOT, back)), text)


# PX4: a writer of the published ULog format. Header, flag bits (B), formats (F), then
# subscriptions (A) and data (D); each message is its length, its letter, its bytes.


def ulog(formats, data, subscriptions=None):
    """Bytes of a log; `formats` name -> fields, `data` (name, instance, packed bytes)."""
    log = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", 0), _ulog_message("B", bytes(40))]
    for name, fields in formats.items():
        log.append(_ulog_message("F", f"{name}:{fields}".encode()))
    instances = list(dict.fromkeys((name, instance) for name, instance, _ in data))
    for number, (name, instance) in enumerate(subscriptions or instances):
        log.append(_ulog_message("A", struct.pack("<BH", instance, number) + name.encode()))
    for name, instance, packed in data:
        number = instances.index((name, instance))
        log.append(_ulog_message("D", struct.pack("<H", number) + packed))
    return b"".join(log)


def _ulog_message(letter, content):
    return struct.pack("<HB", len(content), ord(letter)) + content


PX4 = {
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float vx;float vy;"
    "bool xy_valid;bool v_xy_valid;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "actuator_outputs": "uint64_t timestamp;float[4] output;",
}
OTTER = """
[file]
velocity_axes = "earth"
[columns]
x = "vehicle_local_position:x"
y = "vehicle_local_position:y"
u = "vehicle_local_position:vx"
v = "vehicle_local_position:vy"
psi = "vehicle_attitude:q.yaw"
cmd_port = "actuator_outputs[1]:output.2"
cmd_first = "actuator_outputs:output.2"
"""


def px4_data():
    data = []
    for i in range(200):
        t = 1_000_000 + 10_000 * i
        yaw = 3.0 + 0.2 * (t * 1e-6 - 1)
        q = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        data.append(("vehicle_attitude", 0, struct.pack("<Q4f", t, *q)))
        if i % 20 == 0:
            values = (1.0 * i, -2.0, 1.2, 0.9, i != 40, True)
            data.append(("vehicle_local_position", 0, struct.pack("<Q4f2?", t, *values)))
            data.append(("actuator_outputs", 0, struct.pack("<Q4f", t, 9, 9, 9, 9)))
            data.append(("actuator_outputs", 1, struct.pack("<Q4f", t, 0, 0, i, 0)))
    return data


@pytest.fixture
def px4(tmp_path):
    """A function that writes a PX4 log."""
    pytest.importorskip("pyulog", reason="needs diffsea[px4]")

    def write(data):
        path = tmp_path / "log.ulg"
        path.write_bytes(data)
        return path

    return write


def test_px4_logs_are_read_with_attitude_flags_and_instances(px4, mapped):
    run = mapped(px4(ulog(PX4, px4_data())), OTTER)
    np.testing.assert_allclose(run.t, 1 + 0.01 * np.arange(200))
    psi = 3.0 + 0.2 * (run.t - 1)
    np.testing.assert_allclose(run.psi, psi, atol=1e-6)
    marked = np.arange(0, 200, 20)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(run.u)), marked)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(run.x)), np.delete(marked, 2))
    # The velocity over ground is 1.2 m/s north and 0.9 m/s east.
    np.testing.assert_allclose(run.u[marked], 1.2 * np.cos(psi[marked]) + 0.9 * np.sin(psi[marked]))
    np.testing.assert_allclose(run.v[marked], 0.9 * np.cos(psi[marked]) - 1.2 * np.sin(psi[marked]))
    np.testing.assert_array_equal(run.commanded["port"], np.repeat(marked, 20))
    np.testing.assert_array_equal(run.commanded["first"], 9)


def test_px4_fixes_in_whole_numbers(px4, mapped):
    formats = {
        "vehicle_gps_position": "uint64_t timestamp;int32_t lat;int32_t lon;uint8_t fix_type;"
    }
    fixes = [(0, 0, 1), (600000000, 50000000, 2), (600010000, 50000000, 3)]
    data = [
        ("vehicle_gps_position", 0, struct.pack("<QiiB", 100_000 * i, *fix))
        for i, fix in enumerate(fixes)
    ]
    text = """
    [columns]
    latitude = { column = "vehicle_gps_position:lat", unit = "deg", scale = 1e-7 }
    longitude = { column = "vehicle_gps_position:lon", unit = "deg", scale = 1e-7 }
    """
    run = mapped(px4(ulog(formats, data)), text)
    np.testing.assert_allclose(run.x, [np.nan, 0, 111.412], atol=1e-3)
    with pytest.raises(UserError, match="with scale = 1e-7 for whole numbers"):
        mapped(px4(ulog(formats, data)), text.replace(", scale = 1e-7", ""))


def test_px4_logs_cut_off_say_so(px4, mapped):
    text = '[columns]\npsi = "vehicle_attitude:q.yaw"\n'
    run = mapped(px4(ulog(PX4, px4_data())[:-3003]), text)
    assert 100 < run.t.size < 200
    assert "log.ulg ends within a message; what is before it is used" in run.provenance
    whole = mapped(px4(ulog(PX4, px4_data())), text)
    assert not any("log.ulg ends" in note for note in whole.provenance)
    for part in (3, 20, 30):
        with pytest.raises(UserError, match=r"log.ulg cannot be read as a PX4 log \(ULog\)"):
            mapped(px4(ulog(PX4, px4_data())[:part]), text)


# MATLAB, written by scipy


def test_matlab_structures_vectors_and_matrices(tmp_path, mapped):
    t, slow = np.arange(50) * 100.0, np.arange(10) * 500.0 + 20.0
    savemat(
        tmp_path / "run.mat",
        {
            "nav": {"time": t, "att": {"yaw": np.arange(50.0), "note": "deg"}},
            "gnss": {"time": slow, "pos": np.stack([slow, -slow], axis=1)},
            "port": np.arange(50.0)[:, None],
            "short": np.arange(3.0),
        },
    )
    text = """
    [columns]
    t = { column = "nav:time", unit = "ms" }
    psi = { column = "nav.att:yaw", unit = "deg" }
    x = "gnss:pos.0"
    y = "gnss:pos.1"
    """
    run = mapped(tmp_path / "run.mat", text + 'cmd_port = "port"\n')
    np.testing.assert_allclose(run.t, t * 1e-3)
    np.testing.assert_allclose(run.psi, np.radians(np.arange(50)))
    np.testing.assert_array_equal(run.commanded["port"], np.arange(50))
    marked = np.flatnonzero(np.isfinite(run.x))
    np.testing.assert_array_equal(marked, [1, *range(5, 50, 5)])
    np.testing.assert_allclose(run.x[marked], t[marked])
    np.testing.assert_allclose(run.y[marked], -t[marked])
    with pytest.raises(UserError, match=r"short has 3 values, but its time \(nav:time\) has 50"):
        mapped(tmp_path / "run.mat", text + 'cmd_port = "short"\n')
    with pytest.raises(UserError, match="note is no series of numbers"):
        mapped(tmp_path / "run.mat", text + 'cmd_port = "nav.att:note"\n')
    with pytest.raises(UserError, match="no 'nav:tim', which map.toml maps to t. It has"):
        mapped(tmp_path / "run.mat", text.replace("nav:time", "nav:tim"))


def test_matlab_arrays_of_structures_and_a_missing_time(tmp_path, mapped):
    t = np.arange(4.0)
    signals = np.empty(2, dtype=object)
    signals[:] = [{"values": t**2, "label": "x"}, {"values": -t, "label": "y"}]
    savemat(tmp_path / "run.mat", {"out": {"time": t, "signals": signals}})
    text = '[columns]\nx = "out.signals.0:values"\ny = "out.signals.1:values"\n'
    run = mapped(tmp_path / "run.mat", text + 't = "out:time"\n')
    np.testing.assert_array_equal(run.x, t**2)
    np.testing.assert_array_equal(run.y, -t)
    with pytest.raises(UserError, match="needs a channel t, or .*time_step.*\n  out: time"):
        mapped(tmp_path / "run.mat", text)


def test_matlab_with_time_step_and_plain_vectors(tmp_path, mapped):
    savemat(tmp_path / "run.mat", {"yaw": np.arange(5.0), "pos": np.ones((2, 5))})
    run = mapped(
        tmp_path / "run.mat",
        '[file]\ntime_step = 0.5\n[columns]\npsi = "yaw"\nx = "pos.1"\n',
    )
    np.testing.assert_allclose(run.t, np.arange(5) * 0.5)
    np.testing.assert_array_equal(run.x, 1)
    assert contents(tmp_path / "run.mat") == {"": ["yaw", "pos.0", "pos.1"]}


def test_matlab_7_3_says_how_to_save(tmp_path, mapped):
    (tmp_path / "run.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(600))
    with pytest.raises(UserError, match="7.3 file.*'-v7'"):
        mapped(tmp_path / "run.mat", '[columns]\nt = "t"\nx = "x"\n')


# What every format shares


def test_bad_files_are_refused_in_one_sentence(tmp_path, mapped):
    text = '[columns]\nt = "a:t"\npsi = "a:b"\n'
    logs = text.replace('t = "a:t"\n', "")
    for suffix, package, what in (
        (".bag", "rosbags", "a ROS bag"),
        (".mcap", "rosbags", "a ROS bag"),
        (".db3", "rosbags", "a ROS bag"),
        (".bin", "pymavlink", "an ArduPilot log"),
        (".ulg", "pyulog", "a PX4 log"),
        (".mat", "scipy", "a MATLAB file"),
    ):
        pytest.importorskip(package)
        path = tmp_path / f"run{suffix}"
        with pytest.raises(UserError, match=f"there is no recording .*run{suffix}"):
            mapped(path, logs if suffix != ".mat" else text)
        path.write_bytes(b"")
        with pytest.raises(UserError, match="is empty"):
            mapped(path, logs if suffix != ".mat" else text)
        for rubbish in (b"t,x\n1,2\n" * 300, b"\xa3", bytes(4000)):
            path.write_bytes(rubbish)
            with pytest.raises(UserError, match=f"run{suffix} .*{what}"):
                mapped(path, logs if suffix != ".mat" else text)


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_bags_that_were_cut_off_are_refused(bag, mapped, kind):
    make = Messages(kind)
    path = bag([("/imu", i * 0.1, make.imu(i * 0.1, 0.0)) for i in range(200)], kind)
    text = '[columns]\nr = "/imu:angular_velocity.z"\n'
    assert mapped(path, text).t.size == 200
    file = path if kind == "ros1" else next(path.glob(f"*.{kind}"))
    whole = file.read_bytes()
    assert mapped(file, text).t.size == 200
    for part in (0.1, 0.6, 0.95):
        file.write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(UserError, match="cannot be read as a ROS bag.*reindex"):
            mapped(file, text)


def test_a_folder_without_metadata_is_named(bag, mapped):
    make = Messages("mcap")
    path = bag([("/imu", i, make.imu(i, 0.0)) for i in range(5)])
    (path / "metadata.yaml").unlink()
    with pytest.raises(UserError, match="without metadata.yaml.*ros2 bag reindex"):
        mapped(path, '[columns]\nr = "/imu:angular_velocity.z"\n')
    assert not is_log(path.parent)


def test_without_a_mapping_the_message_lists_what_there_is(bag):
    make = Messages("mcap")
    messages = [("/thrust", i, make.thrust(i, [1.0])) for i in range(3)]
    path = bag(messages + [("/depth", 3 + i, make.number(i)) for i in range(3)])
    with pytest.raises(UserError) as told:
        read_recording(path)
    assert "/thrust: thrusters.0\n" in str(told.value)
    # Nothing there is called a heading, so no field is said to be one.
    assert '[columns]\n  psi = { column = "topic:field", unit = "rad" }' in str(told.value)


@pytest.mark.parametrize(
    "text, message",
    [
        ('r = "/imo:angular_velocity.z"', "no '/imo'.*maps to r; did you mean '/imu'"),
        ('r = "/imu:angular_velocity.q"', "no field 'angular_velocity.q'.*did you mean"),
        ('r = "/imu:x"', "'x' may be any of .*orientation.x, angular_velocity.x"),
        ('x = "/once:data"', "/once has 1 sample"),
        ('r = "/imu:angular_velocity.z"\ncmd_a = "/late:data"', "clocks do not overlap.*/late"),
        ('t = "/imu:orientation.x"\nr = "/imu:angular_velocity.z"', "leave t and .*time_step"),
        ('r = "/imu:angular_velocity.z"\nx = "x"', "'x' must be written topic:field"),
        ('cmd_a = "/late:data"', "no motion channel"),
        ('latitude = "/imu:orientation.w"\nlongitude = "/imu:orientation.w"', None),
        ('latitude = "/late:data"\nlongitude = "/imu:orientation.w"', "from one topic"),
    ],
)
def test_mappings_that_do_not_fit_are_refused_with_what_there_is(bag, mapped, text, message):
    make = Messages("mcap")
    messages = [("/imu", i, make.imu(i, 0.0)) for i in range(5)] + [("/once", 5, make.number(1))]
    messages += [("/late", 100 + i, make.number(1000)) for i in range(5)]
    path = bag(messages)
    if message is None:
        assert mapped(path, "[columns]\n" + text).has("x")
        return
    with pytest.raises(UserError, match="(?s)" + message):
        mapped(path, "[columns]\n" + text)


def test_messages_name_channels_as_the_mapping_does(bag, mapped):
    make = Messages("mcap")
    path = bag([("/imu", i, make.imu(i, 0.0)) for i in range(5)])
    text = '[file]\nframe = "ENU"\n[columns]\nr = "/imu:angular_velocity.z"\n'
    for column, message in (("/gps:x", "'/gps'.*to x"), ("/imu:q", "map.toml, x: '/imu' has no")):
        with pytest.raises(UserError, match=message):
            mapped(path, text + f'x = "{column}"\n')


def test_a_clock_that_is_not_mapped_is_refused(bag, mapped):
    make = Messages("mcap")
    path = bag([("/imu", i, make.imu(i, 0.0)) for i in range(5)])
    with pytest.raises(UserError, match="clock = '/imo' is none of the topics mapped: /imu"):
        mapped(path, '[file]\nclock = "/imo"\n[columns]\nr = "/imu:angular_velocity.z"\n')


@pytest.mark.parametrize(
    "package, extra, suffix",
    [("rosbags", "ros", ".bag"), ("pymavlink", "ardupilot", ".bin"), ("pyulog", "px4", ".ulg")],
)
def test_absent_packages_name_their_extra(tmp_path, mapped, monkeypatch, package, extra, suffix):
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    path = tmp_path / f"run{suffix}"
    path.write_bytes(b"anything")
    with pytest.raises(
        UserError, match=rf"needs the package {package}: pip install 'diffsea\[{extra}\]'"
    ):
        mapped(path, '[columns]\npsi = "a:b"\n')


@pytest.mark.parametrize(
    "text, message",
    [
        ("[file]\nframe = 'FLU'\n[columns]\nt = 't'\n", 'frame must be "NED" or "ENU"'),
        ("[file]\nstamps = 'both'\n[columns]\nt = 't'\n", 'stamps must be "header" or "receive"'),
        ("[file]\nclock = 3\n[columns]\nt = 't'\n", "clock must be the name of a topic"),
        ("[file]\norigin = 60\n[columns]\nt = 't'\n", r"origin must be \[latitude, longitude\]"),
        ("[file]\norigin = [100, 60]\n[columns]\nt = 't'\n", "is no place; latitude comes first"),
        ("[columns]\nt = 't'\nlatitude = 'a'\n", "belong together"),
        ("[columns]\nt = 't'\nlatitude = 'a'\nlongitude = 'b'\nx = 'c'\n", "leave x and y out"),
        ("[columns]\nt = 't'\nlatitude = { column = 'a', unit = 'm' }\n", "not a unit of angle"),
    ],
)
def test_wrong_mappings_are_refused(tmp_path, text, message):
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(UserError, match=message):
        read_mapping(tmp_path / "map.toml")


# Tables go through the same frames and geodesy


def test_tables_in_enu_with_earth_velocities(tmp_path, mapped):
    path = tmp_path / "run.csv"
    path.write_text("t,e,n,yaw,ve,vn,rate\n0,1,2,0.3,0.4,0.5,0.1\n1,3,4,0.3,0.4,0.5,0.1\n")
    run = mapped(
        path,
        """
        [file]
        frame = "ENU"
        velocity_axes = "earth"
        [columns]
        t = "t"
        x = "e"
        y = "n"
        psi = { column = "yaw", offset = 0.1, scale = 2, sign = -1 }
        u = "ve"
        v = "vn"
        r = "rate"
        """,
    )
    np.testing.assert_array_equal(run.x, [2, 4])
    np.testing.assert_array_equal(run.y, [1, 3])
    psi = np.pi / 2 + 0.7
    np.testing.assert_allclose(run.psi, psi)
    np.testing.assert_allclose(run.u, 0.5 * np.cos(psi) + 0.4 * np.sin(psi))
    np.testing.assert_allclose(run.v, 0.4 * np.cos(psi) - 0.5 * np.sin(psi))
    np.testing.assert_allclose(run.r, -0.1)


def test_tables_with_fixes_and_angles_that_are_none(tmp_path, mapped):
    path = tmp_path / "run.csv"
    path.write_text("t,lat,lon\n0,,\n1,60,5\n2,60.001,5\n")
    text = '[columns]\nt = "t"\nlatitude = { column = "lat", unit = "deg", delay = 0.5 }\n'
    run = mapped(path, text + 'longitude = { column = "lon", unit = "deg", delay = 0.5 }\n')
    np.testing.assert_allclose(run.x, [np.nan, 55.706, np.nan], atol=1e-3)
    assert "x shifted by -0.5 s" in run.provenance
    with pytest.raises(UserError, match='latitude of 60.001 rad is none.*unit = "deg"'):
        mapped(path, '[columns]\nt = "t"\nlatitude = "lat"\nlongitude = "lon"\n')


def earth_centred(latitude, longitude):
    """Cartesian coordinates (m) of a place on the WGS84 ellipsoid."""
    a, b = 6378137.0, 6356752.314245179
    across = a**2 / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
    along = across * (b / a) ** 2
    return np.array(
        [
            across * np.cos(latitude) * np.cos(longitude),
            across * np.cos(latitude) * np.sin(longitude),
            along * np.sin(latitude),
        ]
    )


@pytest.mark.parametrize("zero", [(63.4, 10.4), (-33.0, 151.0), (0.0, 179.99), (74.0, -179.98)])
@pytest.mark.parametrize("kilometres, limit", [(0.1, 1e-5), (5.0, 0.01)])
def test_local_metres_agree_with_the_tangent_plane(zero, kilometres, limit):
    """The oracle rotates Cartesian differences into the horizon of the origin."""
    phi, lam = np.radians(zero)
    bearing = np.linspace(0, 2 * np.pi, 17)
    latitude = phi + kilometres / 6371 * np.cos(bearing)
    longitude = lam + kilometres / 6371 * np.sin(bearing) / np.cos(phi)
    longitude = (longitude + np.pi) % (2 * np.pi) - np.pi
    east = np.array([-np.sin(lam), np.cos(lam), 0])
    north = np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    offset = earth_centred(latitude, longitude) - earth_centred(phi, lam)[:, None]
    x, y = local_position(latitude, longitude, (phi, lam))
    np.testing.assert_allclose(x, north @ offset, atol=limit)
    np.testing.assert_allclose(y, east @ offset, atol=limit)


def test_angles_of_a_rotation_are_those_of_its_matrix():
    """Fossen's handbook, (2.18): the elements of a rotation's matrix in its three angles."""
    rng = np.random.default_rng(3)
    w, x, y, z = 2.5 * rng.standard_normal((4, 200))
    angles = euler_angles(w, x, y, z)
    square = w**2 + x**2 + y**2 + z**2
    cosine = np.cos(angles["pitch"])
    forward_north = 1 - 2 * (y**2 + z**2) / square
    forward_east = 2 * (x * y + w * z) / square
    forward_down = 2 * (x * z - w * y) / square
    starboard_down, down_down = 2 * (y * z + w * x) / square, 1 - 2 * (x**2 + y**2) / square
    np.testing.assert_allclose(cosine * np.cos(angles["yaw"]), forward_north, atol=1e-9)
    np.testing.assert_allclose(cosine * np.sin(angles["yaw"]), forward_east, atol=1e-9)
    np.testing.assert_allclose(-np.sin(angles["pitch"]), forward_down, atol=1e-9)
    np.testing.assert_allclose(cosine * np.sin(angles["roll"]), starboard_down, atol=1e-9)
    np.testing.assert_allclose(cosine * np.cos(angles["roll"]), down_down, atol=1e-9)
    unknown = euler_angles(*(np.array([value, 0.0]) for value in (np.nan, 0.0, 0.0, 1.0)))
    assert np.isnan(unknown["yaw"]).tolist() == [True, True]


# The clocks


def test_no_sample_counts_twice_and_none_is_invented():
    rows = np.arange(0, 10, 0.01)
    t = np.array([0.5, 1.5, 2.503, 3.497, 7.5, 8.5, 9.5])
    values, notes = join_channels({"x": LogChannel("a", t, 2 * t)}, rows, False, "run")
    marked = np.flatnonzero(np.isfinite(values["x"]))
    np.testing.assert_array_equal(marked, [50, 150, 250, 349, 750, 850, 950])
    np.testing.assert_allclose(values["x"][marked], 2 * rows[marked])
    assert not notes


def test_a_sample_beside_a_gap_is_moved_only_where_there_is_a_line():
    rows = np.arange(0.0, 20.0)
    t = np.array([0.0, 1.0, 2.2, 9.4, 10.4, 11.4])
    values, notes = join_channels({"x": LogChannel("a", t, t**2)}, rows, False, "run")
    marked = np.flatnonzero(np.isfinite(values["x"]))
    # 2.2 s has no line to row 2's far side but one to its near side; 9.4 s moves to row 10.
    np.testing.assert_array_equal(marked, [0, 1, 2, 10, 11])
    np.testing.assert_allclose(values["x"][2], 1 + (2.2**2 - 1) / 1.2)
    lone = np.array([0.0, 1.0, 2.0, 9.4, 17.0, 18.0])
    values, notes = join_channels({"x": LogChannel("a", lone, lone)}, rows, False, "run")
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(values["x"])), [0, 1, 2, 17, 18])
    assert notes == ["x: 1 samples beside gaps of the clocks are left out"]


def test_faster_channels_on_a_slower_clock_and_angles_across_north():
    rows = np.array([0.05, 1.05, 2.05])
    t = np.arange(0, 2.0, 0.1)
    wrapped = np.angle(np.exp(1j * (3.0 + 0.3 * t)))
    channels = {"psi": LogChannel("a", t, wrapped), "cmd_a": LogChannel("b", t, t)}
    values, _ = join_channels(channels, rows, False, "run")
    np.testing.assert_allclose(values["psi"], [3.015, 3.315, np.nan])
    # In force halfway to the next row: a row stands for what is around it.
    np.testing.assert_allclose(values["cmd_a"], [0.5, 1.5, 1.9])


@pytest.mark.parametrize("name", ["wind_direction", "apparent_wind_angle"])
def test_between_two_readings_of_a_wind_that_goes_round_lies_no_wind_from_behind(name):
    t, rows = np.array([0.0, 1.0, 2.0]), np.array([0.4, 1.4])
    wind = LogChannel("wind", t, np.radians([350.0, 10.0, 350.0]))
    values, _ = join_channels({name: wind}, rows, False, "run")
    off = np.degrees(np.angle(np.exp(1j * values[name])))
    np.testing.assert_allclose(off, [-2.0, 2.0], atol=1e-9)


def test_delays_move_stamps_and_repeated_stamps_become_one(dataflash, mapped):
    rows = [("ATT", (1_000_000 * i, 0, 0, 100 * i)) for i in range(6)]
    rows.insert(3, ("ATT", (2_000_000, 0, 0, 250)))
    rows += [("IMU", (1_000_000 * i + 500_000, 0, float(i))) for i in range(5)]
    text = '[columns]\npsi = { column = "ATT:Yaw" }\n'
    run = mapped(
        dataflash(bin_log(ARDUPILOT, rows)), text + 'r = { column = "IMU:GyrZ", delay = 0.5 }\n'
    )
    np.testing.assert_allclose(run.r, [0, 1, 2, 3, 4, np.nan])
    np.testing.assert_allclose(run.psi[:4], [0, 1, 2.5, 3])
    assert "r shifted by -0.5 s" in run.provenance
    (repeated,) = [finding for finding in audit(run) if finding.kind == "duplicate"]
    assert repeated.value == 1 and "1 of 7, first at t = 2 s in ATT" in repeated.message


def test_commands_take_logs_through_mappings(bag, tmp_path, capsys):
    """A boat that weaves and drifts outwards; its compass is 5 degrees off. 20 Hz and 5 Hz."""
    make, rng = Messages("mcap"), np.random.default_rng(2)
    messages = []
    for t in np.arange(0, 60, 0.05):
        psi = 2 * np.sin(0.2 * t)
        rate = 0.4 * np.cos(0.2 * t) + 0.001 * rng.standard_normal()
        messages.append(("/imu", t, make.imu(t, -rate, np.pi / 2 - psi)))
    time = np.arange(0, 60, 0.001)
    drift = -0.06 * np.cos(0.2 * time)
    course = (1.5 + 1j * drift) * np.exp(2j * np.sin(0.2 * time))
    track = np.concatenate([[0], np.cumsum(course[:-1] + course[1:]) * 0.0005])
    for i in range(0, 60_000, 200):
        psi = 2 * np.sin(0.2 * time[i])
        odometry = make.odometry(
            time[i],
            track[i].imag + 0.01 * rng.standard_normal(),
            track[i].real + 0.01 * rng.standard_normal(),
            np.pi / 2 - psi - np.radians(5),
            1.5 + 0.01 * rng.standard_normal(),
            -drift[i] + 0.01 * rng.standard_normal(),
        )
        messages.append(("/odom", time[i] + 0.003, odometry))
    messages.append(("/thrust", 0.001, make.thrust(0.0, [10.0, 10.0])))
    messages.append(("/thrust", 0.002, make.thrust(0.001, [10.0, 10.0])))
    path = bag(sorted(messages, key=lambda item: item[1]))
    (tmp_path / "map.toml").write_text(ROS)
    arguments = [str(path), "--mapping", str(tmp_path / "map.toml"), "--json"]
    assert main(["audit", *arguments, "-o", str(tmp_path / "audit")]) == 0
    told = capsys.readouterr().out
    assert '"heading-offset"' in told and '"axes"' not in told
    assert main(["metrics", *arguments, "-o", str(tmp_path / "metrics")]) == 0
