"""Run every experiment, one after the other, in a size that takes minutes; all, or those named.

    python experiments/every.py [NAME ...]

The whole proofs of those that take hours have commands of their own in their READMEs. What each
printed goes to out/experiments/NAME.log, seconds and exit status of each to
out/experiments/summary.json. Ends with status 1 where one failed.
"""

import json
import subprocess
import sys
import time
from pathlib import Path


HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OUT = ROOT / "out" / "experiments"
ALONE = [["run.py"]]
FEW = ("--out", "out/concealed/few")

# Where not a plain `run.py`: what it needs first, or a part of what takes hours.
COMMANDS = {
    "kvlcc2_hsva": [
        ["../real_fits/run.py", "kvlcc2", "--objective", "innovation"], ["run.py"],
    ],
    "real_fits": [["run.py", "kvlcc2", "--objective", "free-run"]],
    "audit_power": [["run.py", "--quick"]],
    "coverage": [["run.py", "--cases", "10"]],
    "null_calibration": [["run.py", "--quick"]],
    "fit_benchmark": [["run.py", "--repeats", "1"]],
    "concealed": [
        ["-m", "experiments.concealed.generate", "--set", "scored", "--subset", "8", *FEW],
        ["run.py", "--set", "scored", *FEW],
        ["-m", "experiments.concealed.score", "--set", "scored", *FEW],
    ],
}  # fmt: skip


def main() -> None:
    """Run the experiments named on the command line, or all."""
    every = sorted(path.parent.name for path in HERE.glob("*/run.py"))
    wanted = sys.argv[1:] or every
    unknown = [name for name in wanted if name not in every]
    if unknown:
        sys.exit(f"no experiment {', '.join(unknown)}; there are {', '.join(every)}")
    OUT.mkdir(parents=True, exist_ok=True)
    summary = {}
    for number, name in enumerate(wanted, 1):
        print(f"[{number} of {len(wanted)}] {name} ...", flush=True)
        summary[name] = run(name)
        print("    {outcome} after {seconds:.0f} s, see {log}".format(**summary[name]), flush=True)
        (OUT / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    failed = [name for name, record in summary.items() if record["status"]]
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


def run(name: str) -> dict:
    """Run one experiment's commands up to the first that fails."""
    began, log, status = time.perf_counter(), OUT / f"{name}.log", 0
    with log.open("w") as file:
        for first, *options in COMMANDS.get(name, ALONE):
            script = str((HERE / name / first).resolve()) if first.endswith(".py") else first
            command = [sys.executable, script, *options]
            status = subprocess.run(command, cwd=ROOT, stdout=file, stderr=file).returncode
            if status:
                break
    seconds = round(time.perf_counter() - began, 1)
    outcome = "failed" if status else "done"
    return {
        "status": status, "outcome": outcome, "seconds": seconds, "log": str(log.relative_to(ROOT)),
    }  # fmt: skip


if __name__ == "__main__":
    main()
