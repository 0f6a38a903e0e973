"""Logs checked as they are, without a mapping or a vessel."""

import contextlib
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

from diffsea.channels import is_azimuth, is_rudder, side_of
from diffsea.checks import LogCheck, check_run
from diffsea.errors import UserError, nearest
from diffsea.recordings import (
    Finding,
    Mapping,
    audit_set,
    logs,
    read_mapping,
    read_recording,
    unreadable,
)
from diffsea.recordings.auditing.mapping_rows import mapping_text
from diffsea.recordings.geodesy import PlaceNote
from diffsea.recordings.known import Recognised, recognise
from diffsea.recordings.mapping_proposal import (
    SURE,
    Proposal,
    foreign_layouts,
    native_with_guessed_actuators,
    propose_mapping,
    with_guessed_actuators,
)
from diffsea.recordings.mappings import (
    CHANNEL_DIMENSIONS,
    check_stems,
    mapping_path,
)
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Trajectory


_SI = {"time": "s", "length": "m", "angle": "rad", "angular rate": "rad/s", "speed": "m/s"}
_SI |= {"ratio": "1"}


@dataclasses.dataclass(frozen=True)
class ChosenMapping:
    """How a log is read.

    Attributes:
        mapping: None of a table with native columns.
        text: the mapping as a file, None where the user or nobody gave it.
        text_without_place: the same without where on the earth the log is from.
        told: which it is, for people.
        known: what the log was recognised as.
        guesses: channels of a proposed mapping that are no more than guessed, and why.
    """

    mapping: Mapping | None
    text: str | None
    text_without_place: str | None
    told: str
    known: Recognised | None = None
    guesses: tuple[str, ...] = ()


def choose_mappings(
    paths: Sequence[Path], mapping: Path | None = None
) -> dict[Path, ChosenMapping | Finding]:
    """How each log is read: the mapping that is given, else one by content, else a proposed one.

    A log that cannot be read at all has the finding that says why.

    Raises:
        UserError: the mapping that is given cannot be read.
    """
    if mapping is not None:
        if not mapping.is_dir():
            given = read_mapping(mapping)
            return {path: ChosenMapping(given, None, None, f"through {mapping}") for path in paths}
        check_stems(mapping, paths)
        own = {path: mapping_path(mapping, path) for path in paths}
        rest = choose_mappings([path for path, file in own.items() if file is None])
        return rest | {
            path: ChosenMapping(read_mapping(file), None, None, f"through {file}")
            for path, file in own.items()
            if file is not None
        }
    chosen: dict[Path, ChosenMapping | Finding] = {}
    for path in paths:
        if not path.exists():
            siblings = [item.name for item in path.parent.glob("*")]
            why = f"there is no recording {path}{nearest(path.name, siblings)}"
            chosen[path] = unreadable(path.name, why)
            continue
        try:
            known = recognise(path)
        except UserError as error:
            chosen[path] = unreadable(path.name, str(error))
            continue
        if known is not None:
            chosen[path] = _as_recognised(known)
        else:
            columns = "without a mapping" if logs.is_log(path) else "native columns"
            chosen[path] = ChosenMapping(None, None, None, columns)
    for layout in foreign_layouts([p for p in paths if isinstance(chosen[p], ChosenMapping)]):
        try:
            proposals = propose_by_axes(layout)
        except UserError as error:
            chosen |= {path: unreadable(path.name, str(error)) for path in layout}
            continue
        for group, proposal in proposals:
            if not proposal.timed:
                why = (
                    "the file has no time, and nothing tells its sampling interval: propose a "
                    f"mapping by `diffsea audit {group[0]}`, put the interval (s) into its [file] "
                    "time_step, and name it with --mapping"
                )
                chosen |= {path: unreadable(path.name, why) for path in group}
                continue
            told = "through a mapping proposed from names and kinematics:\n" + proposal.summary
            if len(proposals) > 1:
                axes = {"earth": "north and east", "body": "along the vessel and to starboard"}
                told = f"velocities {axes[proposal.mapping.velocity_axes]}, {told}"
            texts = proposal.text, proposal.text_without_place
            how = ChosenMapping(proposal.mapping, *texts, told, guesses=proposal.guesses)
            chosen |= dict.fromkeys(group, how)
    return chosen | _with_guessed_actuators(chosen)


def _with_guessed_actuators(
    chosen: dict[Path, ChosenMapping | Finding],
) -> dict[Path, ChosenMapping]:
    """How those logs are read of which only the motion is known, where something seems to drive."""
    known, native, found = dict[Path, Recognised](), list[Path](), dict[Path, ChosenMapping]()
    for path, how in chosen.items():
        if isinstance(how, ChosenMapping) and how.known is not None:
            known[path] = how.known
        elif isinstance(how, ChosenMapping) and how.mapping is None:
            native.append(path)
    for path, (log, guesses) in with_guessed_actuators(known).items():
        found[path] = _as_recognised(log, guesses)
    for path, (mapping, notes, doubtful) in native_with_guessed_actuators(native).items():
        told = "native columns, and columns that drive the vessel by their names"
        text = mapping_text(mapping, ["Native columns, and guessed ones of actuators.", *notes])
        found[path] = ChosenMapping(mapping, text, text, told, guesses=doubtful)
    return found


def _as_recognised(known: Recognised, guesses: tuple[str, ...] = ()) -> ChosenMapping:
    """The mapping of a log whose format is known; its text is that of any log of this kind."""
    return ChosenMapping(known.mapping, known.text, known.text, known.sentence, known, guesses)


def propose_by_axes(files: Sequence[Path]) -> list[tuple[Sequence[Path], Proposal]]:
    """Mappings proposed for files of one layout: one for all, unless their velocities differ.

    Recorders change between axes of the vessel and of the earth from one day to another. Where
    velocities are no more than likely, or the audit finds the axes wrong in some of the files that
    are read alike, each is asked alone.

    Raises:
        UserError: nothing can be proposed.
    """
    together = propose_mapping(files)
    if len(files) == 1 or not together.timed:
        return [(files, together)]
    doubted = any(together.sure.get(channel, SURE) < SURE for channel in ("u", "v"))
    if not doubted and not _has_wrong_axes(files, together.mapping):
        return [(files, together)]
    by_axes: dict[str, list[Path]] = {}
    for path in files:
        axes = together.mapping.velocity_axes
        with contextlib.suppress(UserError):  # too little of it to be asked alone: as the others
            axes = propose_mapping(path).mapping.velocity_axes
        by_axes.setdefault(axes, []).append(path)
    if len(by_axes) < 2:
        return [(files, together)]
    return [(group, propose_mapping(group)) for group in by_axes.values()]


def _has_wrong_axes(files: Sequence[Path], mapping: Mapping) -> bool:
    """Whether the audit finds velocities in other axes, in any file that can be read so."""
    runs = []
    for path in files:
        with contextlib.suppress(UserError):  # told by who reads them in earnest
            runs.append(read_recording(path, mapping))
    return any(one.kind == "axes" for found in audit_set(runs) for one in found)


@one_blas_thread
def check_logs(
    paths: Sequence[Path],
    chosen: dict[Path, ChosenMapping | Finding],
    start: float | None = None,
    end: float | None = None,
    hide_place: bool = False,
) -> list[LogCheck | Finding]:
    """The check of each log of one boat, in order; a broken one is the finding that says why.

    With `hide_place` positions count from the first one, and no origin is told.

    Raises:
        UserError: none of the logs can be read.
    """
    read: list[tuple[Trajectory, ChosenMapping] | Finding] = []
    for path in paths:
        how = chosen[path]
        if isinstance(how, Finding):
            read.append(how)
            continue
        try:
            run = read_recording(path, how.mapping, start, end)
        except UserError as error:
            read.append(unreadable(path.name, str(error)))
            continue
        read.append((_without_place(run) if hide_place else run, how))
    broken = [one.message for one in read if isinstance(one, Finding)]
    if len(broken) == len(read):
        several = f"none of the {len(broken)} logs can be read:\n  " if len(broken) > 1 else ""
        raise UserError(several + "\n  ".join(broken))
    judged = iter(audit_set([one[0] for one in read if not isinstance(one, Finding)]))
    checks: list[LogCheck | Finding] = []
    for path, one in zip(paths, read, strict=True):
        if isinstance(one, Finding):
            checks.append(one)
            continue
        run, how = one
        outputs = how.known.outputs if how.known else ()
        missing = tuple(how.known.missing.values()) if how.known else _unmapped_orders(run)
        named = _format_of(path, how, run)
        sources = _sources(how)
        checks.append(check_run(run, next(judged), named, sources, outputs, missing, how.guesses))
    return checks


def _without_place(run: Trajectory) -> Trajectory:
    """The run from where it began, without the origin among its notes."""
    notes = tuple(note for note in run.provenance if not isinstance(note, PlaceNote))
    moved = {}
    for axis in ("x", "y"):
        series = getattr(run, axis)
        known = [value for value in series if value == value]
        moved[axis] = series - known[0] if known else series
    return dataclasses.replace(run, **moved, provenance=notes)


def _unmapped_orders(run: Trajectory) -> tuple[str, ...]:
    """Which columns of a table may be the orders, where none is known as one, or what drives."""
    unused = run.read.unused_columns
    known = {name.lower() for name in (*run.commanded, *run.executed)}
    if known and all(map(is_rudder, known)):
        return (
            "no column is known as the order of a propeller or motor; where it never changed, say "
            "so under [columns] of the mapping, in rev/s or the unit of the motor: "
            "cmd_propeller = { constant = VALUE }",
        )
    if known or not unused:
        return ()
    why = "no column is known as an order or as executed actuation"
    how = (
        "if one is, name it in the mapping as cmd_port and cmd_starboard, or cmd_rudder and "
        "cmd_motor"
    )
    return (f"{why}; columns not used: {', '.join(unused)}; {how}",)


def _format_of(path: Path, how: ChosenMapping, run: Trajectory) -> tuple[str, str, str]:
    """The name of a log's format, the same for people, and the craft."""
    if how.known is not None:
        guessed = not how.known.outputs and (run.commanded or run.executed)
        craft = craft_of([*run.commanded, *run.executed]) if guessed else how.known.craft
        return how.known.log, how.known.title, craft
    form = logs.format_of(path)
    name = form.name if form else path.suffix.lower().removeprefix(".") or "table"
    title = "a table with native columns" if how.mapping is None else "a table through a mapping"
    return (
        name,
        f"{title} ({name})" if form is None else name,
        craft_of([*run.commanded, *run.executed]),
    )


def craft_of(actuators: Iterable[str]) -> str:
    """The kind of vessel by the names of its actuators."""
    names = {name.lower() for name in actuators}
    rudders = set(filter(is_rudder, names))
    shafts = {n for n in names if any(word in n for word in ("propeller", "shaft"))} - rudders
    azimuths = {name.removesuffix(".angle") for name in filter(is_azimuth, names)}
    others = {n for n in names if n.partition(".")[0] not in azimuths} - rudders - shafts
    sides = [{n for n in others if side_of(n) == side} for side in ("port", "starboard")]
    parts = []
    if all(len(side) == 1 for side in sides):
        parts.append("two thrusters, port and starboard")
        others -= sides[0] | sides[1]
    parts.append(_counted(len(azimuths), "azimuth thruster"))
    parts.append(_counted(len(shafts), "propeller"))
    parts.append(_counted(len(rudders), "rudder"))
    if others:
        parts.append(f"{_counted(len(others), 'actuator')} ({', '.join(sorted(others))})")
    parts = [part for part in parts if part]
    if not parts:
        return "vessel whose actuators were not recorded"
    first, last = ", ".join(parts[:-1]), parts[-1]
    return f"vessel with {f'{first} and ' if first else ''}{last}"


def _counted(number: int, word: str) -> str:
    numbers = ("", "a" if word[0] not in "aeiou" else "an", "two", "three", "four")
    if number == 0:
        return ""
    counted = numbers[number] if number < len(numbers) else str(number)
    return f"{counted} {word}{'s' * (number > 1)}"


def _sources(how: ChosenMapping) -> dict[str, tuple[str, str]]:
    """Column and unit of each channel, as they stand in the log, or that it never changed."""
    if how.mapping is None:
        return {name: (name, _SI.get(unit, "")) for name, unit in CHANNEL_DIMENSIONS.items()}
    found = {}
    orders = (
        {}
        if how.known is None
        else dict.fromkeys((f"cmd_{output.channel}" for output in how.known.outputs), "us")
    )
    swapped = {"latitude": "x", "longitude": "y"}
    for name, column in how.mapping.ned_channels.items():
        unit = column.unit or orders.get(name) or _SI.get(CHANNEL_DIMENSIONS.get(name, ""), "")
        found[swapped.get(name, name)] = (" and ".join(column.names), unit)
    for name in how.mapping.constants:
        found[name] = ("constant, by the mapping", _SI.get(CHANNEL_DIMENSIONS.get(name, ""), ""))
    return found
