"""MAVLink telemetry logs (`.tlog`) of ground stations: every message of the vehicle a stream."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.recordings.logs.mavlink import mavlink_streams
from diffsea.recordings.logs.streams import (
    LONGEST_ARRAY,
    Stream,
    ends_within_a_message,
    unreadable,
)
from diffsea.recordings.mappings import Mapping


_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: a ground station, a camera, a gimbal


def contents(path: Path) -> dict[str, list[str]]:
    """The numeric fields of every message of the vehicle; further outputs are `[1]` and so on."""
    found = _streams(path)
    return {topic: list(found[topic].fields) for topic in sorted(found)}


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the messages that the log has; time is seconds since boot.

    Fields are in the units of MAVLink (`lat` in 1e-7 deg, `vx` of GLOBAL_POSITION_INT in cm/s).
    Of several vehicles the one with the most heartbeats counts. `HEARTBEAT:armed` is one while
    orders reach the actuators.

    Raises:
        UserError: the file has no MAVLink messages.
    """
    del mapping
    found = _streams(path)
    return {topic: found[topic] for topic in topics if topic in found}


def parameters(path: Path) -> list[tuple[str, float]]:
    """The vehicle's parameters as they were told (PARAM_VALUE), in the order of the file."""
    return [
        (message.param_id.rstrip("\x00"), float(message.param_value))
        for message in _vehicle_messages(path)[0]
        if message.get_type() == "PARAM_VALUE"
    ]


def _streams(path: Path) -> dict[str, Stream]:
    rows: dict[str, list[dict[str, float]]] = {}
    received: dict[str, list[float]] = {}
    messages, cut_off = _vehicle_messages(path)
    for message in messages:
        topic, fields = message.get_type(), _numbers(message)
        if topic == "SERVO_OUTPUT_RAW" and fields.get("port"):
            topic = f"{topic}[{fields['port']:.0f}]"
        rows.setdefault(topic, []).append(fields)
        received.setdefault(topic, []).append(message._timestamp)
    series = {
        topic: {
            name: np.array([row.get(name, np.nan) for row in own], dtype=float)
            for name in dict.fromkeys(name for row in own for name in row)
        }
        for topic, own in rows.items()
    }
    times = {topic: np.array(stamps, dtype=float) for topic, stamps in received.items()}
    return mavlink_streams(times, series, path.name, cut_off)


def _vehicle_messages(path: Path) -> tuple[list[Any], str]:
    """The vehicle's messages in the order of the file; and whether that is cut off, in words."""
    from pymavlink import mavutil

    with unreadable(path, "a MAVLink telemetry log"):
        log = mavutil.mavlogfile(str(path))
        messages = []
        while (message := log.recv_msg()) is not None:
            if message.get_type() != "BAD_DATA":
                messages.append(message)
        cut_off = ends_within_a_message(path) if log.mav.buf_len() else ""
        log.close()
        if not messages:
            raise ValueError("it has no MAVLink messages")
    beats = Counter(
        message.get_srcSystem()
        for message in messages
        if message.get_type() == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT
    )
    vehicle = beats.most_common(1)[0][0] if beats else messages[0].get_srcSystem()
    own = [
        message
        for message in messages
        if message.get_srcSystem() == vehicle
        and (message.get_type() != "HEARTBEAT" or message.autopilot != _NO_AUTOPILOT)
    ]
    return own, cut_off


def _numbers(message: Any) -> dict[str, float]:
    """The numeric fields of a message, arrays by element."""
    found: dict[str, float] = {}
    for name, value in message.to_dict().items():
        if isinstance(value, int | float):
            found[name] = float(value)
        elif isinstance(value, list) and len(value) <= LONGEST_ARRAY:
            found |= {
                f"{name}.{index}": float(item)
                for index, item in enumerate(value)
                if isinstance(item, int | float)
            }
    return found
