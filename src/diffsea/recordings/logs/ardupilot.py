"""ArduPilot's `.bin` logs: every message a stream on the autopilot's one clock."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.logs.streams import Stream, ends_within_a_message, unreadable
from diffsea.recordings.mappings import Mapping


_TIME_FIELDS = {"TimeUS": 1e-6, "TimeMS": 1e-3}  # of present and of old firmware
_HEAD = b"\xa3\x95"  # with which a message begins
_FORMATS_ID = 0x80  # the message that defines the others
# A satellite fix below two dimensions (GPS.Status) measures nothing.
_FIX_STATUS = {"GPS": "Status", "GPS2": "Status"}
_TWO_DIMENSIONS = 2
_NUMBERS = "bBhHiIqQfdgcCeELM"  # characters of formats that are numbers; M is a mode


def contents(path: Path) -> dict[str, list[str]]:
    """The fields of every message that has a time; instances have their number in []."""
    with _opened(path) as (log, *_), unreadable(path, "an ArduPilot log"):
        found = {
            form.name: _numeric_fields(form)
            for number, form in sorted(log.formats.items(), key=lambda item: item[1].name)
            if log.counts[number] and any(time in form.columns for time in _TIME_FIELDS)
        }
        instances = {name: name.partition("[")[0] for name in log.messages if "[" in name}
        found |= {name: found[base] for name, base in instances.items() if base in found}
        found = {name: fields for name, fields in found.items() if name not in instances.values()}
    return dict(sorted(found.items()))


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the topics that the log has; time is seconds since boot.

    Fields have the scale that their format states: angles of ATT, and Lat and Lng, are in
    degrees. A message of several instances is named with the instance, `GPS[1]`; without it the
    first is meant. Satellite fixes below two dimensions are NaN.

    Raises:
        UserError: the file is no such log or has no data, or a topic has no time.
    """
    del mapping
    bases = {topic.partition("[")[0] for topic in topics}
    messages: dict[str, list] = {}
    with _opened(path) as (log, notes, cut_off), unreadable(path, "an ArduPilot log"):
        while (message := log.recv_match(type=list(bases))) is not None:
            name, instance = message.get_type(), message.fmt.instance_field
            if instance is not None:
                name = f"{name}[{getattr(message, instance)}]"
            messages.setdefault(name, []).append(message)
    streams = {}
    for topic in topics:
        found = messages.get(topic) or messages.get(f"{topic}[0]")
        if found:
            streams[topic] = _stream(topic, found, path, notes, cut_off)
    return streams


def parameters(path: Path) -> list[tuple[str, float]]:
    """The autopilot's parameters as they were told (PARM), in the order of the file."""
    found = []
    with _opened(path) as (log, *_), unreadable(path, "an ArduPilot log"):
        while (message := log.recv_match(type=["PARM"])) is not None:
            found.append((message.Name, float(message.Value)))
    return found


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, tuple[str, ...], str]]:
    """The log, a note where some of the file is damaged, and whether it is cut off, in words."""
    from pymavlink import DFReader

    with unreadable(path, "an ArduPilot log"):
        log = DFReader.DFReader_binary(str(path))
    with contextlib.closing(log):
        with unreadable(path, "an ArduPilot log"):
            if not log.counts[_FORMATS_ID]:
                raise ValueError("it defines no messages")
            known = [k for k in range(256) if log.counts[k] and k in log.formats]
            covered = sum(log.counts[k] * log.formats[k].len for k in known)
        yield log, *_damage(path, covered)


def _damage(path: Path, covered: int) -> tuple[tuple[str, ...], str]:
    """A note where bytes belong to no message, and whether the log is cut off, in words."""
    size = path.stat().st_size
    if covered == size:
        return (), ""
    if covered > size or _begins_a_message(path.read_bytes()[covered:]):
        return (), ends_within_a_message(path)
    return (f"{path.name}: {size - covered} of {size} bytes belong to no message",), ""


def _begins_a_message(rest: bytes) -> bool:
    """Whether these are the first bytes of a message, and no more than its name."""
    return 0 < len(rest) <= len(_HEAD) + 1 and rest.startswith(_HEAD[: len(rest)])


def _numeric_fields(form: Any) -> list[str]:
    return [
        column
        for column, kind in zip(form.columns, form.format, strict=False)
        if kind in _NUMBERS and column not in _TIME_FIELDS
    ]


def _stream(topic: str, messages: list, path: Path, notes: tuple[str, ...], cut_off: str) -> Stream:
    form = messages[0].fmt
    time = next((name for name in _TIME_FIELDS if name in form.columns), None)
    if time is None:
        raise UserError(f"{path}: {topic} has no time (TimeUS), so it cannot be a channel")
    columns = {
        name: np.array([getattr(message, name) for message in messages], dtype=float)
        for name in (time, *_numeric_fields(form))
    }
    t = columns.pop(time) * _TIME_FIELDS[time]
    status = columns.get(_FIX_STATUS.get(form.name, ""))
    if status is not None:
        columns = {
            name: series if series is status else np.where(status < _TWO_DIMENSIONS, np.nan, series)
            for name, series in columns.items()
        }
    return Stream(topic, t, columns, "the autopilot's time since boot", notes, cut_off=cut_off)
