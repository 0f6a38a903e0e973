"""What an audit says: one record per fault, with its size and its uncertainty."""

import dataclasses
import math

from diffsea.recordings.auditing.edits import Edit


KINDS = (
    "sensor-latency",
    "gyro-bias",
    "heading-offset",
    "hard-iron",
    "lever-arm",
    "clock-drift",
    "axes",
    "sign",
    "unit",
    "scale",
    "swapped-channels",
    "swapped-actuators",
    "time-step",
    "gap",
    "duplicate",
    "stuck",
    "quantised",
    "outliers",
    "order-not-motion",
    "through-water",
)


@dataclasses.dataclass(frozen=True)
class Finding:
    """One fault of a recording.

    `value` and `std` are in `unit`; where a fault is a matter of yes or no, `value` is what
    the message explains and `std` is NaN. `channels` are the columns it concerns, `parameters`
    what the catalogue of effects calls them by. `repair` says what to do about it, `edits` do
    it; `doubt` says why the fault might have to be repaired otherwise, or not here at all.
    """

    kind: str
    value: float
    std: float
    unit: str
    message: str
    repair: str = ""
    channels: tuple[str, ...] = ()
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)
    recording: str = ""
    edits: tuple[Edit, ...] = ()
    doubt: str = ""

    def as_dict(self) -> dict:
        """The finding as it stands in audit.json; a size or error that is unknown is null."""
        return {
            "kind": self.kind,
            "recording": self.recording,
            "value": _number(self.value),
            "std": _number(self.std),
            "unit": self.unit,
            "message": self.message,
            "repair": self.repair,
            "channels": list(self.channels),
            "parameters": {name: _number(value) for name, value in self.parameters.items()},
        }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
