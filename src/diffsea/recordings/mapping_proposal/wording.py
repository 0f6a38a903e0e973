"""A proposal as a mapping file to edit: every line with why, and how sure it is."""

import json
import math
import textwrap

from diffsea.recordings.mapping_proposal.actuators import ActuatorColumn
from diffsea.recordings.mapping_proposal.guesses import ChannelGuess
from diffsea.recordings.mapping_proposal.names import LABELS, Suggestion
from diffsea.recordings.mapping_proposal.proposal import ProposalEvidence
from diffsea.recordings.mapping_proposal.readings import NED
from diffsea.recordings.mappings import Column


SURE, LIKELY = 0.95, 0.7  # probabilities from which on a guess is called so
_ACTUATOR = {"rudder": "rudder", "propeller": "propeller", "thrust": "thrust"}
_MIRROR = 0.02  # probability of a mirrored record from which on it is mentioned


def level(sure: float) -> str:
    """`sure`, `likely` or `guess`."""
    return "sure" if sure >= SURE else "likely" if sure >= LIKELY else "guess"


def actuator_guesses(evidence: ProposalEvidence) -> list[ChannelGuess]:
    """The actuators as channels; thrusters whose sides are exchanged change their labels."""
    found = []
    for actuator in evidence.actuators:
        name = actuator.role
        if name in ("port", "starboard") and actuator.push < 0:
            name = "starboard" if name == "port" else "port"
        prefix = "cmd_" if actuator.ordered else "exec_"
        reversed_one = actuator.role in ("rudder", "propeller") and actuator.push < 0
        sign = -1.0 if reversed_one else 1.0
        unit = None if actuator.unit in ("", "rad", "rev/s", "N", "rps", "Hz") else actuator.unit
        sure = _actuator_sure(evidence, actuator)
        why = "; ".join(part for part in (actuator.reason, _push(actuator)) if part)
        found.append(ChannelGuess(prefix + name, Column(actuator.column, unit, sign), sure, why))
    return found


def _actuator_sure(evidence: ProposalEvidence, actuator: ActuatorColumn) -> float:
    if actuator.push == 0:
        return min(actuator.sure, 0.9)
    return actuator.sure * (1 - evidence.mirror if actuator.turns else 1.0)


def _push(actuator: ActuatorColumn) -> str:
    if actuator.role == "propeller":
        return {
            1: "positive values speed the vessel up",
            -1: "positive values slow the vessel down",
            0: "its sign cannot be seen in this run",
        }[actuator.push]
    if actuator.role == "rudder":
        return {
            1: "positive values turn the vessel to starboard",
            -1: "positive values turn the vessel to port, hence the sign",
            0: "which way it turns the vessel cannot be seen in this run",
        }[actuator.push]
    if actuator.role in ("port", "starboard"):
        return {
            1: "more on the port side turns the vessel to starboard, as it should",
            -1: "more on the side named port turns the vessel to port: sides exchanged",
            0: "which side it is on cannot be seen in this run",
        }[actuator.push]
    return ""


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
        *_comment(_frame(evidence)),
        "[columns]",
    ]
    for guess in guesses:
        lines += _comment(f"{level(guess.sure)} ({guess.sure:.2f}): {guess.why}.")
        lines.append(f"{guess.channel} = {_value(guess.column)}")
    return "\n".join([*lines, *_unused(evidence, guesses)]) + "\n"


def _file_lines(evidence: ProposalEvidence) -> list[str]:
    layout, lines = evidence.layout, []
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
    if evidence.clock.column is None:
        lines += _step_lines(evidence)
    if evidence.origin is not None:
        lines += _comment("The first fix, from where positions count.")
        lines.append(f"origin = [{evidence.origin[0]!r}, {evidence.origin[1]!r}]")
    reading = evidence.best.reading
    if reading.earth and reading.psi:
        lines += _comment("u and v are the derivatives of x and y: velocities along earth axes.")
        lines.append('velocity_axes = "earth"')
    return lines


def _step_lines(evidence: ProposalEvidence) -> list[str]:
    clock = evidence.clock
    if not math.isfinite(clock.step):
        return [
            *_comment("ASK: the file has no time, and nothing tells the sampling interval (s)."),
            "time_step = 1.0",
        ]
    why = clock.why if clock.sure else "the interval at which the kinematics agree"
    return [*_comment(f"guess: {why}. Put in the true interval (s)."), f"time_step = {clock.step}"]


def _frame(evidence: ProposalEvidence) -> str:
    reading = evidence.best.reading
    if reading.psi is None and reading.x is None:
        return ""
    text = f"Frames read as {evidence.convention.name}"
    if evidence.convention is not NED:
        text += ", turned into north-east-down"
    if evidence.mirror > _MIRROR:
        text += (
            f". A record mirrored as a whole (y, psi, v, r) is as consistent; taken to be "
            f"{100 * evidence.mirror:.0f} % likely: compare one turn with what the vessel did"
        )
    return text + "."


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 92, initial_indent="# ", subsequent_indent="# ")


def _value(column: Column) -> str:
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


def _unused(evidence: ProposalEvidence, guesses: list[ChannelGuess]) -> list[str]:
    used = {guess.column.column for guess in guesses} | {evidence.clock.column}
    rest = [name for name in evidence.layout.names if name and name not in used]
    if not rest:
        return []
    lines = ["", "# Not used:"]
    for name in rest:
        might = _might(evidence.suggestions[name], name in evidence.constant)
        lines.append(f"#   {json.dumps(name, ensure_ascii=False)}{might}")
    return lines


def _might(suggestion: Suggestion, constant: bool) -> str:
    text = " never changes" if constant else ""
    best = max((label for label in LABELS if label != "other"), key=suggestion.weights.__getitem__)
    if suggestion.weights[best] > 0.2:
        text += f"{',' if constant else ''} might be {best}"
        if best in _ACTUATOR or best in ("port", "starboard"):
            text += f": cmd_{best} or exec_{best}"
    return f":{text}" if text else ""
