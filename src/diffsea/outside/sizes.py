"""How large a file becomes when it is expanded, known before it is: refused above a limit.

A file of some kilobytes can stand for gigabytes: compressed chunks, repeated pages, arrays that are
stored as small integers. Whoever expands something says here how much it will be, or counts it
while it comes.
"""

import contextlib
import contextvars
from collections.abc import Iterator
from pathlib import Path

from diffsea.errors import UserError


DEFAULT_LIMIT = 1_000_000_000  # bytes
_limit: contextvars.ContextVar[int] = contextvars.ContextVar("limit", default=DEFAULT_LIMIT)


@contextlib.contextmanager
def size_limit(largest: int) -> Iterator[None]:
    """Within it, files may expand to this many bytes."""
    token = _limit.set(largest)
    try:
        yield
    finally:
        _limit.reset(token)


def current_limit() -> int:
    """Bytes to which a file may expand."""
    return _limit.get()


def check_size(path: Path, size: int, what: str = "it") -> None:
    """Raise `UserError` where what a file holds is larger than the limit.

    Arguments:
        size: bytes of `what` when it is expanded.
    """
    limit = current_limit()
    if size > limit:
        raise UserError(
            f"{path}: {what} would take {_in_words(size)} when expanded, more than "
            f"{_in_words(limit)}; --max-size changes the limit, if you trust the file"
        )


class Meter:
    """Counts what is expanded of one file, and raises `UserError` once it is above the limit."""

    def __init__(self, path: Path):
        self.path, self.size = path, 0

    def add(self, size: int) -> None:
        """So many bytes more."""
        self.size += size
        if self.size > current_limit():
            raise UserError(
                f"{self.path}: what it holds takes more than {_in_words(current_limit())} when "
                "expanded; --max-size changes the limit, if you trust the file"
            )


def _in_words(size: int) -> str:
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
