"""Clusters for tests: a Dask scheduler and its workers, each a process on this machine."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.paths import ROOT


# Not of this process: workers set up JAX themselves.
SET_UP_HERE = ("XLA_FLAGS", "JAX_ENABLE_X64", "JAX_COMPILATION_CACHE_DIR")
ANY_PORT = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")


class LocalProcesses:
    """A scheduler, and workers of one thread each; all end with the block."""

    def __init__(self, folder: Path, environment: Mapping[str, str] | None = None):
        """
        Arguments:
            folder: for what they say and leave.
            environment: what they have beside that of this process.
        """
        self.folder = folder
        mine = {name: value for name, value in os.environ.items() if name not in SET_UP_HERE}
        self.environment = mine | {"PYTHONPATH": _paths()} | dict(environment or {})
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> "LocalProcesses":
        file = self.folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(file))
        end = time.monotonic() + 30.0
        while not (file.exists() and file.read_text()):
            assert time.monotonic() < end, self.logs()
            time.sleep(0.05)
        self.address: str = json.loads(file.read_text())["address"]
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._processes):
            process.terminate()
        for process in self._processes:
            try:
                process.wait(2)
            except subprocess.TimeoutExpired:
                kill(process)

    def start(self, words: Sequence[str], paths: Sequence[Path] = ()) -> "subprocess.Popen[bytes]":
        """Start a process in the environment of all.

        Arguments:
            paths: where it looks for packages first.
        """
        with self._log(len(self._processes)).open("wb") as log:
            environment = self.environment | {"PYTHONPATH": _paths(*paths)}
            process = subprocess.Popen(
                words, stdout=log, stderr=log, env=environment, cwd=self.folder
            )
        self._processes.append(process)
        return process

    def _start(self, *words: str, paths: Sequence[Path] = ()) -> "subprocess.Popen[bytes]":
        return self.start([sys.executable, "-m", "dask", *words, *ANY_PORT], paths)

    def _log(self, number: int) -> Path:
        return self.folder / f"{number}.log"

    def said(self, process: "subprocess.Popen[bytes]") -> str:
        """What a process has said."""
        return self._log(self._processes.index(process)).read_text()

    def worker(
        self, nanny: str = "--no-nanny", paths: Sequence[Path] = ()
    ) -> "subprocess.Popen[bytes]":
        """Start a worker.

        Arguments:
            nanny: `--nanny`: it is started again when it dies.
            paths: where it looks for packages first.
        """
        folder = self.folder / f"worker-{len(self._processes)}"
        own = ("--nthreads", "1", "--local-directory", str(folder))
        return self._start("worker", self.address, *own, nanny, paths=paths)

    def await_workers(self, count: int) -> None:
        """Wait until there are so many."""
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=30)

    def logs(self) -> str:
        """What all have said."""
        return "".join(map(self.said, self._processes))


def _paths(*first: Path) -> str:
    return os.pathsep.join(map(str, (*first, ROOT / "src", ROOT)))


def kill(process: "subprocess.Popen[bytes]") -> None:
    """End a process as a lack of memory does."""
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGKILL)
    process.wait()
