"""Questions of `diffsea new` in a terminal, for what no option says."""

import argparse
import itertools
import pathlib
import sys
from collections.abc import Callable
from typing import Any

from diffsea.cli import options
from diffsea.errors import UserError


HULLS = ("catamaran", "monohull", "barge", "ship")  # as the library has them
UNITS = ("us", "percent", "normalised", "rpm", "rev/s", "N")
BY_SHAFT = ("rpm", "rev/s")  # orders in which need the largest shaft speed


def ask_what_is_missing(
    args: argparse.Namespace, check_target: Callable[[pathlib.Path, bool], None]
) -> None:
    """Ask in the terminal for what was not given; an empty answer takes the default in brackets.

    Arguments:
        check_target: refuses a file that is there or cannot be written: another one is asked for.

    Raises:
        UserError: the input ends.
    """
    _ask_for_the_file(args, check_target)
    if args.hull is None:
        known = options.OneOf(HULLS, "hull form")
        args.hull = _ask(f"hull form ({', '.join(HULLS)})", "catamaran", known)
    args.length = args.length or _ask("length of the waterline, m", None, options.positive)
    args.beam = args.beam or _ask("beam over all, m", None, options.positive)
    if args.mass is None and args.draught is None:
        args.mass = _ask("mass as she sails, kg", None, options.positive)
    if args.top_speed is None:
        args.top_speed = _ask("top speed, m/s", "not known", _or_unknown)
    if args.thrusters is None and args.rudder is None and not args.azimuth:
        usual = "rudder" if args.hull in ("monohull", "ship") else "thrusters"
        drives = options.OneOf(("thrusters", "rudder"), "drive")
        if _ask("steered by (thrusters, rudder)", usual, drives) == "rudder":
            args.rudder = _ask("area of the rudder, m^2", "not known", _or_unknown), None
        else:
            spacing = _ask("metres between the thrusters", "not known", _or_unknown)
            args.thrusters = spacing or 0.5 * args.beam
    if args.hull == "ship" and args.thrusters is None and args.shaft_speed is None:
        args.shaft_speed = _ask("largest shaft speed, rev/s", "not known", _or_unknown)
    if args.unit is None and args.log is None and args.hull != "ship":
        unit = options.OneOf(UNITS, "unit")
        args.unit = _ask(f"motors are ordered in ({', '.join(UNITS)})", "us", unit)
    if args.unit in BY_SHAFT and args.shaft_speed is None:
        args.shaft_speed = _ask("largest shaft speed, rev/s", None, options.positive)


def _ask_for_the_file(
    args: argparse.Namespace, check_target: Callable[[pathlib.Path, bool], None]
) -> None:
    """Ask for the file to write, again where it is refused, before anything else is asked."""
    usual = pathlib.Path("boat.toml")
    while True:
        if args.file is None:
            args.file = _ask("file to write", _free_name(usual), pathlib.Path)
        try:
            return check_target(args.file, args.force)
        except UserError as error:
            print(f"  {error}", file=sys.stderr)
            usual, args.file = args.file, None


def _free_name(file: pathlib.Path) -> pathlib.Path:
    """The file, or where it is there already the first numbered one that is not."""
    numbered = (file.with_stem(f"{file.stem}-{number}") for number in itertools.count(2))
    return file if not file.exists() else next(one for one in numbered if not one.exists())


def _or_unknown(text: str) -> float | None:
    return None if text == "not known" else options.positive(text)


def _ask(question: str, default: Any, kind: Callable[[str], Any]) -> Any:
    """An answer from the terminal, asked again until it is one.

    Raises:
        UserError: the input ends.
    """
    shown = question if default is None else f"{question} [{default}]"
    while True:
        print(f"{shown}: ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise UserError("the input ended before everything was known; nothing was written")
        answer = line.strip() or (None if default is None else str(default))
        if answer is None:
            continue
        try:
            return kind(answer)
        except argparse.ArgumentTypeError as error:
            print(f"  {error}", file=sys.stderr)
