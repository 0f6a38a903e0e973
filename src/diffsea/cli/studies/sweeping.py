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
from diffsea.progress import counted


if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

    from diffsea.simulation.designs import DesignSpace
    from diffsea.simulation.standard import TrialPlan
    from diffsea.studies.front import Goals
    from diffsea.studies.parts import Parts
    from diffsea.vessel.base import Vessel
    from diffsea.vessel.files import VesselFile

    Search = Callable[[pd.DataFrame], dict[str, Any]]


PART = 4096  # as the library has it, which would import JAX to be asked
MAPPED = 100_000  # designs that are drawn at most
TOLD_PARAMETERS = 2  # that a line of a terminal has room for, twice
MERGE = "merge"  # in the place of a vessel
WANTED_FORM = "NAME=VALUE"


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
    options.add_parts(group, "in which parts that are done are kept")
    options.add_cluster(group, "the parts")
    group = sweep.add_argument_group("what is looked for")
    front = "designs that no other beats: the least of each number, or the most (NAME:most)"
    add_option(group, "--front", "NAME", str, front, nargs="+", action=GivenOnce)
    wanted = "designs with these numbers, found from the nearest of the sweep, within its ranges"
    add_option(group, "--wanted", WANTED_FORM, wanted_number, wanted, nargs="+", action=GivenOnce)
    sweep.set_defaults(usage_error=sweep.error)


def shard_of(text: str) -> tuple[int, int]:
    """A type of argument: which of how many, such as `3/16`."""
    number, slash, count = text.partition("/")
    if not slash or not number.isdecimal() or not count.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form I/N, for example 3/16")
    if not 1 <= int(number) <= int(count):
        raise argparse.ArgumentTypeError(f"{text!r}: shards are numbered from 1 to {count}")
    return int(number), int(count)


def wanted_number(text: str) -> tuple[str, float]:
    """A type of argument: a number of the trial and its value, such as `overshoot_1=0.14`."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not of the form {WANTED_FORM}, for example overshoot_1=0.14"
        )
    return name, options.number(value)


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
    diverges or is impossible has nulls and its outcome says so. With --front the designs that no
    other beats in front.csv; with --wanted those that have the wanted numbers in sweep.json.

    examples:
      diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
      diffsea sweep usv.toml --manoeuvre turning-circle --sample 2000 mass=150:220 x_G=-0.3:0.3
      diffsea sweep kvlcc2 --manoeuvre zigzag --grid speed=0.6:1.2:7
      diffsea sweep otter --manoeuvre zigzag --sample 1000000 mass=60:160 --shard 3/16
      diffsea sweep otter --manoeuvre zigzag --sample 1000000 mass=60:160 --cluster tcp://host:8786
      diffsea sweep merge out/sweep-parts -o out/sweep
      diffsea sweep otter --manoeuvre zigzag --sample 500 mass=60:160 N_r=-60:-30 \\
          --front overshoot_1 initial_turning_distance
      diffsea sweep otter --manoeuvre zigzag --sample 500 mass=60:160 N_r=-60:-30 \\
          --wanted overshoot_1=0.07
    """
    from diffsea.studies.front import goals_of

    goals, wanted = goals_of(args.front or []), _wanted(args)
    if args.vessel == MERGE:
        folder: pathlib.Path = args.merged or args.usage_error("merge takes the folder of parts")
        if args.wanted is not None:
            args.usage_error("--wanted needs the vessel: give it with the command that swept")
        from diffsea.studies.parts import read_parts

        with Outputs(args.output) as out:
            summary = _write_results(read_parts(folder), out, goals)
        out.present(args, _summary_text(summary))
        return
    if args.merged is not None or args.manoeuvre is None:
        extra = f"unrecognized arguments: {args.merged}"
        args.usage_error("--manoeuvre is required" if args.merged is None else extra)
    if args.shard is not None:
        if goals or args.wanted is not None:
            args.usage_error("a shard has no results: give --front to `diffsea sweep merge`")
        designs = _designs(args)
        parts = _do_parts(args, designs, *_planned(args, designs))
        told = f"shard {args.shard[0]} of {args.shard[1]} is done"
        text = f"{told}; when all are: diffsea sweep merge {parts.folder}"
        print(json_text(parts.manifest) if args.json else text)
        return
    from diffsea.simulation.planning import number_names
    from diffsea.studies.front import require_numbers

    designs = _designs(args)
    with Outputs(args.output) as out:
        file, plan = _planned(args, designs)
        if goals or wanted:
            known = [*designs.names, *number_names(file.vessel, plan)]
            require_numbers([*goals, *wanted], known)
        search = _search(file.vessel, plan, designs, wanted) if wanted else None
        parts = _do_parts(args, designs, file, plan)
        summary = _write_results(parts, out, goals, search)
    more = "the same with --front NAME ... for designs no other beats, --wanted NAME=VALUE for one"
    out.present(args, _summary_text(summary), [] if goals or wanted else [more])


def _planned(args: argparse.Namespace, designs: "DesignSpace") -> "tuple[VesselFile, TrialPlan]":
    """The vessel, and the plan of its trial."""
    from diffsea.studies.sweep import check_names

    file = options.read_vessel(args)
    check_names(file.vessel, designs.names)
    return file, trial_plan(_at_slowest(args, designs), file.vessel)


def _do_parts(
    args: argparse.Namespace, designs: "DesignSpace", file: "VesselFile", plan: "TrialPlan"
) -> "Parts":
    """The parts that the options ask for, those of the shard done."""
    from diffsea.studies import parts as kept

    folder = options.parts_folder(args)
    parts = kept.parts_of(folder, file.vessel, file.document, plan, designs, args.part)
    if args.resume and not (parts.folder / kept.MANIFEST).exists():
        raise UserError(
            f"{folder} holds no part of this sweep: the vessel, the trial, the designs, --part or "
            "the version is another; leave --resume out to begin"
        )
    with StagedProgress({"running": 20.0}) as tell:
        tell(f"running {counted(designs.count, 'design')} in {counted(parts.count, 'part')}")
        shard = args.shard or (1, 1)
        try:
            kept.do_parts(parts, file.vessel, plan, designs, shard, tell, args.cluster)
        except kept.PartsFailedError as error:
            raise UserError(
                f"{error}\nAll others are kept in {parts.folder}: the same command goes on"
            ) from None
    return parts


def _wanted(args: argparse.Namespace) -> dict[str, float]:
    """The numbers that are wanted; one that is given twice is bad usage."""
    wanted = dict(args.wanted or [])
    if len(wanted) < len(args.wanted or []):
        args.usage_error("--wanted has a number twice")
    return wanted


def _search(
    vessel: "Vessel", plan: "TrialPlan", designs: "DesignSpace", wanted: dict[str, float]
) -> "Search":
    """A function of a sweep's table that finds the designs which are wanted."""
    from diffsea.studies.inverse import designs_for

    ranges = {name: (float(axis[0]), float(axis[1])) for name, axis in designs.axes.items()}

    def search(swept: "pd.DataFrame") -> dict[str, Any]:
        with StagedProgress({"searching": 20.0}) as tell:
            tell("searching from the nearest designs")
            found = designs_for(vessel, plan, ranges, wanted, swept, tell)
        return {"wanted": wanted, "designs": [one.as_dict() for one in found]}

    return search


def _write_results(
    parts: "Parts", out: Outputs, goals: "Goals", search: "Search | None" = None
) -> dict[str, Any]:
    """The results of all parts; returns the content of sweep.json, with the front's size and
    the designs that were wanted."""
    from diffsea.report.pages.sweep import sweep_page
    from diffsea.report.pictures import save_map
    from diffsea.studies.front import front
    from diffsea.studies.merging import every_nth, merge, row_batches, summarise

    manifest = parts.manifest
    target, names = out.path("sweep.parquet"), manifest["parameters"]
    merge(parts, target)
    about = {key: manifest[key] for key in ("vessel", "manoeuvre")}
    summary = about | summarise(target, names)
    for name, ends in summary["parameters"].items():
        ends["unit"] = parts.unit_of(name)
    shown = every_nth(target, -(-summary["designs"] // MAPPED))
    best = front(row_batches(target), goals) if goals else None
    if best is not None:
        summary["front"] = {"goals": dict(goals), "designs": len(best)}
        out.text("front.csv", best.to_csv(index=False))
    if search is not None:
        summary["inverse"] = search(shown)
    out.json("sweep.json", summary)
    # Not the options, of which some say how the parts were divided and change no result.
    source = about | {key: manifest[key] for key in ("space", "versions")}
    out.text("sweep.html", sweep_page(shown, summary, source, best))
    if "grid" in manifest["space"] and len(names) == 2 and summary["designs"] <= MAPPED:
        title = f"{manifest['vessel']}: {manifest['manoeuvre']}"
        save_map(shown, tuple(names), out.path("map.png"), title)
    return summary


_ENDS = ("least", "median", "most")


def _summary_text(summary: dict[str, Any]) -> str:
    """sweep.json for a person."""
    from diffsea.report.pages.sweep import DESIGNS_OF_ENDS, design_words
    from diffsea.report.quantities import for_people
    from diffsea.report.wording.numbers import number_unit

    outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
    lines = [f"{summary['designs']} designs ({outcomes})"]
    rows, told = [], DESIGNS_OF_ENDS if len(summary["parameters"]) <= TOLD_PARAMETERS else ()
    for name, column in summary["metrics"].items():
        if math.isfinite(column["median"]):
            ends = [for_people(column[key], number_unit(name)) for key in _ENDS]
            designs = [design_words(column[key]) for key in told]
            rows.append((name, *(f"{value:.4g}" for value, _ in ends), ends[0][1], *designs))
    head = ("number", *_ENDS, "", *("least in", "most in")[: len(told)])
    lines += [table(rows, head)] if rows else []
    for name, verdict in summary["imo"].items():
        lines.append(f"IMO {name}: {verdict['pass']} pass, {verdict['fail']} fail")
    if "front" in summary:
        goals = ", ".join(f"{goal} {name}" for name, goal in summary["front"]["goals"].items())
        lines.append(f"{summary['front']['designs']} designs no other beats in: {goals}")
    if "inverse" in summary:
        lines.append(_found_text(**summary["inverse"]))
    return "\n".join(lines)


def _found_text(wanted: dict[str, float], designs: list[dict[str, Any]]) -> str:
    """The designs that were found, for a person."""
    from diffsea.studies.inverse import found_sentence

    names = list(designs[0]["parameters"])
    rows = []
    for one in designs:
        values = [one["parameters"][name] for name in names]
        values += [one["metrics"].get(name, math.nan) for name in wanted]
        rows.append((*(f"{value:.5g}" for value in values), f"{100 * one['off']:.1g} %"))
    told = found_sentence(wanted, [one["off"] for one in designs])
    return f"{told}\n{table(rows, (*names, *wanted, 'off by'))}"


def _at_slowest(args: argparse.Namespace, designs: "DesignSpace") -> argparse.Namespace:
    """The options with the lowest speed or thrust of a sweep over it: time limits follow it."""
    for name, lowest in designs.slowest().items():
        if args.speed is not None or args.thrust is not None:
            args.usage_error(f"{name} is swept: leave --speed and --thrust out")
        if lowest <= 0:
            raise UserError(f"{name} must be above zero in every design; the lowest is {lowest:g}")
        args = argparse.Namespace(**{**vars(args), name: lowest})
    return args
