"""The progress of a long command on standard error, so that results alone go to standard output."""

import itertools
import math
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from diffsea.cli import options
from diffsea.cli.progress.compiling import COMPILING
from diffsea.outside.printable import printable
from diffsea.progress import PartialProgress, Remark


if TYPE_CHECKING:
    from diffsea.cli.progress.bar import Bar, Standing

Stages = int | Mapping[str, float]

KNOWN_PACE = 5.0  # s for which the usual seconds are believed before the pace is
SURE_SHARE = 0.05  # of stages of unknown length, from which the time left is told
SILENT_SHARE = 0.9  # of a stage that tells nothing, to which the bar moves with its usual seconds
QUIET = 15.0  # s without a line, after which the next step of a stage is one where no bar is drawn
TOLD_COMPILING = 1.0  # s of it, from which it is told at the end


class StagedProgress:
    """A bar over the stages of an analysis, or a line for each where nobody watches.

        with StagedProgress({"reading": 1, "fitting": 20, "writing": 2}) as tell:
            tell("fitting the vessel")
            tell(PartialProgress("step 1", 0.5))

    A message begins the next stage, one that is a `PartialProgress` tells the share that is done
    of a stage, a `Remark` is a line that stays. On a terminal one line is drawn over and over and
    taken away at the end: the bar, the time left, the stage, and whether a program is being
    compiled. In a file or a pipe a stage is a line of its own, without escape codes, when it
    begins, and so is how far it is now and then. The bar never goes back; the time left follows the
    pace until then.
    """

    def __init__(self, stages: Stages, stream: TextIO | None = None):
        """
        Arguments:
            stages: how many there will be, or the seconds that each usually takes, by how its
                message begins. More do no harm, and any may be left out; one that comes again has
                half of what is left of it.
            stream: where to write; standard error if None.
        """
        self._named = isinstance(stages, Mapping)
        usual = stages if isinstance(stages, Mapping) else dict.fromkeys(range(max(stages, 1)), 1.0)
        self._names, self._usual = tuple(map(str, usual)), tuple(usual.values())
        self._edges = (0.0, *itertools.accumulate(self._usual))
        self._stream = sys.stderr if stream is None else stream
        self._bar: Bar | None = None
        self._began = self._stage_began = self._told_last = time.monotonic()
        self._stage, self._place, self._span = "", -1, (0.0, 1.0)
        self._done = 0.0  # of the usual seconds
        COMPILING.listen()
        self._compiled = COMPILING.programs, COMPILING.seconds

    def __enter__(self) -> "StagedProgress":
        options.LINES.append(self.line)
        if self._stream.isatty():
            from diffsea.cli.progress.bar import Bar

            self._bar = Bar(self.standing, self._stream)
            self._bar.start()
        return self

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        programs = COMPILING.programs - self._compiled[0]
        seconds = COMPILING.seconds - self._compiled[1]
        if kind is None and seconds > TOLD_COMPILING:
            what = "one program" if programs == 1 else f"{programs} programs"
            kept = "kept, so that the next run like this is quicker"
            lost = "no cache can be written to keep them in"
            became = kept if COMPILING.is_kept else lost
            self.line(f"{seconds:.0f} s of this went into compiling {what}: {became}")
        options.LINES.remove(self.line)

    @property
    def share(self) -> float:
        """What is done of the whole work, 0 to 1; it never falls."""
        return self._done / self._edges[-1]

    @property
    def seconds_left(self) -> float:
        """How long it will take from now, s; NaN where nothing tells."""
        elapsed, left = time.monotonic() - self._began, self._edges[-1] - self._done
        if self._named:
            return left * (elapsed + KNOWN_PACE) / (self._done + KNOWN_PACE)
        return left * elapsed / self._done if self.share > SURE_SHARE else math.nan

    def standing(self) -> "Standing":
        """Where the work stands now; a stage that tells nothing moves on with its usual seconds."""
        from diffsea.cli.progress.bar import Standing

        if self._named and self._place >= 0:
            since = (time.monotonic() - self._stage_began) / self._usual[self._place]
            self._reach(SILENT_SHARE * -math.expm1(-since))
        words = f"{self._stage}: compiling" if COMPILING.is_running else self._stage
        return Standing(self.share, self.seconds_left, words)

    def line(self, message: str) -> None:
        """A line that stays, above the bar where there is one."""
        self._told_last = time.monotonic()
        if self._bar is not None:
            self._bar.line(message)
        else:
            print(message, file=self._stream, flush=True)

    def __call__(self, message: str) -> None:
        """Say what is being done."""
        COMPILING.listen()
        if isinstance(message, Remark):
            self.line(printable(message))
            return
        share, stage = 0.0, printable(message)
        if isinstance(message, PartialProgress):
            share = min(max(message.share, 0.0), 1.0)
            stage = printable(message.stage) or self._stage
        if stage != self._stage:
            self._begin(stage)
        elif self._bar is None and time.monotonic() - self._told_last > QUIET:
            self._line_of_time(f"{stage}: {printable(message)}")
        self._reach(share)

    def _begin(self, stage: str) -> None:
        """Go on to a stage: the next one, or that of its name; one of no name is part of its own.

        One that comes again, or after a later one, has half of what is left where the bar stands.
        """
        now = time.monotonic()
        self._stage, self._stage_began = stage, now
        if self._bar is None:
            self._line_of_time(stage)
        following = min(self._place + 1, len(self._usual) - 1)
        if self._named:
            named = (k for k, name in enumerate(self._names) if stage.startswith(name))
            following = max(next(named, 0), self._place, 0)
        start, end = self._span
        is_again = self._named and following == self._place
        self._span = (0.5 * (start + end), end) if is_again else (0.0, 1.0)
        self._place = following

    def _line_of_time(self, told: str) -> None:
        """A line with the time since the beginning."""
        self._told_last = time.monotonic()
        since = self._told_last - self._began
        print(f"[{since:5.0f} s] {told}", file=self._stream, flush=True)

    def _reach(self, share: float) -> None:
        """Move the bar to a share of the stage, never back."""
        start, end = self._span
        first, last = self._edges[self._place : self._place + 2]
        at = first + (start + share * (end - start)) * (last - first)
        self._done = max(self._done, at)
