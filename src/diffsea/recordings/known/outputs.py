"""What the outputs of an autopilot order: the channels that its parameters tell."""

import dataclasses
from collections.abc import Iterable

from diffsea.recordings.known.autopilot_parameters import (
    GROUND_STEERING,
    THROTTLE,
    THROTTLE_LEFT,
    THROTTLE_RIGHT,
    ServoOutput,
)
from diffsea.recordings.mappings import Column


_CHANNELS = {
    THROTTLE_LEFT: "port",
    THROTTLE_RIGHT: "starboard",
    THROTTLE: "motor",
    GROUND_STEERING: "rudder",
}
_HARD_OVER = 35.0  # deg


@dataclasses.dataclass(frozen=True)
class Output:
    """An output of an autopilot, a pulse width in us.

    Attributes:
        channel: the actuator, `port`, `starboard`, `motor` or `rudder`.
        number: of the output, from one.
        neutral: us, no thrust or rudder amidships.
        full_ahead: us, full order ahead or rudder hard to starboard; below neutral where reversed.
        full_astern: us, the other way.
    """

    channel: str
    number: int
    neutral: float
    full_ahead: float
    full_astern: float

    def column(self, source: str) -> Column:
        """The column of the orders, which stand in `source`.

        Thrusters stay in us, as vessel files state what full order is. A rudder's angle is taken
        as in proportion, 35 deg at the end.
        """
        if self.channel != "rudder":
            return Column(source)
        scale = _HARD_OVER / (self.full_ahead - self.neutral)
        return Column(source, unit="deg", scale=scale, offset=-scale * self.neutral)


def assigned_outputs(servos: Iterable[ServoOutput]) -> list[Output]:
    """The outputs that drive or steer, by their number; the first of each function."""
    found: dict[str, Output] = {}
    for servo in servos:
        ends = servo.maximum, servo.minimum
        ahead, astern = reversed(ends) if servo.is_reversed else ends
        channel = _CHANNELS[servo.function]
        found.setdefault(channel, Output(channel, servo.channel, servo.trim, ahead, astern))
    return list(found.values())
