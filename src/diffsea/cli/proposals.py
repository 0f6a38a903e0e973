"""Recordings that come without a mapping and without native columns: one is proposed."""

import argparse
import math
import shlex
from typing import TYPE_CHECKING, NamedTuple

from diffsea.cli import options
from diffsea.cli.outputs import Outputs
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.recordings import Finding
    from diffsea.recordings.mapping_proposal import Proposal
    from diffsea.trajectory import Trajectory


class AuditInput(NamedTuple):
    """What an audit is of.

    Attributes:
        unread: by name, a finding that stands in for a file that cannot be read for want of a time.
        message: what to say of the mapping that was proposed; empty where none was needed.
    """

    runs: "list[Trajectory]"
    unread: "list[tuple[str, list[Finding]]]"
    message: str


def read_or_propose(args: argparse.Namespace, out: Outputs) -> AuditInput:
    """The recordings, through a proposed mapping, which is written to `out`, where they need one.

    Raises:
        UserError: they cannot be read, and no mapping could be proposed.
    """
    from diffsea.recordings.mapping_proposal import is_foreign, propose_mapping

    paths = args.recordings
    if args.mapping is not None or not any(is_foreign(path) for path in paths):
        return AuditInput(options.read_recordings(paths, args.mapping), [], "")
    try:
        proposal = propose_mapping(paths)
    except UserError as error:
        raise UserError(f"{_refusal(args)}; no mapping could be proposed: {error}") from error
    name = f"{paths[0].stem}.mapping.toml"
    out.text(name, proposal.text)
    message = _message(args, out, name, proposal)
    if not proposal.timed:
        return AuditInput(
            [], [(path.name, [_finding_without_time(path.name)]) for path in paths], message
        )
    return AuditInput(options.read_recordings(paths, out.path_of(name)), [], message)


def _refusal(args: argparse.Namespace) -> str:
    """What the reader has against the files as they are."""
    try:
        options.read_recordings(args.recordings, None)
    except UserError as error:
        return str(error)
    return "some of these files need a mapping"


def _message(args: argparse.Namespace, out: Outputs, name: str, proposal: "Proposal") -> str:
    files = " ".join(shlex.quote(str(path)) for path in args.recordings)
    mapping = shlex.quote(str(out.folder / name))
    lines = [
        f"{args.recordings[0]} has no native columns, so a mapping was proposed: {mapping}",
        "  channel         how sure       column",
        proposal.summary,
    ]
    if proposal.checks:
        lines += ["check these, and edit the mapping:", *(f"  {item}" for item in proposal.checks)]
    lines += ["then run", f"  diffsea audit {files} --mapping {mapping}", ""]
    if proposal.timed:
        lines.append("The audit below is of the recordings read through the proposed mapping.")
    else:
        lines.append("Not audited: without a time step nothing read through it means anything.")
    return "\n".join(lines) + "\n\n"


def _finding_without_time(name: str) -> "Finding":
    from diffsea.recordings import Finding

    return Finding(
        "time-step",
        math.nan,
        math.nan,
        "",
        "the file has no time, and nothing tells its sampling interval; it was not audited",
        "put the interval (s) into [file] time_step of the proposed mapping",
        ("t",),
        recording=name,
    )
