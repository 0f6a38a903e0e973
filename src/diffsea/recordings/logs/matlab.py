"""MATLAB's `.mat` files: every structure a stream, with the vectors in it as fields."""

import collections
import dataclasses
import functools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.outside.sizes import check_size, current_limit
from diffsea.recordings.logs import mat_child
from diffsea.recordings.logs.streams import LONGEST_ARRAY, Stream, list_fields
from diffsea.recordings.mappings import Mapping
from diffsea.trajectory import Samples


_SECONDS = 120.0  # that reading a file may take
_KEPT = 8  # files whose content is kept


@dataclasses.dataclass
class _Group:
    """The numeric arrays of one structure, and why what else stands in it is not read."""

    arrays: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    unread: dict[str, str] = dataclasses.field(default_factory=dict)


def contents(path: Path) -> dict[str, list[str]]:
    """The arrays of every structure; those that stand in none are under the empty name."""
    found = {}
    for name, group in _groups(path).items():
        found[name] = []
        for field, array in group.arrays.items():
            split = array.ndim == 2 and min(array.shape) <= LONGEST_ARRAY
            parts = range(min(array.shape)) if split else ()
            found[name] += [f"{field}.{i}" for i in parts] or [field]
    return found


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the structures that the file has.

    A structure's time is the vector that has the name of the mapping's t, in the structure
    itself, in one around it, or else that of t itself; or samples count by [file] time_step.
    Matrices give a field per column (or per row, where the rows are as many as columns of
    others), `pos.0`, `pos.1` ...

    Raises:
        UserError: the file is of MATLAB 7.3 (HDF5) or cannot be read, a time is missing, or
            the vectors of a structure have another length than their time.
    """
    groups = _groups(path)
    has = list_fields({name: list(group.arrays) for name, group in groups.items()})
    if "t" not in mapping.channels and mapping.time_step is None:
        raise UserError(
            f"{mapping.name}: {path} needs a channel t, or [file] time_step in seconds; it has\n"
            + has
        )
    if "t" in mapping.channels:
        topic, field = mapping.channels["t"].topic_and_field
        if topic not in groups or field not in groups[topic].arrays:
            raise UserError(
                f"{path} has no {mapping.channels['t'].column!r}, which {mapping.name} maps to t. "
                f"It has\n{has}"
            )
    there = [topic for topic in topics if topic in groups and groups[topic].arrays]
    return {topic: _stream(topic, groups, mapping) for topic in there}


def table(path: Path) -> dict[str, Samples]:
    """The vectors, and columns of matrices, that are as long as most are: those of one clock."""
    series: dict[str, Samples] = {}
    for topic, group in _groups(path).items():
        for field, array in group.arrays.items():
            name = f"{topic}:{field}".removeprefix(":")
            if array.ndim == 1:
                series[name] = array
            elif array.ndim == 2 and min(array.shape) <= LONGEST_ARRAY:
                columns = array.T if array.shape[0] >= array.shape[1] else array
                series |= {f"{name}.{index}": one for index, one in enumerate(columns)}
    lengths = collections.Counter(one.size for one in series.values() if one.size > 1)
    usual = max(lengths, key=lambda size: (lengths[size], size), default=0)
    return {name: one.astype(float) for name, one in series.items() if one.size == usual}


def _groups(path: Path) -> dict[str, _Group]:
    with path.open("rb") as file:
        start = file.read(128)
    if start.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise UserError(
            f"{path} is a MATLAB 7.3 file (HDF5), which this does not read; load it in MATLAB and "
            "save it with save(name, '-v7')"
        )
    state = path.stat()
    return _groups_of_child(path, current_limit(), state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=_KEPT)
def _groups_of_child(path: Path, limit: int, changed: int, size: int) -> dict[str, _Group]:
    """What a process of its own reads, so that a file which ends the reader is a message.

    A mapping is proposed by several looks at a file; `changed` (ns) and `size` say that it is the
    same, and `limit` how many bytes it may expand to.

    Raises:
        UserError: the file is damaged, expands beyond the limit, or takes too long.
    """
    words = [sys.executable, "-P", mat_child.__file__, str(path.resolve()), str(limit)]
    quiet = {"OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}  # threads reserve memory
    with tempfile.TemporaryFile() as output:
        try:
            ended = subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                env=os.environ | quiet,
                timeout=_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise UserError(
                f"{path} cannot be read as a MATLAB file: it takes longer than {_SECONDS} s"
            ) from error
        told = ended.stderr.decode(errors="replace").strip()
        if ended.returncode == mat_child.TOO_LARGE:
            check_size(path, int(told))
        if ended.returncode != 0:
            said = told if ended.returncode == mat_child.UNREADABLE else "it is damaged"
            raise UserError(f"{path} cannot be read as a MATLAB file: {said}")
        output.seek(0)
        groups: dict[str, _Group] = {}
        for topic, names, unread in json.loads(output.readline()):
            read = np.lib.format.read_array
            arrays = {name: read(output, allow_pickle=False) for name in names}
            for array in arrays.values():
                array.flags.writeable = False  # whoever asks next has it, too
            groups[topic] = _Group(arrays, unread)
    return groups


def _stream(topic: str, groups: dict[str, _Group], mapping: Mapping) -> Stream:
    """A structure as a stream; arrays of another length than its time are unfit."""
    group = groups[topic]
    if "t" not in mapping.channels:
        size = max(max(array.shape) for array in group.arrays.values())
        t, clock = np.arange(size) * mapping.time_step, "[file] time_step"
    else:
        column, parts = mapping.channels["t"], topic.split(".")
        default, field = column.topic_and_field
        around = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
        owners = [name for name in (*around, default) if name in groups]
        owner = next(name for name in owners if field in groups[name].arrays)
        t = groups[owner].arrays[field].ravel() * column.gain + column.shift
        clock = f"{owner}:{field}".removeprefix(":")
    fields, unfit = {}, dict(group.unread)
    for name, array in group.arrays.items():
        columns = np.atleast_2d(array.T if array.shape[0] == t.size else array)
        if array.ndim == 1 and array.size == t.size:
            fields[name] = array
        elif array.ndim == 2 and columns.shape[1] == t.size and len(columns) <= LONGEST_ARRAY:
            fields |= {f"{name}.{index}": series for index, series in enumerate(columns)}
        else:
            shape = " x ".join(map(str, array.shape))
            unfit[name] = f"has {shape} values, but its time ({clock}) has {t.size}"
    return Stream(topic, t, fields, clock, unfit=unfit)
