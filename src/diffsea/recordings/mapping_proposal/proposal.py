"""A mapping proposed for files that nobody has mapped, and which files need one.

The proposal is a mapping file to edit: every line with why, and how sure it is.
"""

import dataclasses
import functools
import json
import math
import re
import textwrap
import tomllib
from collections.abc import Sequence
from pathlib import Path

from diffsea.errors import UserError
from diffsea.recordings import logs
from diffsea.recordings.mapping_proposal.actuators import ROLES
from diffsea.recordings.mapping_proposal.columns import NO_CLOCK
from diffsea.recordings.mapping_proposal.evidence import ProposalEvidence, gather_evidence
from diffsea.recordings.mapping_proposal.guesses import ChannelGuess, actuator_guesses, level
from diffsea.recordings.mapping_proposal.hypotheses import NED, QUANTITIES
from diffsea.recordings.mapping_proposal.names import LABELS, NAMED
from diffsea.recordings.mapping_proposal.table_layout import sniff_layout
from diffsea.recordings.mappings import Column, Mapping, is_channel, mapping_from
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import MOTION_CHANNELS


WRITTEN = 0.1  # probability below which a guess is no row of the mapping, but a comment
_TOGETHER = {"x": "y", "y": "x", "latitude": "longitude", "longitude": "latitude"}
_MENTIONED_MIRROR = 0.02  # probability of a mirrored record from which on it is mentioned
_MENTIONED_LABEL = 0.2  # weight from which on an unused column is said to be one perhaps


@dataclasses.dataclass(frozen=True)
class Proposal:
    """A proposed mapping.

    Attributes:
        text: TOML that `read_mapping` accepts.
        text_without_place: the same without the origin of a geographic position.
        sure: by channel, the probability that its column, unit and sign are right.
        summary: what to tell, a line per channel.
        checks: what to look at before anybody relies on the mapping.
        guesses: what is no more than a guess, and why: a sentence per channel.
        timed: false where the file has no time and nothing told its step: the text then holds a
            placeholder, and nothing read through it means anything.
    """

    text: str
    text_without_place: str
    sure: dict[str, float]
    summary: str
    checks: tuple[str, ...]
    guesses: tuple[str, ...] = ()
    timed: bool = True

    @functools.cached_property
    def mapping(self) -> Mapping:
        """What `text` says."""
        return mapping_from(tomllib.loads(self.text), Path("the proposed mapping"))


@one_blas_thread
def propose_mapping(paths: str | Path | Sequence[str | Path]) -> Proposal:
    """Propose one mapping for a file, or for several files of one layout.

    Raises:
        UserError: a file is no table of numbers, or files have different columns.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    evidence = gather_evidence(files)
    guesses = [*evidence.guesses, *actuator_guesses(evidence.actuators, evidence.mirror)]
    guesses, doubted = _without_the_doubtful(evidence, guesses)
    written = {guess.channel for guess in guesses}
    if "t" not in written and evidence.clock.column is not None:
        evidence = dataclasses.replace(evidence, clock=NO_CLOCK)
    if "latitude" not in written:
        evidence = dataclasses.replace(evidence, origin=None)
    summary, checks, doubtful = [], [], []
    timed = evidence.clock.column is not None or math.isfinite(evidence.clock.step)
    if evidence.clock.column is None:
        known = f"guessed as {evidence.clock.step:g} s" if timed else "unknown"
        checks.append(f"[file] time_step: the file has no time column; the step is {known}")
    for guess in guesses:
        name, sure = ", ".join(guess.column.names), guess.sure
        summary.append(f"  {guess.channel:15s} {level(sure):6s} {sure:5.2f}  {name}")
        if level(sure) != "sure":
            checks.append(f"{guess.channel} ({name}): {guess.why}")
        if level(sure) == "guess":
            doubtful.append(guess.sentence)
    for guess in doubted:
        summary.append(f"  {guess.channel:15s} none   {guess.sure:5.2f}  {guess.column.column}")
        checks.append(_why_not_written(evidence, guess, guesses))
    return Proposal(
        text=_mapping_text(evidence, guesses, doubted, files[0].name),
        text_without_place=_mapping_text(
            dataclasses.replace(evidence, origin=None), guesses, doubted, files[0].name
        ),
        sure={guess.channel: guess.sure for guess in guesses},
        summary="\n".join(summary),
        checks=tuple(checks),
        guesses=tuple(doubtful),
        timed=timed,
    )


def is_foreign(path: str | Path) -> bool:
    """Whether a file is a table that cannot be read without a mapping, for its columns.

    Logs of robots are not, nor what cannot be read as a table at all, nor a file of nothing
    but native columns of which some are missing: there a mapping is of no help.
    """
    return _foreign_names(Path(path)) is not None


def foreign_layouts(paths: Sequence[Path]) -> list[list[Path]]:
    """The files that cannot be read without a mapping, those of one layout together."""
    groups: dict[tuple[str, ...], list[Path]] = {}
    for path in paths:
        names = _foreign_names(path)
        if names is not None:
            groups.setdefault(names, []).append(path)
    return list(groups.values())


def _foreign_names(path: Path) -> tuple[str, ...] | None:
    """The names of the columns of a file that is foreign, none where the disk fails; None of any
    other."""
    try:
        layout = None if logs.is_log(path) and not logs.log_table(path) else sniff_layout(path)
    except UserError as error:
        return () if isinstance(error.__cause__, OSError) else None
    if layout is None:
        return None
    how, names = layout.mapping, layout.names
    plain = (how.delimiter, how.decimal, how.encoding, how.header_lines) == (
        *(",", ".", "utf-8-sig"),
        1 if layout.text else None,
    )
    complete = "t" in names and any(name in MOTION_CHANNELS for name in names)
    native = plain and (complete or all(is_channel(name) for name in names))
    native = native and not logs.is_log(path)
    return None if native else names


def _without_the_doubtful(
    evidence: ProposalEvidence, guesses: list[ChannelGuess]
) -> tuple[list[ChannelGuess], list[ChannelGuess]]:
    """The guesses that are probable enough to be written, and the others.

    Of a pair of coordinates neither is written without the other, and no velocities along earth
    axes without the heading that turns them.
    """
    doubtful = {guess.channel for guess in guesses if guess.sure < WRITTEN}
    doubtful |= {_TOGETHER[channel] for channel in doubtful if channel in _TOGETHER}
    if "psi" in doubtful and evidence.motion.earth:
        doubtful |= {"u", "v"}
    return (
        [guess for guess in guesses if guess.channel not in doubtful],
        [guess for guess in guesses if guess.channel in doubtful],
    )


def _why_not_written(
    evidence: ProposalEvidence, guess: ChannelGuess, written: list[ChannelGuess]
) -> str:
    """Why a guess is no row of the mapping, with the column that is called what it is, if any."""
    channel, column = guess.channel, _quoted(guess.column.column)
    text = f"{channel} is not written: {column} is it with a probability of {guess.sure:.2f}"
    text += f", below {WRITTEN}" if guess.sure < WRITTEN else f", and goes with {_partner(channel)}"
    better = _better_named(evidence, guess, written)
    return text + (f"; the name of {_quoted(better)} says that it is" if better else "")


def _partner(channel: str) -> str:
    return _TOGETHER.get(channel, "psi")


def _better_named(
    evidence: ProposalEvidence, guess: ChannelGuess, written: list[ChannelGuess]
) -> str | None:
    """The unused column whose name says the channel of a guess most clearly; None if none does."""
    used = {name for each in [*written, guess] for name in each.column.names}
    channel = {"latitude": "x", "longitude": "y"}.get(guess.channel, guess.channel)
    label = channel.removeprefix("cmd_").removeprefix("exec_")
    labels = [each for each in QUANTITIES.get(channel, (label,)) if each in LABELS]
    weights = {
        name: max((told.weights[each] for each in labels), default=0.0)
        for name, told in evidence.suggestions.items()
        if name not in used
    }
    best = max(weights, key=lambda name: weights[name], default=None)
    return best if best is not None and weights[best] > NAMED else None


def _mapping_text(
    evidence: ProposalEvidence,
    guesses: list[ChannelGuess],
    doubted: list[ChannelGuess],
    source: str,
) -> str:
    """The mapping as TOML with comments; `source` is the file it was proposed for."""
    motion, frames = evidence.motion, ""
    if motion.psi is not None or motion.x is not None:
        frames = f"Frames read as {evidence.convention.name}"
        if evidence.convention is not NED:
            frames += ", turned into north-east-down"
        if evidence.mirror > _MENTIONED_MIRROR:
            frames += (
                f". A record mirrored as a whole (y, psi, v, r) is as consistent; taken to be "
                f"{100 * evidence.mirror:.0f} % likely: compare one turn with what the vessel did"
            )
        frames += "."
    lines = [
        f"# Proposed for {source} from the names of its columns and from kinematics.",
        "# sure, likely and guess are probabilities above 0.95, above 0.7, and below: check the",
        "# last two kinds, and delete what is wrong.",
        *([f"# What is less probable than {WRITTEN} stands in a comment."] if doubted else []),
        "format = 1",
        "",
        "[file]",
        *_file_lines(evidence, guesses),
        "",
        *_comment(frames),
        "[columns]",
    ]
    for guess in guesses:
        lines += _comment(f"{level(guess.sure)} ({guess.sure:.2f}): {guess.why}.")
        lines.append(f"{_key(guess.channel)} = {_column_value(guess.column)}")
    for guess in doubted:
        better = _better_named(evidence, guess, guesses)
        lines += _comment(f"{_why_not_written(evidence, guess, guesses)}.")
        column = guess.column if better is None else Column(better)
        lines.append(f"# {_key(guess.channel)} = {_column_value(column)}")
    used = {name for guess in guesses for name in guess.column.names} | {evidence.clock.column}
    unused = [name for name in evidence.layout.names if name and name not in used]
    if unused:
        lines += ["", "# Not used:"]
    for name in unused:
        parts = ["never changes"] if name in evidence.constant else []
        weights = evidence.suggestions[name].weights
        best = max((label for label in LABELS if label != "other"), key=weights.__getitem__)
        if weights[best] > _MENTIONED_LABEL:
            channels = f": cmd_{best} or exec_{best}" if best in ROLES else ""
            parts.append(f"might be {best}{channels}")
        might_be = f": {', '.join(parts)}" if parts else ""
        lines.append(f"#   {_quoted(name)}{might_be}")
    return "\n".join(lines) + "\n"


def _file_lines(evidence: ProposalEvidence, guesses: list[ChannelGuess]) -> list[str]:
    """What stands under [file]: how the table is read, its time step, origin and axes."""
    layout, clock, how, lines = evidence.layout, evidence.clock, evidence.layout.mapping, []
    if layout.text:
        lines.append(f"delimiter = {json.dumps(how.delimiter)}")
        lines.append(f"header_lines = {how.header_lines}")
        if how.encoding != "utf-8-sig":
            lines.append(f"encoding = {json.dumps(how.encoding)}")
        if how.decimal != ".":
            lines.append(f"decimal = {json.dumps(how.decimal)}")
    if how.columns is not None:
        lines += _comment(
            "The names of the file."
            if layout.named
            else "The file has no names of columns: give them better ones, here and below."
        )
        lines.append(f"columns = [{', '.join(_quoted(name) for name in how.columns)}]")
    if clock.column is None and math.isfinite(clock.step):
        why = clock.why if clock.sure else "the interval at which the kinematics agree"
        lines += _comment(f"guess: {why}. Put in the true interval (s).")
        lines.append(f"time_step = {clock.step}")
    elif clock.column is None:
        lines += _comment("ASK: the file has no time, and nothing tells the sampling interval (s).")
        lines.append("time_step = 1.0")
    if evidence.origin is not None:
        lines += _comment("The first fix, from where positions count.")
        lines.append(f"origin = [{evidence.origin[0]!r}, {evidence.origin[1]!r}]")
    if evidence.motion.earth and {"psi", "u"} <= {guess.channel for guess in guesses}:
        lines += _comment("u and v are the derivatives of x and y: velocities along earth axes.")
        lines.append('velocity_axes = "earth"')
    return lines


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 92, initial_indent="# ", subsequent_indent="# ")


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _key(channel: str) -> str:
    """A channel as a key of TOML."""
    return channel if re.fullmatch(r"[A-Za-z0-9_-]+", channel) else _quoted(channel)


def _column_value(column: Column) -> str:
    """A column as a mapping has it: a name, or a table of what it has besides."""
    parts = [f"column = {_quoted(column.column)}"]
    if column.cosine is not None:
        parts.append(f"cosine = {_quoted(column.cosine)}")
    if column.course is not None:
        parts.append(f"course = {_quoted(column.course)}")
        parts += ['course_unit = "rad"'] if column.course_unit == "rad" else []
    if column.unit is not None:
        parts.append(f'unit = "{column.unit}"')
    if column.sign != 1:
        parts.append("sign = -1")
    if column.scale != 1:
        parts.append(f"scale = {float(column.scale)!r}")
    if column.offset != 0:
        parts.append(f"offset = {float(column.offset)!r}")
    return _quoted(column.column) if len(parts) == 1 else "{ " + ", ".join(parts) + " }"
