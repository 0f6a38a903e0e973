"""ArduPilot's logs, `.bin` or text in `.log`: every message a stream on the autopilot's clock."""

import contextlib
import re
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
_NUMBERS = "bBhHiIqQfdgcCeEL"  # characters of formats that are numbers
_MODE = "M"  # one that is a number in a binary log and a name in text
_TEXT = re.compile(rb"^FMT, ?\d", re.MULTILINE)  # a line of a text log that defines a message
_SEARCHED = 1 << 16  # bytes of a file in which such a line is, before which a header may stand


def is_log(path: Path) -> bool:
    """Whether a file is such a log by how it begins, text or not."""
    with path.open("rb") as file:
        start = file.read(_SEARCHED)
    return start.startswith(_HEAD) or _is_text(start)


def contents(path: Path) -> dict[str, list[str]]:
    """The fields of every message that has a time; instances have their number in []."""
    with _opened(path) as (log, *_), unreadable(path, "an ArduPilot log"):
        forms = sorted(_recorded(log), key=lambda form: form.name)
        timed = [form for form in forms if any(time in form.columns for time in _TIME_FIELDS)]
        found = {form.name: _numeric_fields(form, log) for form in timed}
        instances = {name: name.partition("[")[0] for name in _instances(log, timed)}
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
            messages.setdefault(_instance(message), []).append(message)
        streams = {}
        for topic in topics:
            found = messages.get(topic) or messages.get(f"{topic}[0]")
            if found:
                fields = _numeric_fields(found[0].fmt, log)
                streams[topic] = _stream(topic, found, fields, path, notes, cut_off)
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

    with path.open("rb") as file:
        is_text = _is_text(file.read(_SEARCHED))
    reader = DFReader.DFReader_text if is_text else DFReader.DFReader_binary
    with unreadable(path, "an ArduPilot log"):
        log = reader(str(path))
    with contextlib.closing(log):
        with unreadable(path, "an ArduPilot log"):
            if not any(form.type == _FORMATS_ID for form in _recorded(log)):
                raise ValueError("it defines no messages")
            damage = _damage_of_text(path, log) if is_text else _damage(path, log)
        yield log, *damage


def _is_text(start: bytes) -> bool:
    return not start.startswith(_HEAD) and _TEXT.search(start) is not None


def _is_text_log(log: Any) -> bool:
    """Whether an opened log is text, whose messages are counted by name."""
    return isinstance(log.counts, dict)


def _recorded(log: Any) -> list[Any]:
    """The formats of which a log has messages."""
    if _is_text_log(log):
        return [form for name, form in log.formats.items() if log.counts.get(name)]
    return [form for number, form in log.formats.items() if log.counts[number]]


def _instances(log: Any, forms: list[Any]) -> list[str]:
    """Names of the messages that have several instances: opened text has read but one of each."""
    several = [form.name for form in forms if form.instance_field is not None]
    if _is_text_log(log) and several:
        while log.recv_match(type=several) is not None:
            pass
    return [name for name in log.messages if "[" in name]


def _instance(message: Any) -> str:
    """The name of a message, with its instance where its format has several."""
    name, instance = message.get_type(), message.fmt.instance_field
    return name if instance is None else f"{name}[{getattr(message, instance)}]"


def _damage(path: Path, log: Any) -> tuple[tuple[str, ...], str]:
    """A note where bytes belong to no message, and whether the log is cut off, in words."""
    covered = sum(log.counts[form.type] * form.len for form in _recorded(log))
    size = path.stat().st_size
    if covered == size:
        return (), ""
    if covered > size or _begins_a_message(path.read_bytes()[covered:]):
        return (), ends_within_a_message(path)
    return (f"{path.name}: {size - covered} of {size} bytes belong to no message",), ""


def _damage_of_text(path: Path, log: Any) -> tuple[tuple[str, ...], str]:
    """The same of a text log, by lines; one without an end is no line."""
    strange = sum(count for name, count in log.counts.items() if name not in log.formats)
    lines = "1 line belongs" if strange == 1 else f"{strange} lines belong"
    notes = (f"{path.name}: {lines} to no message",) if strange else ()
    return notes, "" if log.data_map[-1:] == b"\n" else ends_within_a_message(path)


def _begins_a_message(rest: bytes) -> bool:
    """Whether these are the first bytes of a message, and no more than its name."""
    return 0 < len(rest) <= len(_HEAD) + 1 and rest.startswith(_HEAD[: len(rest)])


def _numeric_fields(form: Any, log: Any) -> list[str]:
    """Columns that are numbers, but for the time."""
    numbers = _NUMBERS if _is_text_log(log) else _NUMBERS + _MODE
    return [
        column
        for column, kind in zip(form.columns, form.format, strict=False)
        if kind in numbers and column not in _TIME_FIELDS
    ]


def _stream(
    topic: str,
    messages: list[Any],
    fields: list[str],
    path: Path,
    notes: tuple[str, ...],
    cut_off: str,
) -> Stream:
    form = messages[0].fmt
    time = next((name for name in _TIME_FIELDS if name in form.columns), None)
    if time is None:
        raise UserError(f"{path}: {topic} has no time (TimeUS), so it cannot be a channel")
    columns = {
        name: np.array([getattr(message, name) for message in messages], dtype=float)
        for name in (time, *fields)
    }
    t = columns.pop(time) * _TIME_FIELDS[time]
    status = columns.get(_FIX_STATUS.get(form.name, ""))
    if status is not None:
        columns = {
            name: series if series is status else np.where(status < _TWO_DIMENSIONS, np.nan, series)
            for name, series in columns.items()
        }
    return Stream(topic, t, columns, "the autopilot's time since boot", notes, cut_off=cut_off)
