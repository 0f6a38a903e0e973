"""A proposal as a mapping file to edit: every line with why, and how sure it is."""

import json
import math
import textwrap

from diffsea.recordings.mapping_proposal.actuators import ActuatorColumn
from diffsea.recordings.mapping_proposal.evidence import ProposalEvidence
from diffsea.recordings.mapping_proposal.guesses import ChannelGuess
from diffsea.recordings.mapping_proposal.hypotheses import NED
from diffsea.recordings.mapping_proposal.names import Suggestion
from diffsea.recordings.mapping_proposal.vocabulary import LABELS
from diffsea.recordings.mappings import Column


SURE, LIKELY = 0.95, 0.7  # probabilities from which on a guess is called so
_SUREST_WITHOUT_ANSWER = 0.9  # of an actuator to which no motion was seen to answer
_MENTIONED_MIRROR = 0.02  # probability of a mirrored record from which on it is mentioned
_MENTIONED_LABEL = 0.2  # weight from which on an unused column is said to be one perhaps
_UNITS_WITHOUT_MENTION = ("", "rad", "rev/s", "N", "rps", "Hz")  # of actuators, in SI
_PUSHES = {
    "propeller": {
        1: "positive values speed the vessel up",
        -1: "positive values slow the vessel down",
        0: "its sign cannot be seen in this run",
    },
    "rudder": {
        1: "positive values turn the vessel to starboard",
        -1: "positive values turn the vessel to port, hence the sign",
        0: "which way it turns the vessel cannot be seen in this run",
    },
    "side": {
        1: "more on the port side turns the vessel to starboard, as it should",
        -1: "more on the side named port turns the vessel to port: sides exchanged",
        0: "which side it is on cannot be seen in this run",
    },
    "thrust": {1: "", -1: "", 0: ""},
}


def level(sure: float) -> str:
    """`sure`, `likely` or `guess`."""
    return "sure" if sure >= SURE else "likely" if sure >= LIKELY else "guess"


def actuator_guesses(evidence: ProposalEvidence) -> list[ChannelGuess]:
    """The actuators as channels; thrusters whose sides are exchanged change their labels."""
    found = []
    for actuator in evidence.actuators:
        name, sides = actuator.role, ("port", "starboard")
        push = _PUSHES["side" if name in sides else name][actuator.push]
        if name in sides and actuator.push < 0:
            name = sides[name == "port"]
        sign = -1.0 if name in ("rudder", "propeller") and actuator.push < 0 else 1.0
        unit = None if actuator.unit in _UNITS_WITHOUT_MENTION else actuator.unit
        channel = ("cmd_" if actuator.ordered else "exec_") + name
        column = Column(actuator.column, unit, sign)
        why = "; ".join(part for part in (actuator.reason, push) if part)
        found.append(ChannelGuess(channel, column, _probability(evidence, actuator), why))
    return found


def _probability(evidence: ProposalEvidence, actuator: ActuatorColumn) -> float:
    if actuator.push == 0:
        return min(actuator.sure, _SUREST_WITHOUT_ANSWER)
    return actuator.sure * (1 - evidence.mirror if actuator.turns else 1.0)


def mapping_text(evidence: ProposalEvidence, source: str) -> str:
    """The mapping as TOML with comments; `source` is the file it was proposed for."""
    guesses = [*evidence.guesses, *actuator_guesses(evidence)]
    lines = [
        f"# Proposed for {source} from the names of its columns and from kinematics.",
        "# sure, likely and guess are probabilities above 0.95, above 0.7, and below: check the",
        "# last two kinds, and delete what is wrong.",
        "format = 1",
        "",
        "[file]",
        *_file_lines(evidence),
        "",
        *_comment(_frame_sentence(evidence)),
        "[columns]",
    ]
    for guess in guesses:
        lines += _comment(f"{level(guess.sure)} ({guess.sure:.2f}): {guess.why}.")
        lines.append(f"{guess.channel} = {_column_value(guess.column)}")
    used = {guess.column.column for guess in guesses} | {evidence.clock.column}
    unused = [name for name in evidence.layout.names if name and name not in used]
    if unused:
        lines += ["", "# Not used:"]
    for name in unused:
        might_be = _what_it_might_be(evidence.suggestions[name], name in evidence.constant)
        lines.append(f"#   {json.dumps(name, ensure_ascii=False)}{might_be}")
    return "\n".join(lines) + "\n"


def _file_lines(evidence: ProposalEvidence) -> list[str]:
    layout, clock, lines = evidence.layout, evidence.clock, []
    if layout.text:
        lines.append(f"delimiter = {json.dumps(layout.delimiter)}")
        lines.append(f"header_lines = {layout.header_lines}")
        if layout.encoding != "utf-8-sig":
            lines.append(f"encoding = {json.dumps(layout.encoding)}")
        if layout.decimal != ".":
            lines.append(f"decimal = {json.dumps(layout.decimal)}")
    if layout.listed:
        lines += _comment(
            "The names of the file."
            if layout.named
            else "The file has no names of columns: give them better ones, here and below."
        )
        names = ", ".join(json.dumps(name, ensure_ascii=False) for name in layout.names)
        lines.append(f"columns = [{names}]")
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
    best = evidence.best.hypothesis
    if best.earth and best.psi:
        lines += _comment("u and v are the derivatives of x and y: velocities along earth axes.")
        lines.append('velocity_axes = "earth"')
    return lines


def _frame_sentence(evidence: ProposalEvidence) -> str:
    best = evidence.best.hypothesis
    if best.psi is None and best.x is None:
        return ""
    text = f"Frames read as {evidence.convention.name}"
    if evidence.convention is not NED:
        text += ", turned into north-east-down"
    if evidence.mirror > _MENTIONED_MIRROR:
        text += (
            f". A record mirrored as a whole (y, psi, v, r) is as consistent; taken to be "
            f"{100 * evidence.mirror:.0f} % likely: compare one turn with what the vessel did"
        )
    return text + "."


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 92, initial_indent="# ", subsequent_indent="# ")


def _column_value(column: Column) -> str:
    name = json.dumps(column.column, ensure_ascii=False)
    parts = [f"column = {name}"]
    if column.unit is not None:
        parts.append(f'unit = "{column.unit}"')
    if column.sign != 1:
        parts.append("sign = -1")
    if column.scale != 1:
        parts.append(f"scale = {column.scale!r}")
    if column.offset != 0:
        parts.append(f"offset = {float(column.offset)!r}")
    return name if len(parts) == 1 else "{ " + ", ".join(parts) + " }"


def _what_it_might_be(suggestion: Suggestion, constant: bool) -> str:
    text = " never changes" if constant else ""
    best = max((label for label in LABELS if label != "other"), key=suggestion.weights.__getitem__)
    if suggestion.weights[best] > _MENTIONED_LABEL:
        text += f"{',' if constant else ''} might be {best}"
        if best in ("rudder", "propeller", "thrust", "port", "starboard"):
            text += f": cmd_{best} or exec_{best}"
    return f":{text}" if text else ""
