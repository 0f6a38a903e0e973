"""The commands that go on from a check, or from a diagnosis.

From a check a vessel file, and a diagnosis of the logs by it.
"""

import argparse
import math
import pathlib
import re
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from diffsea.channels import is_azimuth, steers


if TYPE_CHECKING:
    from diffsea.checks import LogCheck

    Checked = tuple[pathlib.Path, LogCheck]


_PROPELLED = "--hull ship"  # a propeller's shaft, ordered in rev/s, and a rudder
_ANY_SHARE = 1.5  # of full order, that a throttle in shares of one may exceed
_STEERED = "--rudder"  # and a motor, as an outboard's orders look, too


def following_commands(
    args: argparse.Namespace,
    checked: "Sequence[Checked]",
    mappings: Mapping[pathlib.Path, pathlib.Path],
) -> list[str]:
    """The commands; logs of one boat go into one of them.

    Where these are read through several mappings, it names the folder that has one for each. None
    for a boat that `diffsea new` has no drive for.

    Arguments:
        checked: the logs that could be read.
        mappings: the file by which a log is read, where it needs one; of logs that are read alike
            the same file.
    """
    alike: dict[str | None, list[Checked]] = {}
    for path, one in checked:
        boat = _drive(one) if path in mappings else None
        alike.setdefault(boat, []).append((path, one))
    lines: list[str] = []
    boats: dict[str, str] = {}
    for logs in alike.values():
        new = _new_boat(logs)
        if not new:
            continue
        boat = boats.setdefault(new, f"boat{len(boats) + 1 if boats else ''}.toml")
        lines.append(f"diffsea new {boat} {new}")
        if _STEERED in new:
            lines.append("(with an outboard: --azimuth outboard=X in place of --rudder)")
        for mapping, paths in _by_mapping([path for path, _ in logs], mappings).items():
            words = ["diffsea", "diagnose", boat, *map(str, paths)]
            words += [] if mapping is None else ["--mapping", str(mapping)]
            lines.append(shlex.join([*words, *reading_options(args)]))
    return list(dict.fromkeys(lines))


def _by_mapping(
    paths: Sequence[pathlib.Path], mappings: Mapping[pathlib.Path, pathlib.Path]
) -> dict[pathlib.Path | None, list[pathlib.Path]]:
    """Logs by what is named with them: the mapping of all, or the folder that has one for each."""
    files = {path: mappings.get(path) for path in paths}
    given = set(files.values())
    folders = {file.parent for file in given if file is not None}
    told_by_name = None not in given and len({path.stem for path in mappings}) == len(mappings)
    if told_by_name and len(given) > 1 and len(folders) == 1:
        return {folders.pop(): list(paths)}
    found: dict[pathlib.Path | None, list[pathlib.Path]] = {}
    for path, file in files.items():
        found.setdefault(file, []).append(path)
    return found


def commands_after_diagnosis(
    args: argparse.Namespace, folder: pathlib.Path, record: dict[str, Any], in_order: bool = False
) -> list[str]:
    """What to do after a diagnosis that wrote into a folder: first put right how logs are read.

    Arguments:
        in_order: whether the recordings were on one clock.
    """
    from diffsea.report.wording.findings import misread_sentences
    from diffsea.report.wording.words import named_effects

    if misread_sentences(record):
        words = ["diffsea", "audit", *map(str, [*args.recordings, *args.test]), *read_so(args)]
        repaired = folder / "repaired"
        return [
            "put right first how the recordings are read, on which all of this rests",
            shlex.join([*words, "--repair", "-o", str(repaired)]),
            f"and diagnose what it writes into {repaired}, the same runs held out",
        ]
    lines = []
    if named_effects(record):
        lines.append(f"diffsea predict {shlex.quote(str(folder / 'vessel.toml'))} ANOTHER_RUN")
    several = len(args.recordings) + len(args.test) > 1
    if several and not in_order and record["verdict"] == "unexplained":
        strongest = next((one for one in record["where"] if not one["in_regime"]), None)
        perhaps = "" if strongest is None else f" ({strongest['recording']}?)"
        lines += [
            "the same with --one-after-another, if the recordings were made in this order:",
            f"what changed in one{perhaps} may have stayed so after it",
        ]
    return lines


def read_so(args: argparse.Namespace) -> list[str]:
    """The words by which another command reads the same: mapping and stretch."""
    mapping = [] if args.mapping is None else ["--mapping", str(args.mapping)]
    return [*mapping, *reading_options(args)]


def reading_options(args: argparse.Namespace) -> list[str]:
    """The words of a command line by which the same stretch is read."""
    ends = {"--start": args.start, "--end": args.end}
    return [word for key, end in ends.items() if end is not None for word in (key, f"{end:g}")]


def _new_boat(logs: "Sequence[Checked]") -> str:
    """The options by which `diffsea new` makes a vessel that takes the orders of logs, or nothing.

    Logs of one boat; a shaft turns as fast as in any of them.
    """
    path, one = logs[0]
    drive = _drive(one)
    log = f" --log {shlex.quote(str(path))}" if one.log.startswith("ardupilot") else ""
    fastest = max((_largest_order(each, "propeller") for _, each in logs), default=0.0)
    shaft = f" --shaft-speed {_rounded_up(fastest):g}" if fastest and drive == _PROPELLED else ""
    shaft = shaft or (_azimuth_unit(logs) if _azimuths(one) else "")
    return f"--length M --beam M --mass KG {drive}{shaft}{log}" if drive else ""


def _drive(one: "LogCheck") -> str:
    """The options of what drives and steers the boat of a log, or nothing where none fits."""
    orders = {name.lower() for name in (*one.run.commanded, *one.run.executed)}
    unit = _unit_option(one)
    if orders == {"port", "starboard"}:
        return f"--thrusters M{unit}"
    if orders == {"rudder", "motor"}:
        return f"{_STEERED}{unit}"
    if turning := _azimuths(one):
        return " ".join(f"--azimuth {name}=X" for name in turning)
    return _PROPELLED if orders in ({"rudder", "propeller"}, {"rudder"}) else ""


def _azimuths(one: "LogCheck") -> list[str]:
    """The names of azimuth thrusters, where a boat has no other drive."""
    orders = {*one.run.commanded, *one.run.executed}
    names = [name.removesuffix(".angle") for name in sorted(filter(is_azimuth, orders))]
    known = {f"{name}.{part}" for name in names for part in ("force", "angle")}
    return names if orders == known else []


def _azimuth_unit(logs: "Sequence[Checked]") -> str:
    """The unit of azimuth thrusters' orders; with their largest where a column says rpm."""
    _, one = logs[0]
    columns = [one.channels.get(f"{p}{n}.force") for n in _azimuths(one) for p in ("cmd_", "exec_")]
    told = [column for column in columns if column is not None]
    if not told or not all("rpm" in column.source.lower() for column in told):
        return _unit_option(one)
    names = [f"{name}.force" for name in _azimuths(one)]
    fastest = max(_largest_order(each, name) for _, each in logs for name in names)
    return f" --unit rpm --shaft-speed {_rounded_up(fastest / 60):g}" if fastest else ""


def _largest_order(one: "LogCheck", channel: str) -> float:
    """The largest size of an order; zero where there is none."""
    orders = (one.run.commanded or one.run.executed).get(channel)
    sizes = [] if orders is None else [abs(order) for order in orders.tolist()]
    return max((size for size in sizes if math.isfinite(size)), default=0.0)


def _rounded_up(size: float) -> float:
    """To three digits."""
    last = 10.0 ** (math.floor(math.log10(size)) - 2)
    return math.ceil(size / last - 1e-9) * last


def _unit_option(one: "LogCheck") -> str:
    """The unit of thrusters' orders as an option, where it is not that of a pulse width."""
    known = {scale.unit for scale in one.scales.values()}
    if known <= {"us"}:
        return ""
    if known == {"normalised"}:
        return " --unit normalised"
    from diffsea.recordings.mapping_proposal import suggest_labels

    orders = {
        name: suggest_labels(column.source)
        for channel, column in one.channels.items()
        if channel.startswith("cmd_") and not steers(name := channel.removeprefix("cmd_"))
    }
    percents = [
        told.unit == "%"
        or ("throttle" in told.words and _ANY_SHARE < _largest_order(one, name) <= 100)
        for name, told in orders.items()
    ]
    if percents and all(percents):
        return " --unit percent"
    columns = [one.channels[name] for name in one.channels if name.startswith(("cmd_", "exec_"))]
    forces = [
        column.unit == "N" or "force" in re.split(r"[^a-z]+", column.source.lower())
        for column in columns
    ]
    return f" --unit {'N' if any(forces) else 'UNIT'}"
