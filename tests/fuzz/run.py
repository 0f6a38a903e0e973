"""The longer run of `make fuzz`: hostile inputs to every reader, counted in results.json.

    python -m tests.fuzz.run --inputs 100000 --only csv mat
    python -m tests.fuzz.run --inputs 1000 --command audit

Inputs come in blocks, each drawn by a seed of its own. A run that was stopped goes on after the
last whole block of each reader; `--anew` begins again. What breaks is kept in a folder, to be made
small and put into tests/corpus.
"""

import argparse
import collections
import hashlib
import importlib.metadata
import json
import pathlib
import tempfile
import time

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as with_seed
from tests.fuzz.changes import hostile
from tests.fuzz.harness import Harness, breach
from tests.fuzz.seeds import KINDS, SUFFIXES
from tests.fuzz.server import COMMANDS, DOCUMENTS


BLOCK = 500  # inputs drawn by one seed
RESULTS = pathlib.Path(__file__).with_name("results.json")


def tried(kind, inputs, seed, harness, kept, command="metrics"):
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
        ended = harness.ended(kind, content, command=command)
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
    return {"inputs": harness.tried - before, **statuses, "breaches": sum(found.values())}


def with_block(results, kind, counts):
    """The counts of a reader with those of one more block."""
    had = results.get(kind, {})
    sums = {key: had.get(key, 0) + n for key, n in {"blocks": 1, **counts}.items()}
    return {**results, kind: {"pandas": importlib.metadata.version("pandas"), **had, **sums}}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--inputs", type=int, default=1000, help="of each reader, in all runs")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--command", choices=COMMANDS, default="metrics", help="that reads them")
    parser.add_argument("--anew", action="store_true", help="forget what was counted")
    parser.add_argument("--kept", type=pathlib.Path, default=pathlib.Path("out/fuzz"))
    parser.add_argument("--results", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    kinds = [one for one in args.only or KINDS if args.command == "metrics" or one not in DOCUMENTS]
    named = lambda kind: kind if args.command == "metrics" else f"{args.command} {kind}"
    args.kept.mkdir(parents=True, exist_ok=True)
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    if args.anew:
        results = {kind: own for kind, own in results.items() if kind not in map(named, kinds)}
    of = lambda kind, key: results.get(named(kind), {}).get(key, 0)
    with tempfile.TemporaryDirectory() as folder:
        harness = Harness(folder)
        # The reader with the fewest comes next, so that a run that is stopped has tried all alike.
        while left := [kind for kind in kinds if of(kind, "inputs") < args.inputs]:
            kind = min(left, key=lambda kind: of(kind, "inputs"))
            inputs = min(BLOCK, args.inputs - of(kind, "inputs"))
            began = time.monotonic()
            seed = of(kind, "blocks") + 1
            counts = tried(kind, inputs, seed, harness, args.kept, args.command)
            results = with_block(results, named(kind), counts)
            args.results.write_text(json.dumps(results, indent=1) + "\n")
            took = 1e3 * (time.monotonic() - began) / max(counts["inputs"], 1)
            print(named(kind), results[named(kind)], f"{took:.0f} ms an input", flush=True)
        harness.close()


if __name__ == "__main__":
    main()
