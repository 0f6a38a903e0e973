"""A line on a terminal that is drawn over and over: a bar, the time left, what is being done."""

import bisect
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple, TextIO

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
)
from rich.table import Column
from rich.text import Text


class Standing(NamedTuple):
    """What the bar shows."""

    share: float  # of the whole work, 0 to 1
    seconds_left: float  # NaN where nothing tells
    words: str


class Bar(Progress):
    """A bar that asks where the work stands whenever it is drawn; taken away when it is stopped."""

    def __init__(self, standing: Callable[[], Standing], stream: TextIO):
        self._standing = standing
        text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
        super().__init__(
            *(BarColumn(24), TaskProgressColumn(), _TimeLeft(), text),
            console=Console(file=stream, force_terminal=True, highlight=False),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self.add_task("", total=1.0, left=math.nan)

    def get_renderables(self) -> Iterable[RenderableType]:
        """What is drawn, of now."""
        for task in self.tasks:
            share, left, words = self._standing()
            task.completed, task.description, task.fields["left"] = share, words, left
        yield from super().get_renderables()

    def line(self, message: str) -> None:
        """A line above the bar, which stays."""
        self.console.print(message, markup=False, soft_wrap=True)


class _TimeLeft(ProgressColumn):
    """The time left, in words."""

    def render(self, task: Task) -> Text:
        return Text(time_left(task.fields["left"]), no_wrap=True)


# Seconds as a person says them: up to so many, in steps of so many.
_STEPS = ((60.0, 10.0), (600.0, 60.0), (math.inf, 300.0))


def time_left(seconds: float) -> str:
    """The time left as a person says it; nothing where it is not known."""
    if math.isnan(seconds):
        return ""
    if seconds < 10:
        return "a few s left"
    step = _STEPS[bisect.bisect([most for most, _ in _STEPS], seconds)][1]
    rounded = step * math.ceil(seconds / step)
    return f"{rounded:.0f} s left" if rounded < 60 else f"{rounded / 60:.0f} min left"
