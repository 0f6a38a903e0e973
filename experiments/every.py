"""Run every experiment, one after the other, in a size that takes minutes; all, or those named.

    python -m experiments.every [NAME ...]

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
FEW = ("--out", "out/concealed/few")
BASIN = ("--out", "out/concealed_real/few")

# Where not a plain `run`: what it needs first, or a part of what takes hours.
COMMANDS = {
    "kvlcc2_hsva": [
        ["experiments.real_fits.run", "kvlcc2", "--objective", "innovation"],
        ["experiments.kvlcc2_hsva.run"],
    ],
    "real_fits": [["experiments.real_fits.run", "kvlcc2", "--objective", "free-run"]],
    "audit_power": [["experiments.audit_power.run", "--quick"]],
    "coverage": [["experiments.coverage.run", "--cases", "10"]],
    "null_calibration": [["experiments.null_calibration.run", "--quick"]],
    "fit_benchmark": [["experiments.fit_benchmark.run", "--repeats", "1"]],
    "concealed": [
        ["experiments.concealed.generate", "--set", "scored", "--subset", "8", *FEW],
        ["experiments.concealed.run", "--set", "scored", *FEW],
        ["experiments.concealed.score", "--set", "scored", *FEW],
    ],
    "concealed_real": [
        ["experiments.concealed_real.run", "--injected", "--subset", "4", "--sets", "kcs", *BASIN],
        ["experiments.concealed_real.score", *BASIN],
    ],
}


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
        for module, *options in COMMANDS.get(name, [[f"experiments.{name}.run"]]):
            command = [sys.executable, "-m", module, *options]
            status = subprocess.run(command, cwd=ROOT, stdout=file, stderr=file).returncode
            if status:
                break
    seconds = round(time.perf_counter() - began, 1)
    outcome = "failed" if status else "done"
    where = str(log.relative_to(ROOT))
    return {"status": status, "outcome": outcome, "seconds": seconds, "log": where}


if __name__ == "__main__":
    main()
