"""MAVLink telemetry logs (`.tlog`) of ground stations: every message of the vehicle a stream."""

from pathlib import Path
from typing import Any

from diffsea.recordings.logs.mavlink import Message, MessageLog
from diffsea.recordings.logs.streams import LONGEST_ARRAY, ends_within_a_message, unreadable


def _messages(path: Path) -> tuple[list[Message], str]:
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
    return messages, cut_off


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


LOG = MessageLog(_messages)
