"""What the commands share: options, reading their inputs, and writing all outputs or none."""

import argparse
import difflib
import functools
import json
import math
import os
import pathlib
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from diffsea.errors import UserError
from diffsea.runtime import prepare_jax


if TYPE_CHECKING:
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.files import VesselFile


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], None],
    help: str,
    description: str,
    examples: str,
) -> argparse.ArgumentParser:
    """A sub-command with the options that every command has: `-o`, `--json`, `--debug`."""
    parser = commands.add_parser(
        name,
        help=help,
        description=description,
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    common = parser.add_argument_group("output")
    common.add_argument(
        "-o", "--output", metavar="DIR", type=pathlib.Path, default=pathlib.Path("out") / name,
        help="folder for the results (default: %(default)s)",
    )  # fmt: skip
    common.add_argument(
        "--json", action="store_true", help="print the result as JSON, and nothing else, on stdout"
    )
    common.add_argument("--debug", action="store_true", help="show the traceback of a bug")
    return parser


def add_vessel(parser: argparse.ArgumentParser) -> None:
    """The positional argument VESSEL."""
    parser.add_argument("vessel", metavar="VESSEL", help="TOML file, or name of a shipped vessel")


def add_recordings(parser: argparse.ArgumentParser, several: bool = True) -> None:
    """The positional argument RECORDING, and `--mapping`."""
    parser.add_argument(
        "recordings" if several else "recording", metavar="RECORDING", type=pathlib.Path,
        nargs="+" if several else None, help="run as CSV or Parquet, or a log (needs --mapping)",
    )  # fmt: skip
    parser.add_argument(
        "--mapping", metavar="M", type=pathlib.Path,
        help="TOML file that says which columns are which, and in which unit",
    )  # fmt: skip


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


def angle(text: str) -> float:
    """An angle in degrees above zero and at most 180."""
    value = positive(text)
    if value > 180:
        raise argparse.ArgumentTypeError(f"{text} is more than 180 degrees")
    return value


class LazyChoices:
    """Names that the library knows, with what they mean, asked for only where they are needed.

    Asking imports JAX, which takes a second that a parser must not take for other commands.
    Iterated, as argparse does for `%(choices)s`, they are as they stand in the help.
    """

    def __init__(self, load: Callable[[], dict[str, str]]) -> None:
        self._load = load

    @functools.cached_property
    def named(self) -> dict[str, str]:
        """Meaning by name; without one it is empty."""
        prepare_jax()
        return self._load()

    def __contains__(self, name: object) -> bool:
        return name in self.named

    def __iter__(self) -> Iterator[str]:
        return (f"{name} ({text})" if text else name for name, text in self.named.items())


def one_of(choices: Sequence[str] | LazyChoices, what: str) -> Callable[[str], str]:
    """One of some names; the message has the nearest one and the list."""

    def chosen(text: str) -> str:
        names = list(choices.named) if isinstance(choices, LazyChoices) else choices
        if text not in names:
            near = difflib.get_close_matches(text, names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise argparse.ArgumentTypeError(
                f"there is no {what} {text!r}{hint}; choose one of {', '.join(names)}"
            )
        return text

    return chosen


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    parts = tuple(part.strip() for part in text.split(",") if part.strip())
    if not parts:
        raise argparse.ArgumentTypeError("give names separated by commas")
    return parts


# Inputs


def read_vessel(args: argparse.Namespace) -> "VesselFile":
    """The vessel of a command, with the document it was read from."""
    from diffsea.vessel import files

    return files.read_vessel(args.vessel)


def read_recordings(
    paths: Iterable[pathlib.Path], mapping: pathlib.Path | None
) -> "list[Trajectory]":
    """The recordings, under names that tell them apart."""
    import dataclasses

    from diffsea import recordings

    paths = list(paths)
    table = None if mapping is None else recordings.read_mapping(mapping)
    runs = [recordings.read_recording(path, table) for path in paths]
    if len({run.name for run in runs}) < len(runs):
        runs = [
            dataclasses.replace(run, name=str(path)) for run, path in zip(runs, paths, strict=True)
        ]
    if len({run.name for run in runs}) < len(runs):
        raise UserError("a recording is named twice; name each only once")
    return runs


# Outputs


def progress(message: str) -> None:
    """A line for the person who waits, on standard error."""
    print(message, file=sys.stderr, flush=True)


class Outputs:
    """The files of one command: all of them appear in the folder at the end, or none.

        with Outputs(args.output) as out:
            out.json("fit.json", {...})
            out.path("vessel.toml").write_text(...)
        out.present(args, "summary for a person")

    Whatever is raised within leaves nothing behind. A folder that cannot be written is told
    on entering, before any work is done.
    """

    def __init__(self, folder: pathlib.Path):
        self.folder = pathlib.Path(folder)
        self.files: list[pathlib.Path] = []
        self._elsewhere: dict[pathlib.Path, pathlib.Path] = {}
        self._result = "null"

    def __enter__(self) -> "Outputs":
        self._made: list[pathlib.Path] = []
        try:
            self._make(self.folder)
            self._temporary = pathlib.Path(tempfile.mkdtemp(prefix=".unfinished-", dir=self.folder))
        except OSError as error:
            self._remove_made()
            raise UserError(
                f"cannot write into {self.folder}: {error.strerror}; choose another folder with -o"
            ) from None
        return self

    def _make(self, folder: pathlib.Path) -> None:
        if not folder.is_dir():
            if folder.parent != folder:
                self._make(folder.parent)
            try:
                folder.mkdir()
            except FileExistsError:  # another command may make the same folder at this moment
                if not folder.is_dir():
                    raise
            else:
                self._made.append(folder)

    def _remove_made(self) -> None:
        for folder in reversed(self._made):
            try:
                folder.rmdir()
            except OSError:  # somebody else has put something there
                return

    def path(self, name: str) -> pathlib.Path:
        """Where to write the file `name` for now."""
        self.files.append(self.folder / name)
        return self._temporary / name

    def elsewhere(self, file: pathlib.Path, option: str) -> pathlib.Path:
        """Where to write the file that an option names, in any folder, for now.

        Raises:
            UserError: no file of this name can be written there.
        """
        if not file.parent.is_dir():
            raise UserError(f"{option}: {file.parent} is no folder; give the name of a file")
        if file.is_dir():
            raise UserError(f"{option}: {file} is a folder; give the name of a file")
        if not os.access(file if file.exists() else file.parent, os.W_OK):
            raise UserError(f"{option}: cannot write {file}; choose another file")
        self._elsewhere[file] = self._temporary / f"elsewhere-{len(self._elsewhere)}"
        return self._elsewhere[file]

    def json(self, name: str, data: Any) -> None:
        """Write the command's JSON file; `--json` will print it."""
        self._result = json_text(data)
        self.path(name).write_text(self._result + "\n", encoding="utf-8")

    def __exit__(self, kind: type | None, error: BaseException | None, trace: Any) -> None:
        try:
            if kind is None:
                for file in self.files:
                    os.replace(self._temporary / file.name, file)
                for file, temporary in self._elsewhere.items():
                    if temporary.exists():
                        shutil.move(temporary, file)
                        self.files.append(file)
        except OSError as failed:
            raise UserError(f"cannot write into {self.folder}: {failed.strerror}") from None
        finally:
            shutil.rmtree(self._temporary, ignore_errors=True)
            if kind is not None:
                self._remove_made()

    def present(self, args: argparse.Namespace, summary: str) -> None:
        """Print the result: JSON alone with `--json`, else the summary and the files' names."""
        if args.json:
            print(self._result)
        else:
            print(f"{summary}\n\nwritten: {', '.join(str(file) for file in self.files)}")


def json_text(data: Any) -> str:
    """Valid JSON: numbers that are not finite become null."""
    return json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False)


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if hasattr(data, "tolist"):
        return _plain(data.tolist())
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data


def table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Columns of text, numbers to the right."""
    rows = [tuple(map(str, row)) for row in rows]
    whole = [tuple(header), *rows] if header else rows
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    right = [all(_is_number(row[k]) for row in rows) for k in range(len(widths))]
    lines = [
        "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(row, widths, right, strict=True)
        ).rstrip()
        for row in whole
    ]
    return "\n".join(lines)


def _is_number(text: str) -> bool:
    return not text or text[0].isdigit() or (text[0] in "+-" and text[1:2].isdigit())
