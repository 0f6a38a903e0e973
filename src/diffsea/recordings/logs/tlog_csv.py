"""Telemetry logs that Mission Planner has converted to CSV: a line for each message.

    2026-06-01T12:00:00.125,FD,1C, 0, 0,2A, 1, 1,    1E,mavlink_attitude_t,time_boot_ms,490309,
        roll,-0.0118,yaw,0.3458,yawspeed,-0.0010,,sig ,Len,44

A time, the message's header in hexadecimal numbers, its name, and then names and values in turn.
Times of older versions are to the second. Where the computer writes numbers with a comma, they
stand in two cells.
"""

import re
from datetime import UTC, datetime
from pathlib import Path

from diffsea.recordings.logs.mavlink import Message, MessageLog
from diffsea.recordings.logs.streams import ends_within_a_message, unreadable


_SEARCHED = 1 << 16  # bytes of a file in which a first message stands
_LINE = re.compile(rb"^[^,\n]{4,40},F[DE],(?:[ 0-9A-F]{1,6},){5,7}mavlink_\w+_t,", re.MULTILINE)
_NAME = re.compile(r"mavlink_(\w+)_t")
_PLACES_OF_THE_NAME = (9, 7)  # after the time and the header of MAVLink 2, or 1
_HEXADECIMAL = re.compile(r"[0-9A-F]{1,2}")
_FIELD = re.compile(r"[A-Za-z_]\w*")
_FRACTION = re.compile(r"\d+([eE][-+]?\d+)?")
_LONGEST_LINE = 10_000  # letters: no message is near it
# As months stand first in most, which only matters between two days.
_TIMES = ("%m/%d/%Y %I:%M:%S %p", "%m/%d/%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S")


def is_log(path: Path) -> bool:
    """Whether a file has a message of such a log where it begins."""
    with path.open("rb") as file:
        return _LINE.search(file.read(_SEARCHED)) is not None


def _messages(path: Path) -> tuple[list[Message], str]:
    messages, last, number = [], "\n", 0
    with (
        unreadable(path, "a telemetry log as CSV"),
        path.open(encoding="utf-8-sig", errors="replace") as file,
    ):
        while line := file.readline(_LONGEST_LINE):
            last, number = line, number + 1
            try:
                message = _message(line) if line.endswith("\n") else None
            except ValueError as error:
                raise ValueError(f"line {number}: {error}") from error
            if message is not None:
                messages.append(message)
        if not messages:
            raise ValueError("it has no MAVLink messages")
    return messages, "" if last.endswith("\n") else ends_within_a_message(path)


def _message(line: str) -> Message | None:
    """The message of a line; None where none stands in it."""
    cells = line.rstrip("\r\n").split(",")
    for place in _PLACES_OF_THE_NAME:
        name = _NAME.fullmatch(cells[place]) if place < len(cells) else None
        system = cells[place - 3].strip() if name else ""
        if name and _HEXADECIMAL.fullmatch(system):
            fields = _fields(cells[place + 1 :])
            return Message(name[1].upper(), int(system, 16), _seconds(cells[0]), fields)
    return None


def _fields(cells: list[str]) -> dict[str, float | str]:
    """Names and values in turn, up to the first empty name."""
    found: dict[str, float | str] = {}
    k = 0
    while k + 1 < len(cells) and _FIELD.fullmatch(cells[k]):
        name, value = cells[k], cells[k + 1]
        k += 2
        if k < len(cells) and _FRACTION.fullmatch(cells[k]):
            value, k = f"{value}.{cells[k]}", k + 1
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    return found


def _seconds(text: str) -> float:
    """A time as text, s since any instant. Raises `ValueError` where it is none."""
    try:
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    except ValueError:
        for form in _TIMES:
            try:
                return datetime.strptime(text, form).replace(tzinfo=UTC).timestamp()
            except ValueError:
                continue
    raise ValueError(f"{text!r} is no time such as 2026-06-01T12:00:00.125")


LOG = MessageLog(_messages)
