"""`diffsea sweep`: a trial of many designs, part by part."""

import argparse
import math
import pathlib
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.grammar import GivenOnce
from diffsea.cli.options import add_flag, add_option
from diffsea.cli.outputs import Outputs, json_text, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.studies.axes import GRID_FORM, RANGE_FORM, axis, by_name, number_and_ranges
from diffsea.cli.trial import add_trial_command, trial_plan
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.simulation.designs import DesignSpace
    from diffsea.studies.parts import Parts


PART = 4096  # as the library has it, which would import JAX to be asked
MAPPED = 100_000  # designs that are drawn at most
MERGE = "merge"  # in the place of a vessel


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "run a trial of many designs at once"
    sweep = add_trial_command(commands, "sweep", sweep_command, summary, needed=False)
    text = "with `merge` in place of a vessel: the folder of parts"
    sweep.add_argument("merged", metavar="PARTS", type=pathlib.Path, nargs="?", help=text)
    group = sweep.add_argument_group("designs")
    grid = "all combinations of evenly spaced values"
    add_option(group, "--grid", GRID_FORM, axis, grid, nargs="+", action=GivenOnce)
    sample = "N random designs that cover all ranges evenly"
    form = ("N", RANGE_FORM)
    add_option(group, "--sample", form, str, sample, nargs="+", action=GivenOnce)
    sobol = "the first N designs of a Sobol sequence; best a power of two"
    add_option(group, "--sobol", form, str, sobol, nargs="+", action=GivenOnce)
    add_option(group, "--seed", "K", int, "of the sample or sequence (default: 0)", default=0)
    group = sweep.add_argument_group("parts")
    add_option(group, "--part", "N", options.count, "designs of each part", default=PART)
    shard = "do every n-th part from the i-th on, and merge nothing"
    add_option(group, "--shard", "I/N", shard_of, shard)
    add_flag(group, "--resume", "only go on: refuse where no part of this very sweep is there")
    folder = "folder in which parts that are done are kept (default: DIR with -parts at its end)"
    add_option(group, "--parts", "FOLDER", pathlib.Path, folder)
    options.add_cluster(group, "the parts")
    sweep.set_defaults(usage_error=sweep.error)


def shard_of(text: str) -> tuple[int, int]:
    """A type of argument: which of how many, such as `3/16`."""
    number, slash, count = text.partition("/")
    if not slash or not number.isdecimal() or not count.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form I/N, for example 3/16")
    if not 1 <= int(number) <= int(count):
        raise argparse.ArgumentTypeError(f"{text!r}: shards are numbered from 1 to {count}")
    return int(number), int(count)


def _designs(args: argparse.Namespace) -> "DesignSpace":
    """What `--grid`, `--sample` or `--sobol` asks for; bad usage ends here."""
    from diffsea.simulation.designs import Grid, LatinHypercube, SobolSequence

    if sum(asked is not None for asked in (args.grid, args.sample, args.sobol)) != 1:
        args.usage_error("give either --grid or --sample or --sobol")
    try:
        if args.grid is not None:
            return Grid(by_name(args.grid))
        space, words = (LatinHypercube, args.sample) if args.sample else (SobolSequence, args.sobol)
        number, axes = number_and_ranges(words)
        return space(axes, number, args.seed)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise


def sweep_command(args: argparse.Namespace) -> None:
    """Run a trial of many designs. A design is the vessel with some parameters changed: any number
    of the vessel file by name (mass, N_r, rudder.area ...), the approach speed (speed, m/s) or the
    total thrust (thrust, N). All values are in SI units.
    Designs are run part by part, and each part is kept as soon as it is finished: the same command
    again goes on where it was stopped. With --shard one of several processes does its share, and
    `diffsea sweep merge PARTS` makes the results of all. With --cluster the workers of a Dask
    cluster run the parts; they need diffsea of the same version, and no files.
    Writes sweep.parquet with one row per design: parameters, metrics, IMO verdicts and outcome; a
    summary in sweep.json; sweep.html; and map.png for a grid over two parameters. A design that
    diverges or is impossible has nulls and its outcome says so.

    examples:
      diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
      diffsea sweep usv.toml --manoeuvre turning-circle --sample 2000 mass=150:220 x_G=-0.3:0.3
      diffsea sweep kvlcc2 --manoeuvre zigzag --grid speed=0.6:1.2:7
      diffsea sweep otter --manoeuvre zigzag --sample 1000000 mass=60:160 --shard 3/16
      diffsea sweep otter --manoeuvre zigzag --sample 1000000 mass=60:160 --cluster tcp://host:8786
      diffsea sweep merge out/sweep-parts -o out/sweep
    """
    if args.vessel == MERGE:
        folder: pathlib.Path = args.merged or args.usage_error("merge takes the folder of parts")
        from diffsea.studies.parts import read_parts

        with Outputs(args.output) as out:
            summary = _write_results(read_parts(folder), out)
        out.present(args, _summary_text(summary))
        return
    if args.merged is not None or args.manoeuvre is None:
        extra = f"unrecognized arguments: {args.merged}"
        args.usage_error("--manoeuvre is required" if args.merged is None else extra)
    if args.shard is not None:
        parts = _do_parts(args)
        told = f"shard {args.shard[0]} of {args.shard[1]} is done"
        text = f"{told}; when all are: diffsea sweep merge {parts.folder}"
        print(json_text(parts.manifest) if args.json else text)
        return
    designs = _designs(args)
    with Outputs(args.output) as out:
        summary = _write_results(_do_parts(args, designs), out)
    out.present(args, _summary_text(summary))


def _do_parts(args: argparse.Namespace, designs: "DesignSpace | None" = None) -> "Parts":
    """The parts that the options ask for, those of the shard done."""
    from diffsea.studies import parts as kept
    from diffsea.studies.sweep import check_names

    designs = designs or _designs(args)
    file = options.read_vessel(args)
    check_names(file.vessel, designs.names)
    plan = trial_plan(_at_slowest(args, designs), file.vessel)
    folder = args.parts or args.output.with_name(f"{args.output.name}-parts")
    parts = kept.parts_of(folder, file.vessel, file.document, plan, designs, args.part)
    if args.resume and not (parts.folder / kept.MANIFEST).exists():
        raise UserError(
            f"{folder} holds no part of this sweep: the vessel, the trial, the designs, --part or "
            "the version is another; leave --resume out to begin"
        )
    with StagedProgress({"running": 20.0}) as tell:
        tell(f"running {designs.count} designs in {parts.count} parts")
        shard = args.shard or (1, 1)
        try:
            kept.do_parts(parts, file.vessel, plan, designs, shard, tell, args.cluster)
        except kept.PartsFailedError as error:
            raise UserError(
                f"{error}\nAll others are kept in {parts.folder}: the same command goes on"
            ) from None
    return parts


def _write_results(parts: "Parts", out: Outputs) -> dict[str, Any]:
    """The results of all parts; returns the content of sweep.json."""
    from diffsea.report.pages.sweep import sweep_page
    from diffsea.report.pictures import save_map
    from diffsea.studies.merging import every_nth, merge, summarise

    manifest = parts.manifest
    target, names = out.path("sweep.parquet"), manifest["parameters"]
    merge(parts, target)
    about = {key: manifest[key] for key in ("vessel", "manoeuvre")}
    summary = about | summarise(target, names)
    out.json("sweep.json", summary)
    shown = every_nth(target, -(-summary["designs"] // MAPPED))
    # Not the options, of which some say how the parts were divided and change no result.
    source = about | {key: manifest[key] for key in ("space", "versions")}
    out.text("sweep.html", sweep_page(shown, summary, source))
    if "grid" in manifest["space"] and len(names) == 2 and summary["designs"] <= MAPPED:
        title = f"{manifest['vessel']}: {manifest['manoeuvre']}"
        save_map(shown, tuple(names), out.path("map.png"), title)
    return summary


def _summary_text(summary: dict[str, Any]) -> str:
    """sweep.json for a person."""
    outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
    lines = [f"{summary['designs']} designs ({outcomes})"]
    rows = [
        (name, *(f"{column[key]:.4g}" for key in ("least", "median", "most")))
        for name, column in summary["metrics"].items()
        if math.isfinite(column["median"])
    ]
    lines += [table(rows, ("number (SI)", "least", "median", "most"))] if rows else []
    for name, verdict in summary["imo"].items():
        lines.append(f"IMO {name}: {verdict['pass']} pass, {verdict['fail']} fail")
    return "\n".join(lines)


def _at_slowest(args: argparse.Namespace, designs: "DesignSpace") -> argparse.Namespace:
    """The options with the lowest speed or thrust of a sweep over it: time limits follow it."""
    for name, lowest in designs.slowest().items():
        if args.speed is not None or args.thrust is not None:
            args.usage_error(f"{name} is swept: leave --speed and --thrust out")
        if lowest <= 0:
            raise UserError(f"{name} must be above zero in every design; the lowest is {lowest:g}")
        args = argparse.Namespace(**{**vars(args), name: lowest})
    return args
