"""Keeping the truth from the tool: hashes before scoring, and a process that cannot open it."""

import hashlib
import os
import sys
from pathlib import Path


class TruthIsSealed(PermissionError):
    """Raised in a sealed process at any attempt to open or list the truth."""


def seal(folder: Path) -> None:
    """From now on, this process cannot open or list anything in `folder` or below it.

    An audit hook, which Python offers no way to remove. Relative names and links are resolved.
    """
    forbidden = os.path.realpath(folder)

    def hook(event: str, args: tuple) -> None:
        if event not in ("open", "os.listdir", "os.scandir", "os.rename", "os.link", "os.symlink"):
            if event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork"):
                _no_helpers(event, args)
            return
        for path in args[:2]:
            if not isinstance(path, str | bytes | os.PathLike):
                continue
            full = os.path.realpath(os.fsdecode(path))
            if full == forbidden or full.startswith(forbidden + os.sep):
                raise TruthIsSealed(f"the truth is sealed: {full}")

    def _no_helpers(event: str, args: tuple) -> None:
        # A child process would not have the hook. What the tool starts itself (ldconfig for
        # ctypes, git for its version) may run as long as the truth is not among its arguments.
        if forbidden in repr(args):
            raise TruthIsSealed(f"the truth is sealed from {event}")

    sys.addaudithook(hook)


def sha256(path: Path) -> str:
    """Of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def manifest(folder: Path, pattern: str = "**/*") -> dict[str, str]:
    """SHA-256 of every file of the folder by its name relative to it."""
    files = sorted(p for p in folder.glob(pattern) if p.is_file())
    return {str(p.relative_to(folder)): sha256(p) for p in files}


def source_digest(root: Path) -> str:
    """One SHA-256 of all Python files below `root`: what is run, committed or not."""
    total = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        total.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return total.hexdigest()
