"""Writing for good: after a power cut a file is the old one or the new one, whole.

Written beside its destination, flushed to the disk, renamed, and the folder flushed: a rename
alone may reach the disk before the content does. Calls that a signal interrupts are made again.
"""

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import ParamSpec, TypeVar

from diffsea.outside.unfinished import unfinished_folder


P = ParamSpec("P")
R = TypeVar("R")


@contextlib.contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A file to write beside `path`; it takes its place at the end, or is gone after an error.

    Raises:
        OSError: it cannot be written; names `path` or its folder.
    """
    with unfinished_folder(path.parent) as folder, errors_placed({folder: path.parent}, path):
        yield folder / path.name
        replace_for_good([(folder / path.name, path)])


@contextlib.contextmanager
def working_folder() -> Iterator[Path]:
    """A folder among the system's temporary ones, which errors of its files name.

    Raises:
        OSError: it cannot be made.
    """
    with unfinished_folder(Path(tempfile.gettempdir())) as folder, errors_placed({}, folder):
        yield folder


@contextlib.contextmanager
def errors_placed(places: Mapping[Path, Path], otherwise: Path) -> Iterator[None]:
    """Errors of unfinished files name the files that they were to become.

    Arguments:
        places: of unfinished folders, where their files are to go.
        otherwise: what an error names that names nothing, as a write's does.

    Raises:
        OSError: instead of the one raised within.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        written = error.filename2 or error.filename  # of a copy or a move, where it goes
        name = None if written is None else Path(os.fsdecode(written))
        for folder, place in places.items():
            if name is not None and name.is_relative_to(folder):
                name = place / name.relative_to(folder)
        if name is not None and str(name) == os.fsdecode(error.filename):
            raise
        told = error.strerror or str(error)
        raise OSError(error.errno or errno.EIO, told, str(name or otherwise)) from error


def replace_for_good(files: Sequence[tuple[Path, Path]]) -> None:
    """Put finished files in the places of others: all of them, or none where one cannot be.

    Arguments:
        files: where each is, in a folder that will be removed, and on the same file system where
            it shall be. What was there is kept beside the first until all have succeeded.

    Raises:
        OSError: one cannot take its place; everything is then as it was.
    """
    for source, _ in files:
        flush(source)
    with contextlib.ExitStack() as undo:
        for number, (source, target) in enumerate(files):
            if os.path.lexists(target):
                old = source.parent / f".kept-{number}"
                _keep(target, old)
                undo.callback(os.replace, old, target)
            else:
                undo.callback(target.unlink, missing_ok=True)
            uninterrupted(os.replace, source, target)
        for folder in dict.fromkeys(target.parent for _, target in files):
            flush(folder)
        undo.pop_all()


def _keep(file: Path, old: Path) -> None:
    """Another name for a file; a copy where the file system has one name for each."""
    try:
        os.link(file, old, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(file, old, follow_symlinks=False)


def flush(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk.

    Folders are left alone where the system cannot open them.

    Raises:
        OSError: they do not get there; names the path.
    """
    if path.is_dir() and os.name == "nt":
        return
    handle = uninterrupted(os.open, path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        uninterrupted(os.fsync, handle)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        os.close(handle)


def uninterrupted(call: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """A call of the system, made again for as long as signals interrupt it.

    Python does so itself for most; a rename over a network may end so, too.
    """
    while True:
        try:
            return call(*args, **kwargs)
        except InterruptedError:
            continue
