"""Recordings that come without a mapping and without native columns: one is proposed."""

import argparse
import shlex
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.recordings import Finding
    from diffsea.recordings.mapping_proposal import Proposal
    from diffsea.trajectory import Trajectory


def read_recordings(
    args: argparse.Namespace, out: options.Outputs
) -> "tuple[list[Trajectory], list[tuple[str, list[Finding]]], str]":
    """The recordings, through a proposed mapping where they need one.

    The mapping is written to `out`. Besides the recordings come, by name, findings that stand
    in for files that could not be read for want of a time, and what to tell.
    """
    from diffsea.recordings.mapping_proposal import is_foreign, propose_mapping

    paths = args.recordings
    if args.mapping is not None or not any(is_foreign(path) for path in paths):
        return options.read_recordings(paths, args.mapping), [], ""
    try:
        proposal = propose_mapping(paths)
    except UserError as error:
        raise UserError(f"{_refusal(args)}; no mapping could be proposed: {error}") from error
    name = f"{paths[0].stem}.mapping.toml"
    written = out.path(name)
    written.write_text(proposal.text, encoding="utf-8")
    told = _told(args, out, name, proposal)
    if not proposal.timed:
        return [], [(path.name, [_untimed(path.name)]) for path in paths], told
    return options.read_recordings(paths, written), [], told


def _refusal(args: argparse.Namespace) -> str:
    """What the reader has against the files as they are."""
    try:
        options.read_recordings(args.recordings, None)
    except UserError as error:
        return str(error)
    return "some of these files need a mapping"


def _told(args: argparse.Namespace, out: options.Outputs, name: str, proposal: "Proposal") -> str:
    files = " ".join(shlex.quote(str(path)) for path in args.recordings)
    written = shlex.quote(str(out.folder / name))
    lines = [
        f"{args.recordings[0]} has no native columns, so a mapping was proposed: {written}",
        "  channel         how sure       column",
        proposal.summary,
    ]
    if proposal.checks:
        lines += ["check these, and edit the mapping:", *(f"  {item}" for item in proposal.checks)]
    again = f"  diffsea audit {files} --mapping {written}"
    lines += ["then run", again, ""]
    if proposal.timed:
        lines.append("The audit below is of the recordings read through the proposed mapping.")
    else:
        lines.append("Not audited: without a time step nothing read through it means anything.")
    return "\n".join(lines) + "\n\n"


def _untimed(name: str) -> "Finding":
    from diffsea.recordings import Finding

    return Finding(
        "time-step",
        float("nan"),
        float("nan"),
        "",
        "the file has no time, and nothing tells its sampling interval; it was not audited",
        "put the interval (s) into [file] time_step of the proposed mapping",
        ("t",),
        recording=name,
    )
