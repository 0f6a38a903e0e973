"""The README's commands as they stand there: the first time, with nothing compiled, and again.

Seconds of processors, all threads together, which the load of the machine changes least.
"""

import os
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.record import Figure


ROOT = Path(__file__).resolve().parents[1]
BEGINS = ".venv/bin/diffsea "


def commands(readme: str) -> dict[str, str]:
    """The lines of a shell under "The main jobs", by the name of their command."""
    jobs = readme[readme.index("## The main jobs") : readme.index("| also |")]
    lines = jobs.replace("\\\n", " ").splitlines()
    found = (line.strip() for line in lines if line.strip().startswith(BEGINS))
    return {line.split()[1]: line for line in found}


def measure() -> list[Figure]:
    """Every command twice, in a folder of its own with a cache of its own."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        os.symlink(ROOT / "examples", Path(folder) / "examples")
        for name, line in commands((ROOT / "README.md").read_text(encoding="utf-8")).items():
            words = line.replace(BEGINS, f"{shlex.quote(sys.executable)} -m diffsea ", 1)
            cache = Path(folder) / f"cache-{name}"
            cache.mkdir()
            first, again = (processor_seconds(words, Path(folder), cache) for _ in range(2))
            more = {"again": again, "command": " ".join(line.removeprefix(BEGINS).split())}
            figures.append(Figure(f"command-{name}", "s of processors", [first], more=more))
    return figures


def processor_seconds(line: str, folder: Path, cache: Path) -> float:
    """What a line of a shell takes there."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    subprocess.run(line, shell=True, cwd=folder, check=True, capture_output=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
