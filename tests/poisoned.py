"""What workers of a cluster do in tests: parts and boats that fail, die, or take their time.

A module of its own, which workers import by its name.
"""

import os
import pathlib
import signal
import time

from diffsea.studies.parts import PartRunner
from diffsea.workflows import boat_processes


ATTEMPTS = "DIFFSEA_TEST_ATTEMPTS"  # folder in which workers note what they begin


def attempt(name):
    """Note that a task is begun; returns how often it was before."""
    folder = pathlib.Path(os.environ[ATTEMPTS])
    before = sum(one.name.startswith(f"{name}-") for one in folder.iterdir())
    (folder / f"{name}-{before}").touch()
    return before


def die():
    os.kill(os.getpid(), signal.SIGKILL)


class Watched(PartRunner):
    """Runs parts on a worker, and notes each that it begins."""

    def __call__(self, number, *args):
        self.before(number, attempt(number))
        return super().__call__(number, *args)

    def before(self, number, attempts):
        """What happens to a part that was begun so often."""


class DyingOnce(Watched):
    def before(self, number, attempts):
        if number == 1 and not attempts:
            die()


class Poisoned(Watched):
    def before(self, number, attempts):
        if number == 1:
            raise ValueError("a design from hell")
        if number == 2:
            die()


class Slow(Watched):
    def before(self, number, attempts):
        time.sleep(2.0)


def poisoned_boat(folder, task):
    """One boat raises, one kills its workers, one does so only at first."""
    before = attempt(task["boat"])
    if task["boat"] == "raises":
        raise ValueError("a log from hell")
    if task["boat"] == "kills" or (task["boat"] == "one" and not before):
        die()
    ((_, result),) = boat_processes.done_in_processes([task], 1)
    return result
