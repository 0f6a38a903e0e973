"""`diffsea diagnose`: from recordings to what a vessel's model lacks."""

import argparse
import pathlib
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.outputs import Outputs


if TYPE_CHECKING:
    from diffsea.identification.estimates import Progress
    from diffsea.workflows.identification import DiagnosisResult

STAGES = 8  # of a diagnosis, as most are


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "find the physics that the model leaves out"
    parser = options.add_command(commands, "diagnose", diagnose_command, summary)
    options.add_fit_options(parser)
    draws = "judge chance by so many simulated and refitted data sets (100 or more; seconds each)"
    options.add_option(parser, "--bootstrap", "DRAWS", int, draws, default=0)
    manoeuvre = "write the manoeuvre that separates rivals as a command sequence (t, cmd_...)"
    options.add_option(parser, "--next-manoeuvre", "CSV", pathlib.Path, manoeuvre)


def diagnose_command(args: argparse.Namespace) -> None:
    """Locates where model and recordings differ, names what was left out, models it and
    shows the fit improve on data that was held out. Writes diagnosis.json, the vessel with what
    was found as vessel.toml, and report.html.

    examples:
      diffsea diagnose usv.toml run*.csv --test other*.csv
      diffsea diagnose ship.toml a.csv b.csv --environment per-recording
    """
    with Outputs(args.output) as out:
        from diffsea.cli.progress import StagedProgress
        from diffsea.report.words import verdict_text
        from diffsea.vessel.files import dump
        from diffsea.workflows.identification import diagnose

        next_csv = args.next_manoeuvre and out.elsewhere(args.next_manoeuvre, "--next-manoeuvre")
        with StagedProgress(STAGES) as tell:
            file = options.read_vessel(args)
            runs, test = options.read_fitted_and_held_out(args)
            per_run = args.environment == "per-recording"
            found = diagnose(file, runs, test, None, per_run, args.free, args.bootstrap, tell)
            if next_csv is not None:
                _write_manoeuvre(next_csv, found, tell)
            tell("writing the report")
            out.json("diagnosis.json", found.record)
            out.text("vessel.toml", dump(found.diagnosed.document))
            out.text("report.html", found.html())
    out.present(args, verdict_text(found.record))


def _write_manoeuvre(path: pathlib.Path, found: "DiagnosisResult", tell: "Progress") -> None:
    """The manoeuvre to record next as a command sequence; nothing where none is needed."""
    import pandas as pd

    from diffsea.diagnosis.experiment import commands

    if found.experiment is None:
        tell("no two explanations are left to separate, so no manoeuvre is written")
    elif not found.experiment.exists:
        tell(f"no manoeuvre is written: {found.experiment.why}")
    else:
        train = found.diagnosis.split.train
        sequence = pd.DataFrame(commands(train, found.diagnosis.final, found.experiment))
        sequence.to_csv(path, index=False, float_format="%.6g")
