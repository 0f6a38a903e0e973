"""MAVLink telemetry logs (`.tlog`) of ground stations: every message of the vehicle a stream."""

from pathlib import Path
from typing import Any

from diffsea.recordings.logs.mavlink import (
    Message,
    of_the_vehicle,
    streams_of_messages,
    told_parameters,
)
from diffsea.recordings.logs.streams import (
    LONGEST_ARRAY,
    Stream,
    ends_within_a_message,
    unreadable,
)
from diffsea.recordings.mappings import Mapping


def contents(path: Path) -> dict[str, list[str]]:
    """The numeric fields of every message of the vehicle; further outputs are `[1]` and so on."""
    found = _streams(path)
    return {topic: list(found[topic].fields) for topic in sorted(found)}


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the messages that the log has; time is seconds since boot.

    Raises:
        UserError: the file has no MAVLink messages.
    """
    del mapping
    found = _streams(path)
    return {topic: found[topic] for topic in topics if topic in found}


def parameters(path: Path) -> list[tuple[str, float]]:
    """The vehicle's parameters as they were told, in the order of the file."""
    return told_parameters(_vehicle_messages(path)[0])


def _streams(path: Path) -> dict[str, Stream]:
    messages, cut_off = _vehicle_messages(path)
    return streams_of_messages(messages, path.name, cut_off)


def _vehicle_messages(path: Path) -> tuple[list[Message], str]:
    """The vehicle's messages in the order of the file; and whether that is cut off, in words."""
    from pymavlink import mavutil

    with unreadable(path, "a MAVLink telemetry log"):
        log = mavutil.mavlogfile(str(path))
        messages = []
        while (message := log.recv_msg()) is not None:
            if message.get_type() != "BAD_DATA":
                sent = message.get_type(), message.get_srcSystem(), message._timestamp
                messages.append(Message(*sent, _fields(message)))
        cut_off = ends_within_a_message(path) if log.mav.buf_len() else ""
        log.close()
        if not messages:
            raise ValueError("it has no MAVLink messages")
    return of_the_vehicle(messages), cut_off


def _fields(message: Any) -> dict[str, float | str]:
    """The numbers and words of a message, arrays by element."""
    found: dict[str, float | str] = {}
    for name, value in message.to_dict().items():
        if isinstance(value, int | float):
            found[name] = float(value)
        elif isinstance(value, str):
            found[name] = value
        elif isinstance(value, list) and len(value) <= LONGEST_ARRAY:
            found |= {
                f"{name}.{index}": float(item)
                for index, item in enumerate(value)
                if isinstance(item, int | float)
            }
    return found
