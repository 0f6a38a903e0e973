"""A command with each of its calls of the system failing once, and what is wrong with its end."""

import errno
import os
import pathlib
import shutil

from tests.faults.calls import Calls
from tests.faults.commands import commands, contents, ended, temporary_files

import diffsea


ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)
PACKAGE = pathlib.Path(diffsea.__file__).parent
OLD = b"old"


class Trial:
    """One command in a folder with results of an earlier run, and what it does undisturbed."""

    def __init__(self, name, inputs, folder):
        """
        Arguments:
            inputs: folder of `write_inputs`.
            folder: in which the command may write; emptied before each run.
        """
        self.inputs, self.folder = inputs, folder
        self.out, self.temporary = folder / "out", folder / "tmp"
        self.words = commands(inputs, self.out)[name]
        self.written = []
        self._clear()
        status, said = self._run(Calls(self._watched))
        assert status == 0, said
        self.written = [path for path, content in self._contents().items() if content is not None]
        calls = Calls(self._watched)  # now over the old results
        self._prepare()
        status, said = self._run(calls)
        assert status == 0, said
        self.calls = calls.made

    def chosen(self):
        """Numbers of the calls of which each is the last of its kind: by name, folder, suffix."""
        kinds = {}
        for number, call in enumerate(self.calls):
            folder = call.path.parent.name.split("-")[0]
            kinds[call.name, folder, call.path.suffix] = number
        return sorted(kinds.values())

    @property
    def _watched(self):
        return [self.inputs, self.folder, PACKAGE / "vessel", PACKAGE / "report"]

    def _contents(self):
        return contents(self.out, self.inputs / "next", *self._kept())

    def _kept(self):
        return [path for path in self.folder.iterdir() if path not in (self.out, self.temporary)]

    def _clear(self):
        for one in (self.folder, self.inputs / "next"):
            shutil.rmtree(one, ignore_errors=True)
            one.mkdir()
        self.temporary.mkdir()

    def _prepare(self):
        """The folders as an earlier run left them: files of the same names, with something else."""
        self._clear()
        for path in map(pathlib.Path, self.written):
            if "-parts" not in str(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(OLD)

    def _run(self, calls):
        with temporary_files(self.temporary), calls.watched():
            return ended(self.words)

    def breach(self, number, error, fresh=False):
        """What is wrong with how the command ends where a call fails; empty where nothing is.

        Arguments:
            fresh: whether there is no earlier result.
        """
        self._clear() if fresh else self._prepare()
        before = self._contents()
        calls = Calls(self._watched, number, error)
        status, said = self._run(calls)
        after = self._contents()
        if len(calls.made) <= number:
            return ""  # the command has fewer calls, as where an old file is kept
        call = calls.made[number]
        wrong = self._wrong(call, error, status, said, before, after)
        if not wrong:
            return ""
        told = said.strip().splitlines()[-1] if said.strip() else "nothing"
        return f"{call.name} of {call.path}, {errno.errorcode[error]}: {wrong}; said {told}"

    def _wrong(self, call, error, status, said, before, after):
        if "bug" in said or "Traceback" in said:
            return "it is told as a bug"
        # PythonFMU3 leaves its own temporary folder where it fails to read it.
        parts = {path for path in (*after, *contents(self.temporary)) if "unfinished" in path}
        parts |= {p for p in contents(self.temporary) if "pythonfmu_" not in p}
        if parts:
            return f"left {sorted(parts)}"
        if status == 0:  # it did without
            missing = [p for p in self.written if after.get(p, OLD) == OLD and "-parts" not in p]
            return f"ended with 0 and did not write {missing}" if missing else ""
        if status not in (1, 2):
            return f"ended with {status}"
        kept = {path for path in after if "-parts" in path}  # of long work, for the next time
        if {k: v for k, v in after.items() if k not in kept} != before:
            changed = [p for p in {*before, *after} - kept if before.get(p, 0) != after.get(p, 0)]
            return f"ended with {status} and changed {sorted(changed)}"
        *_, message = said.partition("diffsea: error: ")
        if not message or "diffsea: error: " in message:
            return "there is not one message"
        if os.strerror(error) not in message:
            return "the message does not say what failed"
        return "" if self._is_named(call.path, message) else "the message names no path"

    def _is_named(self, path, message):
        """Whether a message names a path, or the folder or file that it was to become."""
        names = [path, *(p for p in path.parents if self.folder in p.parents)]
        names += [one for one in [path.parent.parent] if "unfinished" in path.parent.name]
        names += [one for one in [path.parent] if "unfinished" in path.name]
        return any(str(name) in message for name in names)
