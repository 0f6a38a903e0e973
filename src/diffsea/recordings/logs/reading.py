"""A log through a mapping: streams read, channels picked, put into SI and NED, and joined."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np

from diffsea.errors import UserError, nearest
from diffsea.recordings.geodesy import place_fixes
from diffsea.recordings.logs import ardupilot, matlab, px4, ros
from diffsea.recordings.logs.joining import LogChannel, join_channels
from diffsea.recordings.logs.streams import LogFormat, Stream, list_fields, merge_repeated_times
from diffsea.recordings.mappings import Column, Mapping
from diffsea.trajectory import MOTION_CHANNELS, RowsLeftOut, Samples


# Every format of log there is.
FORMATS = (
    LogFormat((".bin",), ardupilot.contents, ardupilot.streams, extra="ardupilot"),
    LogFormat((".ulg",), px4.contents, px4.streams, extra="px4"),
    LogFormat((".mat",), matlab.contents, matlab.streams, time_is_mapped=True),
    LogFormat(
        (".bag", ".db3", ".mcap"), ros.contents, ros.streams, extra="ros", is_folder=ros.is_folder
    ),
)
_HEADINGS = ("yaw", "heading", "psi")  # what a field for the example may be called


class LogChannels(NamedTuple):
    """The channels of a log on one clock, in SI units and NED axes."""

    values: dict[str, Samples]  # with `t` in s
    notes: list[str]
    repeated_times: tuple[RowsLeftOut, ...]


def is_log(path: Path) -> bool:
    """Whether a file is named like a log, or a folder is that of a ROS 2 bag."""
    return _format(path) is not None


def contents(path: Path) -> dict[str, list[str]]:
    """The topics of a log and their numeric fields.

    Raises `UserError` for a file that is none, or an optional package that is absent.
    """
    form = _checked_format(path)
    with form.packages(path):
        return form.contents(path)


def read_log(path: Path, mapping: Mapping | None) -> LogChannels:
    """Channels of a log in SI units and NED axes on one clock, with `t` in s.

    The mapping names its columns `topic:field`; a field may be named by the end of its name
    where that leaves no doubt. The rows are the samples of the topic with the most of them, or
    of that under [file] clock; `join_channels` says how the other topics meet them.

    Raises `UserError` for a log that cannot be read, a topic or field that it does not have,
    a stream with one sample or with time that runs backwards, and clocks that do not overlap.
    """
    form = _checked_format(path)
    if mapping is None:
        raise UserError(_how_to_map(path, form))
    _check_columns(mapping, path, form)
    columns = {name: column for name, column in mapping.ned_channels.items() if name != "t"}
    if not any(name in columns for name in (*MOTION_CHANNELS, "latitude")):
        raise UserError(
            f"{mapping.name} has no motion channel ({', '.join(MOTION_CHANNELS)}, or latitude "
            f"and longitude); {path} needs one"
        )
    streams = _mapped_streams(path, mapping, form, columns)
    channels, notes = _pick_channels(path, mapping, columns, streams)
    clock, why = _choose_clock(mapping, streams)
    rows = clock.t
    notes.insert(0, f"rows are the {rows.size} samples of {clock.title} ({why})")
    values, lost = join_channels(channels, rows, mapping.velocity_axes == "earth", str(path))
    merged = [stream.repeated_times for stream in streams.values()]
    return LogChannels({"t": rows} | values, [*notes, *lost], tuple(m for m in merged if m))


def _format(path: Path) -> LogFormat | None:
    if path.is_dir():
        return next((form for form in FORMATS if form.is_folder and form.is_folder(path)), None)
    return next((form for form in FORMATS if path.suffix.lower() in form.suffixes), None)


def _checked_format(path: Path) -> LogFormat:
    if not path.exists():
        siblings = [item.name for item in path.parent.glob("*")] if path.parent.is_dir() else []
        raise UserError(f"there is no recording {path}{nearest(path.name, siblings)}")
    if path.is_file():
        try:
            with path.open("rb") as file:
                first = file.read(1)
        except OSError as error:
            raise UserError(f"cannot read {path}: {error.strerror}") from error
        if not first:
            raise UserError(f"{path} is empty; copy the log again")
    form = _format(path)
    if form is None:
        suffixes = ", ".join(suffix for form in FORMATS for suffix in form.suffixes)
        raise UserError(f"{path} is no log; logs are named {suffixes}, or are ROS 2 folders")
    return form


def _how_to_map(path: Path, form: LogFormat) -> str:
    """What to say where there is no mapping: all there is, and how a mapping begins."""
    found = contents(path)
    fields = [(topic, field) for topic, names in found.items() for field in names]
    headings = [pair for pair in fields if pair[1].lower().split(".")[-1] in _HEADINGS]
    column = ":".join((headings or fields or [("topic", "field")])[0]).removeprefix(":")
    time = '  t = { column = "...", unit = "s" }\n' if form.time_is_mapped else ""
    return (
        f"{path} is a log and needs a mapping that says which fields are which channels. "
        f"Topics and fields:\n{list_fields(found)}\nWrite, for instance in boat.toml,\n"
        f'  [columns]\n{time}  psi = {{ column = "{column}", unit = "rad" }}\n'
        "with a line per channel and its unit in the log, and name it with --mapping boat.toml"
    )


def _topic_and_field(column: Column) -> tuple[str, str]:
    topic, _, field = column.column.rpartition(":")
    return topic, field


def _check_columns(mapping: Mapping, path: Path, form: LogFormat) -> None:
    if form.time_is_mapped:
        return
    if "t" in mapping.channels or mapping.time_step is not None:
        raise UserError(
            f"{mapping.name}: {path} has clocks of its own, so leave t and [file] time_step out; "
            "[file] clock chooses the topic whose samples become the rows"
        )
    for name, column in mapping.ned_channels.items():
        if not all(_topic_and_field(column)):
            raise UserError(
                f"{mapping.name}: [columns] {name}: {column.column!r} must be written topic:field, "
                f"for {path} is a log with several topics"
            )


def _mapped_streams(
    path: Path, mapping: Mapping, form: LogFormat, columns: dict[str, Column]
) -> dict[str, Stream]:
    """The streams that the mapping names, in its order, with strictly increasing time."""
    topics = list(dict.fromkeys(_topic_and_field(column)[0] for column in columns.values()))
    with form.packages(path):
        streams = form.streams(path, mapping, topics)
    for column in columns.values():
        topic = _topic_and_field(column)[0]
        if topic not in streams:
            found = contents(path)
            known = [*found, *(name.partition("[")[0] for name in found)]
            raise UserError(
                f"{path} has no {topic!r}, which {mapping.name} maps to "
                + mapping.channel_of(column.column)
                + nearest(topic, known)
                + f". It has\n{list_fields(found)}"
            )
    return {topic: merge_repeated_times(streams[topic], path) for topic in topics}


def _pick_channels(
    path: Path, mapping: Mapping, columns: dict[str, Column], streams: dict[str, Stream]
) -> tuple[dict[str, LogChannel], list[str]]:
    """The channels in SI units, each with its own clock, and notes on where they come from."""
    channels: dict[str, LogChannel] = {}
    sources: dict[str, list[str]] = {topic: [] for topic in streams}
    for name, column in columns.items():
        topic, field = _topic_and_field(column)
        written = mapping.channel_of(column.column)
        full, series = streams[topic].field(field, f"{path}, {mapping.name}, {written}")
        series = np.where(np.isfinite(series), series, np.nan) * column.gain + column.shift
        if not np.any(np.isfinite(series)):
            raise UserError(f"{path}: {column.column}, mapped to {written}, has no valid value")
        channels[name] = LogChannel(topic, streams[topic].t - column.delay, series)
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
    if "latitude" not in channels:
        return channels, notes
    latitude, longitude = channels.pop("latitude"), channels.pop("longitude")
    if latitude.topic != longitude.topic or np.any(latitude.t != longitude.t):
        raise UserError(
            f"{mapping.name}: latitude and longitude must come from one topic, with one delay"
        )
    north, east, note = place_fixes(latitude.values, longitude.values, mapping.origin, str(path))
    position = {
        "x": dataclasses.replace(latitude, values=north),
        "y": dataclasses.replace(longitude, values=east),
    }
    return position | channels, [*notes, note]


def _choose_clock(mapping: Mapping, streams: dict[str, Stream]) -> tuple[Stream, str]:
    """The stream whose samples become the rows, and why."""
    if mapping.clock is None:
        return max(streams.values(), key=lambda stream: stream.t.size), "the most samples"
    if mapping.clock not in streams:
        raise UserError(
            f"{mapping.name}: [file] clock = {mapping.clock!r} is none of the topics mapped: "
            + ", ".join(streams)
            + nearest(mapping.clock, streams)
        )
    return streams[mapping.clock], "[file] clock"
