"""MATLAB's `.mat` files in a process of its own: what ends it is a message in another.

Run as a script by `matlab`, with a path and the bytes that the file may expand to. SciPy's reader
is compiled code that a damaged file can end. On standard output stand a line of JSON, the
groups with the names of their arrays, then these arrays in NumPy's format, in the same order.
"""

import json
import struct
import sys
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np


UNREADABLE, TOO_LARGE = 3, 4  # exit status; the message is on standard error
LONGEST_ARRAY = 64  # of cells, and of columns of a matrix
_SPARE = 2_000_000_000  # bytes of address space that Python and its libraries take
_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_MATRIX, _COMPRESSED = 14, 15
_OF_AN_ARRAY = 200  # bytes that an array takes besides its numbers
_PIECE = 1 << 16
_OBJECT = "is an object of MATLAB's class"


class _CountedBytes:
    """Bytes that are read once, of a file or of a compressed part of it."""

    def __init__(self, file: BinaryIO, size: int, compressed: bool):
        self._file, self._left = file, size
        self._inflate = zlib.decompressobj() if compressed else None

    def read(self, count: int) -> bytes:
        """So many bytes, fewer at the end."""
        if self._inflate is None:
            content = self._file.read(min(count, self._left))
            self._left -= len(content)
            return content
        found = b""
        while len(found) < count and not self._inflate.eof:
            waiting = self._inflate.unconsumed_tail
            if not waiting:
                waiting = self._file.read(min(_PIECE, self._left))
                self._left -= len(waiting)
            if not waiting:
                break
            found += self._inflate.decompress(waiting, count - len(found))
        return found

    def skip(self, count: int) -> bool:
        """Whether so many bytes were there."""
        while count > 0:
            gone = len(self.read(min(count, _PIECE)))
            if gone == 0:
                return False
            count -= gone
        return True


def expanded_size(path: Path, limit: int) -> int:
    """Bytes that the arrays of a file of version 5 to 7 take, numbers as floats of 64 bits.

    Arrays are not made; counting ends above the limit. Zero for a file of another version.
    """
    with path.open("rb") as file:
        head = file.read(128)
        order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
        total = 0
        while order and total <= limit and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            after = file.tell() + size
            total += _array_bytes(
                _CountedBytes(file, size, kind == _COMPRESSED), order, limit - total
            )
            file.seek(after)
    return total


def _array_bytes(source: _CountedBytes, order: str, limit: int) -> int:
    """Bytes of the arrays in one part of a file: every tag is one of a matrix or of numbers."""
    total = 0
    try:
        while total <= limit and len(tag := source.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind == _MATRIX:
                total += _OF_AN_ARRAY
                continue
            if kind >> 16:  # up to four bytes stand within the tag
                kind, size = kind & 0xFFFF, 0
            total += size * 8 // _BYTES.get(kind, 1)
            if not source.skip(-(-size // 8) * 8):
                break
    except zlib.error:  # SciPy says what is wrong with it
        pass
    return total


def _gather(topic: str, name: str, value: Any, groups: dict[str, tuple[dict, dict]]) -> None:
    """Puts a variable, and what stands in it, into the groups of their structures."""
    inner = f"{topic}.{name}" if topic else name
    if isinstance(value, dict):
        for field, item in value.items():
            _gather(inner, str(field), item, groups)
        return
    arrays, unread = groups.setdefault(topic, ({}, {}))
    array = np.asarray(value) if not isinstance(value, list) else np.array(value, dtype=object)
    called, kind = _object_name(array)
    if kind:
        unread[called or name] = (
            f"{_OBJECT} {kind}, which this does not read; save its numbers, of a timeseries ts: "
            "t = ts.Time; y = ts.Data; save('run.mat', 't', 'y', '-v7')"
        )
    elif array.dtype == object:
        for index, item in enumerate(array.ravel()[:LONGEST_ARRAY]):
            if isinstance(item, dict):
                _gather(inner, str(index), item, groups)
        unread[name] = "is no numeric array; timeseries, tables and cells are not read"
    elif array.dtype.kind in "biuf" and array.size > 1 and array.ndim <= 2:
        arrays[name] = array.astype(float)
    else:
        unread[name] = "is no series of numbers"


def _read(path: Path) -> dict[str, tuple[dict, dict]]:
    """Numeric arrays, and why what else there is is not read, by structure."""
    from scipy import io

    groups: dict[str, tuple[dict, dict]] = {}
    for name, value in io.loadmat(path, simplify_cells=True).items():
        if not str(name).startswith("__"):
            _gather("", str(name), value, groups)
    kinds = [kind for _, unread in groups.values() for kind in unread.values() if _OBJECT in kind]
    if kinds and not any(arrays for arrays, _ in groups.values()):
        raise ValueError(f"a variable {kinds[0]}")
    return groups


def _object_name(array: np.ndarray) -> tuple[str, str]:
    """The name of a variable that is an object of a MATLAB class, and the class; else empty."""
    if array.dtype.names is None or not {"s0", "s2"} <= set(array.dtype.names) or not array.size:
        return "", ""
    name, kind = (array.ravel()[0][field] for field in ("s0", "s2"))
    as_text = lambda text: text.decode(errors="replace") if isinstance(text, bytes) else str(text)
    return as_text(name), as_text(kind)


def main(path: Path, limit: int) -> int:
    """Write what a file holds to standard output, and return the exit status."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_SPARE + 4 * limit, _SPARE + 4 * limit))
    except ImportError:  # not on Windows
        pass
    size = expanded_size(path, limit)
    if size > limit:
        print(size, file=sys.stderr)
        return TOO_LARGE
    try:
        groups = _read(path)
    except MemoryError:
        print("it asks for more memory than it may have", file=sys.stderr)
        return UNREADABLE
    except Exception as error:  # SciPy raises many kinds for a broken file
        print(str(error).strip() or type(error).__name__, file=sys.stderr)
        return UNREADABLE
    index = [[topic, list(arrays), unread] for topic, (arrays, unread) in groups.items()]
    sys.stdout.buffer.write(json.dumps(index).encode() + b"\n")
    for arrays, _ in groups.values():
        for array in arrays.values():
            np.lib.format.write_array(sys.stdout.buffer, array, allow_pickle=False)
    sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
