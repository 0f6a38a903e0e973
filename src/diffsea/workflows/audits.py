"""What all jobs share, recordings as given and results as tables; and the audit. Needs no JAX."""

import abc
import html
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from diffsea.recordings import Finding, Mapping, read_recording
from diffsea.recordings import audit as audit_run
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
        return "".join([*parts, *(f"<p>{html.escape(note)}</p>" for note in self.notes())])


Recording = Trajectory | pd.DataFrame | str | pathlib.Path


class Findings(Tabulated, Sequence[Finding]):
    """What an audit found, run by run."""

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
            }
            for one in self._findings
        ]

    def notes(self) -> list[str]:
        return [f"{one.recording}: {one.message}" for one in self._findings]


def as_recording(
    given: Recording, mapping: Mapping | str | pathlib.Path | None = None
) -> Trajectory:
    """A recording as it is, or read from a file or a DataFrame.

    Raises:
        UserError: it cannot be read; says what is wrong, where, and what to do.
    """
    return given if isinstance(given, Trajectory) else read_recording(given, mapping)


def as_recordings(
    given: Recording | Iterable[Recording], mapping: Mapping | str | pathlib.Path | None = None
) -> list[Trajectory]:
    """One or several recordings, read where they are not yet; see `as_recording`."""
    several = [given] if isinstance(given, Recording) else given
    return [as_recording(one, mapping) for one in several]


def audit(
    recordings: Recording | Iterable[Recording], mapping: Mapping | str | pathlib.Path | None = None
) -> Findings:
    """Whether recordings are sound: clocks, frames, units, signs, sensor errors.

    Arguments:
        recordings: one or several, each a file, a DataFrame or a recording.
        mapping: how to read files and DataFrames with other columns.

    Raises:
        UserError: a recording cannot be read.
    """
    runs = as_recordings(recordings, mapping)
    found = [finding for run in runs for finding in audit_run(run)]
    return Findings(found, [run.name for run in runs])
