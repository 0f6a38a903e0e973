"""Which mapping a log needs, found from the topics and fields that it contains."""

import dataclasses
import functools
import importlib.resources
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from diffsea.errors import UserError
from diffsea.recordings import logs
from diffsea.recordings.auditing.mapping_rows import mapping_text
from diffsea.recordings.known.autopilot_parameters import read_parameters
from diffsea.recordings.known.outputs import Output, assigned_outputs
from diffsea.recordings.mappings import Column, Mapping, mapping_from
from diffsea.trajectory import MOTION_CHANNELS


_LAYOUTS = importlib.resources.files("diffsea.recordings.known") / "layouts"
_GROUPS = ("position", "heading", "velocity", "yaw_rate", "roll", "armed", "orders")
_BOAT = 2  # FRAME_CLASS of Rover
OWN_TOPICS = "/diffsea/"  # under which an exported recording has its channels as they are
OWN_PREFIXES = {"orders": "cmd_", "executed": "exec_"}  # of channels, by their group of topics
_NEEDED = ("position", "velocity", "heading", "yaw_rate", "orders")

Contents = dict[str, list[str]]  # fields by topic


@dataclasses.dataclass(frozen=True)
class Recognised:
    """A log whose format is known, and the mapping chosen for it.

    Attributes:
        log: the name of its format.
        title: what wrote it, for people.
        mapping: the parts of the layout that the log can fill.
        outputs: what the orders of an autopilot are, where its parameters tell.
        craft: what kind of vessel it is, as far as the log tells.
        missing: what the log lacks, by its group of channels, with the setting that records it.
        others: topics that would have done as well, by the channel that they would be.
        guessed: what more was found by names and motion, a sentence for each channel: who reads
            the log without this mapping does not know of it.
    """

    log: str
    title: str
    mapping: Mapping
    outputs: tuple[Output, ...]
    craft: str
    missing: dict[str, str]
    others: tuple[str, ...]
    guessed: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The mapping as a file to edit, with what is missing as comments."""
        notes = [f"Chosen for {self.title} by what the log contains."]
        notes += [f"{output.channel}: output {output.number}" for output in self.outputs]
        return mapping_text(
            self.mapping, [*notes, *self.others, *self.guessed, *self.missing.values()]
        )

    @property
    def sentence(self) -> str:
        """Which mapping was chosen, and how to choose another."""
        channels = ", ".join(f"{n} from {c.column}" for n, c in self.mapping.channels.items())
        return (
            f"read as {self.title} ({self.log}) by what it contains: {channels}; `diffsea check` "
            "writes this mapping as a file, and --mapping FILE overrides it"
        )


def recognise(path: str | Path) -> Recognised | None:
    """The mapping for a log, by its content; None of tables and of logs that no layout knows.

    Raises:
        UserError: the log cannot be read, or its format is known and it has no motion at all; the
            message then names the messages to record, and the settings that record them.
    """
    path = Path(path)
    form = logs.format_of(path)
    layouts = [] if form is None else _layouts().get(form.name, [])
    if form is None or not layouts:
        return None
    found = logs.contents(path)
    if own := {t: fields for t, fields in found.items() if t.startswith(OWN_TOPICS)}:
        return _exported(form.name, own, path)
    filled = [_fill(layout, path, found) for layout in layouts]
    for one in filled:
        if one.has_motion:
            return one.recognised(form.name, path)
    if form.name == "ros-bag":  # it may have anything: the message on mappings lists it
        return None
    most = max(filled, key=lambda one: len(one.channels))
    lacking = "\n  ".join(most.missing.values())
    raise UserError(f"{path} was read as {most.title}, and no motion is in it:\n  {lacking}")


class _Filled(NamedTuple):
    """A layout with what a log has of it."""

    title: str
    file: dict[str, Any]
    channels: dict[str, Any]
    outputs: list[Output]
    parameters: dict[str, float]
    missing: dict[str, str]
    others: list[str]

    @property
    def has_motion(self) -> bool:
        """Whether any motion of the vessel is in it."""
        return any(name in self.channels for name in (*MOTION_CHANNELS, "latitude"))

    def recognised(self, log: str, path: Path) -> Recognised:
        """The log of a format, with the mapping that this is."""
        mapping = mapping_from({"file": self.file, "columns": self.channels}, path)
        return Recognised(
            log,
            self.title,
            dataclasses.replace(mapping, name=f"the known mapping of {self.title}"),
            tuple(self.outputs),
            _craft(self.channels, self.parameters),
            self.missing,
            tuple(self.others),
        )


def _fill(layout: dict[str, Any], path: Path, found: Contents) -> _Filled:
    """The channels of a layout that a log can fill from the topics found in it."""
    others, file = list[str](), dict(layout.get("file", {}))
    channels: dict[str, Any] = {}
    parameters: dict[str, float] = {}
    outputs: list[Output] = []
    if "outputs" in layout:
        told = read_parameters(path)
        parameters = dict(told.values)
        outputs, columns = _outputs(layout["outputs"], assigned_outputs(told.outputs), found)
        channels |= columns
    for group in _GROUPS:
        chosen = _first_that_fits(layout.get(group, []), found, channels)
        if chosen is None:
            continue
        columns, candidate, rivals = chosen
        file |= candidate.get("file", {})
        if candidate.get("clock"):
            file["clock"] = Column(next(iter(_plain(columns).values()))).topic_and_field[0]
        channels |= columns
        others += [f"{', '.join(columns)} might also be from {topic}" for topic in rivals]
    if file.get("velocity_axes") == "earth" and "u" not in channels:
        del file["velocity_axes"]
    missing = _missing(layout, channels, found)
    return _Filled(layout["title"], file, channels, outputs, parameters, missing, others)


def column_of_output(path: Path, number: int) -> str:
    """The column in which a log has the pulse widths of an output of the autopilot."""
    form = logs.format_of(path)
    layouts = [] if form is None else _layouts().get(form.name, [])
    named = [layout["outputs"] for layout in layouts if "outputs" in layout]
    return (named or ["SERVO{number}"])[0].format(number=number).removeprefix("*")


def _exported(log: str, found: Contents, path: Path) -> Recognised:
    """A recording that was exported: its own channels under their own names.

    A topic has the channels of a group, or in a ROS bag one of them.
    """
    alone = all(set(fields) == {"data"} for fields in found.values())
    channels = {
        _own_channel(topic) if alone else field: f"{topic}:{field}"
        for topic, fields in found.items()
        for field in fields
        if not field.startswith("timestamp.")
    }
    clock = next((t for t in found if t.endswith("motion")), next(iter(found)))
    mapping = mapping_from({"file": {"clock": clock}, "columns": channels}, path)
    title = "an export of diffsea"
    mapping = dataclasses.replace(mapping, name=f"the channels of {title}")
    return Recognised(log, title, mapping, (), _craft(channels, {}), {}, ())


def _own_channel(topic: str) -> str:
    """The channel of which a topic is."""
    group, _, name = topic.removeprefix(OWN_TOPICS).partition("/")
    return OWN_PREFIXES.get(group, "") + name.replace("/", ".")


@functools.cache
def _layouts() -> dict[str, list[dict[str, Any]]]:
    """The layouts that there are, by the formats of logs that they are for, in order of names."""
    found: dict[str, list[dict[str, Any]]] = {}
    for file in sorted(_LAYOUTS.iterdir(), key=lambda file: file.name):
        if file.name.endswith(".toml"):
            layout = tomllib.loads(file.read_text(encoding="utf-8"))
            for log in layout["logs"]:
                found.setdefault(log, []).append(layout)
    return found


def _plain(columns: dict[str, Any]) -> dict[str, str]:
    """The column of each channel as text, without its unit."""
    return {n: c if isinstance(c, str) else c["column"] for n, c in columns.items()}


def _first_that_fits(
    candidates: list[dict[str, Any]], found: Contents, channels: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], list[str]] | None:
    """Columns with the log's own topics, the candidate they are of, and topics passed over."""
    for candidate in candidates:
        if candidate.get("needs") == "heading" and "psi" not in channels:
            continue
        fields: dict[str, list[str]] = {}  # by pattern of topics
        for column in _plain(candidate["columns"]).values():
            pattern, field = Column(column).topic_and_field
            fields.setdefault(pattern, []).append(field)
        fitting = {pattern: _topics(pattern, names, found) for pattern, names in fields.items()}
        if not all(fitting.values()):
            continue
        columns: dict[str, Any] = {}
        for name, entry in candidate["columns"].items():
            plain = entry if isinstance(entry, str) else entry["column"]
            pattern, field = Column(plain).topic_and_field
            column = f"{fitting[pattern][0]}:{field}"
            columns[name] = column if isinstance(entry, str) else entry | {"column": column}
        rivals = [topic for topics in fitting.values() for topic in topics[1:]]
        return columns, candidate, list(dict.fromkeys(rivals))
    return None


def _topics(pattern: str, fields: list[str], found: Contents) -> list[str]:
    """The topics of a pattern that have all the fields; shortest names first."""

    def has(topic: str, field: str) -> bool:
        ends = [name for name in found[topic] if name == field or name.endswith(f".{field}")]
        return field in found[topic] or len(ends) == 1

    fitting = [
        topic
        for topic in found
        if fnmatchcase(topic.partition("[")[0].lower(), pattern.lower())
        and not topic.endswith(tuple(f"[{k}]" for k in range(1, 10)))
        and all(has(topic, field) for field in fields)
    ]
    return sorted(fitting, key=lambda topic: (len(topic), topic))


def _outputs(
    source: str, assigned: list[Output], found: Contents
) -> tuple[list[Output], dict[str, Any]]:
    """The outputs that the log has orders of, and their columns, `source` naming a number's."""
    outputs, columns = [], {}
    for output in assigned:
        pattern, field = Column(source.format(number=output.number)).topic_and_field
        topics = _topics(pattern, [field], found)
        if not topics:
            continue
        column = output.column(f"{topics[0]}:{field}")
        entry = {"column": column.column}
        if column.unit is not None:
            entry |= {"unit": column.unit, "scale": column.scale, "offset": column.offset}
        columns[f"cmd_{output.channel}"] = entry
        outputs.append(output)
    return outputs, columns


def _missing(layout: dict[str, Any], channels: dict[str, Any], found: Contents) -> dict[str, str]:
    """What is not in the log, in the words of its layout, by the group of channels."""
    turned = channels | {"psi": ""}  # a velocity that only lacks its heading is recorded
    outputs = layout.get("outputs")
    there = {
        "position": "x" in channels or "latitude" in channels,
        "velocity": _first_that_fits(layout.get("velocity", []), found, turned) is not None,
        "heading": "psi" in channels,
        "yaw_rate": "r" in channels,
        "orders": any(name.startswith("cmd_") for name in channels),
    }
    lacking = {group: layout["missing"][group] for group in _NEEDED if not there[group]}
    if outputs is not None and "orders" in lacking:
        pattern = outputs.partition(":")[0]
        if _topics(pattern, [], found):  # the orders are there, and nothing says whose they are
            lacking["orders"] = layout["missing"]["functions"]
    return lacking


def _craft(channels: dict[str, Any], parameters: dict[str, float]) -> str:
    """The kind of vessel by what drives and steers it."""
    names = {name.removeprefix("cmd_") for name in channels if name.startswith("cmd_")}
    kind = "boat" if parameters.get("FRAME_CLASS") == _BOAT else "vessel"
    if {"port", "starboard"} <= names:
        return f"{kind} with two thrusters, port and starboard"
    if "rudder" in names:
        return f"{kind} with {'a motor and ' if 'motor' in names else ''}a rudder"
    return f"{kind} with one thruster" if names else f"{kind} whose actuators were not recorded"
