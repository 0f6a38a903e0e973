"""Which output of an autopilot drives what: the assignment that its parameters tell.

ArduPilot numbers the functions of outputs (SERVOn_FUNCTION): 73 and 74 are the throttles to port
and to starboard of skid steering, 70 is one throttle, 26 the steering of a rudder or an outboard.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from diffsea.recordings.logs import ardupilot, mcap_json, tlog
from diffsea.recordings.mappings import Column


_CHANNELS = {73: "port", 74: "starboard", 70: "propeller", 26: "rudder"}
_HARD_OVER = 35.0  # deg
_MOST_OUTPUTS = 32  # of ArduPilot
_USUAL = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0, "REVERSED": 0.0}


@dataclasses.dataclass(frozen=True)
class Output:
    """An output of an autopilot, a pulse width in us.

    Attributes:
        channel: the actuator, `port`, `starboard`, `propeller` or `rudder`.
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


def autopilot_parameters(path: Path, log: str) -> dict[str, float]:
    """The parameters that a log tells, by name; none of a format without them.

    Arguments:
        log: the name of its format, as `LogFormat` has it.
    """
    if log == "mavlink-tlog":
        return tlog.parameters(path)
    if log == "mcap-json":
        return mcap_json.parameters(path)
    return ardupilot.parameters(path) if log == "ardupilot-bin" else {}


def assigned_outputs(parameters: Mapping[str, float]) -> list[Output]:
    """The outputs that drive or steer, by their number; the first of each function."""
    found: dict[str, Output] = {}
    for number in range(1, _MOST_OUTPUTS + 1):
        channel = _CHANNELS.get(int(parameters.get(f"SERVO{number}_FUNCTION", -1)))
        if channel is None or channel in found:
            continue
        low, trim, high, turned = (
            parameters.get(f"SERVO{number}_{key}", usual) for key, usual in _USUAL.items()
        )
        ahead, astern = (low, high) if turned else (high, low)
        found[channel] = Output(channel, number, trim, ahead, astern)
    return list(found.values())
