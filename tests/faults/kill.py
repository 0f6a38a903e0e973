"""A sweep is killed at a random moment and begun again: the results are those of one left alone.

    python -m tests.faults.kill --rounds 200

Counts go into results.json beside those of failing calls.
"""

import argparse
import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time

from tests.boats import BOAT


RESULTS = pathlib.Path(__file__).with_name("results.json")
DESIGNS = ("--grid", "mass=180:220:3", "N_r=-400:-200:4", "--part", "2")
TRIAL = ("--manoeuvre", "zigzag", "--executes", "2", "--step", "0.1")


class Kills:
    """Rounds of a sweep in a folder, each killed once and then begun again."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "boat.toml").write_text(BOAT)
        self._run("first")  # compiles
        began = time.monotonic()
        self._run("alone")
        self.seconds = time.monotonic() - began
        self.alone, self.count = self._results("alone"), len(self._parts("alone"))

    def _started(self, name):
        words = ["sweep", str(self.folder / "boat.toml"), *TRIAL, *DESIGNS]
        return subprocess.Popen(
            [sys.executable, "-m", "diffsea", *words, "-o", str(self.folder / name)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(self.folder)},
        )

    def _run(self, name):
        process = self._started(name)
        said = process.communicate()[1]
        assert process.returncode == 0, said

    def _results(self, name):
        return {one.name: one.read_bytes() for one in sorted((self.folder / name).iterdir())}

    def _parts(self, name):
        """Finished parts, by name; each with what changes when it is written again."""
        found = (self.folder / f"{name}-parts").glob("*/part-*.parquet")
        return {one.name: (one.stat().st_ino, one.stat().st_mtime_ns) for one in found}

    def moment(self, draw):
        """When to kill: so many parts are there, and so many seconds more have passed.

        Every other time at any moment from the start on; else amid the parts, which take the least
        of the time, or while results are written.
        """
        if draw.random() < 0.5:
            return 0, draw.uniform(0.0, 1.1 * self.seconds)
        return draw.randint(1, self.count), draw.expovariate(20.0)

    def breach(self, parts, seconds):
        """Parts that the kill left, and what is wrong in the end; empty where nothing is.

        Arguments:
            parts, seconds: the `moment` of the kill.
        """
        for name in ("killed", "killed-parts"):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        process = self._started("killed")
        while len(self._parts("killed")) < parts and process.poll() is None:
            time.sleep(1e-3)
        time.sleep(seconds)
        process.kill()
        process.communicate()
        before = self._parts("killed")
        shown = self.folder / "killed"
        left = {p.name for p in shown.iterdir() if p.name[0] != "."} if shown.exists() else set()
        if left and self._results_of(left) != {k: v for k, v in self.alone.items() if k in left}:
            return len(before), f"results that are not whole after the kill: {left}"
        self._run("killed")
        after = self._parts("killed")
        if any(after[name] != was for name, was in before.items()):
            return len(before), "a finished part was done again"
        hidden = [str(one) for one in self.folder.glob("killed*/**/.*")]
        if hidden:
            return len(before), f"left {hidden}"
        found = self._results("killed")
        differing = [k for k in {*found, *self.alone} if found.get(k) != self.alone.get(k)]
        return len(before), f"{differing} differ" if differing else ""

    def _results_of(self, names):
        return {name: (self.folder / "killed" / name).read_bytes() for name in names}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--results", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    draw, parts, breaches = random.Random(args.seed), [], []
    with tempfile.TemporaryDirectory() as folder:
        kills = Kills(pathlib.Path(folder))
        for number in range(args.rounds):
            left, wrong = kills.breach(*kills.moment(draw))
            parts.append(left)
            breaches += [wrong] if wrong else []
            print(number, left, wrong, flush=True)
            results["kills of a sweep"] = {
                "rounds": len(parts),
                "within_the_parts": sum(0 < n < kills.count for n in parts),
                "breaches": len(breaches),
            }
            args.results.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
