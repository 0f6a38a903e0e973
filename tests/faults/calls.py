"""Calls of the system that touch files of some folders: counted, and one of them made to fail.

What Python itself writes goes through here: `open`, `write` and `close` of files, `os.open`,
`os.write`, `os.sendfile`, `os.fsync`, `os.replace`, `os.rename` and `os.mkdir`. A file that is
closed fails as one whose last block finds no room: it is closed, and the error is told.
"""

import builtins
import contextlib
import dataclasses
import io
import os
import pathlib
from unittest import mock


@dataclasses.dataclass(frozen=True)
class Call:
    """A call, and the file that it was for."""

    name: str
    path: pathlib.Path


class Calls:
    """Within it, calls for files of the folders are counted in `made`.

    Arguments:
        folders: whose files count.
        failing: the number of the call that fails, or None.
        error: number of its error.
    """

    def __init__(self, folders, failing=None, error=0):
        self.folders = [os.path.realpath(folder) for folder in folders]
        self.failing, self.error = failing, error
        self.made = []

    @contextlib.contextmanager
    def watched(self):
        """Patches are in place."""
        real_open = io.open

        def opened(file, mode="r", *args, **kwargs):
            self.count("open", file)
            made = real_open(file, mode, *args, **kwargs)
            is_read = not set(mode) & set("wax+")
            return made if is_read or not self.counts(file) else _Written(made, file, self)

        with contextlib.ExitStack() as patches:
            patches.enter_context(mock.patch.object(io, "open", opened))
            patches.enter_context(mock.patch.object(builtins, "open", opened))
            for name in ("open", "write", "sendfile", "fsync", "replace", "rename", "mkdir"):
                counted = self._counting(name, getattr(os, name))
                patches.enter_context(mock.patch.object(os, name, counted))
            yield self

    def _counting(self, name, real):
        def counted(first, *args, **kwargs):
            self.count(name, first)
            return real(first, *args, **kwargs)

        return counted

    def counts(self, file):
        """Whether a file, by path or handle, is in one of the folders."""
        path = self._path(file)
        return path is not None and any(
            path == folder or path.startswith(folder + os.sep) for folder in self.folders
        )

    @staticmethod
    def _path(file):
        try:
            name = os.readlink(f"/proc/self/fd/{file}") if isinstance(file, int) else file
            return os.path.abspath(os.fsdecode(name))
        except (OSError, TypeError):
            return None

    def count(self, name, file):
        """A call is made; raises `OSError` where it is the one to fail."""
        if not self.counts(file):
            return
        self.made.append(Call(name, pathlib.Path(self._path(file) or "")))
        if len(self.made) - 1 == self.failing:
            named = (str(file),) if not isinstance(file, int) and name != "write" else ()
            raise OSError(self.error, os.strerror(self.error), *named)


class _Written:
    """A file that is written, its writes and its end counted."""

    def __init__(self, file, path, calls):
        self._file, self._path, self._calls = file, path, calls

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __iter__(self):
        return iter(self._file)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()

    def write(self, data):
        self._calls.count("write", _as_handle(self._file))
        return self._file.write(data)

    def close(self):
        handle = None if self._file.closed else _as_handle(self._file)
        if handle is not None:
            named = self._calls._path(handle)
            self._file.close()
            self._calls.count("write", _Nameless(named))


def _as_handle(file):
    return file.fileno()


class _Nameless(os.PathLike):
    """The path of a call whose error does not name it."""

    def __init__(self, path):
        self._path = path

    def __fspath__(self):
        return self._path
