"""`diagnose`: from recordings to what a vessel's model lacks; and what `fit` shares with it."""

import argparse
import pathlib
import time
from typing import TYPE_CHECKING, Any

from diffsea.cli.options import (
    Outputs,
    add_command,
    add_recordings,
    add_vessel,
    names,
    progress,
    read_recordings,
    read_vessel,
)


if TYPE_CHECKING:
    from diffsea.trajectory import Trajectory

STAGES = 8  # of a diagnosis, as most are


def register(commands: Any) -> None:
    """Add the command to the parser."""
    diagnose = add_command(
        commands, "diagnose", _diagnose, "find the physics that the model leaves out",
        "Locates where model and recordings differ, names what was left out, models it and\n"
        "shows the fit improve on data that was held out.",
        "  diffsea diagnose usv.toml run*.csv --test other*.csv\n"
        "  diffsea diagnose ship.toml a.csv b.csv --environment per-recording",
    )  # fmt: skip
    add_common(diagnose)
    diagnose.add_argument(
        "--environment", choices=("shared", "per-recording"), default="shared",
        help="whether wind and current are the same in all recordings (default: %(default)s)",
    )  # fmt: skip
    diagnose.add_argument(
        "--bootstrap", metavar="DRAWS", type=int, default=0,
        help="judge chance by so many simulated and refitted data sets (100 or more; seconds each)",
    )  # fmt: skip
    diagnose.add_argument(
        "--next-manoeuvre", metavar="CSV", type=pathlib.Path,
        help="write the manoeuvre that separates rivals as a command sequence (t, cmd_...)",
    )  # fmt: skip


def _write_manoeuvre(path: pathlib.Path, diagnosis: Any, experiment: Any, tell: Any) -> None:
    """The manoeuvre to record next as a command sequence; nothing where none is needed."""
    import pandas as pd

    from diffsea.diagnosis.experiment import commands

    if experiment is None:
        tell("no two explanations are left to separate, so no manoeuvre is written")
        return
    if not experiment.exists:
        tell(f"no manoeuvre is written: {experiment.why}")
        return
    pd.DataFrame(commands(diagnosis, experiment)).to_csv(path, index=False, float_format="%.6g")


def add_common(parser: argparse.ArgumentParser) -> None:
    """Options of `fit` and `diagnose`."""
    add_vessel(parser)
    add_recordings(parser)
    parser.add_argument(
        "--free", metavar="NAMES", type=names,
        help="parameters to estimate, separated by commas (default: the hull's derivatives)",
    )  # fmt: skip
    parser.add_argument(
        "--test", metavar="RECORDING", nargs="+", type=pathlib.Path, default=[],
        help="recordings to hold out for judging",
    )  # fmt: skip


def read_all(args: argparse.Namespace) -> "tuple[list[Trajectory], list[Trajectory]]":
    """The recordings to fit, and those held out."""
    runs = read_recordings([*args.recordings, *args.test], args.mapping)
    return runs[: len(args.recordings)], runs[len(args.recordings) :]


def clock() -> Any:
    """Progress with the seconds since the start."""
    began = time.monotonic()

    def tell(message: str) -> None:
        progress(f"[{time.monotonic() - began:5.0f} s] {message}")

    return tell


def _diagnose(args: argparse.Namespace) -> None:
    with Outputs(args.output) as out:
        from diffsea.cli.progress import StagedProgress
        from diffsea.report.words import verdict_text
        from diffsea.vessel.files import dump
        from diffsea.workflows.identification import diagnose

        next_csv = args.next_manoeuvre and out.elsewhere(args.next_manoeuvre, "--next-manoeuvre")
        with StagedProgress(STAGES) as tell:
            file = read_vessel(args)
            runs, test = read_all(args)
            per_run = args.environment == "per-recording"
            found = diagnose(file, runs, test, None, per_run, args.free, args.bootstrap, tell)
            if next_csv is not None:
                _write_manoeuvre(next_csv, found.diagnosis, found.experiment, tell)
            tell("writing the report")
            out.json("diagnosis.json", found.record)
            text = dump(found.diagnosed.document)
            out.path("vessel.toml").write_text(text, encoding="utf-8")
            out.path("report.html").write_text(found.html(), encoding="utf-8")
    out.present(args, verdict_text(found.record))
