"""`diffsea segment`: trials in long recordings, cut out and traced."""

import argparse
import dataclasses
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.errors import UserError
from diffsea.progress import PartialProgress, counted


if TYPE_CHECKING:
    from diffsea.segments import Segment
    from diffsea.trajectory import Trajectory


KINDS = ("turning", "zigzag", "straight", "coasting", "station", "unknown")  # as the library has
FORMATS = ("csv", "parquet")
COLUMNS = ",kind,onset s,end s,side,order deg,turned deg,approach m/s,,group".split(",")


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "trials in long recordings, cut out and traced"
    parser = options.add_command(commands, "segment", segment_command, summary)
    options.add_recordings(parser)
    vessel = "vessel that names the actuators and answers the orders"
    add_option(parser, "--vessel", "V", str, vessel)
    kinds = f"only these, separated by commas ({' | '.join(KINDS)})"
    parser.add_argument("--kind", metavar="KINDS", type=_kind_names, default=KINDS, help=kinds)
    window = "time in which the vessel turns by 90 deg at its fastest (default: as recorded)"
    add_option(parser, "--window", "S", options.positive, window)
    interval = "resample the segments to this time step (default: as recorded)"
    add_option(parser, "--interval", "S", options.positive, interval)
    formats = options.OneOf(FORMATS, "format")
    add_option(parser, "--format", "|".join(FORMATS), formats, "of the segments", default="csv")


def _kind_names(text: str) -> tuple[str, ...]:
    """Kinds of segments separated by commas."""
    kind = options.OneOf(KINDS, "kind")
    return tuple(kind(name) for name in options.names(text))


def segment_command(args: argparse.Namespace) -> None:
    """Find trials in long recordings: turning, zig-zag, straight, coasting, station. Onsets are
    those of the executed steering, where it was measured or a vessel says how orders are answered;
    else of the orders, and the result says so. Every segment becomes a recording of its own, time
    zero at the onset, with checks from order to motion. Writes the segments, segments.json with
    their provenance, segments.html, and a plot of each recording.

    examples:
      diffsea segment day1.csv day2.csv
      diffsea segment log.csv --mapping boat.toml --vessel otter
      diffsea segment day1.csv --kind zigzag,turning --interval 0.1 -o trials
    """
    from diffsea.recordings.mappings import mapping_path
    from diffsea.report.pages.recordings import segments_page
    from diffsea.report.pictures import save_segments
    from diffsea.segments import SegmentSettings, group_repeats
    from diffsea.segments.export import export, file_name, record, source_of
    from diffsea.segments.segments import segments_of, with_window
    from diffsea.segments.signals import signals_of
    from diffsea.segments.traceability import checks_of

    vessel = options.read_vessel(args).vessel if args.vessel else None
    settings, suffix = SegmentSettings(window=args.window), f".{args.format}"
    stages = {"reading": 3.0, "looking": 3.0, "writing": 3.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell(f"reading {counted(len(args.recordings), 'recording')}")
        runs = options.read_recordings(args.recordings, args)
        stems = _different_stems(runs)
        of_run = lambda path: mapping_path(args.mapping, path) if args.mapping else None
        mappings = [of_run(path) for path in args.recordings]
        tell("looking for trials")
        signals = [signals_of(run, vessel) for run in runs]
        scales = [with_window(one, settings) for one in signals]
        found = [segments_of(*pair) for pair in zip(signals, scales, strict=True)]
        labelled = iter(group_repeats([segment for own in found for segment in own], settings))
        entries, texts, shown = [], [], []
        for k, run in enumerate(runs):
            tell(PartialProgress(run.name, k / len(runs), "writing the segments"))
            segments = [next(labelled) for _ in found[k]]
            save_segments(signals[k], segments, out.path(f"{stems[k]}.png"), run.name)
            chosen = [segment for segment in segments if segment.kind in args.kind]
            checks = {n: checks_of(signals[k], item, vessel) for n, item in enumerate(chosen)}
            paths = [out.path(file_name(run, n, item, suffix)) for n, item in enumerate(chosen, 1)]
            written = (
                export(run, chosen, paths[0].parent, args.interval, suffix, checks) if paths else []
            )
            entries.append(
                {
                    "recording": run.name,
                    "source": source_of(args.recordings[k], mappings[k]),
                    "vessel": None if vessel is None else vessel.name,
                    "actuation": signals[k].origin,
                    "steering": signals[k].channel,
                    "parameters": dataclasses.asdict(scales[k]),
                    "notes": list(signals[k].notes),
                    "segments": written,
                }
            )
            texts.append(_segments_text(run, chosen, signals[k].notes))
            shown.append((run, chosen, signals[k].notes))
        out.json("segments.json", record(entries))
        out.text("segments.html", segments_page(shown, options.source_of(args)))
    has_any = any(entry["segments"] for entry in entries)
    following = [f"diffsea metrics {shlex.quote(str(out.folder))}/*{suffix}"] if has_any else []
    out.present(args, "\n\n".join(texts), following)


def _different_stems(runs: "list[Trajectory]") -> list[str]:
    """Names of the recordings' files without their ends; raises `UserError` where two are alike."""
    stems = [Path(run.name).stem for run in runs]
    for stem in stems:
        if stems.count(stem) > 1:
            raise UserError(
                f"two recordings are called {stem!r}, so their segments would overwrite one "
                "another: rename one, or run the command for each"
            )
    return stems


def _segments_text(run: "Trajectory", found: "list[Segment]", notes: tuple[str, ...]) -> str:
    """The segments of one recording for a person: a table in deg and s, then notes."""

    def finite(value: float, form: str) -> str:
        return format(value, form) if math.isfinite(value) else ""

    rows = []
    for number, item in enumerate(found, 1):
        times = (f"{item.onset:.2f}", f"{item.end:.2f}")
        order = finite(math.degrees(item.order), ".1f")
        heading = finite(math.degrees(item.heading_change), ".0f")
        approach = (finite(item.approach.speed, ".3g"), item.approach.verdict)
        side = item.side or ""
        rows.append((str(number), item.kind, *times, side, order, heading, *approach, item.group))
    lines = [f"{run.name}: {counted(len(found), 'segment')}"]
    lines += [table(rows, COLUMNS)] if rows else []
    return "\n".join([*lines, *(f"note: {note}" for note in notes)])
