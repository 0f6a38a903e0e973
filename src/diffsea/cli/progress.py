"""The progress of a long command on standard error, so that results alone go to standard output."""

import sys
import time
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from diffsea.identification.estimates import PartialProgress
from diffsea.outside.printable import printable


class StagedProgress:
    """A bar over the stages of an analysis, or a line for each where nobody watches.

        with StagedProgress(3) as tell:
            tell("fitting the nominal model")
            tell(PartialProgress("round 1", 0.5))

    A message begins the next stage, one that is a `PartialProgress` tells the share that is done
    of a stage. On a terminal one line is drawn over and over and taken away at the end; in a file
    or a pipe a stage is a line of its own, without escape codes, when it begins.
    """

    def __init__(self, total: int, stream: TextIO | None = None):
        """
        Arguments:
            total: how many stages there will be; more do not harm, the bar then waits at its end.
            stream: where to write; standard error if None.
        """
        self.total = max(total, 1)
        self._stream = sys.stderr if stream is None else stream
        self._live = self._stream.isatty()
        self._began = time.monotonic()
        self._stage, self._number = "", -1
        text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
        console = Console(file=self._stream, force_terminal=self._live, highlight=False)
        columns = (BarColumn(24), TaskProgressColumn(), TimeElapsedColumn(), text)
        self._bar = Progress(
            *columns,
            console=console,
            transient=True,
            disable=not self._live,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._task = self._bar.add_task("", total=self.total)

    def __enter__(self) -> "StagedProgress":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    @property
    def share(self) -> float:
        """What is done of the whole work, 0 to 1; it never falls."""
        return self._bar.tasks[0].completed / self.total

    def __call__(self, message: str) -> None:
        """Say what is being done."""
        share, stage = 0.0, printable(message)
        if isinstance(message, PartialProgress):
            share, stage = (
                min(max(message.share, 0.0), 1.0),
                printable(message.stage) or self._stage,
            )
        if stage != self._stage:
            self._stage, self._number = stage, min(self._number + 1, self.total - 1)
            if not self._live:
                seconds = time.monotonic() - self._began
                print(f"[{seconds:5.0f} s] {stage}", file=self._stream, flush=True)
        done = max(self._bar.tasks[0].completed, self._number + share)
        self._bar.update(self._task, completed=done, description=stage)
