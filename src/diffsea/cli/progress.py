"""The progress of a long command: a bar with the stage's name, on standard error."""

import re
import shutil
import sys
import time
from typing import TextIO


_BAR = 24  # characters
_PAUSE = 0.1  # s between two drawings of the bar
_ROUNDS = 8  # of a fit, at most


class Stages:
    """A bar over several stages, or a line for each where nobody watches.

        stages = Stages(3)
        stages.tell("auditing recordings", 0.0)
        stages.tell("auditing recordings", 0.5)
        stages.tell("fitting the nominal model", 0.0)
        stages.done()

    On a terminal one line is drawn over and over; elsewhere, in a file or a pipe, each stage
    is a line of its own when it begins.
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
        self._stage = ""
        self._number = -1
        self._share = 0.0
        self._drawn = -1.0

    def tell(self, stage: str, share: float = 0.0) -> None:
        """Say what is being done, and which share of it, 0 to 1, is done.

        A name that differs from the last one begins the next stage.
        """
        fresh = stage != self._stage
        if fresh:
            self._stage, self._share = stage, 0.0
            self._number = min(self._number + 1, self.total - 1)
        self._share = max(self._share, min(max(share, 0.0), 1.0))
        now = time.monotonic()
        if not self._live:
            if fresh:
                self._write(f"[{now - self._began:5.0f} s] {stage}\n")
        elif fresh or share >= 1.0 or now - self._drawn >= _PAUSE:
            self._drawn = now
            self._write(f"\r\x1b[K{self._line(now)}")

    def done(self) -> None:
        """Take the bar away, so that what is printed next has the line to itself."""
        if self._live and self._number >= 0:
            self._write("\r\x1b[K")

    def _line(self, now: float) -> str:
        """No wider than the terminal: a line that wraps could not be drawn over."""
        whole = (self._number + self._share) / self.total
        bar = "#" * round(_BAR * whole)
        line = f"[{bar:-<{_BAR}}] {100 * whole:3.0f} % {now - self._began:4.0f} s  {self._stage}"
        return line[: shutil.get_terminal_size().columns - 1]

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class Messages:
    """Progress messages of an analysis as a bar.

    `round 3: ...`, `refitting 2 of 6: ...` and `simulating 2 of 100 data sets` are shares of a
    stage, any other message begins the next one.
    """

    def __init__(self, total: int, stream: TextIO | None = None):
        self._stages = Stages(total, stream)
        self._stage = ""

    def __call__(self, message: str) -> None:
        """Say what is being done."""
        share = 0.0
        if rounds := re.match(r"round (\d+)", message):
            share = int(rounds[1]) / _ROUNDS
        elif counted := re.match(r"(\w+) (\d+) of (\d+)(?:: | ([\w ]+)$)", message):
            self._stage = f"{counted[1]} {counted[3]} {counted[4] or 'hypotheses'}"
            share = (int(counted[2]) - 1) / int(counted[3])
        else:
            self._stage = message
        self._stages.tell(self._stage, share)

    def done(self) -> None:
        """Take the bar away."""
        self._stages.done()
