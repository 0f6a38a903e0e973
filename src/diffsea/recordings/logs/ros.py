"""ROS 1 and ROS 2 bags: every topic a stream, messages flattened, quaternions also as angles."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.outside.sizes import Meter
from diffsea.recordings.logs.chunks import check_chunks
from diffsea.recordings.logs.streams import LONGEST_ARRAY, Stream, unreadable
from diffsea.recordings.mappings import Mapping
from diffsea.recordings.rotations import ANGLES, angles_in, quaternions_in
from diffsea.series import CALENDAR


_MOST_VALUES = 10_000  # of a message, those of arrays of numbers counted as one
_LOOKED_AT = 50  # messages of a topic in which its fields are looked for
# A message overtaken on its way comes a few of its topic's intervals late; what falls back
# further is a clock that was set, or a second publisher.
_OVERTAKEN = 3.0
_UNKNOWN = {  # covariance whose first entry is -1 -> what the message then does not measure
    "orientation_covariance": "orientation",
    "angular_velocity_covariance": "angular_velocity",
    "linear_acceleration_covariance": "linear_acceleration",
}


def is_folder(path: Path) -> bool:
    """Whether a folder is that of a ROS 2 bag."""
    return (path / "metadata.yaml").exists() or any(
        item.suffix in (".db3", ".mcap") for item in path.iterdir()
    )


def contents(path: Path) -> dict[str, list[str]]:
    """The numeric fields of every topic, from its first messages."""
    found = {}
    with _open_bag(path) as reader:
        for topic in _topics(reader):
            try:
                first = [message for *_, message in _messages(reader, [topic], path, _LOOKED_AT)]
            except UserError:  # a type that the bag does not define is no reason not to list
                first = []
            names = list(_places_of_fields(first))
            angles = [f"{start}{name}" for start in quaternions_in(names) for name in ANGLES]
            found[topic] = names + angles
    return found


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the topics that the bag has.

    Time is that of the header stamps where messages have them, else that at which the
    recorder received the message. It counts from the first message of these topics.

    Raises:
        UserError: the bag is broken, a type is not defined, or stamps jump back.
    """
    with _open_bag(path) as reader:
        there = [topic for topic in topics if topic in _topics(reader)]
        received: dict[str, list[int]] = {topic: [] for topic in there}
        messages: dict[str, list] = {topic: [] for topic in there}
        for topic, time, message in _messages(reader, there, path):
            received[topic].append(time)
            messages[topic].append(message)
    stamped = {}
    for topic in there:
        times = np.array(received[topic], dtype=np.int64)
        stamped[topic] = _stamped_fields(topic, times, messages.pop(topic), path, mapping.stamps)
    zero = min((int(stamps[0]) for stamps, *_ in stamped.values() if stamps.size), default=0)
    day = np.datetime64(zero, "ns").astype("datetime64[ms]")
    origin = f"from {zero / 1e9:.9f} s ({day} UTC)"
    epoch = zero * 1e-9 if zero * 1e-9 > CALENDAR else None
    return {
        topic: Stream(
            topic, (stamps - zero) * 1e-9, fields, f"{clock}, {origin}", notes, epoch=epoch
        )
        for topic, (stamps, fields, clock, notes) in stamped.items()
    }


@contextmanager
def _open_bag(path: Path) -> Iterator[Any]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    default = get_typestore(Stores.ROS2_HUMBLE)
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise UserError(
            f"{path} is a ROS 2 bag without metadata.yaml; restore it with `ros2 bag reindex`, or "
            "name the .db3 or .mcap file in the folder"
        )
    tool = "rosbag reindex" if path.suffix.lower() == ".bag" else "ros2 bag reindex"
    hint = f"; if its recording was cut off, `{tool}` may restore it"
    check_chunks(path)
    with unreadable(path, "a ROS bag", hint):
        reader = AnyReader([path], default_typestore=default)
        _check_types(reader.readers, path)
        reader.open()
    try:
        with unreadable(path, "a ROS bag", hint):
            yield reader
    finally:
        reader.close()


def _check_types(readers: Any, path: Path) -> None:
    """Raises `UserError` where a message type holds more values than any message has.

    Each type may hold several of another one, which hold several of a third: the number of values
    grows by powers with the number of types, and reading with it.
    """
    from rosbags.typesys import get_types_from_msg

    for reader in readers:
        with reader as opened:
            connections = list(opened.connections)
        definitions = {
            (one.msgdef.data, one.msgtype, one.msgdef.format.name) for one in connections
        }
        for text, kind, form in definitions:
            if form == "MSG":
                fields = {name: own for name, (_, own) in get_types_from_msg(text, kind).items()}
                if _values_of(fields) > _MOST_VALUES:
                    raise UserError(
                        f"{path}: a message of type {kind} would have more than {_MOST_VALUES} "
                        "fields; no sensor sends such"
                    )


def _values_of(types: dict[str, Any]) -> int:
    """Values in one message of the largest type, arrays of a fixed size with all their elements.

    Found by growing estimates, so that types that hold one another end too.
    """
    sizes = dict.fromkeys(types, 1)
    for _ in range(len(types) + 1):
        before = dict(sizes)
        for name, fields in types.items():
            sizes[name] = 1 + sum(_field_values(kind, before) for _, kind in fields)
        if sizes == before or max(sizes.values(), default=0) > _MOST_VALUES:
            break
    return max(sizes.values(), default=0)


def _field_values(kind: Any, sizes: dict[str, int]) -> int:
    """Values of one field: a base type, a name, or an array or sequence of these."""
    node, inner = int(kind[0]), kind[1]
    if node == 2:  # a type by its name
        return sizes.get(str(inner), 1)
    if node in (3, 4):  # an array of a fixed size, a sequence
        element, count = inner
        own = _field_values(element, sizes)
        return own * (count if node == 3 and own > 1 else 1)
    return 1


def _topics(reader: Any) -> list[str]:
    return sorted({connection.topic for connection in reader.connections})


def _messages(
    reader: Any, topics: list[str], path: Path, most: int | None = None
) -> Iterator[tuple[str, int, Any]]:
    """Topics, receive times (ns) and messages, in one pass over the bag."""
    connections = [item for item in reader.connections if item.topic in topics]
    for topic in topics:
        kinds = sorted({item.msgtype for item in connections if item.topic == topic})
        if len(kinds) > 1:
            raise UserError(f"{path}: {topic} carries several types: {', '.join(kinds)}")
        if kinds[0] not in reader.typestore.fielddefs:
            raise UserError(
                f"{path}: {topic} has messages of type {kinds[0]}, which the bag does not define; "
                "convert it to MCAP, which carries its definitions"
            )
    if not connections:  # rosbags would read them all
        return
    every = reader.messages(connections=connections)
    meter = Meter(path)
    for connection, received, raw in itertools.islice(every, most):
        meter.add(len(raw))
        yield connection.topic, received, reader.deserialize(raw, connection.msgtype)


def _stamped_fields(
    topic: str, times: np.ndarray, messages: list, path: Path, stamps: str
) -> tuple[np.ndarray, dict[str, np.ndarray], str, tuple[str, ...]]:
    """Time stamps (ns), fields, what clock the stamps are of, and notes.

    Messages that were overtaken on their way are put in the order of their header stamps.
    """
    places = _places_of_fields(messages[:_LOOKED_AT])
    fields = {name: _series(messages, place) for name, place in places.items()}
    _mask_unknown(fields, messages)
    fields |= angles_in(fields)
    if stamps != "header" or not messages or not hasattr(messages[0], "header"):
        return times, fields, "receive time", ()
    pairs = [(message.header.stamp.sec, message.header.stamp.nanosec) for message in messages]
    header = np.array([sec * 1_000_000_000 + rest for sec, rest in pairs], dtype=np.int64)
    if not np.all(header):
        unset = f"header stamps not set in {np.sum(header == 0)} of {header.size} messages"
        return times, fields, "receive time", (f"{topic}: {unset}",)
    steps = np.diff(header)
    if not np.any(steps < 0):
        return header, fields, "header stamps", ()
    usual = float(np.median(steps[steps > 0], axis=0)) if np.any(steps > 0) else 0.0
    if np.min(steps) < -_OVERTAKEN * usual:
        raise UserError(
            f"{path}: the header stamps of {topic} jump back by {-np.min(steps) * 1e-9:.6g} s, "
            f"{usual * 1e-9:.6g} s being their usual interval: a clock was set, or two publishers "
            'share the topic; split the bag, or give [file] stamps = "receive"'
        )
    order = np.argsort(header, kind="stable")
    fields = {name: series[order] for name, series in fields.items()}
    note = f"{topic}: {np.sum(steps < 0)} messages received late, put in the order of their stamps"
    return header[order], fields, "header stamps", (note,)


_Place = tuple[str | int, ...]  # of a field in a message: attributes, then an index and rest


def _places_of_fields(messages: list) -> dict[str, _Place]:
    """Where the numeric fields of messages stand, by their names."""
    found: dict[str, _Place] = {}

    def gather(value: Any, name: str, place: _Place) -> None:
        if isinstance(value, bool | int | float | np.number | np.bool_):
            found.setdefault(name, place)
        elif isinstance(value, list | np.ndarray):
            if len(value) <= LONGEST_ARRAY and not name.endswith("covariance"):
                for index, item in enumerate(value):
                    gather(item, f"{name}.{index}", (*place, index))
        elif hasattr(value, "__msgtype__"):
            for part, item in vars(value).items():
                # Constants of the type are in capitals; a header has the clock, and no channel.
                if not (part.startswith("__") or part.isupper() or part == "header"):
                    gather(item, f"{name}.{part}" if name else part, (*place, part))

    for message in messages:
        gather(message, "", ())
    return found


def _series(messages: list, place: _Place) -> np.ndarray:
    """One field of every message; NaN where an array is shorter."""
    if all(isinstance(part, str) for part in place):
        get = attrgetter(".".join(map(str, place)))
        return np.array([get(message) for message in messages], dtype=float)

    def item(value: Any) -> float:
        for part in place:
            if isinstance(part, int) and part >= len(value):
                return float("nan")
            value = value[part] if isinstance(part, int) else getattr(value, part)
        return value

    return np.array([item(message) for message in messages], dtype=float)


def _mask_unknown(table: dict[str, np.ndarray], messages: list) -> None:
    """Empties what a message says it does not know: no fix, orientation not measured."""
    for name in [name for name in table if name.endswith("status.status")]:
        place = name.removesuffix("status.status")
        for field in ("latitude", "longitude", "altitude"):
            if place + field in table:
                table[place + field] = np.where(table[name] < 0, np.nan, table[place + field])
    for covariance, measured in _UNKNOWN.items():
        if messages and hasattr(messages[0], covariance):
            unknown = np.array([getattr(message, covariance)[0] == -1 for message in messages])
            for field in [field for field in table if field.startswith(f"{measured}.")]:
                table[field] = np.where(unknown, np.nan, table[field])
