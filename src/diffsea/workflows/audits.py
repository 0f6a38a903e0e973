"""What all jobs share, recordings as given and results as tables; and the audit. Needs no JAX."""

import abc
import dataclasses
import html
import pathlib
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Any

import pandas as pd

from diffsea.errors import UserError
from diffsea.progress import Progress, no_progress
from diffsea.recordings import Finding, Mapping, audit_set, read_mapping, read_recording, unreadable
from diffsea.recordings.auditing.finding import weight
from diffsea.recordings.auditing.mapping_rows import with_rows_of_mapping
from diffsea.recordings.idle import used_parts
from diffsea.recordings.mappings import check_stems, mapping_for
from diffsea.trajectory import Trajectory


_DIGITS = "{:.4g}".format  # of numbers shown


class Tabulated(abc.ABC):
    """A record that prints as a headline, a short table and notes; as HTML in a notebook.

    A dataclass that derives from it is declared with `repr=False`, or its own representation
    would come first.
    """

    @abc.abstractmethod
    def headline(self) -> str:
        """What this is, in one line."""

    @abc.abstractmethod
    def rows(self) -> Sequence[dict[str, Any]]:
        """The table's rows, each from heading to cell."""

    def notes(self) -> Sequence[str]:
        """Sentences below the table."""
        return ()

    def to_frame(self) -> pd.DataFrame:
        """The table as a DataFrame."""
        return pd.DataFrame(list(self.rows()))

    def __repr__(self) -> str:
        table, lines = self.to_frame(), [self.headline()]
        if len(table):
            lines.append(table.to_string(index=False, na_rep="-", float_format=_DIGITS))
        return "\n".join([*lines, *self.notes()])

    def _repr_html_(self) -> str:
        table, parts = self.to_frame(), [f"<p><b>{html.escape(self.headline())}</b></p>"]
        if len(table):
            parts.append(table.to_html(index=False, border=0, na_rep="-", float_format=_DIGITS))
        return "".join([*parts, self._notes_html()])

    def _notes_html(self) -> str:
        return "".join(f"<p>{html.escape(note)}</p>" for note in self.notes())


Recording = Trajectory | pd.DataFrame | str | pathlib.Path


class Findings(Tabulated, Sequence[Finding]):
    """What an audit found, run by run; its table and notes have what matters most first."""

    def __init__(self, findings: Iterable[Finding], runs: Sequence[str]):
        self._findings = tuple(findings)
        self.runs = tuple(runs)

    def __getitem__(self, index: Any) -> Any:
        return self._findings[index]

    def __len__(self) -> int:
        return len(self._findings)

    def headline(self) -> str:
        count = len(self._findings)
        found = f"{count} finding{'s' * (count != 1)}" if count else "nothing found"
        return f"audit of {', '.join(self.runs)}: {found}"

    def rows(self) -> list[dict[str, Any]]:
        return [
            {
                "recording": one.recording,
                "kind": one.kind,
                "value": one.value,
                "+-": one.std,
                "unit": one.unit,
                "off in a minute (m)": one.cost,
            }
            for one in self._by_weight()
        ]

    def notes(self) -> list[str]:
        return [f"{one.recording}: {one.message}" for one in self._by_weight()]

    def _by_weight(self) -> list[Finding]:
        key = lambda one: weight(one.kind, one.doubt, one.cost)
        return sorted(self._findings, key=key, reverse=True)


def as_recording(
    given: Recording,
    mapping: Mapping | str | pathlib.Path | None = None,
    start: float | None = None,
    end: float | None = None,
) -> Trajectory:
    """A recording as it is, or read from a file or a DataFrame, from `start` to `end` (s).

    Raises:
        UserError: it cannot be read; says what is wrong, where, and what to do.
    """
    return given if isinstance(given, Trajectory) else read_recording(given, mapping, start, end)


def as_recordings(
    given: Recording | Iterable[Recording], mapping: Mapping | str | pathlib.Path | None = None
) -> list[Trajectory]:
    """One or several recordings, read where they are not yet; see `as_recording`."""
    several = [given] if isinstance(given, Recording) else given
    return [as_recording(one, mapping) for one in several]


def as_used_recordings(
    given: Recording | Iterable[Recording],
    mapping: Mapping | str | pathlib.Path | None = None,
    keep_idle: bool = False,
    progress: Progress = no_progress,
) -> list[Trajectory]:
    """Recordings as fits use them: of files that are read here without their idle stretches.

    What is left out is told; see `diffsea.recordings.idle.used_parts`.
    """
    used: list[Trajectory] = []
    for one in [given] if isinstance(given, Recording) else given:
        read = as_recording(one, mapping)
        parts, left_out = ([read], "") if keep_idle or read is one else used_parts(read)
        used += parts
        if left_out:
            progress(f"{left_out}; keep_idle=True keeps them")
    return used


def read_readable(
    given: Iterable[Recording],
    mapping: Mapping | str | pathlib.Path | None = None,
    start: float | None = None,
    end: float | None = None,
) -> list[Trajectory | Finding]:
    """Each recording, or where it cannot be read the finding that says why; under unlike names.

    Files are read from `start` to `end` (s on their clocks), where these are given.

    Raises:
        UserError: the mapping cannot be read.
    """
    several, read = list(given), []
    check_stems(mapping, (one for one in several if isinstance(one, str | pathlib.Path)))
    if isinstance(mapping, str | pathlib.Path) and not pathlib.Path(mapping).is_dir():
        mapping = read_mapping(mapping)
    for one in several:
        try:
            read.append(as_recording(one, mapping, start, end))
        except UserError as error:
            name = pathlib.Path(one).name if isinstance(one, str | pathlib.Path) else "<DataFrame>"
            read.append(unreadable(name, str(error)))
    names = [_name(one) for one in read]
    for place, (one, source) in enumerate(zip(read, several, strict=True)):
        if names.count(names[place]) > 1 and isinstance(source, str | pathlib.Path):
            read[place] = _renamed(one, str(source))
    return read


def _name(one: Trajectory | Finding) -> str:
    return one.recording if isinstance(one, Finding) else one.name


def _renamed(one: Trajectory | Finding, name: str) -> Trajectory | Finding:
    field = "recording" if isinstance(one, Finding) else "name"
    return dataclasses.replace(one, **{field: name})


def audit_readable(
    read: Sequence[Trajectory | Finding], mappings: Sequence[Mapping | None] = ()
) -> list[tuple[str, list[Finding]]]:
    """Name and findings of every recording of a set, in its order; see `read_readable`.

    `mappings` are those that they were read through, in whose units repairs are then said.

    Raises:
        UserError: none could be read.
    """
    runs = [one for one in read if isinstance(one, Trajectory)]
    refused = [one.message for one in read if isinstance(one, Finding)]
    if refused and all(isinstance(one, Finding) and one.kind == "unreadable" for one in read):
        several = f"none of the {len(refused)} recordings can be read:\n  "
        raise UserError((several if len(refused) > 1 else "") + "\n  ".join(refused))
    judged = iter(audit_set(runs))
    found = []
    for one, mapping in zip_longest(read, mappings):
        findings = [one] if isinstance(one, Finding) else next(judged)
        if mapping is not None:
            findings = [with_rows_of_mapping(finding, mapping) for finding in findings]
        found.append((_name(one), findings))
    return found


def audit(
    recordings: Recording | Iterable[Recording], mapping: Mapping | str | pathlib.Path | None = None
) -> Findings:
    """Whether recordings are sound: clocks, frames, units, signs, sensor errors.

    Several recordings are a set: what one cannot tell by itself, such as the axes of its
    velocities on a straight track, it takes from others that tell it clearly, and says so. One that
    cannot be read has that as its finding.

    Arguments:
        recordings: one or several, each a file, a DataFrame or a recording.
        mapping: how to read files and DataFrames with other columns.

    Raises:
        UserError: no recording can be read, or the mapping cannot.
    """
    several = [recordings] if isinstance(recordings, Recording) else list(recordings)
    read = read_readable(several, mapping)

    def through(one: Recording, done: Trajectory | Finding) -> Mapping | None:
        if isinstance(one, Trajectory) or isinstance(done, Finding):
            return None
        return mapping_for(mapping, one if isinstance(one, str | pathlib.Path) else "")

    judged = audit_readable(read, list(map(through, several, read)))
    found = [finding for _, findings in judged for finding in findings]
    return Findings(found, [name for name, _ in judged])
