"""How long a diagnosis takes, cold and warm: time of each stage, and memory.

    python -m experiments.diagnosis_benchmark.run
    python -m experiments.diagnosis_benchmark.run --one-core

Six runs, 13 minutes in all at 10 Hz, the whole catalogue. The first diagnosis of a process
compiles everything (no cache of compiled programs); the second has other noise and uses the
programs of the first. Writes out/diagnosis_benchmark/results.json.
"""

import argparse
import json
import os
import re
import tempfile
import time
from pathlib import Path


ROOT = Path(__file__).resolve().parents[2]
RUNS = ("random-slow", "random-fast", "zigzag-slow", "circle-fast", "speed-steps", "zigzag-fast")
HIDDEN = {"current": {"speed": 0.25, "direction": 2.2}}
OUT = ROOT / "out" / "diagnosis_benchmark"


class Stages:
    """Seconds spent between messages, added up by stage."""

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self._stage, self._since = "start", time.monotonic()

    def __call__(self, message: str) -> None:
        now = time.monotonic()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
        self._since = now
        if re.match(r"fitting, step \d+", message):
            return
        self._stage = re.sub(r" \d+ of \d+: .*|: .*", "", message)


def one(vessel, document: dict, seed: int) -> dict:
    """Time one diagnosis of six fresh runs."""
    from tests.oracle import make_recordings

    from diffsea import read_recording
    from diffsea.diagnosis.experiment import next_experiment
    from diffsea.diagnosis.record import summary
    from diffsea.diagnosis.verdict import diagnose
    from diffsea.recordings import audit

    with tempfile.TemporaryDirectory() as folder:
        make_recordings.produce(
            Path(folder), document, seed, HIDDEN, seconds=130.0, rate=10.0, runs=RUNS
        )
        runs = [read_recording(Path(folder) / f"{name}.csv") for name in RUNS]
    stages, began = Stages(), time.monotonic()
    stages("auditing")
    findings = [found.as_dict() for run in runs for found in audit(run)]
    found = diagnose(vessel, runs, progress=stages)
    stages("summary")
    record = summary(found, findings)
    next_experiment(found)
    stages("end")
    return {
        "seconds": round(time.monotonic() - began, 1),
        "stages": {name: round(value, 1) for name, value in stages.seconds.items() if value > 0.05},
        "verdict": record["verdict"],
        "effects": [effect["name"] for effect in record["effects"]],
        "rows": sum(len(run.t) for run in runs),
    }


def main() -> None:
    """Diagnose twice, on every core or pinned to one; print and write the times."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--one-core", action="store_true", help="pin the process to one core")
    if parser.parse_args().one_core:
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[-1]})
    from diffsea.runtime import set_xla_flags

    set_xla_flags()
    import jax

    jax.config.update("jax_enable_x64", True)
    from experiments.harness.memory import peak_memory

    from tests.oracle.simulator import load

    from diffsea.vessel.files import build

    document = load(str(ROOT / "tests" / "oracle" / "usv.toml"))
    vessel = build(document)
    results = {}
    for name, seed in (("cold", 5), ("warm", 6)):
        results[name] = one(vessel, document, seed)
        print(name, json.dumps(results[name], indent=1), flush=True)
    peak = peak_memory()
    results["peak_memory_GiB"] = round(peak, 2)
    print(f"peak memory {peak:.2f} GiB")
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
