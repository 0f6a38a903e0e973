"""Every call of every command with every error, counted in results.json.

python -m tests.faults.run --only metrics "export --to mss"
"""

import argparse
import json
import pathlib
import tempfile

from diffsea.runtime import prepare_jax


prepare_jax()  # before anything imports JAX

from tests.faults.commands import commands, remembered, write_inputs  # isort: skip
from tests.faults.trying import ERRORS, Trial  # isort: skip


RESULTS = pathlib.Path(__file__).with_name("results.json")
NAMES = list(commands(pathlib.Path("in"), pathlib.Path("out")))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", nargs="*", default=NAMES, choices=NAMES)
    parser.add_argument("--results", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    with tempfile.TemporaryDirectory() as name, remembered():
        inputs = write_inputs(pathlib.Path(name) / "inputs")
        for command in args.only:
            trial = Trial(command, inputs, pathlib.Path(name) / "work")
            tried = [(k, error) for k in range(len(trial.calls)) for error in ERRORS]
            found = [one for pair in tried if (one := trial.breach(*pair))]
            counts = {"calls": len(trial.calls), "tried": len(tried), "breaches": len(found)}
            results.setdefault("commands", {})[command] = counts
            args.results.write_text(json.dumps(results, indent=1) + "\n")
            print(command, counts, *found[:3], sep="\n  ", flush=True)


if __name__ == "__main__":
    main()
