"""The longer run of `make fuzz`: hostile inputs to every reader, counted in results.json.

    python -m tests.fuzz.run --inputs 1000 --seed 1 --only csv mat

What breaks is kept in a folder, to be made small and put into tests/corpus.
"""

import argparse
import collections
import hashlib
import importlib.metadata
import json
import pathlib
import tempfile

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as with_seed
from tests.fuzz.changes import hostile
from tests.fuzz.harness import Harness, breach
from tests.fuzz.seeds import KINDS, SUFFIXES


RESULTS = pathlib.Path(__file__).with_name("results.json")


def tried(kind, inputs, seed, harness, kept):
    """Inputs tried and breaches found, by what is wrong; those that break are kept in a folder."""
    found, statuses = collections.Counter(), collections.Counter()

    @with_seed(seed)
    @settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(hostile(kind))
    def try_one(content):
        ended = harness.ended(kind, content)
        wrong = breach(ended)
        statuses["read" if ended["status"] == 0 else "refused"] += 1
        if wrong:
            lines = [line for line in ended["said"].splitlines() if "bug" in line]
            told = f"{wrong}: {(lines or [''])[0][:160]}"
            found[told] += 1
            if found[told] <= 2:
                name = f"{kind}-{hashlib.sha256(content).hexdigest()[:8]}{SUFFIXES[kind]}"
                (kept / name).write_bytes(content)
                print(f"{name}: {told}\n{ended['said'][-700:]}", flush=True)

    before = harness.tried
    try_one()  # pyright: ignore[reportCallIssue]  # Hypothesis gives the content
    counts = {"inputs": harness.tried - before, **statuses, "breaches": sum(found.values())}
    return counts, found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=KINDS)
    parser.add_argument("--kept", type=pathlib.Path, default=pathlib.Path("out/fuzz"))
    parser.add_argument("--results", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    args.kept.mkdir(parents=True, exist_ok=True)
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    pandas = importlib.metadata.version("pandas")
    with tempfile.TemporaryDirectory() as folder:
        harness = Harness(folder)
        for kind in args.only:
            counts, found = tried(kind, args.inputs, args.seed, harness, args.kept)
            results[kind] = {"pandas": pandas, **counts}
            args.results.write_text(json.dumps(results, indent=1) + "\n")
            print(kind, counts, dict(found), flush=True)
        harness.close()


if __name__ == "__main__":
    main()
