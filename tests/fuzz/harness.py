"""Hostile inputs put to the warm process, and what counts as a breach."""

import json
import pathlib
import re
import subprocess
import sys

from tests.fuzz.seeds import SUFFIXES
from tests.fuzz.server import MEGABYTES


_ACTING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class Harness:
    """The warm process, asked for one input after the other."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert json.loads(self._answer()) == "ready"
        self.tried = 0

    def _answer(self):
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def ended(self, kind, content, suffix=None, command="metrics"):
        """How a command that reads these bytes as a file of a kind ended."""
        self.tried += 1
        file = self.folder / f"input{suffix or SUFFIXES[kind]}"
        file.write_bytes(content)
        asked = {"kind": kind, "command": command, "file": str(file)}
        asked["out"] = str(self.folder / "out")
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        return json.loads(self._answer())

    def close(self):
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def breach(ended):
    """What is wrong with how an input ended; empty where nothing is."""
    if ended["status"] == -14:
        return "takes longer than 20 s"
    if ended["status"] not in (0, 1, 2):
        return f"ended with {ended['status']}"
    for words in ("this is a bug", "Traceback"):
        if words in ended["said"]:
            return f"said {words!r}"
    if ended["megabytes"] > MEGABYTES:
        return f"took {ended['megabytes']:.0f} MB"
    if ended["left"]:
        return f"left {ended['left']}"
    if ended["status"] != 0 and "error: " not in ended["said"]:
        return "failed without a message"
    if _ACTING.search(ended["said"]):
        return "printed a control character"
    return ""
