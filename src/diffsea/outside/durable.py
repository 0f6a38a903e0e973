"""Writing for good: after a power cut a file is the old one or the new one, whole.

Beside its destination, flushed to the disk, renamed, and the folder flushed: a rename alone may
reach the disk before the content does.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A file to write beside `path`; it takes its place at the end, or is gone after an error.

    Raises:
        OSError: the folder cannot be written.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".unfinished-", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~_umask())  # mkstemp makes files that only their owner can read
        replace_for_good(Path(name), path)
    finally:
        Path(name).unlink(missing_ok=True)


def replace_for_good(source: Path, target: Path) -> None:
    """Put a finished file of the same file system in the place of another.

    Raises:
        OSError: it cannot be.
    """
    flush(source)
    os.replace(source, target)
    flush(target.parent)


def move_for_good(source: Path, target: Path) -> None:
    """Put a finished file in the place of another, on whatever file system.

    Raises:
        OSError: it cannot be.
    """
    with written_beside(target) as beside:
        shutil.copyfile(source, beside)
    source.unlink()


def flush(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk.

    Folders are left alone where the system cannot open them.
    """
    if path.is_dir() and os.name == "nt":
        return
    handle = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
