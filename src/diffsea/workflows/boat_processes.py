"""How boats get done: each by a process of its own, and kept by the hash of what it rests on."""

import contextlib
import hashlib
import importlib.metadata
import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from diffsea.errors import UserError
from diffsea.outside.durable import working_folder, written_beside
from diffsea.vessel.files import shipped_vessels


POLL = 0.2  # s, between looks at the processes
CANNOT_WRITE = "cannot write"  # how a process ends that found no room for its result


def part_key(task: dict[str, Any]) -> str:
    """The hash of what a boat's files hold, of their names and roles, the settings and the version.

    Where the files lie does not count.
    """

    def inside(path: str | None) -> str:
        return "" if path is None else _content_hash(pathlib.Path(path))

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


def _content_hash(path: pathlib.Path) -> str:
    """Of a file, or of all files of a folder; empty where nothing can be read."""
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        inside = sorted(one for one in path.rglob("*") if one.is_file())
        parts = [f"{one.relative_to(path)}\0{_content_hash(one)}\n" for one in inside]
        return hashlib.sha256("".join(parts).encode()).hexdigest()
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
    waiting = list(enumerate(tasks))
    running: dict[int, subprocess.Popen[bytes]] = {}
    with working_folder() as folder:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    number, task = waiting.pop(0)
                    running[number] = _started(folder, number, task)
                ended = [
                    number for number, process in running.items() if process.poll() is not None
                ]
                for number in ended:
                    yield tasks[number], _result_of(folder, number, tasks[number])
                    del running[number]
                if not ended:
                    time.sleep(POLL)
        finally:
            for process in running.values():
                with contextlib.suppress(OSError):
                    process.terminate()
                process.wait()


def _started(folder: pathlib.Path, number: int, task: dict[str, Any]) -> "subprocess.Popen[bytes]":
    """The process of one boat; what it says goes into a file."""
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
        return subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log)


def _result_of(folder: pathlib.Path, number: int, task: dict[str, Any]) -> dict[str, Any]:
    """What the process of a boat left; of one that broke down, its last words."""
    with contextlib.suppress(FileNotFoundError, ValueError):
        return json.loads((folder / f"{number}.json").read_text(encoding="utf-8"))
    said = (folder / f"{number}.log").read_text(encoding="utf-8", errors="replace").splitlines()
    last = next((line for line in reversed(said) if line.strip()), "it said nothing")
    reason = last.strip()
    if not reason.startswith(CANNOT_WRITE):
        reason = f"its process broke down, which is a bug or a lack of memory: {reason}"
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
