"""What every format of log is turned into: streams, tables with a clock of their own."""

import contextlib
import dataclasses
import importlib
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd

from diffsea.errors import UserError, nearest
from diffsea.recordings.vocabulary import REPEATED_TIMES


# What an array may hold and still be numbers to choose from; images and point clouds are longer.
LONGEST_ARRAY = 64
_LISTED = 12  # fields of a topic that a message names


@dataclasses.dataclass(frozen=True)
class Stream:
    """The messages of one topic: flat fields, as they stand in the file, over time.

    `t` is in seconds and never decreases; `fields` are series of the same length under names
    such as `pose.pose.position.x` or `thrusters.0`, NaN where a message has no valid value.
    `clock` says in words which time that is. `unfit` are fields that cannot be used, and why.
    """

    topic: str
    t: np.ndarray  # s
    fields: dict[str, np.ndarray]
    clock: str
    notes: tuple[str, ...] = ()
    unfit: dict[str, str] = dataclasses.field(default_factory=dict)

    def field(self, name: str, where: str) -> tuple[str, np.ndarray]:
        """The full name and the series of a field, which may be named by the end of its name.

        Raises `UserError`, beginning with `where`, where there is none or more than one such.
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


def checked(stream: Stream, path: Path) -> Stream:
    """The stream with rows of one time stamp made one, of the last value of each field.

    Raises `UserError` for fewer than two samples, and for time that is missing or runs backwards.
    """
    where = f"{path}: {stream.topic or 'the top level'}"
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
    samples = 1 + np.sum(steps > 0) if stream.t.size else 0
    if samples < 2:
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
        f"t = {stream.t[1:][steps == 0][0]:g} s in {stream.topic or 'the top level'}"
    )
    return dataclasses.replace(
        stream, t=table.index.to_numpy(), fields=fields, notes=(*stream.notes, note)
    )


def euler_angles(w, x, y, z) -> dict[str, np.ndarray]:
    """Roll, pitch and yaw (rad) of a rotation given by a quaternion of any length above zero.

    The rotation is yaw about z, then pitch about the new y, then roll about the new x, as in
    Fossen's handbook, (2.58); frames are those of the message. NaN for a quaternion of zeros.
    """
    w, x, y, z = (np.asarray(part, dtype=float) for part in (w, x, y, z))
    square = w**2 + x**2 + y**2 + z**2
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(square > 0, 2 / square, np.nan)
        roll = np.arctan2(scale * (w * x + y * z), 1 - scale * (x**2 + y**2))
        pitch = np.arcsin(np.clip(scale * (w * y - z * x), -1, 1))
        yaw = np.arctan2(scale * (w * z + x * y), 1 - scale * (y**2 + z**2))
    return {"roll": roll, "pitch": pitch, "yaw": yaw}


def library(module: str, extra: str, path: Path) -> ModuleType:
    """An optional package; raises `UserError` with the extra that brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UserError(
            f"reading {path} needs the package {package}: pip install 'diffsea[{extra}]'"
        ) from error


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


def listing(contents: Mapping[str, list[str]]) -> str:
    """Topics and their fields, a line each, long lists of fields cut short."""
    lines = []
    for topic, fields in contents.items():
        rest = len(fields) - _LISTED
        more = f" and {rest} more" if rest > 0 else ""
        lines.append(f"  {topic or '(top level)'}: {', '.join(fields[:_LISTED]) or '-'}{more}")
    return "\n".join(lines)
