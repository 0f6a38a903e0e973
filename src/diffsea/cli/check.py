"""`diffsea check`: what is in a log, whether it is sound, and what it shows."""

import argparse
import math
import pathlib
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.following import following_commands, reading_options
from diffsea.cli.options import add_flag
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.checks import LogCheck, PooledCheck
    from diffsea.recordings import Finding
    from diffsea.workflows.checks import ChosenMapping


STAGES = {"reading": 1.0, "checking": 3.0, "writing": 0.5}  # usual seconds


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "what is in a log, whether it is sound, what it shows"
    parser = options.add_command(commands, "check", check_command, summary)
    text = "a log as it was recorded, or a table"
    parser.add_argument("logs", metavar="LOG", type=pathlib.Path, nargs="+", help=text)
    options.add_reading(parser)
    add_flag(parser, "--hide-place", "write no coordinates: positions count from the first one")


def check_command(args: argparse.Namespace) -> None:
    """Says what is in logs of one boat, without a mapping and without a vessel: craft and format,
    channels, gaps and faults, idle stretches that are left out, trials, speed and turning rate by
    order, lag, difference of the sides, what the logs cannot tell and which minutes would.
    Writes check.json, check.html, and where a mapping was chosen or proposed STEM.mapping.toml.
    With several logs check.json holds {"logs": {name: ...}}, and what they show together in
    "together". A log that cannot be read is a row.

    examples:
      diffsea check boat.bin
      diffsea check day1.tlog day2.tlog --hide-place
      diffsea check logged_by_others.csv --start 60 --end 660
    """
    paths = args.logs
    if len(set(paths)) < len(paths):
        raise UserError("a log is named twice; name each only once")
    with Outputs(args.output) as out, StagedProgress(STAGES) as tell:
        tell("reading the logs")
        from diffsea.checks import check_together
        from diffsea.recordings import Finding
        from diffsea.report.pages.check import check_report
        from diffsea.workflows.checks import check_logs, choose_mappings

        chosen = choose_mappings(paths, args.mapping)
        hows = [chosen[path] for path in paths]
        told = [how.message if isinstance(how, Finding) else how.told for how in hows]
        read_alike: dict[str, list[str]] = {}
        for path, how in zip(paths, hows, strict=True):
            if not isinstance(how, Finding):  # what cannot be read is told with the results
                read_alike.setdefault(how.told, []).append(path.name)
        for sentence, names_of_logs in read_alike.items():
            options.progress(f"{', '.join(names_of_logs)}: {sentence}")
        tell("checking the log" if len(paths) == 1 else f"checking {len(paths)} logs")
        checks = check_logs(paths, chosen, args.start, args.end, args.hide_place)
        mappings = _write_mappings(out, chosen, args)
        records = [_record(one) for one in checks]
        names = [path.name for path in paths]
        keys = names if len(set(names)) == len(names) else [str(path) for path in paths]
        several: dict[str, object] = {"format": 1, "logs": dict(zip(keys, records, strict=True))}
        together = check_together([one for one in checks if not isinstance(one, Finding)])
        if together is not None:
            several["together"] = together.as_dict()
        out.json("check.json", records[0] if len(records) == 1 else several)
        tell("writing the page")
        command = shlex.join(["diffsea", "check", *map(str, paths), *reading_options(args)])
        source = {"command": command, "logs": keys}
        checked = [
            (path, one)
            for path, one in zip(paths, checks, strict=True)
            if not isinstance(one, Finding)
        ]
        commands = following_commands(args, checked, mappings)
        out.text("check.html", check_report(checks, told, source, together, commands))
    texts = [_check_lines(one) for one in checks]
    if len(checked) > 1:
        names = [one.name for _, one in checked]
        texts = _said_once(texts, _together_lines(names, together))
    out.present(args, "\n\n".join("\n".join(lines) for lines in texts if lines), commands)


def _write_mappings(
    out: Outputs,
    chosen: "dict[pathlib.Path, ChosenMapping | Finding]",
    args: argparse.Namespace,
) -> dict[pathlib.Path, pathlib.Path]:
    """Write the mappings that were chosen or proposed; by log, that which other commands need.

    A log that is known by what it contains needs none. Of logs of one layout it is that of the
    first.
    """
    from diffsea.recordings import Finding

    written: dict[pathlib.Path, str] = {}
    needed: dict[pathlib.Path, pathlib.Path] = {}
    for path, how in chosen.items():
        if args.mapping is not None:
            needed[path] = args.mapping
        if isinstance(how, Finding):
            continue
        text = how.text_without_place if args.hide_place else how.text
        if text is None:
            continue
        name = f"{path.stem}.mapping.toml"
        if written.get(out.folder / name, text) != text:
            name = f"{path.stem}.{len(out.files) + 1}.mapping.toml"
        if out.folder / name not in written:
            out.text(name, text)
            written[out.folder / name] = text
        if how.known is None or how.known.guessed:
            needed[path] = next(file for file, other in written.items() if other == text)
    return needed


def _record(one: "LogCheck | Finding") -> dict[str, object]:
    """What check.json has of a log; one that could not be read has its finding alone."""
    from diffsea.recordings import Finding

    if not isinstance(one, Finding):
        return one.as_dict()
    lists = ("used", "trials", "cannot_tell")
    empty: dict[str, object] = {name: [] for name in lists}
    known = {"format": 1, "file": one.recording, "log": None, "craft": None, "channels": {}}
    return known | {"audit": [one.as_dict()]} | empty


def _said_once(logs: list[list[str]], together: list[str]) -> list[list[str]]:
    """Lines of each log and of all together; what every log read says is said of all, once."""
    read = [lines for lines in logs if len(lines) > 1]
    shared = [line for line in read[0][1:] if all(line in other for other in read)]
    of_all = [*together, *(line for line in shared if line not in together)]
    own = [[line for line in lines if line not in shared] for lines in logs]
    return [*own, of_all if len(of_all) > 1 else []]


def _check_lines(one: "LogCheck | Finding") -> list[str]:
    """A check for a person at a terminal; its first line is the log's name and what it is."""
    from diffsea.recordings import Finding
    from diffsea.report.pages.check import guess_sentence, headlines, trial_order
    from diffsea.report.wording.findings import heaviest_first

    if isinstance(one, Finding):
        return [f"{one.recording}: not read: {one.message}"]
    duration = one.run.t[-1] - one.run.t[0]
    used = sum(end - start for start, end in one.used)
    lines = [
        f"{one.name}: {one.craft}; {one.title}",
        f"{duration:.0f} s recorded, {used:.0f} s used",
        *map(guess_sentence, one.guesses),
        *(f"idle: {s.start:.0f} s to {s.end:.0f} s, {s.why}" for s in one.idle),
        *(f"missing: {sentence}" for sentence in one.missing),
        *(f"finding: {finding.kind}: {finding.message}" for finding in heaviest_first(one.audit)),
        *headlines(one.answers, bool(one.run.commanded), one.reversed_turning),
    ]
    known = lambda speed: f"{speed:.2f}" if math.isfinite(speed) else ""
    rows = [
        (
            *(trial.kind, f"{trial.onset:.1f}", f"{trial.end:.1f}", trial.side or ""),
            *(trial_order(trial.order, one.answers.paired), known(trial.approach.speed)),
        )
        for trial in one.trials
    ]
    heads = ("trial", "onset s", "end s", "side", "order", "approach m/s")
    lines += [table(rows, heads)] if rows else []
    lines += _open_lines(one)
    return [*lines, *(f"note: {note}" for note in one.notes)]


def _together_lines(names: Sequence[str], pooled: "PooledCheck | None") -> list[str]:
    """What several logs show together, if anything, under a line with their names."""
    from diffsea.report.pages.check import headlines

    if pooled is None:
        return [f"{', '.join(names)}, each of them:"]
    told = headlines(pooled.answers, pooled.commanded, pooled.reversed_turning)
    return [f"{', '.join(names)} together:", *told, *_open_lines(pooled)]


def _open_lines(one: "LogCheck | PooledCheck") -> list[str]:
    """What cannot be told, and what to record next."""
    from diffsea.report.quantities import duration

    lines = [f"cannot tell {q.what}: {q.why}" for q in one.cannot_tell]
    if one.next:
        length = duration(sum(q.seconds for q in one.next))
        lines.append(f"record next, in {length}: " + "; ".join(q.record or "" for q in one.next))
    return lines
