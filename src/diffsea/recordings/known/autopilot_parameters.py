"""Parameters in a log of ArduPilot: which output is which motor, its zero, its ends, its sense.

The autopilot tells its parameters when logging starts, and again what is changed later.
`SERVOn_FUNCTION` says what output n drives, by numbers of ArduPilot's list.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from diffsea.errors import UserError, nearest
from diffsea.recordings.logs.reading import format_of


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

    channel: int  # n of SERVOn
    function: int
    minimum: float
    maximum: float
    trim: float
    is_reversed: bool

    def check_ends(self, where: str) -> None:
        """Raises `UserError` where neutral is not between both ends, as of a motor it has to be."""
        if not self.minimum < self.trim < self.maximum:
            raise UserError(
                f"{where}: SERVO{self.channel}_TRIM = {self.trim:g} us is not between its MIN = "
                f"{self.minimum:g} and MAX = {self.maximum:g}; a motor that runs both ways has "
                "its neutral between them"
            )

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
        values: of all parameters, by name, as they were told last.
        outputs: those of a known function, by channel.
        thrust_asymmetry: thrust full ahead over full astern that the autopilot mixes with.
        changed: names of parameters of these outputs that changed in the log; the last value is
            used.
    """

    values: Mapping[str, float]
    outputs: tuple[ServoOutput, ...]
    thrust_asymmetry: float
    changed: tuple[str, ...] = ()

    def output(self, function: int) -> ServoOutput | None:
        """The first output of a function, or None."""
        return next((one for one in self.outputs if one.function == function), None)


def read_parameters(path: Path) -> AutopilotParameters:
    """What the parameters in a log say of a boat's actuators: none of a format that has none.

    Raises:
        UserError: the log is not there or cannot be read, or the package that reads it is absent.
    """
    if not path.exists():
        siblings = [item.name for item in path.parent.glob("*")]
        raise UserError(f"there is no log {path}{nearest(path.name, siblings)}")
    form, told = format_of(path), list[tuple[str, float]]()
    if form is not None and form.parameters is not None:
        with form.packages(path):
            told = form.parameters(path)
    values: dict[str, float] = {}
    changed = dict[str, None]()
    for name, value in told:
        if values.get(name, value) != value:
            changed[name] = None
        values[name] = value
    outputs = _outputs(values)
    of_outputs = tuple(f"SERVO{one.channel}_" for one in outputs)
    return AutopilotParameters(
        values,
        outputs,
        max(values.get("MOT_THST_ASYM", 1.0), 1.0),
        tuple(name for name in changed if name.startswith(of_outputs)),
    )


def _outputs(values: Mapping[str, float]) -> tuple[ServoOutput, ...]:
    """The outputs of a known function, by their number."""
    found = []
    for channel in range(1, OUTPUTS + 1):
        function = int(values.get(f"SERVO{channel}_FUNCTION", 0))
        if function in FUNCTIONS:
            least, most, trim, turned = (
                values.get(f"SERVO{channel}_{key}", usual) for key, usual in _DEFAULTS.items()
            )
            found.append(ServoOutput(channel, function, least, most, trim, bool(turned)))
    return tuple(found)
