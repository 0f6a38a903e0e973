"""A million designs by the command line: seconds a part, memory, and what more would cost."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.record import Figure


DESIGNS = 1_000_000
PLANNED = 100_000_000
COMMAND = (
    "sweep", "otter", "--manoeuvre", "zigzag", "--angle", "20", "--heading", "20",
    "--thrust", "90", "--sample", str(DESIGNS), "mass=60:160", "N_r=-60:-30", "x_G=0:0.2",
)  # fmt: skip


def measure() -> list[Figure]:
    """One sweep with a cache of its own, as on a machine that has compiled nothing."""
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name), Path(name) / "sweep"
        began = time.time()
        process = subprocess.Popen(
            [sys.executable, "-m", "diffsea", *COMMAND, "-o", str(out)],
            env=os.environ | {"XDG_CACHE_HOME": name},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.time() - began
        if status:
            raise RuntimeError(f"the sweep ended with {os.waitstatus_to_exitcode(status)}")
        parts = sorted(folder.glob("sweep-parts/*/part-*.parquet"), key=lambda p: p.stat().st_mtime)
        ends = [part.stat().st_mtime for part in parts]
        kept = sum(part.stat().st_size for part in parts)
        results = sum(one.stat().st_size for one in out.iterdir())
    apart = [after - before for before, after in zip(ends, ends[1:], strict=False)]
    designs = DESIGNS / len(parts)
    more = {
        "command": " ".join(COMMAND),
        "seconds": seconds,
        "parts": len(parts),
        "megabytes_of_memory": used.ru_maxrss / 1e3,
        "megabytes_of_parts": kept / 1e6,
        "megabytes_of_results": results / 1e6,
        "hours_of_planned": PLANNED / designs * sum(apart) / len(apart) / 3600,
        "gigabytes_of_planned": PLANNED / DESIGNS * (kept + results) / 1e9,
    }
    tenths = len(apart) // 10
    samples = [sum(apart[k * tenths : (k + 1) * tenths]) / tenths for k in range(10)]
    return [Figure("scale", "s a part", samples, more=more)]
