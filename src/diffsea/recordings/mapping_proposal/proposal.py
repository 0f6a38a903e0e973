"""A mapping proposed for files that nobody has mapped, and which files need one."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

from diffsea.errors import UserError
from diffsea.recordings import logs
from diffsea.recordings.mapping_proposal.evidence import gather_evidence
from diffsea.recordings.mapping_proposal.table_layout import sniff_layout
from diffsea.recordings.mapping_proposal.wording import actuator_guesses, level, mapping_text
from diffsea.recordings.vocabulary import is_channel
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import MOTION_CHANNELS


@dataclasses.dataclass(frozen=True)
class Proposal:
    """A proposed mapping.

    `text` is TOML that `read_mapping` accepts; `sure` has for every channel the probability
    that its column, unit and sign are right; `summary` is what to tell and `checks` what to
    look at. `timed` is false where the file has no time and nothing told its step: the text
    then holds a placeholder, and nothing read through it means anything.
    """

    text: str
    sure: dict[str, float]
    summary: str
    checks: tuple[str, ...]
    timed: bool = True


@one_blas_thread
def propose_mapping(paths: str | Path | Sequence[str | Path]) -> Proposal:
    """Propose one mapping for a file, or for several files of one layout.

    Raises `UserError` for what is no table of numbers, and for files of different columns.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    evidence = gather_evidence(files)
    guesses = [*evidence.guesses, *actuator_guesses(evidence)]
    summary, checks = [], []
    timed = evidence.clock.column is not None or math.isfinite(evidence.clock.step)
    if evidence.clock.column is None:
        known = f"guessed as {evidence.clock.step:g} s" if timed else "unknown"
        checks.append(f"[file] time_step: the file has no time column; the step is {known}")
    for guess in guesses:
        name, sure = guess.column.column, guess.sure
        summary.append(f"  {guess.channel:15s} {level(sure):6s} {sure:5.2f}  {name}")
        if level(sure) != "sure":
            checks.append(f"{guess.channel} ({name}): {guess.why}")
    return Proposal(
        text=mapping_text(evidence, files[0].name),
        sure={guess.channel: guess.sure for guess in guesses},
        summary="\n".join(summary),
        checks=tuple(checks),
        timed=timed,
    )


def is_foreign(path: str | Path) -> bool:
    """Whether a file is a table that cannot be read without a mapping, for its columns.

    Logs of robots are not, nor what cannot be read as a table at all, nor a file of nothing
    but native columns of which some are missing: there a mapping is of no help.
    """
    path = Path(path)
    try:
        if logs.is_log(path):
            return False
        layout = sniff_layout(path)
    except UserError:
        return False
    plain = not layout.text or (
        (layout.delimiter, layout.decimal, layout.encoding) == (",", ".", "utf-8-sig")
        and layout.header_lines == 1
    )
    names = layout.names
    complete = "t" in names and any(name in MOTION_CHANNELS for name in names)
    return not (plain and (complete or all(is_channel(name) for name in names)))
