"""A twin-thruster boat driven about, and her logs as autopilots and robots write them.

The truth is integrated here, by Euler's method on NumPy arrays, and shares no code with the
library. Axes are NED.
"""

import dataclasses
import datetime
import functools
import json
import struct

import numpy as np
from tests.recordings.test_logs import EPOCH, SECOND, Messages, bin_log, ulog


STEP = 0.02  # s
BOOT = 30.0  # s since boot at which the log begins
ORIGIN = (63.44, 10.39)  # deg
NEUTRAL, FULL = 1500.0, 400.0  # us


@dataclasses.dataclass(frozen=True)
class DrivenBoat:
    """Motion and orders every 0.02 s: m, m/s, rad, rad/s; orders in us."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    u: np.ndarray
    v: np.ndarray
    r: np.ndarray
    port: np.ndarray
    starboard: np.ndarray
    roll: np.ndarray
    armed: np.ndarray

    def every(self, seconds):
        """Every so many rows."""
        step = round(seconds / STEP)
        fields = dataclasses.asdict(self)
        return DrivenBoat(**{name: series[::step] for name, series in fields.items()})

    @functools.cached_property
    def north_east(self):
        """Velocity over ground, north + i east."""
        return (self.u + 1j * self.v) * np.exp(1j * self.psi)


def shares(t):
    """Orders to port and starboard, from -1 to 1, of the time since the start of the plan."""
    mean, turn = np.zeros_like(t), np.zeros_like(t)
    plan = [(0, 25, 0.3, 0.0), (25, 50, 0.5, 0.0), (50, 75, 0.7, 0.0), (75, 100, 0.9, 0.0)]
    plan += [(100 + 4 * k, 104 + 4 * k, 0.6, 0.1 * (-1) ** k) for k in range(8)]
    plan += [(132, 180, 0.6, 0.0), (180, 225, 0.6, 0.12), (225, 240, 0.6, 0.0)]
    plan += [(240, 285, 0.6, -0.12), (285, 300, 0.6, 0.0), (300, 320, 0.9, 0.05)]
    plan += [(320, 340, 0.4, -0.1), (340, 360, 0.8, 0.1)]
    for start, end, both, difference in plan:
        rows = (t >= start) & (t < end)
        mean[rows], turn[rows] = both, difference
    return mean + turn, mean - turn


def drive(delay=0.4, weaker_starboard=0.0, dock=40.0, after=40.0, upside_down=0.0):
    """A plan of six minutes after a rest at the dock, and a rest, perhaps upside down, after it.

    Arguments:
        delay: s from the order to the thrust.
        weaker_starboard: share by which the thrust to starboard is smaller.
        dock, after, upside_down: s at rest before, at rest after, and turned over after that.
    """
    t = np.arange(0, dock + 360 + after + upside_down, STEP)
    port, starboard = shares(t - dock)
    late = round(delay / STEP)
    force = {
        "port": 40.0 * np.concatenate([np.zeros(late), port])[: t.size],
        "starboard": 40.0
        * (1 - weaker_starboard)
        * np.concatenate([np.zeros(late), starboard])[: t.size],
    }
    state = np.zeros((t.size, 6))
    for k in range(t.size - 1):
        x, y, psi, u, v, r = state[k]
        left, right = force["port"][k], force["starboard"][k]
        change = (
            u * np.cos(psi) - v * np.sin(psi),
            u * np.sin(psi) + v * np.cos(psi),
            r,
            (left + right - 18 * abs(u) * u - 6 * u) / 16 + v * r,
            -u * r - 2.0 * v,
            (0.28 * (left - right) - 4.0 * r - 3.0 * abs(r) * r) / 2.0,
        )
        state[k + 1] = state[k] + STEP * np.array(change)
    turned = t > t[-1] - upside_down
    x, y, psi, u, v, r = state.T
    return DrivenBoat(
        t=t,
        x=x,
        y=y,
        psi=psi,
        u=u,
        v=v,
        r=r,
        port=np.round(NEUTRAL + FULL * port),
        starboard=np.round(NEUTRAL + FULL * starboard),
        roll=np.where(turned, np.pi * 0.97, 0.02),
        armed=np.where((t > dock - 15) & (t < dock + 360 + after), 1.0, 0.0),
    )


def noisy(boat, seed=1):
    """The boat with noise of usual sensors on her motion."""
    rng = np.random.default_rng(seed)
    scales = {"x": 0.03, "y": 0.03, "psi": 0.005, "u": 0.02, "v": 0.02, "r": 0.01}
    noise = {name: rng.normal(0, scale, boat.t.size) for name, scale in scales.items()}
    return dataclasses.replace(boat, **{n: getattr(boat, n) + noise[n] for n in scales})


PARAMETERS = {"FRAME_CLASS": 2.0, "SERVO1_FUNCTION": 74.0, "SERVO3_FUNCTION": 73.0}
PARAMETERS |= {
    f"SERVO{n}_{key}": us
    for n in (1, 3)
    for key, us in (("MIN", 1100.0), ("TRIM", 1500.0), ("MAX", 1900.0), ("REVERSED", 0.0))
}

ARDUPILOT = {
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "ATT": ("QccC", "TimeUS,Roll,Pitch,Yaw"),
    "XKF1": ("Qffff", "TimeUS,VN,VE,PN,PE"),
    "GPS": ("QBIHLLff", "TimeUS,Status,GMS,GWk,Lat,Lng,Spd,GCrs"),
    "IMU": ("Qf", "TimeUS,GyrZ"),
    "RCOU": ("QHHH", "TimeUS,C1,C2,C3"),
    "ARM": ("QB", "TimeUS,ArmState"),
}


def ardupilot_log(boat, without=(), parameters=None, write=bin_log):
    """Bytes of a dataflash log: starboard on output 1, port on output 3."""
    rows, named = [], PARAMETERS if parameters is None else parameters
    us = lambda t: round((BOOT + t) * 1e6)
    for name, value in named.items():
        rows.append((0.0, "PARM", (us(0.0), name.encode(), value)))
    slow = boat.every(0.1)
    velocity = slow.north_east
    for k, t in enumerate(slow.t):
        degrees = round(np.degrees(slow.psi[k]) * 100) % 36000
        roll = round(np.degrees(slow.roll[k]) * 100)
        rows.append((t, "ATT", (us(t), roll, 0, degrees)))
        filtered = velocity[k].real, velocity[k].imag, slow.x[k], slow.y[k]
        rows.append((t, "XKF1", (us(t), *filtered)))
        orders = int(slow.starboard[k]), 1500, int(slow.port[k])
        rows.append((t, "RCOU", (us(t), *orders)))
    fast = boat.every(0.04)
    rows += [(t, "IMU", (us(t), r)) for t, r in zip(fast.t, fast.r, strict=True)]
    for k, t in enumerate(boat.every(0.2).t):
        place = round((ORIGIN[0] + slow.x[2 * k] / 111_300) * 1e7), round(ORIGIN[1] * 1e7)
        course = float(np.degrees(np.angle(velocity[2 * k])) % 360)
        rows.append((t, "GPS", (us(t), 3, 200 * k, 2300, *place, abs(velocity[2 * k]), course)))
    for k in np.flatnonzero(np.diff(boat.armed)) + 1:
        rows.append((boat.t[k], "ARM", (us(boat.t[k]), int(boat.armed[k]))))
    rows = [row for row in sorted(rows, key=lambda row: row[0]) if row[1] not in without]
    kinds = {name: entry for name, entry in ARDUPILOT.items() if name not in without}
    return write(kinds, [(name, values) for _, name, values in rows])


def telemetry_log(boat, path):
    """Writes a MAVLink telemetry log, received 0.2 s late, with a ground station's heartbeats."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    vehicle = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    boat_kind, rover = mavlink.MAV_TYPE_SURFACE_BOAT, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    rows = []
    for number, (name, value) in enumerate(PARAMETERS.items()):
        message = mavlink.MAVLink_param_value_message(name.encode(), value, 9, 6, number)
        rows.append((0.0, vehicle, message))
    for k, t in enumerate(boat.t[::5]):
        row, ms = 5 * k, round((BOOT + t) * 1e3)
        yaw = (boat.psi[row] + np.pi) % (2 * np.pi) - np.pi
        attitude = (ms, boat.roll[row], 0.0, yaw, 0.0, 0.0, boat.r[row])
        rows.append((t, vehicle, mavlink.MAVLink_attitude_message(*attitude)))
        speed = boat.north_east[row]
        local = (boat.x[row], boat.y[row], 0.0, speed.real, speed.imag, 0.0)
        rows.append((t, vehicle, mavlink.MAVLink_local_position_ned_message(ms, *local)))
        outputs = int(boat.starboard[row]), 1500, int(boat.port[row]), *[0] * 5
        servo = mavlink.MAVLink_servo_output_raw_message(ms * 1000 % 2**32, 0, *outputs)
        rows.append((t, vehicle, servo))
        if k % 10 == 0:
            mode = 128 * int(boat.armed[row])
            beat = mavlink.MAVLink_heartbeat_message(boat_kind, rover, mode, 0, 3, 3)
            rows.append((t, vehicle, beat))
            other = mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 3, 3)
            rows.append((t, station, other))
    with path.open("wb") as file:
        for t, source, message in rows:
            stamp = EPOCH // 1000 + round((t + 0.2) * 1e6)
            file.write(struct.pack(">Q", stamp) + message.pack(source))


def telemetry_csv(boat, path, version=2, comma=False):
    """Writes the same log as Mission Planner converts it to CSV, of MAVLink 2 or 1.

    Arguments:
        comma: whether numbers have a decimal comma, as the computer's language may have it.
    """
    from pymavlink import mavutil

    binary = path.with_suffix(".tlog")
    telemetry_log(boat, binary)
    log, lines = mavutil.mavlogfile(str(binary)), []
    while (message := log.recv_msg()) is not None:
        sender = message.get_srcSystem(), message.get_srcComponent()
        head = f"FD,{30:2X}, 0, 0,{len(lines) % 256:2X}" if version == 2 else f"FE,{30:2X}, 7"
        head += f",{sender[0]:2X},{sender[1]:2X},{message.get_msgId():6X}"
        stamp = datetime.datetime.fromtimestamp(message._timestamp, datetime.UTC)
        text = f"{stamp:%Y-%m-%dT%H:%M:%S}.{stamp.microsecond // 1000:03d}"
        text = text if version == 2 else f"{stamp:%m/%d/%Y %I:%M:%S %p}"
        fields = {k: v for k, v in message.to_dict().items() if k != "mavpackettype"}
        shown = {k: f"{v:.7G}" if isinstance(v, float) else str(v) for k, v in fields.items()}
        if comma:
            shown = {k: v if k == "param_id" else v.replace(".", ",") for k, v in shown.items()}
        pairs = ",".join(f"{name},{value}" for name, value in shown.items())
        name = f"mavlink_{message.get_type().lower()}_t"
        lines.append(f"{text},{head},{name},{pairs},,sig ,Len,44\r\n")
    log.close()
    path.write_text("".join(lines), newline="")


def json_log(boat, path):
    """Writes MAVLink messages as JSON in MCAP, as BlueOS does."""
    from mcap.writer import Writer

    rows = []
    for number, (name, value) in enumerate(PARAMETERS.items()):
        letters = list(name.ljust(16, "\0"))
        rows.append(
            (
                0.0,
                {
                    "type": "PARAM_VALUE",
                    "param_id": letters,
                    "param_value": value,
                    "param_index": number,
                },
            )
        )
    for k, t in enumerate(boat.t[::5]):
        row, ms = 5 * k, round((BOOT + t) * 1e3)
        yaw = (boat.psi[row] + np.pi) % (2 * np.pi) - np.pi
        speed = boat.north_east[row]
        rows.append(
            (
                t,
                {
                    "type": "ATTITUDE",
                    "time_boot_ms": ms,
                    "roll": boat.roll[row],
                    "pitch": 0.0,
                    "yaw": yaw,
                    "yawspeed": boat.r[row],
                },
            )
        )
        rows.append(
            (
                t,
                {
                    "type": "LOCAL_POSITION_NED",
                    "time_boot_ms": ms,
                    "x": boat.x[row],
                    "y": boat.y[row],
                    "vx": speed.real,
                    "vy": speed.imag,
                },
            )
        )
        rows.append(
            (
                t,
                {
                    "type": "SERVO_OUTPUT_RAW",
                    "time_usec": ms * 1000,
                    "servo1_raw": int(boat.starboard[row]),
                    "servo2_raw": 1500,
                    "servo3_raw": int(boat.port[row]),
                },
            )
        )
        if k % 10 == 0:
            rows.append(
                (t, {"type": "HEARTBEAT", "base_mode": {"bits": 128 * int(boat.armed[row])}})
            )
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096)  # as a recorder that loses little
        writer.start()
        schema = writer.register_schema("mavlink", "jsonschema", b"{}")
        channels = {}
        for t, message in rows:
            topic = f"mavlink/1/1/{message['type']}"
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            stamp = EPOCH + round((t + 0.2) * SECOND)
            content = json.dumps({"header": {"system_id": 1}, "message": message}).encode()
            writer.add_message(channels[topic], stamp, content, stamp)
        writer.finish()


def ros_json_log(boat, path, received=0.0):
    """Writes the messages of ROS as JSON in MCAP, with the names of their fields.

    Arguments:
        received: delay (s) with which messages with a header reach the recorder.
    """
    from mcap.writer import Writer

    def plain(value):
        if hasattr(value, "__msgtype__"):
            fields = vars(value).items()
            return {k: plain(v) for k, v in fields if not k.startswith("__") and not k.isupper()}
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {}
        for topic, t, message in ros_messages(boat, "db3"):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            late = received if hasattr(message, "header") else 0.0
            stamp = EPOCH + round((t + late) * SECOND)
            content = json.dumps(plain(message)).encode()
            writer.add_message(channels[topic], stamp, content, stamp)
        writer.finish()


def px4_log(boat):
    """Bytes of a PX4 log: motor 1 to starboard, motor 2 to port, orders from -1 to 1."""
    formats = {
        "vehicle_local_position": "uint64_t timestamp;float x;float y;float vx;float vy;"
        "bool xy_valid;bool v_xy_valid;",
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
        "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz;",
        "actuator_motors": "uint64_t timestamp;float[12] control;",
    }
    data, slow = [], boat.every(0.1)
    for k, t in enumerate(slow.t):
        us, speed = round((BOOT + t) * 1e6), slow.north_east[k]
        local = struct.pack("<Qffff??", us, slow.x[k], slow.y[k], speed.real, speed.imag, 1, 1)
        data.append(("vehicle_local_position", 0, local))
        half = slow.psi[k] / 2
        data.append(
            ("vehicle_attitude", 0, struct.pack("<Qffff", us, np.cos(half), 0, 0, np.sin(half)))
        )
        data.append(("vehicle_angular_velocity", 0, struct.pack("<Qfff", us, 0, 0, slow.r[k])))
        sides = (slow.starboard[k] - NEUTRAL) / FULL, (slow.port[k] - NEUTRAL) / FULL
        data.append(("actuator_motors", 0, struct.pack("<Q12f", us, *sides, *[np.nan] * 10)))
    return ulog(formats, data)


def ros_messages(boat, kind):
    """Messages of a bag as (topic, receive time, message): ENU, and thrust by side."""
    make, rows = Messages(kind), []
    for k, t in enumerate(boat.t[::5]):
        row = 5 * k
        yaw = np.pi / 2 - boat.psi[row]
        pose = boat.y[row], boat.x[row], yaw
        odometry = make.odometry(t, *pose, boat.u[row], -boat.v[row], -boat.r[row])
        rows.append(("/odometry/filtered", t + 0.01, odometry))
        rows.append(("/imu/data", t + 0.011, make.imu(t, -boat.r[row], yaw)))
        for side in ("left", "right"):
            order = (boat.port if side == "left" else boat.starboard)[row]
            value = make.number((order - NEUTRAL) / FULL)
            rows.append((f"/thrusters/{side}/thrust", t, value))
    return sorted(rows, key=lambda row: row[1])
