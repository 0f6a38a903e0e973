"""Segments as files that are ready for identification, with what was done to them.

Each is a native recording whose time is counted from the onset. What a reader of the files
does not keep stands beside them, in the record of the export.
"""

import dataclasses
import importlib.metadata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.outside.digests import content_digest
from diffsea.recordings import cut, resample, write_recording
from diffsea.segments.segments import Segment
from diffsea.segments.traceability import Check
from diffsea.trajectory import Trajectory


FORMAT = 1


def cut_out(run: Trajectory, segment: Segment, interval: float | None = None) -> Trajectory:
    """A segment with its approach, time zero at the onset, resampled to `interval` s if given.

    Nothing is filled in: executed actuation that was not measured is not written. Every step
    is added to the provenance.

    Raises:
        UserError: too few samples are left.
    """
    piece = cut(run, segment.start, segment.end)
    note = f"time counted from the onset, t = {segment.onset:.10g} s of {run.name}"
    t = np.asarray(piece.t, float) - segment.onset
    piece = dataclasses.replace(piece, t=t, provenance=(*piece.provenance, note))
    return piece if interval is None else resample(piece, interval)


def file_name(run: Trajectory, number: int, segment: Segment, suffix: str = ".csv") -> str:
    """The name of a segment's file, such as `log7-03-zigzag.csv`."""
    return f"{Path(run.name).stem}-{number:02d}-{segment.kind}{suffix}"


def export(
    run: Trajectory,
    found: Sequence[Segment],
    folder: Path,
    interval: float | None = None,
    suffix: str = ".csv",
    checks: Mapping[int, Sequence[Check]] | None = None,
) -> list[dict[str, Any]]:
    """Write every segment of a recording into a folder, and return the entries of the record.

    An entry has the segment's numbers (SI units, rad), its `file` and that file's `sha256`,
    the `steps` that led from the source to it, and the `checks` given for its number in
    `found`. Numbers of segments count from one.

    Raises:
        UserError: no recording has this suffix, or the folder cannot be written.
    """
    if suffix not in (".csv", ".parquet"):
        raise UserError(f"segments are written as .csv or .parquet, not {suffix}")
    entries = []
    for number, segment in enumerate(found, 1):
        piece = cut_out(run, segment, interval)
        path = Path(folder) / file_name(run, number, segment, suffix)
        write_recording(piece, path)
        entries.append(
            {
                "file": path.name,
                "sha256": content_digest(path),
                **dataclasses.asdict(segment),
                "steady": segment.steady,
                "steps": list(piece.provenance),
                "checks": [dataclasses.asdict(c) for c in (checks or {}).get(number - 1, ())],
            }
        )
    return entries


def source_of(path: Path, mapping: Path | None) -> dict[str, Any]:
    """What a recording was read from: file and mapping, each with its hash."""
    source: dict[str, Any] = {
        "file": Path(path).name,
        "sha256": content_digest(path),
        "mapping": None,
    }
    if mapping is not None:
        text = Path(mapping).read_text(encoding="utf-8")
        name = Path(mapping).name
        source["mapping"] = {"file": name, "sha256": content_digest(mapping), "text": text}
    return source


def record(recordings: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The content of `segments.json`."""
    return {
        "format": FORMAT,
        "diffsea": importlib.metadata.version("diffsea"),
        "recordings": list(recordings),
    }
