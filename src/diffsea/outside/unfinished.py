"""Folders for what is not finished: gone when it is, and cleared away after a kill.

A process holds a lock on the folder that it works in, which ends with the process however that
ends. A folder that is unlocked belongs to nobody and goes when the next one is made beside it.
"""

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path


try:
    import fcntl
except ImportError:  # Windows: nothing is locked, and nothing cleared away
    fcntl = None

PREFIX = ".unfinished-"
YOUNG = 1.0  # s, within which a new folder may not be locked yet


@contextlib.contextmanager
def unfinished_folder(parent: Path) -> Iterator[Path]:
    """A folder in `parent` to write in, which is gone at the end.

    Raises:
        OSError: it cannot be made; names `parent`.
    """
    clear_abandoned(parent)
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(parent)) from error
    try:
        with contextlib.ExitStack() as held:
            lock = _locked(folder)
            if lock is not None:
                held.callback(os.close, lock)
            yield folder
    finally:
        _remove(folder)


def clear_abandoned(parent: Path) -> None:
    """Remove what processes that were killed have left in a folder."""
    if fcntl is None:
        return
    for folder in parent.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # gone meanwhile, or not to be removed by us
            lock = _locked(folder)
            age = time.time() - folder.stat().st_ctime
            if lock is not None and 0 <= age < YOUNG:
                os.close(lock)
                time.sleep(YOUNG - age)
                lock = _locked(folder)
            if lock is not None:
                os.close(lock)
                _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a folder as far as that is possible: what fails may succeed when it is tried again."""
    for _ in range(2):
        shutil.rmtree(folder, ignore_errors=True)


def _locked(folder: Path) -> int | None:
    """A handle that locks a folder until it is closed; None where another process has it."""
    if fcntl is None:
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # another's, or a file system without locks
        os.close(handle)
        return None
    return handle
