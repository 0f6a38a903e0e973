"""Long work is killed at a random moment and begun again: the results are those of one left alone.

    python -m tests.faults.kill --rounds 200
    python -m tests.faults.kill --rounds 200 --of diagnosis fit

Counts go into results.json beside those of failing calls; a run that was stopped goes on.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time

from tests.faults.commands import ZIGZAG, write_inputs


RESULTS = pathlib.Path(__file__).with_name("results.json")


@dataclasses.dataclass(frozen=True)
class Work:
    """A command that takes long: its words, its parts, and whether these stay in the end."""

    words: tuple[str, ...]  # names of inputs among them
    parts: str  # pattern, in the folder of parts
    parts_stay: bool


WORKS = {
    "sweep": Work(
        (
            "sweep",
            "boat.toml",
            *ZIGZAG,
            "--grid",
            "mass=180:220:3",
            "N_r=-400:-200:4",
            "--part",
            "2",
        ),
        "*/part-*.parquet",
        True,
    ),
    "fit": Work(
        (
            "fit",
            "wrong.toml",
            "run.csv",
            "--test",
            "other.csv",
            "--free",
            "X_u,N_r",
            "--starts",
            "4",
        ),
        "fit-*.npz",
        False,
    ),
    "diagnosis": Work(
        ("diagnose", "wrong.toml", "run.csv", "--test", "other.csv", "--free", "X_u,N_r"),
        "fit-*.npz",
        False,
    ),
}


class Kills:
    """Rounds of long work in a folder, each killed once and then begun again."""

    def __init__(self, folder, work):
        self.inputs, self.folder, self.work = folder / "inputs", folder, work
        write_inputs(self.inputs)
        boat = (self.inputs / "boat.toml").read_text()
        (self.inputs / "wrong.toml").write_text(boat.replace("N_rr = -300.0", ""))
        self._run("first")  # compiles
        began = time.monotonic()
        self.count = self._run("alone")
        self.seconds = time.monotonic() - began
        self.alone = self._results("alone")

    def _started(self, name):
        files = {one.name: str(one) for one in self.inputs.iterdir()}
        words = [str(files.get(word, word)) for word in self.work.words]
        return subprocess.Popen(
            [sys.executable, "-m", "diffsea", *words, "-o", str(self.folder / name)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(self.folder)},
        )

    def _run(self, name):
        """Work that is left alone; how many parts were seen."""
        process, seen = self._started(name), 0
        reading = threading.Thread(target=process.communicate)
        reading.start()  # what is said must not fill the pipe
        while process.poll() is None:
            seen = max(seen, len(self._parts(name)))
            time.sleep(1e-2)
        reading.join()
        assert process.returncode == 0, process.args
        return max(seen, len(self._parts(name)))

    def _results(self, name):
        return {one.name: one.read_bytes() for one in sorted((self.folder / name).iterdir())}

    def _parts(self, name):
        """Finished parts, by name; each with what changes when it is written again."""
        found = {}
        for one in (self.folder / f"{name}-parts").glob(self.work.parts):
            with contextlib.suppress(FileNotFoundError):  # it goes just now
                found[one.name] = one.stat().st_ino, one.stat().st_mtime_ns
        return found

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
        if self.work.parts_stay and any(after[name] != was for name, was in before.items()):
            return len(before), "a finished part was done again"
        if not self.work.parts_stay and (self.folder / "killed-parts").exists():
            return len(before), "parts were left when all was done"
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
    parser.add_argument("--rounds", type=int, default=200, help="of each work, in all runs")
    parser.add_argument("--of", nargs="+", choices=WORKS, default=list(WORKS))
    parser.add_argument("--anew", action="store_true", help="forget the rounds counted")
    parser.add_argument("--results", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    results = json.loads(args.results.read_text()) if args.results.exists() else {}
    for name in args.of:
        none = {"rounds": 0, "within_the_parts": 0, "breaches": 0}
        counts = none if args.anew else results.get(f"kills of a {name}", none)
        if counts["rounds"] >= args.rounds:
            continue
        with tempfile.TemporaryDirectory() as folder:
            kills = Kills(pathlib.Path(folder), WORKS[name])
            for number in range(counts["rounds"], args.rounds):
                left, wrong = kills.breach(*kills.moment(random.Random(f"{name} {number}")))
                print(name, number, left, wrong, flush=True)
                counts = {
                    "rounds": number + 1,
                    "within_the_parts": counts["within_the_parts"] + (0 < left < kills.count),
                    "breaches": counts["breaches"] + bool(wrong),
                }
                results[f"kills of a {name}"] = counts
                args.results.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
