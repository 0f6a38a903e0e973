"""How boats get done: each by a process of its own, and kept by the hash of what it rests on.

On a cluster a worker starts the process, in the folder of the one who asks where it has that.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
import pathlib
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from diffsea.errors import UserError
from diffsea.outside.cluster import RETRIES, Failed, Workers
from diffsea.outside.digests import content_digest
from diffsea.outside.durable import working_folder, written_beside
from diffsea.vessel.files import shipped_vessels


POLL = 0.2  # s, between looks at the processes
CANNOT_WRITE = "cannot write"  # how a process ends that found no room for its result


def part_key(task: dict[str, Any]) -> str:
    """The hash of what a boat's files hold, of their names and roles, the settings and the version.

    Where the files lie does not count.
    """

    def inside(path: str | None) -> str:
        return "" if path is None else _digest(pathlib.Path(path))

    vessel = shipped_vessels().get(task["vessel"], task["vessel"])
    content = {
        "boat": task["boat"],
        "settings": task["settings"],
        "version": importlib.metadata.version("diffsea"),
        "vessel": inside(str(vessel)),
        "recordings": [
            (one["name"], one["role"], inside(one["recording"]), inside(one["mapping"]))
            for one in task["recordings"]
        ],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _digest(path: pathlib.Path) -> str:
    """Of what can be read; else empty."""
    try:
        return content_digest(path)
    except OSError:
        return ""


def kept_part(folder: pathlib.Path, task: dict[str, Any]) -> dict[str, Any] | None:
    """What was found of a boat before; None where it was not, or was only half written."""
    try:
        part = json.loads((folder / f"{part_key(task)}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    rows = zip(part["recordings"], task["recordings"], strict=True)
    return part | {"vessel": task["vessel"], "recordings": [row | now for row, now in rows]}


def keep_part(folder: pathlib.Path, task: dict[str, Any], result: dict[str, Any]) -> None:
    """Write a part, the whole of it or nothing.

    Raises:
        UserError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with written_beside(folder / f"{part_key(task)}.json") as part:
            part.write_text(json.dumps(result), encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write into {folder}: {error.strerror}") from None


def done_in_processes(
    tasks: Sequence[dict[str, Any]], jobs: int
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Each task with its result, as they come; so many processes at once."""
    for task, result in _ended(tasks, jobs):
        yield task, _failed_boat(task, result.reason) if isinstance(result, Failed) else result


def done_on_cluster(
    tasks: Sequence[dict[str, Any]], workers: Workers
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Each task with its result, as they come; each by a process that a worker starts.

    Raises:
        UserError: the cluster cannot be used any more.
    """
    here = functools.partial(_done_by_worker, os.getcwd())
    for task, result in workers.results(here, tasks):
        if isinstance(result, Failed):
            told = f"on the cluster, tried {RETRIES + 1} times or more: {result.reason}"
            result = _failed_boat(task, told)
        yield task, result


def _done_by_worker(folder: str, task: dict[str, Any]) -> dict[str, Any]:
    """What is found of a boat, in a folder so that its paths lead where they do for who asks.

    Raises:
        UserError: the boat's process broke down; another worker may have more memory.
    """
    ((_, result),) = _ended([task], 1, folder if os.path.isdir(folder) else None)
    if isinstance(result, Failed):
        raise UserError(result.reason)
    return result


def _ended(
    tasks: Sequence[dict[str, Any]], jobs: int, where: str | None = None
) -> Iterator[tuple[dict[str, Any], dict[str, Any] | Failed]]:
    """Each task with what its process left, as they end; so many at once, in a folder."""
    waiting = list(enumerate(tasks))
    running: dict[int, subprocess.Popen[bytes]] = {}
    with working_folder() as folder:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    number, task = waiting.pop(0)
                    running[number] = _started(folder, number, task, where)
                ended = [
                    number for number, process in running.items() if process.poll() is not None
                ]
                for number in ended:
                    yield tasks[number], _result_of(folder, number)
                    del running[number]
                if not ended:
                    time.sleep(POLL)
        finally:
            for process in running.values():
                with contextlib.suppress(OSError):
                    process.terminate()
                process.wait()


def _started(
    folder: pathlib.Path, number: int, task: dict[str, Any], where: str | None
) -> "subprocess.Popen[bytes]":
    """The process of one boat, in the folder `where`; what it says goes into a file."""
    job = folder / f"{number}.job"
    job.write_text(json.dumps(task), encoding="utf-8")
    words = [
        sys.executable,
        "-m",
        "diffsea.workflows.boat",
        str(job),
        str(folder / f"{number}.json"),
    ]
    with (folder / f"{number}.log").open("wb") as log:
        return subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=where)


def _result_of(folder: pathlib.Path, number: int) -> dict[str, Any] | Failed:
    """What the process of a boat left; of one that broke down, its last words."""
    with contextlib.suppress(FileNotFoundError, ValueError):
        return json.loads((folder / f"{number}.json").read_text(encoding="utf-8"))
    said = (folder / f"{number}.log").read_text(encoding="utf-8", errors="replace").splitlines()
    last = next((line for line in reversed(said) if line.strip()), "it said nothing")
    reason = last.strip()
    if not reason.startswith(CANNOT_WRITE):
        reason = f"its process broke down, which is a bug or a lack of memory: {reason}"
    return Failed(reason)


def _failed_boat(task: dict[str, Any], reason: str) -> dict[str, Any]:
    """The result of a boat that could not be done."""
    rows = [
        one | {"status": "failed", "reason": reason, "samples": 0, "seconds": 0.0, "audit": []}
        for one in task["recordings"]
    ]
    return {
        "boat": task["boat"],
        "vessel": task["vessel"],
        "recordings": rows,
        "status": "failed",
        "reason": reason,
    }
