"""What commands leave behind: files, all of them or none, and a result on standard output."""

import argparse
import contextlib
import json
import math
import os
import pathlib
import re
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import Any

from diffsea.errors import UserError
from diffsea.outside.durable import errors_placed, replace_for_good
from diffsea.outside.printable import escaped_json, printable
from diffsea.outside.unfinished import unfinished_folder


_LONGEST_NAME = 255  # bytes of a file's name on the usual file systems


class Outputs:
    """The files of one command: all of them appear in the folder at the end, or none.

        with Outputs(args.output) as out:
            out.json("fit.json", {...})
            out.text("vessel.toml", ...)
        out.present(args, "summary for a person")

    Whatever is raised within leaves nothing behind. A folder that cannot be written is told
    on entering, before any work is done.
    """

    def __init__(self, folder: pathlib.Path):
        """The files of a folder, which is made on entering where it is not there."""
        self.folder = pathlib.Path(folder)
        self.files: list[pathlib.Path] = []
        self._elsewhere: dict[pathlib.Path, pathlib.Path] = {}
        self._unfinished = contextlib.ExitStack()
        self._result = "null"

    def __enter__(self) -> "Outputs":
        self._made = [p for p in (self.folder, *self.folder.parents) if not os.path.exists(p)]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._temporary = self._unfinished.enter_context(unfinished_folder(self.folder))
        except OSError as error:
            self._remove_folders()
            raise UserError(
                f"cannot write into {self.folder}: {error.strerror}; choose another folder with -o"
            ) from None
        return self

    def _remove_folders(self) -> None:
        for folder in self._made:
            with contextlib.suppress(OSError):  # somebody else has put something there
                folder.rmdir()

    def path(self, name: str) -> pathlib.Path:
        """Where to write the file `name` for now.

        Raises:
            UserError: the name is longer than file systems take.
        """
        if len(os.fsencode(name)) > _LONGEST_NAME:
            raise UserError(f"the file name {name} is too long to be written; shorten the input's")
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
        try:
            folder = self._unfinished.enter_context(unfinished_folder(file.parent))
        except OSError as error:
            raise UserError(f"{option}: cannot write {file}: {error.strerror}") from None
        self._elsewhere[file] = folder / file.name
        return self._elsewhere[file]

    def text(self, name: str, text: str) -> pathlib.Path:
        """Write a file of text; returns where it is for now.

        Halves of characters, of names that are not UTF-8, are written as their codes.
        """
        path = self.path(name)
        path.write_text(text, encoding="utf-8", errors="backslashreplace")
        return path

    def json(self, name: str, data: Any) -> None:
        """Write the command's JSON file; `--json` will print it.

        Arguments:
            data: dictionaries, lists, numbers, arrays; numbers that are not finite become null.
        """
        self._result = json_text(data)
        self.text(name, self._result + "\n")

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        places = {self._temporary: self.folder}
        places |= {part.parent: file.parent for file, part in self._elsewhere.items()}
        finished = False
        try:
            with errors_placed(places, self.folder):
                if isinstance(error, OSError):
                    raise error
                if error is None:
                    self._finish()
                    finished = True
        except OSError as failed:
            if failed is not error:  # else it has nothing to do with what is written
                raise UserError(f"cannot write {failed.filename}: {failed.strerror}") from None
        finally:
            self._unfinished.close()
            if not finished:
                self._remove_folders()

    def _finish(self) -> None:
        """Put every file in its place, or none.

        Raises:
            OSError: one cannot be.
            UserError: a folder stands in the way of one.
        """
        for file in self.files:
            if file.is_dir():
                raise UserError(f"cannot write into {self.folder}: {file.name} is a folder there")
        moves = [(self._temporary / file.name, file) for file in self.files]
        elsewhere = {t: file for file, t in self._elsewhere.items() if t.exists()}
        replace_for_good([*moves, *elsewhere.items()])
        self.files += elsewhere.values()

    def present(
        self, args: argparse.Namespace, summary: str, following: Sequence[str] = ()
    ) -> None:
        """Print the result: JSON alone with `--json`, else the summary and the files' names.

        Called after the block: by then the files lie in their folder. `following` are the commands
        that go on from here, a line each.
        """
        if args.json:
            print(self._result)
        else:
            written = ", ".join(str(file) for file in self.files)
            lines = [f"{'      ' if k else 'next: '}{one}" for k, one in enumerate(following)]
            parts = [summary, "\n".join(lines), f"written: {written}"]
            print(printable("\n\n".join(filter(None, parts))))


def json_text(data: Any) -> str:
    """The data as JSON."""
    text = json.dumps(_json_value(data), indent=2, ensure_ascii=False, allow_nan=False)
    return escaped_json(text)


def _json_value(data: Any) -> Any:
    """The data as JSON has it: text as keys, lists, null for numbers that are not finite."""
    if isinstance(data, dict):
        return {str(key): _json_value(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_json_value(value) for value in data]
    if hasattr(data, "tolist"):
        return _json_value(data.tolist())
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data


def table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Columns of text, those of numbers to the right; no line ends in blanks.

    Arguments:
        rows: at least one; their cells are shown as they are, whatever brackets they have.
        header: above the columns.
    """
    import rich.table
    from rich.console import Console
    from rich.text import Text

    def is_number(cell: str) -> bool:
        return re.match(r"[+-]?\d|$", cell) is not None

    rows = [tuple(map(str, row)) for row in rows]
    grid = rich.table.Table.grid(padding=(0, 2, 0, 0), pad_edge=False)
    for column in zip(*rows, strict=True):
        grid.add_column(justify="right" if all(map(is_number, column)) else "left", no_wrap=True)
    for row in [tuple(header), *rows] if header else rows:
        grid.add_row(*map(Text, row))
    widest = sum(max(map(len, column)) + 2 for column in zip(header or rows[0], *rows, strict=True))
    console = Console(width=widest, color_system=None, force_terminal=False)
    with console.capture() as captured:
        console.print(grid)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())
