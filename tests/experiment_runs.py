"""An experiment's quick run, and its modules, for the tests of it."""

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from tests.paths import ROOT


def quick_run(name: str, folder: Path) -> dict:
    """results.json of the quick variant, which is run into a folder."""
    command = [sys.executable, "-m", f"experiments.{name}.run", "--quick", "-o", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads((folder / "results.json").read_text())


def modules(experiment: str, *names: str) -> dict[str, ModuleType]:
    """Modules of an experiment by name."""
    return {name: importlib.import_module(f"experiments.{experiment}.{name}") for name in names}
