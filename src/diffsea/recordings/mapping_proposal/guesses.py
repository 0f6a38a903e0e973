"""Proposed channels: how sure each is in words, and those that actuators become."""

import dataclasses
from collections.abc import Iterable

from diffsea.channels import is_azimuth
from diffsea.recordings.mapping_proposal.actuators import SIDES, ActuatorColumn
from diffsea.recordings.mappings import Column


SURE, LIKELY = 0.95, 0.7  # probabilities from which on a guess is called so
_SUREST_WITHOUT_ANSWER = 0.9  # of an actuator to which no motion was seen to answer
_UNITS_WITHOUT_MENTION = ("", "rad", "rev/s", "N", "rps", "Hz")  # of actuators, in SI
# What is said of the sign of an actuator, by which way it pushes.
_AZIMUTH_PUSHES = {
    1: "positive angles push as those clockwise from ahead do",
    -1: "positive angles push as those anticlockwise from ahead do, hence the sign",
    0: "which way positive angles push cannot be seen: clockwise from ahead is taken for positive",
}
_SIDE_PUSHES = {
    1: "more on the port side turns the vessel to starboard, as it should",
    -1: "more on the side named port turns the vessel to port: sides exchanged",
    0: "which side it is on cannot be seen in this run",
}
_SPEEDS_UP = {
    1: "positive values speed the vessel up",
    -1: "positive values slow the vessel down",
    0: "its sign cannot be seen in this run",
}
_PUSHES = {
    "propeller": _SPEEDS_UP,
    "motor": _SPEEDS_UP,
    "rudder": {
        1: "positive values turn the vessel to starboard",
        -1: "positive values turn the vessel to port, hence the sign",
        0: "which way it turns the vessel cannot be seen in this run",
    },
    "port": _SIDE_PUSHES,
    "starboard": _SIDE_PUSHES,
}


@dataclasses.dataclass(frozen=True)
class ChannelGuess:
    """One proposed channel: how it is read, how probable that is (0 to 1), and why."""

    channel: str
    column: Column
    sure: float
    why: str

    @property
    def sentence(self) -> str:
        """What it is taken for, how probably, why, and what else it may be."""
        why = self.why
        if self.channel.startswith("exec_"):
            order = self.channel.replace("exec_", "cmd_", 1)
            why += f"; an order is {order} in the mapping: only an order is answered late"
        name = ", ".join(self.column.names)
        return f"{self.channel} is {name!r} ({100 * self.sure:.0f} %): {why}"


def level(sure: float) -> str:
    """How sure a probability is, in a word."""
    return "sure" if sure >= SURE else "likely" if sure >= LIKELY else "guess"


def actuator_guesses(
    actuators: Iterable[ActuatorColumn], mirror: float = 0.0
) -> list[ChannelGuess]:
    """The actuators as channels; thrusters whose sides are exchanged change their labels.

    What turns the vessel is as sure as that the record is not mirrored, and what nothing was
    seen to answer is never called sure.

    Arguments:
        mirror: probability that the whole record is mirrored.
    """
    found = []
    for actuator in actuators:
        name, sign, sure = actuator.role, 1.0, actuator.sure
        if actuator.push == 0:
            sure = min(sure, _SUREST_WITHOUT_ANSWER)
        elif actuator.turns:
            sure = sure * (1 - mirror)
        if actuator.push < 0 and name in SIDES:
            name = SIDES[name == "port"]
        elif actuator.push < 0:
            sign = -1.0
        unit = None if actuator.unit in _UNITS_WITHOUT_MENTION else actuator.unit
        channel = ("cmd_" if actuator.ordered else "exec_") + name
        pushes = _AZIMUTH_PUSHES if is_azimuth(name) else _PUSHES.get(actuator.role, {})
        push = pushes.get(actuator.push, "")
        why = "; ".join(part for part in (actuator.reason, push) if part)
        found.append(
            ChannelGuess(
                channel,
                Column(actuator.column, unit, sign, actuator.scale, actuator.offset),
                sure,
                why,
            )
        )
    return found
