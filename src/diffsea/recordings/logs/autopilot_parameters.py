"""Parameters in an ArduPilot log: which output is which motor, its zero, its ends, its sense.

The autopilot writes its parameters as PARM messages when logging starts, and again what is changed
later. `SERVOn_FUNCTION` says what output n (RCOU:Cn) drives, by numbers of ArduPilot's list.
"""

import dataclasses
from pathlib import Path

from diffsea.errors import UserError
from diffsea.recordings.logs.streams import unreadable


THROTTLE_LEFT, THROTTLE_RIGHT, THROTTLE, GROUND_STEERING = 73, 74, 70, 26
FUNCTIONS = {
    THROTTLE_LEFT: "throttle left",
    THROTTLE_RIGHT: "throttle right",
    THROTTLE: "throttle",
    GROUND_STEERING: "ground steering",
}
OUTPUTS = 32  # at most
_DEFAULTS = {"MIN": 1100.0, "MAX": 1900.0, "TRIM": 1500.0, "REVERSED": 0.0}  # ArduPilot's, us


@dataclasses.dataclass(frozen=True)
class ServoOutput:
    """One output of the autopilot, pulse widths in us.

    `trim` is neutral; `is_reversed` where longer pulses are astern (or to port).
    """

    channel: int  # n of SERVOn, whose pulse width is RCOU:Cn
    function: int
    minimum: float
    maximum: float
    trim: float
    is_reversed: bool

    @property
    def full_ahead(self) -> float:
        """Full order ahead, above neutral whatever the sense: us.

        Reversed, full ahead is the shortest pulse, as far below neutral as this lies above it.
        """
        return 2 * self.trim - self.minimum if self.is_reversed else self.maximum

    @property
    def full_astern(self) -> float:
        """Full order astern, below neutral whatever the sense: us."""
        return 2 * self.trim - self.maximum if self.is_reversed else self.minimum


@dataclasses.dataclass(frozen=True)
class AutopilotParameters:
    """What the parameters of a log say of a boat's actuators.

    Attributes:
        outputs: those of a known function, by channel.
        thrust_asymmetry: thrust full ahead over full astern that the autopilot mixes with.
        changed: names of parameters of these outputs that changed in the log; the last value is
            used.
    """

    outputs: tuple[ServoOutput, ...]
    thrust_asymmetry: float
    changed: tuple[str, ...] = ()

    def output(self, function: int) -> ServoOutput | None:
        """The first output of a function, or None."""
        return next((one for one in self.outputs if one.function == function), None)


def read_parameters(path: Path) -> AutopilotParameters:
    """What the parameters in an ArduPilot `.bin` log say of its actuators.

    Raises:
        UserError: the file is no such log or holds no parameters, an output has impossible ends,
            or the package that reads it is absent.
    """
    values, changed = _values(path)
    if not values:
        raise UserError(f"{path} holds no parameters (PARM messages); leave --log out")
    outputs = []
    for channel in range(1, OUTPUTS + 1):
        function = int(values.get(f"SERVO{channel}_FUNCTION", 0))
        if function in FUNCTIONS:
            outputs.append(_output(channel, function, values, path))
    of_outputs = [f"SERVO{one.channel}_" for one in outputs]
    return AutopilotParameters(
        tuple(outputs),
        max(values.get("MOT_THST_ASYM", 1.0), 1.0),
        tuple(name for name in changed if any(name.startswith(one) for one in of_outputs)),
    )


def _values(path: Path) -> tuple[dict[str, float], list[str]]:
    """The last value of every parameter, and the names of those that changed."""
    try:
        from pymavlink import DFReader
    except ImportError as error:
        raise UserError(
            f"reading {path} needs the package pymavlink: pip install 'diffsea[ardupilot]'"
        ) from error
    values: dict[str, float] = {}
    changed: list[str] = []
    with unreadable(path, "an ArduPilot log"):
        log = DFReader.DFReader_binary(str(path))
        while (message := log.recv_match(type=["PARM"])) is not None:
            name, value = message.Name, float(message.Value)
            if values.get(name, value) != value and name not in changed:
                changed.append(name)
            values[name] = value
    return values, changed


def _output(channel: int, function: int, values: dict[str, float], path: Path) -> ServoOutput:
    said = {key: values.get(f"SERVO{channel}_{key}", usual) for key, usual in _DEFAULTS.items()}
    if not said["MIN"] < said["TRIM"] < said["MAX"]:
        raise UserError(
            f"{path}: SERVO{channel}_TRIM = {said['TRIM']:g} us is not between its MIN = "
            f"{said['MIN']:g} and MAX = {said['MAX']:g}; a motor that runs both ways has its "
            "neutral between them"
        )
    return ServoOutput(
        channel, function, said["MIN"], said["MAX"], said["TRIM"], bool(said["REVERSED"])
    )
