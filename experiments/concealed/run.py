"""Diagnose every case of a set, blind; drawn first where it is not there.

    python -m experiments.concealed.run --set develop [--workers 2] [--redo] [--cases c0001 ...]

Resumable: a case with a result of this tool is left alone unless --redo. Each worker is one
process on one core that calls the command line in process, so that compiled programs are used
again; cases are dealt by vessel. A worker cannot open the truth. Writes DIR/results/CASE/
(diagnosis.json, vessel.toml, report.html, run.json) and, before any case, DIR/settings.json.
Without arguments: a balanced part of 40 cases of the scored set.
"""

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path


ROOT = Path(__file__).resolve().parents[2]

from experiments.concealed import draw, sealing


OUT = ROOT / "out" / "concealed"


def revision() -> dict:
    """What the tool is: git revision, whether the tree differs from it, digest of its files."""
    git = lambda *a: subprocess.run(
        ["git", *a], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    return {
        "git": git("rev-parse", "HEAD"),
        "modified": bool(git("status", "--porcelain", "--", "src")),
        "source_sha256": sealing.source_digest(ROOT / "src" / "diffsea"),
    }


def arguments(case: Path, out: Path, next_manoeuvre: bool = False) -> list[str]:
    """The command line of one diagnosis."""
    runs = lambda folder: [str(p) for p in sorted((case / folder).glob("*.csv"))]
    return [
        "diagnose", str(case / "vessel.toml"), *runs("train"), "--test", *runs("test"),
        "-o", str(out), "--json",
        *(["--next-manoeuvre", str(out.parent / f"{out.name}.next.csv")] if next_manoeuvre else []),
    ]  # fmt: skip


def gives_manoeuvre(main) -> bool:
    """Whether this revision of the tool writes the recommended manoeuvre's commands."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        main(["diagnose", "--help"])
    return "--next-manoeuvre" in printed.getvalue()


def diagnose(case: Path, out: Path, main, next_manoeuvre: bool = False) -> dict:
    """Run one case; what happened, with the wall time and the messages' end."""
    shutil.rmtree(out, ignore_errors=True)
    said, printed = io.StringIO(), io.StringIO()
    began, status, error = time.monotonic(), 1, None
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
            status = main(arguments(case, out, next_manoeuvre))
    except Exception as failure:
        error = "".join(traceback.format_exception(failure))[-4000:]
    seconds = time.monotonic() - began
    if status and error is None:
        error = said.getvalue()[-2000:]
    return {"case": case.name, "status": status, "seconds": round(seconds, 2), "error": error}


def work(core: int, folder: Path, cases: list[str], settings: dict, threads: int) -> None:
    """One worker: sealed, pinned to a core, one case after another."""
    if hasattr(os, "sched_setaffinity") and core < (os.cpu_count() or 1):
        os.sched_setaffinity(0, {core})
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = str(threads)
    sealing.seal(folder / "sealed")
    from diffsea.cli import main

    with_manoeuvre = gives_manoeuvre(main)
    for i, name in enumerate(cases):
        out = folder / "results" / name
        record = diagnose(folder / "cases" / name, out, main, with_manoeuvre)
        out.mkdir(parents=True, exist_ok=True)
        if (schedule := out.parent / f"{name}.next.csv").exists():
            schedule.replace(out / "next.csv")
        record["source_sha256"] = settings["tool"]["source_sha256"]
        record["warm"] = i > 0
        (out / "report.html").unlink(missing_ok=True)
        _write_at_once(out / "run.json", json.dumps(record, indent=1) + "\n")
        outcome = "failed" if record["error"] else verdict(out)
        print(f"core {core}: {i + 1}/{len(cases)} {name} {record['seconds']:.0f} s {outcome}",
              file=sys.stderr, flush=True)  # fmt: skip


def _write_at_once(path: Path, text: str) -> None:
    """Write a file that is whole or not there: it says that a case is done."""
    unfinished = path.with_name(f".{path.name}")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)


def verdict(out: Path) -> str:
    """The verdict of a result, for the progress line."""
    try:
        found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
        return found["verdict"]
    except (OSError, ValueError, KeyError):
        return "no diagnosis"


def vessel_of(case: Path) -> str:
    """The name in a case's vessel file, to deal cases of one vessel to one worker in a row."""
    import tomllib

    return tomllib.loads((case / "vessel.toml").read_text(encoding="utf-8"))["name"]


def pending(
    folder: Path, wanted: list[str] | None, redo: bool, digest: str, any_revision: bool = False
) -> list[str]:
    """Cases to do, ordered by vessel; results of other files of the tool are refused."""
    left = []
    for name in wanted or sorted(p.name for p in (folder / "cases").iterdir()):
        path = folder / "results" / name / "run.json"
        if path.exists() and not redo:
            was = json.loads(path.read_text(encoding="utf-8"))
            if was.get("source_sha256") != digest and not any_revision:
                raise SystemExit(
                    f"{path} is of another revision of the tool: --redo replaces such results, "
                    "--any-revision keeps them"
                )
            continue
        left.append(name)
    return sorted(left, key=lambda n: (vessel_of(folder / "cases" / n), n))


def run(folder: Path, workers: int, wanted: list[str] | None, redo: bool, any_revision: bool):
    """Write the settings, then work through the cases."""
    settings = {
        "tool": revision(),
        "arguments": arguments(Path("CASE"), Path("OUT")) + ["(train/*.csv, test/*.csv)"],
        "manifest_sha256": sealing.sha256(folder / "manifest.json"),
        "workers": workers,
        "python": sys.version.split()[0],
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    digest = settings["tool"]["source_sha256"]
    left = pending(folder, wanted, redo, digest, any_revision)
    if not left:
        print("nothing to do")
        return
    (folder / "settings.json").write_text(json.dumps(settings, indent=1) + "\n", encoding="utf-8")
    share = -(-len(left) // workers)
    parts = [left[i : i + share] for i in range(0, len(left), share)]
    if len(parts) == 1:
        work(0, folder, parts[0], settings, 1)
        return
    context = multiprocessing.get_context("spawn")
    processes = [
        context.Process(target=work, args=(i, folder, part, settings, 1))
        for i, part in enumerate(parts)
    ]
    for p in processes:
        p.start()
    for p in processes:
        p.join()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", choices=draw.SETS)
    parser.add_argument("--out", type=Path, help="folder of the set (default: out/concealed/SET)")
    parser.add_argument("--count", type=int, help="cases to draw where none are")
    parser.add_argument("--subset", type=int, help="draw only a balanced part of so many")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cases", nargs="+", help="only these")
    parser.add_argument("--redo", action="store_true", help="replace results that are there")
    parser.add_argument("--any-revision", action="store_true",
                        help="keep results of other revisions of the tool")  # fmt: skip
    args = parser.parse_args()
    folder = args.out or OUT / (args.set or "subset")
    if not (folder / "manifest.json").exists():
        command = [sys.executable, "-m", "experiments.concealed.generate", "--out", str(folder)]
        command += ["--set", args.set or "scored"]
        command += ["--count", str(args.count)] if args.count else []
        part = args.subset or (None if args.set else 40)
        command += ["--subset", str(part)] if part else []
        subprocess.run(command, cwd=ROOT, check=True)
    run(folder.resolve(), args.workers, args.cases, args.redo, args.any_revision)


if __name__ == "__main__":
    main()
