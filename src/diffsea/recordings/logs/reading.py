"""A log through a mapping: streams read, channels picked, put into SI and NED, and joined."""

import dataclasses
from pathlib import Path
from types import ModuleType

import numpy as np

from diffsea.errors import UserError, nearest
from diffsea.recordings.geodesy import placed
from diffsea.recordings.logs import ardupilot, matlab, px4, ros
from diffsea.recordings.logs.joining import Channel, joined
from diffsea.recordings.logs.streams import Stream, checked, listing
from diffsea.recordings.mappings import Column, Mapping
from diffsea.trajectory import MOTION_CHANNELS


_HEADINGS = ("yaw", "heading", "psi")  # what a field for the example may be called
_FORMATS = {".bin": ardupilot, ".ulg": px4, ".mat": matlab} | dict.fromkeys(ros.SUFFIXES, ros)


def is_log(path: Path) -> bool:
    """Whether a file is named like a log, or a folder is that of a ROS 2 bag."""
    return ros.is_bag(path) if path.is_dir() else path.suffix.lower() in _FORMATS


def contents(path: Path, mapping: Mapping | None = None) -> dict[str, list[str]]:
    """The topics of a log and their numeric fields.

    Raises `UserError` for a file that is none, or an optional package that is absent.
    """
    _check_file(path)
    return _format(path).contents(path, mapping)


def read_log(path: Path, mapping: Mapping | None) -> tuple[dict[str, np.ndarray], list[str]]:
    """Channels of a log in SI units and NED axes on one clock, with `t` in s, and notes.

    The mapping names its columns `topic:field`; a field may be named by the end of its name
    where that leaves no doubt. The rows are the samples of the topic with the most of them, or
    of that under [file] clock; `joining.joined` says how the other topics meet them.

    Raises `UserError` for a log that cannot be read, a topic or field that it does not have,
    a stream with one sample or with time that runs backwards, and clocks that do not overlap.
    """
    _check_file(path)
    if mapping is None:
        raise UserError(_proposal(path))
    columns = mapping.ned_channels
    if _format(path) is not matlab:
        _check_columns(columns, mapping, path)
        columns = {name: column for name, column in columns.items() if name != "t"}
    streams = _streams(path, mapping, columns)
    channels, notes = _channels(path, mapping, columns, streams)
    rows, told = _clock(path, mapping, streams)
    values, lost = joined(channels, rows, mapping.velocity_axes == "earth", str(path))
    return {"t": rows} | values, [*told, *notes, *lost]


def _format(path: Path) -> ModuleType:
    return ros if path.is_dir() else _FORMATS[path.suffix.lower()]


def _check_file(path: Path) -> None:
    if not path.exists():
        siblings = [item.name for item in path.parent.glob("*")] if path.parent.is_dir() else []
        raise UserError(f"there is no recording {path}{nearest(path.name, siblings)}")
    if path.is_dir():
        return
    try:
        with path.open("rb") as file:
            first = file.read(1)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error
    if not first:
        raise UserError(f"{path} is empty; copy the log again")


def _proposal(path: Path) -> str:
    """What to say where there is no mapping: all there is, and how a mapping begins."""
    found = contents(path)
    fields = [(topic, field) for topic, names in found.items() for field in names]
    headings = [pair for pair in fields if pair[1].lower().split(".")[-1] in _HEADINGS]
    column = ":".join((headings or fields or [("topic", "field")])[0]).removeprefix(":")
    time = '  t = { column = "...", unit = "s" }\n' if _format(path) is matlab else ""
    return (
        f"{path} is a log and needs a mapping that says which fields are which channels. "
        f"Topics and fields:\n{listing(found)}\nWrite, for instance in boat.toml,\n"
        f'  [columns]\n{time}  psi = {{ column = "{column}", unit = "rad" }}\n'
        "with a line per channel and its unit in the log, and name it with --mapping boat.toml"
    )


def _split(column: Column) -> tuple[str, str]:
    topic, _, field = column.column.rpartition(":")
    return topic, field


def _written(mapping: Mapping, column: Column) -> str:
    """The channel under which the mapping has a column, before a frame turned it."""
    return next(
        name for name, written in mapping.channels.items() if written.column == column.column
    )


def _check_columns(columns: dict[str, Column], mapping: Mapping, path: Path) -> None:
    if "t" in columns or mapping.time_step is not None:
        raise UserError(
            f"{mapping.name}: {path} has clocks of its own, so leave t and [file] time_step out; "
            "[file] clock chooses the topic whose samples become the rows"
        )
    for name, column in columns.items():
        if not all(_split(column)):
            raise UserError(
                f"{mapping.name}: [columns] {name}: {column.column!r} must be written topic:field, "
                f"for {path} is a log with several topics"
            )


def _streams(path: Path, mapping: Mapping, columns: dict[str, Column]) -> dict[str, Stream]:
    """The checked streams that the mapping names, in its order."""
    channels = {name: column for name, column in columns.items() if name != "t"}
    if not any(name in channels for name in (*MOTION_CHANNELS, "latitude")):
        raise UserError(
            f"{mapping.name} has no motion channel ({', '.join(MOTION_CHANNELS)}, or latitude "
            f"and longitude); {path} needs one"
        )
    topics = list(dict.fromkeys(_split(column)[0] for column in channels.values()))
    read = _format(path).streams(path, mapping, topics)
    for column in channels.values():
        topic = _split(column)[0]
        if topic not in read:
            found = contents(path, mapping)
            known = [*found, *(name.partition("[")[0] for name in found)]
            raise UserError(
                f"{path} has no {topic!r}, which {mapping.name} maps to {_written(mapping, column)}"
                + nearest(topic, known)
                + f". It has\n{listing(found)}"
            )
    return {topic: checked(read[topic], path) for topic in topics}


def _channels(
    path: Path, mapping: Mapping, columns: dict[str, Column], streams: dict[str, Stream]
) -> tuple[dict[str, Channel], list[str]]:
    """The channels in SI units, each with its own clock, and notes on where they come from."""
    channels, sources = {}, {topic: [] for topic in streams}
    for name, column in columns.items():
        topic, field = _split(column)
        if name == "t":
            continue
        where = f"{path}, {mapping.name}, {_written(mapping, column)}"
        full, series = streams[topic].field(field, where)
        series = np.where(np.isfinite(series), series, np.nan) * column.gain + column.shift
        if not np.any(np.isfinite(series)):
            channel = _written(mapping, column)
            raise UserError(f"{path}: {column.column}, mapped to {channel}, has no valid value")
        channels[name] = Channel(topic, streams[topic].t - column.delay, series)
        sources[topic].append(f"{name} from {full}")
    notes = [
        f"{topic or 'top level'}: {streams[topic].t.size} samples by {streams[topic].clock}; "
        + ", ".join(names)
        for topic, names in sources.items()
    ]
    notes += [note for stream in streams.values() for note in stream.notes]
    late = {name: column.delay for name, column in columns.items() if column.delay}
    notes += [f"{name} shifted by {-delay:g} s" for name, delay in late.items()]
    if mapping.frame != "NED":
        notes.append(f"turned from {mapping.frame} into NED axes")
    if "latitude" in channels:
        return _placed(path, mapping, channels, notes)
    return channels, notes


def _placed(
    path: Path, mapping: Mapping, channels: dict[str, Channel], notes: list[str]
) -> tuple[dict[str, Channel], list[str]]:
    """The channels with x and y in place of latitude and longitude."""
    latitude, longitude = channels.pop("latitude"), channels.pop("longitude")
    if latitude.topic != longitude.topic or np.any(latitude.t != longitude.t):
        raise UserError(
            f"{mapping.name}: latitude and longitude must come from one topic, with one delay"
        )
    north, east, note = placed(latitude.values, longitude.values, mapping.origin, str(path))
    position = {
        "x": dataclasses.replace(latitude, values=north),
        "y": dataclasses.replace(longitude, values=east),
    }
    return position | channels, [*notes, note]


def _clock(
    path: Path, mapping: Mapping, streams: dict[str, Stream]
) -> tuple[np.ndarray, list[str]]:
    topic = max(streams, key=lambda name: streams[name].t.size)
    why = "the most samples"
    if mapping.clock is not None:
        topic, why = mapping.clock, "[file] clock"
        if topic not in streams:
            raise UserError(
                f"{mapping.name}: [file] clock = {topic!r} is none of the topics mapped: "
                + ", ".join(streams)
                + nearest(topic, streams)
            )
    rows = streams[topic].t
    return rows, [f"rows are the {rows.size} samples of {topic or 'the top level'} ({why})"]
