"""What the commands have in common: how they are declared, their options, reading their inputs.

A command is a function of the parsed arguments whose docstring is its help. Nothing here imports
a numerical library, so that help is quick.
"""

import argparse
import difflib
import functools
import importlib
import inspect
import itertools
import math
import pathlib
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from diffsea.errors import UserError
from diffsea.outside.printable import printable
from diffsea.runtime import prepare_jax


if TYPE_CHECKING:
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.files import VesselFile

# Of a command's arguments, those that change no result.
_NOT_ASKED = ("run", "usage_error", "output", "json", "debug")

Commands = Any  # argparse's sub-parsers, whose class is private
LINES: list[Callable[[str], None]] = []  # what shows lines while bars are drawn
Parser = argparse.ArgumentParser | argparse._ArgumentGroup | argparse._MutuallyExclusiveGroup


def add_command(
    commands: Commands,
    name: str,
    run: Callable[[argparse.Namespace], None],
    summary: str,
    writes: bool = True,
) -> argparse.ArgumentParser:
    """A sub-command with the options that every command has: `-o`, `--json`, `--debug`.

    Arguments:
        run: does the work; its docstring is the description, with examples under `examples:`.
        summary: one line for the list of commands.
        writes: whether it writes files; without, there is no `-o`.
    """
    description, _, examples = (inspect.getdoc(run) or "").partition("\nexamples:\n")
    parser = commands.add_parser(
        name,
        help=summary,
        description=description,
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    output = parser.add_argument_group("output")
    if writes:
        folder = pathlib.Path("out") / name
        flags, text = ("-o", "--output"), "folder for the results (default: %(default)s)"
        output.add_argument(*flags, metavar="DIR", type=pathlib.Path, default=folder, help=text)
    add_flag(output, "--json", "print the result as JSON, and nothing else, on stdout")
    add_flag(output, "--debug", "show the traceback of a bug")
    return parser


def add_option(
    parser: Parser,
    flag: str,
    metavar: str | tuple[str, ...],
    kind: Callable[[str], Any],
    help: str,
    **more: Any,
) -> None:
    """An option with a value; its default, where it has one, is told at the end of the help.

    Arguments:
        kind: makes the value of the text, or raises `argparse.ArgumentTypeError`: bad usage.
        more: of `add_argument`, such as `default` and `nargs`.
    """
    told = " (default: %(default)s)" if more.get("default") else ""
    parser.add_argument(flag, metavar=metavar, type=kind, help=help + told, **more)


def add_choice(parser: Parser, flag: str, choices: Sequence[str], help: str) -> None:
    """An option that is one of few words, the first by default."""
    text = f"{help} ({' | '.join(choices)}; default: %(default)s)"
    kind, metavar = OneOf(choices, "choice"), flag.strip("-").upper()
    parser.add_argument(flag, metavar=metavar, type=kind, default=choices[0], help=text)


def add_flag(parser: Parser, flag: str, help: str) -> None:
    """An option that is given or not."""
    parser.add_argument(flag, action="store_true", help=help)


def add_vessel(parser: argparse.ArgumentParser) -> None:
    """The positional argument VESSEL."""
    parser.add_argument("vessel", metavar="VESSEL", help="TOML file, or name of a shipped vessel")


def add_recordings(parser: argparse.ArgumentParser, several: bool = True) -> None:
    """The positional argument RECORDING, and how recordings are read."""
    name, number = ("recordings", "+") if several else ("recording", None)
    text = "run as CSV or Parquet, or a log"
    parser.add_argument(name, metavar="RECORDING", type=pathlib.Path, nargs=number, help=text)
    add_reading(parser)


def add_reading(parser: Parser) -> None:
    """How recordings are read: `--mapping`, `--start` and `--end`."""
    mapping = (
        "TOML file that says which columns are which, and in which unit, or a folder with "
        "NAME.mapping.toml for each recording (default: by content)"
    )
    add_option(parser, "--mapping", "M", pathlib.Path, mapping)
    add_option(parser, "--start", "S", number, "leave out what is before, s on the clock recorded")
    limit = "bytes to which a file may expand, such as 4GB (default: 1GB)"
    add_option(parser, "--max-size", "SIZE", size, limit)
    add_option(parser, "--end", "S", number, "leave out what is after, s on the clock recorded")


def add_cluster(parser: Parser, what: str) -> None:
    """`--cluster`: where `what` is to be done."""
    text = f"do {what} on the Dask cluster whose scheduler is at ADDRESS, such as tcp://host:8786"
    add_option(parser, "--cluster", "ADDRESS", str, text)


def add_parts(parser: Parser, what: str) -> None:
    """`--parts`: the folder of parts of long work, `what` says which."""
    text = f"folder {what} (default: DIR with -parts at its end)"
    add_option(parser, "--parts", "FOLDER", pathlib.Path, text)


def parts_folder(args: argparse.Namespace) -> pathlib.Path:
    """The folder of parts that is asked for, or the one beside the folder of results.

    Within that one if it has no name of its own (`.`).
    """
    out: pathlib.Path = args.output
    named = out.name not in ("", "..")
    return args.parts or (out.with_name(f"{out.name}-parts") if named else out / "parts")


# Types of arguments. A bad value is bad usage: argparse tells it and ends with status 2.


def positive(text: str) -> float:
    """A number above zero."""
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} is not above zero")
    return value


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def count(text: str) -> int:
    """A whole number above zero."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above zero")
    return int(text)


def size(text: str) -> int:
    """Bytes, such as `4GB`, `500 MB` or `1e9`."""
    factors = {"KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "B": 1.0}
    unit = next((unit for unit in factors if text.upper().endswith(unit)), "")
    return round(positive(text[: len(text) - len(unit)].strip()) * factors.get(unit, 1.0))


def angle(text: str) -> float:
    """An angle in degrees above zero and at most 180, as rad."""
    degrees = positive(text)
    if degrees > 180:
        raise argparse.ArgumentTypeError(f"{text} is more than 180 degrees")
    return math.radians(degrees)


class OneOf:
    """A type of argument: one of some names; the message has the nearest one and the list."""

    def __init__(self, names: Sequence[str], what: str):
        """
        Arguments:
            what: the names are, for the message.
        """
        self.names, self._what = tuple(names), what

    def __call__(self, text: str) -> str:
        if text not in self.names:
            near = difflib.get_close_matches(text, self.names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise argparse.ArgumentTypeError(
                f"there is no {self._what} {text!r}{hint}; choose one of {', '.join(self.names)}"
            )
        return text


class LibraryNames(OneOf):
    """Names that the library explains in a table, which is read where help is asked for.

    Reading it imports JAX, which takes a second that a parser must not take. Iterated, as argparse
    does for `%(choices)s`, the names have their `help` in brackets.
    """

    def __init__(self, names: Sequence[str], what: str, place: str):
        """
        Arguments:
            names: those of the table, written out.
            place: of the table, `module:NAME`; its values may have a text `help`.
        """
        super().__init__(names, what)
        self.place = place

    @functools.cached_property
    def table(self) -> dict[str, Any]:
        """The library's own names and what it says of them."""
        prepare_jax()
        module, _, name = self.place.partition(":")
        table = getattr(importlib.import_module(module), name)
        return table if isinstance(table, dict) else dict.fromkeys(table)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        helps = {name: getattr(entry, "help", "") for name, entry in self.table.items()}
        return (f"{name} ({text})" if text else name for name, text in helps.items())


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    parts = tuple(part.strip() for part in text.split(",") if part.strip())
    if not parts:
        raise argparse.ArgumentTypeError("give names separated by commas")
    return parts


# Inputs


def read_vessel(args: argparse.Namespace) -> "VesselFile":
    """The vessel of a command, with the document it was read from.

    Raises:
        UserError: no such vessel, or one that is impossible; says what is wrong and where.
    """
    from diffsea.vessel import files

    return files.read_vessel(args.vessel)


def read_recordings(paths: Sequence[pathlib.Path], args: argparse.Namespace) -> "list[Trajectory]":
    """The recordings, under names that tell them apart, as `add_reading` has it.

    Which mapping was chosen for a log by its content is told on standard error.

    Raises:
        UserError: a file cannot be read, or is named twice; of a table whose columns are others'
            it says which command proposes a mapping.
    """
    import dataclasses

    from diffsea import recordings
    from diffsea.recordings.mappings import check_span, check_stems

    mapping = args.mapping
    check_stems(mapping, paths)
    if mapping is not None and not mapping.is_dir():
        mapping = recordings.read_mapping(mapping)
    check_span(args.start, args.end, "what is to be read:")
    runs = []
    for path in paths:
        try:
            runs.append(recordings.read_recording(path, mapping, args.start, args.end))
        except UserError as error:
            by_name = mapping is None or isinstance(mapping, pathlib.Path)
            alike = _foreign_like(path, paths) if by_name else []
            if not alike or isinstance(error.__cause__, OSError):
                raise
            raise UserError(_how_to_map(alike, len(paths))) from error
    if len({run.name for run in runs}) < len(runs):
        if len(set(paths)) < len(paths):
            raise UserError("a recording is named twice; name each only once")
        named = zip(runs, paths, strict=True)
        runs = [dataclasses.replace(run, name=str(path)) for run, path in named]
    tell_mappings(runs)
    return runs


def _foreign_like(path: pathlib.Path, paths: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    """A file that needs a mapping, with those of its layout; none where it needs none."""
    from diffsea.recordings.mapping_proposal import foreign_layouts

    groups = foreign_layouts([one for one in paths if one.exists()])
    return next((group for group in groups if path in group), [])


def _how_to_map(paths: Sequence[pathlib.Path], count: int) -> str:
    """That files have the layout of another program, and how a mapping is had.

    Of `count` files in all: a mapping is for all files of a command.
    """
    files = " ".join(shlex.quote(str(path)) for path in paths)
    which = f"{paths[0]} has" if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more have"
    folder = pathlib.Path("out") / "check"
    mapping = folder / f"{paths[0].stem}.mapping.toml" if len(paths) == 1 else folder
    return (
        f"{which} not diffsea's columns (t, x, y, psi, ..., cmd_...) between commas: "
        f"`diffsea check {files}` proposes a mapping and says how sure it is of each; look at it, "
        f"then repeat this with --mapping {shlex.quote(str(mapping))}"
        + (", for these files alone: it goes for all of a command" if len(paths) < count else "")
    )


def tell_mappings(runs: "Sequence[Trajectory]") -> None:
    """Tell which mappings were chosen by content, each once, with what the logs lack."""
    told: dict[tuple[str, ...], list[str]] = {}
    for run in runs:
        if run.read.recognised:
            told.setdefault(run.read.recognised, []).append(run.name)
    for sentences, names_of_runs in told.items():
        progress(f"{', '.join(names_of_runs)}: " + "\n  ".join(sentences))


def read_fitted_and_held_out(
    args: argparse.Namespace,
) -> "tuple[list[Trajectory], list[Trajectory]]":
    """The recordings to fit, and those held out; see `used_parts`."""
    runs, test = read_groups(args, args.recordings, args.test)
    return runs, test


def read_groups(
    args: argparse.Namespace, *groups: "Sequence[pathlib.Path]"
) -> "list[list[Trajectory]]":
    """The recordings of several groups, weighed together as one set; see `used_parts`."""
    rest = iter(read_recordings([path for group in groups for path in group], args))
    return [used_parts(list(itertools.islice(rest, len(group))), args) for group in groups]


def used_parts(runs: "Sequence[Trajectory]", args: argparse.Namespace) -> "list[Trajectory]":
    """The recordings without the idle stretches of logs that are read by what they contain.

    What is left out, and how to keep it, is told on standard error.
    """
    from diffsea.recordings import idle

    if args.keep_idle:
        return list(runs)
    used: list[Trajectory] = []
    for run in runs:
        parts, left_out = idle.used_parts(run)
        used += parts
        if left_out:
            progress(f"{left_out}; --keep-idle keeps them")
    return used


def source_of(args: argparse.Namespace) -> dict[str, Any]:
    """What was asked for, as a page states it: the command, and what it was given."""
    asked = {k: v for k, v in vars(args).items() if k not in _NOT_ASKED and v not in (None, False)}
    texts = {
        name: ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
        for name, value in asked.items()
    }
    command = args.run.__name__.removesuffix("_command")
    return {"command": f"diffsea {command}", "options": texts}


def progress(message: str) -> None:
    """A line for the person who waits, on standard error, above the bar where there is one."""
    shown = printable(message)
    if LINES:
        LINES[-1](shown)
    else:
        print(shown, file=sys.stderr, flush=True)
