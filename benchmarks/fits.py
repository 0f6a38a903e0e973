"""A fit of eight derivatives to six recordings, warm and cold, beside CasADi with IPOPT."""

import os
import tempfile
from pathlib import Path

from benchmarks.record import Figure
from experiments.fit_benchmark.data import make
from experiments.fit_benchmark.run import asked


OURS = {"fit": "diffsea free run", "innovations": "diffsea innovations"}
PEER = "casadi ipopt"
PROCESSES = 2


def measure() -> list[Figure]:
    """Processor seconds; cold is a new process without a cache of compiled programs."""
    seconds = {name: {"cold": [], "warm": []} for name in (*OURS, "peer")}
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "still.npz"
        make(recordings, 1)
        for _ in range(PROCESSES):
            for name, contestant in {**OURS, "peer": PEER}.items():
                told = asked(contestant, recordings, warm=1)
                assert told is not None, f"{contestant} failed"
                for kind, samples in seconds[name].items():
                    samples.append(told[kind])
    return [
        Figure(f"{name}-{kind}", "s", seconds[name][kind], seconds["peer"][kind], PEER)
        for name in OURS
        for kind in ("warm", "cold")
    ]
