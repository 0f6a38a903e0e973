"""The commands that go on from a check: a vessel file, and a diagnosis of the logs by it."""

import argparse
import pathlib
import re
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING


if TYPE_CHECKING:
    from diffsea.checks import LogCheck

    Checked = tuple[pathlib.Path, LogCheck]


def following_commands(
    args: argparse.Namespace,
    checked: "Sequence[Checked]",
    mappings: Mapping[pathlib.Path, pathlib.Path],
) -> list[str]:
    """The commands; logs that are read through one mapping go into one of them.

    None for a boat that `diffsea new` has no drive for.

    Arguments:
        checked: the logs that could be read.
        mappings: the file by which a log is read, where it needs one; of logs that are read alike
            the same file.
    """
    alike: dict[pathlib.Path | None, list[Checked]] = {}
    for path, one in checked:
        alike.setdefault(mappings.get(path), []).append((path, one))
    lines: list[str] = []
    boats: dict[str, str] = {}
    for mapping, logs in alike.items():
        first, one = logs[0]
        new = _new_boat(one, first)
        if not new:
            continue
        boat = boats.setdefault(new, f"boat{len(boats) + 1 if boats else ''}.toml")
        words = ["diffsea", "diagnose", boat, *(str(path) for path, _ in logs)]
        words += [] if mapping is None else ["--mapping", str(mapping)]
        lines += [f"diffsea new {boat} {new}", shlex.join([*words, *reading_options(args)])]
    return list(dict.fromkeys(lines))


def reading_options(args: argparse.Namespace) -> list[str]:
    """The words of a command line by which the same stretch is read."""
    ends = {"--start": args.start, "--end": args.end}
    return [word for key, end in ends.items() if end is not None for word in (key, f"{end:g}")]


def _new_boat(one: "LogCheck", path: pathlib.Path) -> str:
    """The options by which `diffsea new` makes a vessel that takes a log's orders, or nothing."""
    orders = {name.lower() for name in (*one.run.commanded, *one.run.executed)}
    unit = _unit_option(one)
    if orders == {"port", "starboard"}:
        drive = f"--thrusters M{unit}"
    elif orders == {"rudder", "motor"}:
        drive = f"--rudder{unit}"
    elif orders in ({"rudder", "propeller"}, {"rudder"}):
        drive = "--hull ship"
    else:
        return ""
    log = f" --log {shlex.quote(str(path))}" if one.log.startswith("ardupilot") else ""
    return f"--length M --beam M --mass KG {drive}{log}"


def _unit_option(one: "LogCheck") -> str:
    """The unit of thrusters' orders as an option, where it is not that of a pulse width."""
    known = {scale.unit for scale in one.scales.values()}
    if known <= {"us"}:
        return ""
    if known == {"normalised"}:
        return " --unit normalised"
    columns = [one.channels[name] for name in one.channels if name.startswith(("cmd_", "exec_"))]
    forces = [
        column.unit == "N" or "force" in re.split(r"[^a-z]+", column.source.lower())
        for column in columns
    ]
    return f" --unit {'N' if any(forces) else 'UNIT'}"
