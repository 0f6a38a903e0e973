"""An experiment's quick run, and its modules, for the tests of it."""

import contextlib
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from tests.paths import EXPERIMENTS


def quick_run(name: str, folder: Path) -> dict:
    """results.json of the quick variant, which is run into a folder."""
    command = [sys.executable, str(EXPERIMENTS / name / "run.py"), "--quick", "-o", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads((folder / "results.json").read_text())


@contextlib.contextmanager
def modules(name: str, *names: str) -> Iterator[dict[str, ModuleType]]:
    """Modules of an experiment by name; gone again afterwards, as others have the same names."""
    _forget()
    sys.path[:0] = [str(EXPERIMENTS / name), str(EXPERIMENTS)]
    try:
        yield {one: importlib.import_module(one) for one in names}
    finally:
        del sys.path[:2]
        _forget()


def _forget() -> None:
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if file and Path(file).is_relative_to(EXPERIMENTS) and not name.startswith("experiments"):
            del sys.modules[name]
