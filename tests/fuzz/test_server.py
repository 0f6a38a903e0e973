"""The children that read hostile inputs: what one input does is not put down to the next."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile


def _does(kind, command, file, out):
    if kind == "ends":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif kind == "hangs":
        signal.pause()
    elif kind == "raises":
        raise KeyError(kind)
    elif kind == "grows":
        return len(bytearray(300_000_000)) % 2
    elif kind == "writes":
        out.mkdir()
        (out / "half").touch()
        return 1
    print(kind)
    return 0


def _main(kinds):
    from tests.fuzz import server

    server._run, server.SECONDS, server.INPUTS_OF_A_CHILD = _does, 3.0, 3
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryDirectory() as folder:
        reader = server.Reader(printed)
        for kind in kinds:
            found = reader.judge(
                kind, "metrics", pathlib.Path(folder), pathlib.Path(folder) / "out"
            )
            print(json.dumps(found))
        reader.close()


def _ended(*kinds):
    """How inputs ended one after the other, in a process that forks without threads."""
    command = [sys.executable, "-m", "tests.fuzz.test_server", *kinds]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_an_input_that_ends_the_child_is_told_and_the_next_is_read():
    ended = _ended("one", "ends", "two", "hangs", "raises", "three", "four", "five", "six")
    assert [one["status"] for one in ended] == [0, -11, 0, -14, 99, 0, 0, 0, 0]
    said = [one["said"].strip() for one in ended]
    assert said == ["one", "", "two", "", "", "three", "four", "five", "six"]


def test_memory_and_files_are_of_the_input_that_took_them():
    before, grown, after, wrote, last = _ended("one", "grows", "two", "writes", "three")
    assert grown["megabytes"] > 300 + 0.9 * before["megabytes"]
    assert after["megabytes"] < before["megabytes"] + 50
    assert wrote["left"] == ["half"] and last["left"] == []


if __name__ == "__main__":
    _main(sys.argv[1:])
