"""The command that finds trials in long recordings: `segment`."""

import argparse
import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.segments import Segment
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.base import Vessel


# Written out because asking the library would import JAX; a test compares the two.
KINDS = ("turning", "zigzag", "straight", "coasting", "station", "unknown")
_SEGMENT = """\
Find trials in long recordings: turning, zig-zag, straight, coasting, station. Onsets are those
of the executed steering, where it was measured or a vessel says how orders are answered; else
of the orders, and the result says so. Every segment becomes a recording of its own, time zero
at the onset, with checks from order to motion. Writes the segments, segments.json with their
provenance, and a plot of each recording.
"""
_EXAMPLES = """\
  diffsea segment day1.csv day2.csv
  diffsea segment log.csv --mapping boat.toml --vessel otter
  diffsea segment day1.csv --kind zigzag,turning --interval 0.1 -o trials"""


def register(commands) -> None:
    """Add the command."""
    parser = options.add_command(
        commands, "segment", _segment, "trials in long recordings, cut out and traced", _SEGMENT,
        _EXAMPLES,
    )  # fmt: skip
    options.add_recordings(parser)
    parser.add_argument(
        "--vessel", metavar="V", help="vessel that names the actuators and answers the orders"
    )
    parser.add_argument(
        "--kind", metavar="KINDS", type=_kinds, default=KINDS,
        help=f"only these, separated by commas ({' | '.join(KINDS)})",
    )  # fmt: skip
    parser.add_argument(
        "--window",
        metavar="S",
        type=options.positive,
        help="time in which the vessel turns by 90 deg at its fastest (default: as recorded)",
    )
    parser.add_argument(
        "--interval", metavar="S", type=options.positive,
        help="resample the segments to this time step (default: as recorded)",
    )  # fmt: skip
    parser.add_argument(
        "--format", type=options.one_of(("csv", "parquet"), "format"), default="csv",
        metavar="csv|parquet", help="of the segments (default: csv)",
    )  # fmt: skip


def _kinds(text: str) -> tuple[str, ...]:
    chosen = options.one_of(KINDS, "kind")
    return tuple(chosen(name) for name in options.names(text))


def _segment(args: argparse.Namespace) -> None:
    from diffsea.report.pictures import save_segments
    from diffsea.segments import Settings, grouped
    from diffsea.segments.export import record, source_of
    from diffsea.segments.segments import fitted, segments_of
    from diffsea.segments.signals import signals_of

    vessel = options.read_vessel(args).vessel if args.vessel else None
    runs = options.read_recordings(args.recordings, args.mapping)
    _distinct(runs)
    settings = Settings(window=args.window)
    with options.Outputs(args.output) as out:
        entries, texts, found = [], [], []
        for run in runs:
            signals = signals_of(run, vessel)
            own = fitted(signals, settings)
            found.append((run, signals, own, segments_of(signals, own)))
        labelled = iter(grouped([s for *_, items in found for s in items], settings))
        for path, (run, signals, own, items) in zip(args.recordings, found, strict=True):
            items = [next(labelled) for _ in items]
            save_segments(signals, items, out.path(f"{_stem(run)}.png"), run.name)
            kept = [item for item in items if item.kind in args.kind]
            written = _written(args, out, run, signals, kept, vessel)
            entries.append(
                {
                    "recording": run.name,
                    "source": source_of(path, args.mapping),
                    "vessel": None if vessel is None else vessel.name,
                    "actuation": signals.origin,
                    "steering": signals.channel,
                    "parameters": dataclasses.asdict(own),
                    "notes": list(signals.notes),
                    "segments": written,
                }
            )
            texts.append(_text(run, kept, signals.notes))
        out.json("segments.json", record(entries))
    out.present(args, "\n\n".join(texts))


def _distinct(runs: "list[Trajectory]") -> None:
    stems = [_stem(run) for run in runs]
    for stem in stems:
        if stems.count(stem) > 1:
            raise UserError(
                f"two recordings are called {stem!r}, so their segments would overwrite one "
                "another: rename one, or run the command for each"
            )


def _stem(run: "Trajectory") -> str:
    return Path(run.name).stem


def _written(
    args: argparse.Namespace, out: options.Outputs, run: "Trajectory", signals,
    found: "list[Segment]", vessel: "Vessel | None",
) -> list[dict]:  # fmt: skip
    from diffsea.segments.export import export, file_name
    from diffsea.segments.traceability import checks_of

    suffix = f".{args.format}"
    checks = {n: checks_of(signals, item, vessel) for n, item in enumerate(found)}
    paths = [out.path(file_name(run, n, item, suffix)) for n, item in enumerate(found, 1)]
    return export(run, found, paths[0].parent, args.interval, suffix, checks) if paths else []


def _text(run: "Trajectory", found: "list[Segment]", notes: tuple[str, ...]) -> str:
    header = ["", "kind", "onset s", "end s", "side", "order deg", "heading deg", "approach m/s",
              "", "group"]  # fmt: skip
    rows = [
        [
            str(number), item.kind, f"{item.onset:.2f}", f"{item.end:.2f}", item.side or "",
            _number(math.degrees(item.order), ".1f"),
            _number(math.degrees(item.heading_change), ".0f"),
            _number(item.approach.speed, ".3g"), item.approach.verdict, item.group,
        ]
        for number, item in enumerate(found, 1)
    ]  # fmt: skip
    lines = [f"{run.name}: {len(found)} segments"]
    lines += [options.table(rows, header)] if rows else []
    return "\n".join([*lines, *(f"note: {note}" for note in notes)])


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""
