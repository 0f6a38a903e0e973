"""The proof on real recordings: unchanged, told otherwise, known facts, injected; resumable.

    python -m experiments.concealed_real.run [--told] [--facts] [--injected] [--again] [--subset N]
        [--sets NAME ...] [--develop] [--workers N] [--redo] [--out DIR]

Without a part, all of them but `--again`: the unchanged runs by another revision of the tool,
beside those that limits and cases are drawn from; with `--injected` the injected cases. Appends a
line to `results/PART.jsonl` for every case that has none of this revision; a stopped run goes on
where it was. The unchanged runs come first: their detection limits are frozen in
`results/limits.json`, and the cases drawn from them, before anything that is injected.
"""

import argparse
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.check_data import absent
from experiments.concealed.sealing import source_digest
from experiments.concealed_real import cases, facts, results, retellings, sets
from experiments.concealed_real.checks import Line
from experiments.concealed_real.features import features
from experiments.concealed_real.injections import DROPPED, injected
from experiments.concealed_real.material import Material

import diffsea


ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "out" / "concealed_real"  # recordings as injected: never committed
KEPT_OF_VESSEL = ("thruster", "effect")

CHUNK = 40  # cases that are ordered by their set, so that compiled programs are used again

Job = tuple[str, str, Callable[[], Line]]  # id, its set, and what makes its line


# One diagnosis


def diagnosed(material: Material, folder: Path) -> tuple[Line, Any]:
    """The line of one diagnosis, and its whole result (None where it failed).

    A failure of the tool is a result: the line has its `error`.
    """
    shutil.rmtree(folder, ignore_errors=True)
    vessel, train, test = material.write(folder)
    began = time.monotonic()
    try:
        found = diffsea.diagnose(vessel, train, test, per_recording=material.per_recording)
    except Exception as failure:
        told = "".join(traceback.format_exception(failure))[-2000:]
        return _failed(told, time.monotonic() - began), None
    seconds = time.monotonic() - began
    kept = {key: found.diagnosed.document.get(key, []) for key in KEPT_OF_VESSEL}
    return {"seconds": seconds, **results.summarised(found.record), "vessel": kept}, found


def audited(material: Material, folder: Path) -> Line:
    """The line of an audit."""
    shutil.rmtree(folder, ignore_errors=True)
    _, train, test = material.write(folder)
    began = time.monotonic()
    try:
        found = [finding.as_dict() for finding in diffsea.audit([*train, *test])]
    except Exception as failure:
        told = "".join(traceback.format_exception(failure))[-2000:]
        return _failed(told, time.monotonic() - began)
    seconds = time.monotonic() - began
    return {"seconds": seconds, "verdict": None, "effects": [],
            "audit": results.audit_lines(found)}  # fmt: skip


def _failed(told: str, seconds: float) -> Line:
    return {"seconds": seconds, "error": told, "verdict": "failed", "effects": [], "audit": [],
            "where": []}  # fmt: skip


# The parts


def unchanged_line(name: str) -> Line:
    """A set as it is. The line has what is frozen, in `frozen`."""
    material = sets.SETS[name].load()
    line, found = diagnosed(material, WORK / "unchanged" / name)
    if found is None:
        return line
    frozen = {
        "limits": found.record["detection_limits"],
        "parameters": [
            {key: one[key] for key in ("name", "value", "std")}
            for one in found.record["parameters"]
        ],
        "document": found.nominal.document,
        "features": features(material),
    }
    return line | {"frozen": frozen}


def told_line(name: str, key: str) -> Line:
    """A set told otherwise."""
    material = retellings.RETELLINGS[key].tell(sets.SETS[name].load())
    return diagnosed(material, WORK / "told" / name / key)[0]


def fact_line(key: str) -> Line:
    """A fact that is known."""
    fact, folder = facts.FACTS[key], WORK / "facts" / key
    material = fact.material()
    return audited(material, folder) if fact.audit_only else diagnosed(material, folder)[0]


def injected_line(case: cases.Case, frozen: dict[str, Any]) -> Line:
    """A case of an injection. Terms are dropped from the fit of the unchanged runs."""
    material = sets.SETS[case["set"]].load()
    if case["injection"] in DROPPED:
        material = Material(frozen["document"], material.train, material.test,
                            material.per_recording)  # fmt: skip
    told = injected(material, case["injection"], case["settings"])
    return diagnosed(told, WORK / "injected" / case["id"])[0]


def told_jobs(names: list[str]) -> list[Job]:
    """Every retelling that is possible of the sets."""
    possible = {name: list(retellings.retold(sets.SETS[name].load())) for name in names}
    return [
        (f"{name}:{key}", name, lambda name=name, key=key: told_line(name, key) | {"set": name})
        for name in names
        for key in possible[name]
    ]


def fact_jobs(names: list[str]) -> list[Job]:
    """The facts of the sets."""
    wanted = {name.partition("-")[0] for name in names}
    return [
        (key, key.partition("-")[0], lambda key=key: fact_line(key))
        for key in facts.FACTS
        if key.partition("-")[0] in wanted
    ]


def unchanged_jobs(names: list[str]) -> list[Job]:
    """The sets as they are."""
    return [(name, name, lambda name=name: unchanged_line(name) | {"set": name}) for name in names]


def again_jobs(names: list[str]) -> list[Job]:
    """The sets as they are, without what is frozen."""

    def line(name: str) -> Line:
        material = sets.SETS[name].load()
        return diagnosed(material, WORK / "again" / name)[0] | {"set": name}

    return [(name, name, lambda name=name: line(name)) for name in names]


def injected_jobs(
    names: list[str], subset: int | None, folder: Path, first: int | None = None
) -> list[Job]:
    """The cases of the sets; a part of them that is quick, or the first ones of each set.

    Every set's first cases are of as many kinds.
    """
    frozen = cases.read(folder / cases.LIMITS)
    chosen = [case for case in cases.read(folder / cases.CASES)["cases"] if case["set"] in names]
    if first is not None:
        of_set = {name: [c["id"] for c in chosen if c["set"] == name][:first] for name in names}
        chosen = [case for case in chosen if case["id"] in of_set[case["set"]]]
    if subset is not None:
        seconds = {name: frozen[name]["seconds"] for name in names if name in frozen}
        chosen = cases.subset(chosen, seconds, subset)
    chunks = [chosen[k : k + CHUNK] for k in range(0, len(chosen), CHUNK)]
    return [
        (case["id"], case["set"],
         lambda case=case: injected_line(case, frozen[case["set"]]) | {"case": case})
        for chunk in chunks
        for case in sorted(chunk, key=lambda case: case["set"])
    ]  # fmt: skip


# Working through


def work(part: str, jobs: list[Job], args: argparse.Namespace, revision: str) -> None:
    """Do the jobs that have no line yet; those with a line of another revision as `args` say."""
    done = results.read(part, args.out)
    other = {key for key, line in done.items() if line["revision"] != revision}
    if other and not (args.redo or args.any_revision):
        raise SystemExit(
            f"{results.path_of(part, args.out)} has {len(other)} lines of another revision of the "
            "tool: --redo makes them anew, --any-revision keeps them"
        )
    anew = other if args.redo else set()
    worker, workers = args.share
    left = [job for job in jobs[worker::workers] if job[0] not in done or job[0] in anew]
    before = None
    for number, (key, of_set, make) in enumerate(left, 1):
        if of_set != before:
            _forget_programs()
            before = of_set
        line = {"id": key, **make()} | {"id": key, "revision": revision}
        results.append(part, line, args.out)
        said = ", ".join(results.names(line)) or "nothing"
        print(f"{part} {number} of {len(left)}: {key}: {line['seconds']:.0f} s, {line['verdict']}, "
              f"named {said}", file=sys.stderr, flush=True)  # fmt: skip


def _forget_programs() -> None:
    """Let go of the compiled programs of another set, which take much memory."""
    import jax  # once diffsea has set it up

    jax.clear_caches()


def work_together(workers: int) -> int:
    """The same command by several processes, each with its share of the jobs; their exit status."""
    command = [sys.executable, "-m", "experiments.concealed_real.run", *sys.argv[1:]]
    shares = [[*command, "--workers", "1", "--share", str(k), str(workers)] for k in range(workers)]
    running = [subprocess.Popen(share, cwd=ROOT) for share in shares]
    return max(process.wait() for process in running)


def freeze(names: list[str], folder: Path) -> None:
    """Freeze limits and draw the cases, once the unchanged runs of the sets are there."""
    lines = results.read("unchanged", folder)
    if (folder / cases.CASES).exists() or not set(names) <= set(lines):
        return
    frozen = {
        name: lines[name]["frozen"]
        | {"seconds": lines[name]["seconds"], "names": results.names(lines[name])}
        for name in names
        if "frozen" in lines[name]
    }
    if failed := sorted(set(names) - set(frozen)):
        print(f"no cases of {', '.join(failed)}: the tool fails unchanged", file=sys.stderr)
    cases.freeze(folder / cases.LIMITS, frozen)
    drawn = cases.draw_cases(frozen, cases.COUNT, cases.SEED)
    cases.freeze(folder / cases.CASES, {"seed": cases.SEED, "cases": drawn})


def main() -> None:
    """Command line."""
    args = options().parse_args()
    if not sets.available():
        sys.exit(absent("real vessels"))
    names = args.sets or [n for n, one in sets.SETS.items() if one.develop or not args.develop]
    if args.workers > 1:
        sys.exit(work_together(args.workers))
    everything = not (args.told or args.facts or args.injected or args.again)
    revision = source_digest(ROOT / "src" / "diffsea")
    diffsea.prepare_jax()
    frozen = (args.out / cases.CASES).exists()
    if everything or args.told or (args.injected and not frozen):
        # The limits of all sets are frozen together, unless the results are a trial of their own.
        first = list(sets.SETS) if args.out == results.FOLDER and not frozen else names
        work("unchanged", unchanged_jobs(first), args, revision)
        freeze(first, args.out)
    if args.again and not args.injected:
        work("again", again_jobs(names), args, revision)
    if everything or args.told:
        work("told", told_jobs(names), args, revision)
    if everything or args.facts:
        work("facts", fact_jobs(names), args, revision)
    if everything or args.injected:
        part = "injected_again" if args.again else "injected"
        work(part, injected_jobs(names, args.subset, args.out, args.first), args, revision)


def options() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    for part in ("told", "facts", "injected", "again"):
        parser.add_argument(f"--{part}", action="store_true", help="this part, not all")
    few = "so many injected cases that are quick (20 with --workers 2: a quarter of an hour)"
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="so many processes")
    parser.add_argument("--share", type=int, nargs=2, default=(0, 1), help=argparse.SUPPRESS)
    parser.add_argument("--subset", type=int, nargs="?", const=cases.SUBSET, metavar="N", help=few)
    parser.add_argument("--first", type=int, metavar="N", help="the first N cases of each set")
    parser.add_argument("--sets", nargs="+", choices=sets.SETS, help="only these sets")
    parser.add_argument("--develop", action="store_true", help="only the sets to develop on")
    parser.add_argument("--redo", action="store_true", help="make lines of other revisions anew")
    parser.add_argument("--any-revision", action="store_true", help="keep lines of any revision")
    parser.add_argument("--out", type=Path, default=results.FOLDER, help="folder of the results")
    return parser


if __name__ == "__main__":
    main()
