"""`diffsea fleet`: many boats' recordings audited, fitted and diagnosed."""

import argparse
import pathlib

from diffsea.cli import options
from diffsea.cli.options import add_choice, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.progress import PartialProgress


DEPTHS = ("diagnose", "fit", "audit")  # as the library has them, which would import JAX


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "audit, fit and diagnose many boats' recordings"
    parser = options.add_command(commands, "fleet", fleet_command, summary)
    manifest = "CSV with boat, vessel, recording, mapping, role (train or test)"
    parser.add_argument("manifest", metavar="MANIFEST", type=pathlib.Path, help=manifest)
    add_choice(parser, "--until", DEPTHS, "how far each boat is taken")
    where = parser.add_mutually_exclusive_group()
    add_option(where, "--jobs", "N", options.count, "processes at once", default=1)
    options.add_cluster(where, "the boats")
    budget = "begin no further step of a boat's diagnosis after so long"
    add_option(parser, "--minutes", "M", options.positive, budget)
    free = "parameters to estimate, separated by commas (default: the hull's derivatives)"
    add_option(parser, "--free", "NAMES", options.names, free)
    environment = "whether wind and current are the same in all recordings of a boat"
    add_choice(parser, "--environment", ("shared", "per-recording"), environment)
    options.add_parts(parser, "in which boats that are done are kept")


def fleet_command(args: argparse.Namespace) -> None:
    """Audit, fit and diagnose the recordings of many boats. The manifest has a row for each
    recording; its paths are relative to its folder. A log that cannot be read, or a boat that
    cannot be done, is a row with its reason and ends nothing: the command fails only where no boat
    could be done. Boats that are done are kept in a folder of their own, by the content of their
    files, the settings and the version: run the same command again and it goes on.
    With --cluster the workers of a Dask cluster do the boats. They need diffsea of the same
    version, and all files of the manifest at the same paths as here: a file system that is shared.
    Writes fleet.parquet, a row for each recording, and fleet.html: which boats changed, which
    names recur.

    examples:
      diffsea fleet fleet.csv --jobs 4
      diffsea fleet fleet.csv --until audit
      diffsea fleet fleet.csv --minutes 5 --environment per-recording -o out/june
      diffsea fleet /shared/fleet.csv --cluster tcp://host:8786
    """
    with Outputs(args.output) as out, StagedProgress(2) as tell:
        from diffsea.cli.outputs import json_text
        from diffsea.workflows.fleet import fleet

        def follow(message: str) -> None:
            if isinstance(message, PartialProgress):
                tell.line(message)  # what became of each boat stays
            tell(message)

        found = fleet(
            args.manifest,
            until=args.until,
            jobs=args.jobs,
            minutes=args.minutes,
            free=args.free,
            per_recording=args.environment == "per-recording",
            parts=options.parts_folder(args),
            progress=follow,
            cluster=args.cluster,
        )
        found.table.to_parquet(out.path("fleet.parquet"), index=False)
        out.text("fleet.html", found.html())
    if args.json:
        print(json_text(found.record()))
        return
    rows = [[str(cell) for cell in row.values()] for row in found.rows()]
    text = table(rows, tuple(found.rows()[0]))
    out.present(args, "\n".join([found.headline(), "", text, "", *found.notes()]).rstrip())
