"""Differentiable simulation, identification and diagnosis of surface vessels.

A VESSEL is a TOML file, or the name of a vessel that ships with the package:
{vessels}.
A RECORDING is one run as CSV or Parquet; --mapping reads files with other columns.

examples:
  diffsea new boat.toml --length 1.4 --beam 0.93 --mass 22 --thrusters 0.66
  diffsea show otter
  diffsea trial otter --manoeuvre zigzag --angle 20 --heading 20
  diffsea check boat.bin
  diffsea campaign otter
  diffsea metrics run1.csv run2.csv --length 4.9
  diffsea audit field/*.csv --mapping field.toml
  diffsea predict usv.toml run1.csv
  diffsea fit usv.toml run1.csv run2.csv --test run3.csv
  diffsea diagnose usv.toml run*.csv
  diffsea online usv.toml run1.csv
  diffsea sensitivity kvlcc2 --manoeuvre zigzag
  diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
  diffsea run examples/missions/survey_in_a_tide.toml
  diffsea export otter --to mss

diffsea COMMAND --help tells more. Exit status: 0 done, 1 the work failed (the message says
what to do), 2 bad usage.
"""

# The docstring above is the text of `diffsea --help`. This room may import every other one.
# Commands import what they need when they run, so that help is quick and XLA's flags can be set
# before JAX starts.

import argparse
import contextlib
import importlib
import importlib.metadata
import os
import pathlib
import sys
import time
import traceback
from collections.abc import Sequence

from diffsea.cli.grammar import GREETING, Parser
from diffsea.cli.options import parts_folder
from diffsea.errors import UserError
from diffsea.outside.printable import printable
from diffsea.outside.sizes import DEFAULT_LIMIT, size_limit
from diffsea.runtime import prepare_jax


# Modules with a `register(commands)`; the order is that of the help.
COMMAND_MODULES = (
    "vessels.new",
    "trial",
    "check",
    "recordings",
    "identification",
    "studies.sweeping",
    "studies.sensitivity",
    "studies.running",
    "segments",
    "service.online",
    "service.metamodel",
    "service.fleet",
    "vessels.export",
    "vessels.show",
    "completion",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    Arguments:
        argv: the words after `diffsea`; those of the process if None.

    Without any word it greets, with the commands to begin with.

    **Returns:** 0 done, 1 the work failed, 2 bad usage, 130 interrupted. Messages go to standard
    error, and whatever fails leaves no files behind.
    """
    debug, kept, began = False, None, time.time()
    try:
        words = sys.argv[1:] if argv is None else list(argv)
        if not words:
            print(GREETING, end="")
            return 0
        args = make_parser().parse_args(words)
        debug = args.debug
        kept = parts_folder(args) if hasattr(args, "parts") else None
        prepare_jax()  # the settings alone; a command that needs JAX starts it by importing it
        with size_limit(getattr(args, "max_size", None) or DEFAULT_LIMIT):
            args.run(args)
        sys.stdout.flush()
        return 0
    except SystemExit as ended:  # after help, or a usage error that argparse has told
        return int(ended.code or 0)
    except UserError as error:
        print(printable(f"diffsea: error: {error}"), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        told = "diffsea: interrupted; nothing was written"
        if kept is not None and any(file.stat().st_mtime >= began for file in kept.glob("*")):
            told += f", but what was done is kept in {kept}: the same command goes on from there"
        print(printable(told), file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone: no message, no traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError:
        print("diffsea: error: not enough memory; read less, or lower --max-size", file=sys.stderr)
        return 1
    except OSError as error:  # a name too long, a disk that is full or fails
        if debug or error.strerror is None:
            traceback.print_exc()
        told = f"{error.filename}: {error.strerror}; nothing was written"
        if error.filename is None:  # files have names: this is what was printed
            told = f"cannot write to standard output: {error.strerror or error}"
            with contextlib.suppress(OSError, ValueError):  # what it holds back is lost
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(printable(f"diffsea: error: {told}"), file=sys.stderr)
        return 1
    except Exception as error:
        if debug:
            traceback.print_exc()
        hint = "" if debug else " Run it again with --debug for the whole traceback."
        told = (
            f"diffsea: this is a bug: {type(error).__name__}: {error}\n"
            f"Nothing was written. Please report it.{hint}"
        )
        print(printable(told), file=sys.stderr)
        return 1


def shipped_names() -> list[str]:
    """Names of the vessels that ship, found without importing what reads them."""
    folder = pathlib.Path(__file__).parents[1] / "vessel"
    return sorted(file.stem for file in folder.rglob("*.toml"))


def make_parser() -> Parser:
    """The grammar of the command line, with every command."""
    description, _, examples = (__doc__ or "").partition("\nexamples:\n")
    parser = Parser(
        prog="diffsea",
        description=description.format(vessels=", ".join(shipped_names())),
        epilog=f"examples:\n{examples}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    version = importlib.metadata.version("diffsea")
    parser.add_argument("--version", action="version", version=f"diffsea {version}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in COMMAND_MODULES:
        importlib.import_module(f"diffsea.cli.{name}").register(commands)
    return parser
