"""What every format of log is turned into: streams, tables with a clock of their own."""

import contextlib
import dataclasses
import io
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea.errors import UserError, nearest
from diffsea.recordings.mappings import REPEATED_TIMES, Mapping
from diffsea.trajectory import RowsLeftOut, Samples


# What an array may hold and still be numbers to choose from; images and point clouds are longer.
LONGEST_ARRAY = 64
_LISTED_FIELDS = 12  # of a topic, in a message: more would hide the other topics


def ends_within_a_message(path: Path) -> str:
    """That a file does, in words."""
    return f"{path.name} ends within a message; what is before it is used"


@dataclasses.dataclass(frozen=True)
class Stream:
    """The messages of one topic: flat fields, as they stand in the file, over time.

    Attributes:
        topic: its name in the log, empty for what stands in none.
        t: seconds that never decrease.
        fields: series of the same length under names such as `pose.pose.position.x` or
            `thrusters.0`, NaN where a message has no valid value.
        clock: which time `t` is, in words.
        notes: what was damaged or put right in the file, in words.
        unfit: fields that cannot be used, and why.
        repeated_times: what `merge_repeated_times` made one.
        cut_off: that the file ends within a message, in words; empty where it does not.
        epoch: s since 1970 at which its times are zero; None where the file does not say.
    """

    topic: str
    t: Samples
    fields: dict[str, Samples]
    clock: str
    notes: tuple[str, ...] = ()
    unfit: dict[str, str] = dataclasses.field(default_factory=dict)
    repeated_times: RowsLeftOut | None = None
    cut_off: str = ""
    epoch: float | None = None

    @property
    def title(self) -> str:
        """The topic as messages name it."""
        return self.topic or "the top level"

    def field(self, name: str, where: str) -> tuple[str, Samples]:
        """The full name and the series of a field, which may be named by the end of its name.

        Raises:
            UserError: there is none or more than one such; the message begins with `where`.
        """
        if name in self.fields:
            return name, self.fields[name]
        ends = [full for full in self.fields if full.endswith(f".{name}")]
        if len(ends) == 1:
            return ends[0], self.fields[ends[0]]
        if name in self.unfit:
            raise UserError(f"{where}: {self.topic}:{name} {self.unfit[name]}")
        if ends:
            raise UserError(
                f"{where}: {name!r} may be any of {', '.join(ends)} of {self.topic!r}; write it out"
            )
        raise UserError(
            f"{where}: {self.topic!r} has no field {name!r}; it has {', '.join(self.fields)}"
            + nearest(name, self.fields)
        )


@dataclasses.dataclass(frozen=True)
class LogFormat:
    """How logs of one kind are read.

    Both functions import what packages they need when they are called, and raise `UserError` for
    a file that is damaged or no such log.

    Attributes:
        name: for programs, as `check.json` has it.
        suffixes: of file names, in small letters.
        contents: of a path, gives the names of the numeric fields of every topic.
        streams: of a path, a mapping and topics, gives the streams of those that the log has.
        extra: what brings the packages, `pip install 'diffsea[extra]'`; None where none is needed.
        time_is_mapped: whether the mapping names the time, as it stands among the fields.
        is_folder: whether a folder is such a log; None where only files are.
        holds: whether a file of such a name is such a log by its content; None where the name
            tells.
        told: what it is, before "needs a mapping" in a message.
        parameters: of a path, gives an autopilot's parameters as they were told, in order; None of
            a format without.
        table: of a path, gives the fields that share one clock, by what a mapping calls them; None
            of a format whose topics have clocks of their own.
    """

    name: str
    suffixes: tuple[str, ...]
    contents: Callable[[Path], dict[str, list[str]]]
    streams: Callable[[Path, Mapping, list[str]], dict[str, Stream]]
    extra: str | None = None
    time_is_mapped: bool = False
    is_folder: Callable[[Path], bool] | None = None
    holds: Callable[[Path], bool] | None = None
    told: str = "a log and"
    parameters: Callable[[Path], list[tuple[str, float]]] | None = None
    table: Callable[[Path], dict[str, Samples]] | None = None

    @contextlib.contextmanager
    def packages(self, path: Path) -> Iterator[None]:
        """Turns the lack of a package into a `UserError` that names the extra which brings it."""
        try:
            yield
        except ImportError as error:
            package = (error.name or "").partition(".")[0]
            raise UserError(
                f"reading {path} needs the package {package}: pip install 'diffsea[{self.extra}]'"
            ) from error


def merge_repeated_times(stream: Stream, path: Path, fewest: int = 2) -> Stream:
    """The stream with rows of one time stamp made one, of the last value of each field.

    Raises:
        UserError: there are fewer than `fewest` samples, or time is missing or runs backwards.
    """
    where = f"{path}: {stream.title}"
    missing = np.sum(~np.isfinite(stream.t))
    if missing:
        raise UserError(f"{where} has {missing} samples without a time stamp")
    steps = np.diff(stream.t)
    if np.any(steps < 0):
        at = int(np.argmax(steps < 0))
        raise UserError(
            f"{where}: time runs backwards at sample {at + 2}, from {stream.t[at]:.10g} s to "
            f"{stream.t[at + 1]:.10g} s; split the log if it holds two runs"
        )
    samples = 1 + int(np.sum(steps > 0)) if stream.t.size else 0
    if samples < fewest:
        raise UserError(
            f"{where} has {samples} sample(s), and a channel needs at least two; leave it out of "
            "the mapping, or record it longer"
        )
    if samples == stream.t.size:
        return stream
    table = pd.DataFrame(stream.fields).groupby(stream.t).last()
    fields = {name: table[name].to_numpy(dtype=float) for name in stream.fields}
    note = (
        f"{REPEATED_TIMES}: {stream.t.size - samples} of {stream.t.size}, first at "
        f"t = {stream.t[1:][steps == 0][0]:g} s in {stream.title}"
    )
    return dataclasses.replace(
        stream,
        t=table.index.to_numpy(),
        fields=fields,
        notes=(*stream.notes, note),
        repeated_times=RowsLeftOut(stream.t.size - samples, note),
    )


@contextlib.contextmanager
def unreadable(path: Path, what: str, hint: str = "") -> Iterator[None]:
    """Turns whatever a library raises on a broken file into a `UserError`, and keeps it quiet."""
    try:
        silence = io.StringIO()
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            yield
    except (UserError, MemoryError):
        raise
    except Exception as error:  # the libraries raise many kinds for a broken file
        reason = str(error).strip() or type(error).__name__
        raise UserError(f"{path} cannot be read as {what}: {reason}{hint}") from error


def list_fields(contents: dict[str, list[str]]) -> str:
    """Topics and their fields, a line each, long lists of fields cut short."""
    lines = []
    for topic, fields in contents.items():
        rest = len(fields) - _LISTED_FIELDS
        more = f" and {rest} more" if rest > 0 else ""
        shown = ", ".join(fields[:_LISTED_FIELDS]) or "-"
        lines.append(f"  {topic or '(top level)'}: {shown}{more}")
    return "\n".join(lines)
