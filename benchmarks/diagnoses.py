"""The diagnosis of six runs, 13 minutes at 10 Hz, by the whole catalogue, on every core."""

import json
import os
import subprocess
import sys

from benchmarks.record import Figure
from experiments.diagnosis_benchmark import run


def measure() -> list[Figure]:
    """Seconds without a cache of compiled programs, and again in the same process."""
    environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    command = [sys.executable, "-m", "experiments.diagnosis_benchmark.run"]
    subprocess.run(command, check=True, cwd=run.ROOT, env=environment)
    told = json.loads((run.OUT / "results.json").read_text(encoding="utf-8"))
    return [
        Figure(f"diagnosis-{kind}", "s", [own["seconds"]], more={"stages": own["stages"]})
        for kind, own in ((kind, told[kind]) for kind in ("warm", "cold"))
    ]
