"""How long a piece of work may take: whoever is about to begin a step asks whether there is time.

The budget is of the work that runs within it, and need not be handed from step to step. What was
not done for want of time is noted in it, so that results can say so.
"""

import contextlib
import contextvars
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar


P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class Budget:
    """A time for some work; see `time_budget`.

    Once it is over no further step is begun; one that was begun is ended.
    """

    def __init__(self, seconds: float = math.inf):
        """So many seconds from now on."""
        self._end = time.monotonic() + seconds
        self._noted: dict[str, None] = {}

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() > self._end

    @property
    def left_out(self) -> tuple[str, ...]:
        """What was not done, each once, in the order in which it was due."""
        return tuple(self._noted)

    def note(self, what: str) -> None:
        """That something was not done."""
        self._noted[what] = None

    def skips(self, what: str) -> bool:
        """Whether the time is over; what was about to be done is then noted as left out."""
        over = self.is_over
        if over:
            self.note(what)
        return over


_current: contextvars.ContextVar[Budget | None] = contextvars.ContextVar("budget", default=None)


def current_budget() -> Budget:
    """The budget of the work that asks; without any, one that never ends."""
    return _current.get() or Budget()


@contextlib.contextmanager
def time_budget(seconds: float) -> Iterator[Budget]:
    """A budget for the work within.

    with time_budget(60.0) as left:
        ...
    left.left_out  # what was not done
    """
    left = Budget(seconds)
    token = _current.set(left)
    try:
        yield left
    finally:
        _current.reset(token)


def in_this_context(function: Callable[P, R]) -> Callable[P, R]:
    """The function with the budget of now and all else that holds for the work that asks.

    For threads, which begin without any.
    """
    context = contextvars.copy_context()

    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        return context.copy().run(function, *args, **kwargs)

    return called


def on_every_core(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """What a function gives of each item, several at a time, in threads that share this context.

    A compiled program runs on one core and lets other threads run meanwhile.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(in_this_context(function), items))


def left_out_sentence(left_out: Sequence[str]) -> str:
    """What was not done, for a person; empty where everything was."""
    if not left_out:
        return ""
    return f"The time was over before everything was done; left out: {', '.join(left_out)}."
