"""`diffsea completion`: a script by which a shell completes commands, options and files."""

import argparse
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from diffsea.cli import options
from diffsea.errors import UserError


SHELLS = ("bash", "zsh", "fish", "tcsh")  # that shtab writes for

Kind = Mapping[str, Any]  # of a completion: what each shell does, as shtab takes it


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "a script for completion in bash, zsh, fish or tcsh"
    parser = options.add_command(commands, "completion", completion_command, summary, writes=False)
    shells = options.OneOf(SHELLS, "shell")
    parser.add_argument("shell", metavar="SHELL", type=shells, help=", ".join(SHELLS))


def completion_command(args: argparse.Namespace) -> None:
    """Print a script that completes commands, options, shipped vessels, files and folders. A shell
    reads it when it starts, and completing starts no Python. Needs the extra `completion`.

    examples:
      diffsea completion bash > ~/.local/share/bash-completion/completions/diffsea
      diffsea completion zsh > ~/.zfunc/_diffsea     # with fpath+=~/.zfunc before compinit
      diffsea completion fish > ~/.config/fish/completions/diffsea.fish
    """
    try:
        import shtab
    except ImportError:
        raise UserError(
            "completion needs the package shtab: pip install 'diffsea[completion]'"
        ) from None
    from diffsea.cli import make_parser, shipped_names

    parser = make_parser()
    vessel = _file_or(shipped_names(), shtab.FILE)
    _say_what_completes(parser, {"vessel": vessel, "file": shtab.FILE, "folder": shtab.DIRECTORY})
    print(shtab.complete(parser, args.shell))


def _say_what_completes(parser: argparse.ArgumentParser, kinds: dict[str, Kind]) -> None:
    """Give every argument the words that can stand there, or which kind of path can."""
    for action in parser._actions:
        kind = None
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _say_what_completes(command, kinds)
        elif isinstance(action.type, options.OneOf):
            action.choices = action.type.names
        elif action.dest == "vessel":
            kind = kinds["vessel"]
        elif action.type is pathlib.Path:
            kind = kinds["folder" if action.dest == "output" else "file"]
        if kind is not None:
            vars(action)["complete"] = kind  # where shtab looks for it


def _file_or(names: Sequence[str], file: Kind) -> Kind:
    """A completion of names as well as files, in each shell's own words."""
    words = " ".join(names)
    return {
        "bash": "_diffsea_vessels",
        "preamble": {"bash": f'_diffsea_vessels() {{ compgen -W "{words}" -f -- "$1"; }}\n'},
        "zsh": f"{{compadd {words}; _files}}",
        "fish": f"(string split ' ' '{words}'; __fish_complete_path (commandline -ct))",
        "tcsh": file["tcsh"],
    }
