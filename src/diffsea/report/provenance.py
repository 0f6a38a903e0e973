"""What every page ends with: fitted parameters, and where the results come from."""

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Iterable, Mapping, Sequence

from diffsea.report.page import Cell, Table, Verbatim
from diffsea.report.quantities import round_to_error, with_error
from diffsea.report.words import Record, as_words
from diffsea.trajectory import Trajectory


SHOWN_OTHERWISE = ("recordings", "versions", "python")  # as a table, and as one line
PACKAGES = ("diffsea", "jax", "optimistix")  # whose versions may move a result


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Versions, settings, files, and what was done to each recording."""

    terms: Mapping[str, Cell]
    recordings: Table


def provenance(source: Record, runs: Iterable[tuple[Trajectory, str]]) -> Provenance:
    """Where results come from.

    Arguments:
        source: what was run on what: file names, hashes, settings; shown as it is.
        runs: recordings, and what each was used for.
    """
    terms: dict[str, Cell] = {
        as_words(key): _lines(value) for key, value in source.items() if key not in SHOWN_OTHERWISE
    }
    versions = source.get("versions") or {name: _version(name) for name in PACKAGES}
    software = [f"{name} {version}" for name, version in versions.items()]
    software.append(f"Python {source.get('python', platform.python_version())}")
    terms["software"] = Verbatim(", ".join(software))
    rows = [[Verbatim(run.name), use, _extent(run), _notes(run)] for run, use in runs]
    return Provenance(terms, Table(["recording", "use", "length", "notes"], rows))


def _lines(value: object) -> Cell:
    """A value as text, one line for each entry of a dictionary."""

    def plain(one: object) -> str:
        if isinstance(one, list | tuple):
            return ", ".join(str(part) for part in one)
        if isinstance(one, Mapping):
            return ", ".join(f"{key} {part}" for key, part in one.items())
        return str(one)

    if isinstance(value, Mapping):
        return [Verbatim(f"{key}: {plain(one)}") for key, one in value.items()]
    return Verbatim(plain(value))


def _extent(run: Trajectory) -> str:
    """How long a run is, in s and in samples that count."""
    t = run.counted().t
    return f"{t[-1] - t[0]:.0f} s, {len(t)} samples"


def _notes(run: Trajectory) -> Sequence[str]:
    return [Verbatim(note) for note in run.provenance]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version"


def parameter_table(rows: Sequence[Record]) -> Table:
    """Fitted parameters with standard errors, 90 % intervals, and what they rest on.

    Arguments:
        rows: as `identification.estimates.physical_table` makes them.
    """

    def end(value: float, std: float) -> str:
        return round_to_error(value, 0.3 * std) if math.isfinite(value) else "open"

    cells = []
    for row in rows:
        low, high = (end(value, row["std"]) for value in row["interval"])
        estimate = with_error(row["value"], row["std"])
        name, start = Verbatim(row["name"]), round_to_error(row["start"])
        rests_on = _basis(row["determined"])
        bounds = f"{low} to {high}"
        cells.append([name, row["meaning"], start, estimate, bounds, row["unit"], rests_on])
    columns = ["symbol", "name", "start", "estimate", "90 % interval", "unit", "determined by"]
    title = "Fitted with everything else in the model; +- is one standard error"
    return Table(columns, cells, title, numeric=(2, 3, 4))


def _basis(share: float) -> str:
    """How much of an estimate the data determine, in words.

    Arguments:
        share: 0, it rests on the prior, to 1, on the data.
    """
    percent = f"{100 * share:.0f} %"
    if share > 0.9:
        return f"the data ({percent})"
    if share > 0.5:
        return f"data and vessel file ({percent} data)"
    return f"mostly the vessel file ({percent} data)"
