"""MCAP files with JSON messages, as BlueOS records: every topic a stream, objects flattened."""

import dataclasses
import json
import re
import struct
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.outside.sizes import Meter
from diffsea.recordings.logs.chunks import check_chunks
from diffsea.recordings.logs.mavlink import mavlink_streams
from diffsea.recordings.logs.streams import (
    LONGEST_ARRAY,
    Stream,
    ends_within_a_message,
    unreadable,
)
from diffsea.recordings.mappings import Mapping
from diffsea.recordings.rotations import angles_in
from diffsea.trajectory import Samples


_LOOKED_AT = 1 << 20  # bytes at either end of a file, where its channels are told
_CODED = re.compile(rb"[\x03\x04]\x00\x00\x00(json|cdr|ros1)")  # length and name of an encoding


def is_json(path: Path) -> bool:
    """Whether an MCAP file has messages in JSON and none of ROS, by the names of encodings."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        found = set(_CODED.findall(file.read(_LOOKED_AT)))
        file.seek(max(path.stat().st_size - _LOOKED_AT, 0))
        found |= set(_CODED.findall(file.read()))
    return found == {b"json"} if found else _begins_with_json(path)


def _begins_with_json(path: Path) -> bool:
    """Whether the first message is in JSON, of a file that is cut off, its channels packed."""
    try:
        from mcap.reader import NonSeekingReader
    except ImportError:
        return False
    check_chunks(path)
    with path.open("rb") as file:
        try:
            reader = NonSeekingReader(file, record_size_limit=path.stat().st_size)
            messages = reader.iter_messages(log_time_order=False)
            return any(channel.message_encoding == "json" for _, channel, _ in islice(messages, 1))
        except Exception:  # the reader says what is wrong with the file
            return False


def contents(path: Path) -> dict[str, list[str]]:
    """The numeric fields of every topic with messages in JSON."""
    return {topic: list(stream.fields) for topic, stream in sorted(_streams(path).items())}


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the topics that the file has.

    A field is named by its path, `message.yaw`. Topics that carry MAVLink messages of several
    types are parted by type, `mavlink/out/ATTITUDE`. Time is that since boot where MAVLink
    messages tell it, or that of the header where messages have one as those of ROS do, else that
    at which the recorder received the message.

    Raises:
        UserError: the file is no MCAP file, or a message is no JSON.
    """
    found = _streams(path, with_headers=mapping.stamps == "header")
    return {topic: found[topic] for topic in topics if topic in found}


def parameters(path: Path) -> list[tuple[str, float]]:
    """The parameters of a vehicle as they were told (PARAM_VALUE of MAVLink), in that order."""
    found = []
    for topic, _, content in _messages(path)[0]:
        if topic.endswith("PARAM_VALUE"):
            message = content.get("message", content)
            name = message["param_id"]
            name = name if isinstance(name, str) else "".join(map(str, name))
            found.append((name.rstrip("\x00"), float(message["param_value"])))
    return found


def _streams(path: Path, with_headers: bool = True) -> dict[str, Stream]:
    rows: dict[str, list[dict[str, float]]] = {}
    received: dict[str, list[float]] = {}
    messages, cut_off = _messages(path)
    for topic, stamp, content in messages:
        fields: dict[str, float] = {}
        _flatten(content, "", fields)
        rows.setdefault(topic, []).append(fields)
        received.setdefault(topic, []).append(stamp)
    times, series, stamped = {}, {}, set[str]()
    for topic, own in rows.items():
        stamps = np.array(received[topic])
        columns = {
            name: np.array([row.get(name, np.nan) for row in own], dtype=float)
            for name in dict.fromkeys(name for row in own for name in row)
        }
        header = _header_stamps(columns)
        if with_headers and header is not None:
            stamps = header
            stamped.add(topic)
        order = np.argsort(stamps, kind="stable")  # of several writers, or overtaken on their way
        times[topic] = stamps[order]
        series[topic] = {name: values[order] for name, values in columns.items()}
        series[topic] |= angles_in(series[topic])
    found = mavlink_streams(times, series, path.name, cut_off)
    by_header = {t: dataclasses.replace(found[t], clock="header stamps") for t in stamped}
    return found | by_header


def _header_stamps(fields: dict[str, Samples]) -> Samples | None:
    """Times (s) of the headers of messages as ROS has them; None unless each has one."""
    for seconds, rest in (("sec", "nanosec"), ("secs", "nsecs")):
        whole, part = (fields.get(f"header.stamp.{name}") for name in (seconds, rest))
        if whole is not None and part is not None:
            stamps = whole + 1e-9 * part
            return stamps if np.all(stamps > 0) else None
    return None


def _messages(path: Path) -> tuple[list[tuple[str, float, Any]], str]:
    """Topics, receive times (s) and objects, in the order of their times; and where it is cut off.

    The file is read from its beginning, so that one whose end is missing, as after a power cut, is
    read up to there.
    """
    from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
    from mcap.reader import NonSeekingReader

    check_chunks(path)
    meter, cut_off = Meter(path), ""
    every: list[tuple[str, float, Any]] = []
    with unreadable(path, "an MCAP file with JSON messages"), path.open("rb") as file:
        reader = NonSeekingReader(file, record_size_limit=path.stat().st_size)
        try:
            for _, channel, message in reader.iter_messages(log_time_order=False):
                if channel.message_encoding == "json":
                    meter.add(len(message.data))
                    content = json.loads(message.data, parse_int=float)
                    every.append((_topic(channel.topic, content), message.log_time * 1e-9, content))
        except (EndOfFile, RecordLengthLimitExceeded, struct.error):
            # Within a record, whose length may be that of more than there is, or within the length.
            if not every:
                raise
            cut_off = ends_within_a_message(path)
    return sorted(every, key=lambda one: one[1]), cut_off


def _topic(topic: str, content: Any) -> str:
    """The topic, with the type of a MAVLink message where it carries several types."""
    message = content.get("message") if isinstance(content, dict) else None
    kind = message.get("type") if isinstance(message, dict) else None
    if not isinstance(kind, str) or kind in topic.split("/"):
        return topic
    return f"{topic}/{kind}"


def _flatten(value: Any, name: str, found: dict[str, float]) -> None:
    """Adds the numbers of a value to what was `found`, under their paths."""
    if isinstance(value, bool | int | float):
        found[name] = float(value)
    elif isinstance(value, dict):
        for key, item in value.items():
            _flatten(item, f"{name}.{key}" if name else key, found)
    elif isinstance(value, list) and len(value) <= LONGEST_ARRAY:
        for index, item in enumerate(value):
            _flatten(item, f"{name}.{index}", found)
