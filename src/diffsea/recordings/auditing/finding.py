"""What an audit says: one record per fault, with its size and its uncertainty."""

import dataclasses
import importlib.resources
import math
import tomllib
from collections.abc import Callable, Mapping

from diffsea.recordings.auditing.edits import Affine, Edit, Spans, Swap
from diffsea.trajectory import in_words


# In the order in which they are reported: sensors, labels, clocks and samples, what a channel is.
KINDS = (
    *("sensor-latency", "gyro-bias", "heading-offset", "hard-iron", "lever-arm", "clock-drift"),
    *("axes", "sign", "unit", "scale", "swapped-channels", "swapped-actuators", "feedback-error"),
    *("time-step", "gap", "duplicate", "stuck", "quantised", "outliers"),
    *("constant", "interpolated", "bursts", "unreadable"),
    *("order-not-motion", "actuation-unit", "through-water"),
)

# Of these, what is wrong is how the recording is read: a mapping puts it right.
MAPPING_KINDS = (
    *("axes", "sign", "unit", "swapped-channels", "swapped-actuators"),
    *("order-not-motion", "actuation-unit"),
)


@dataclasses.dataclass(frozen=True)
class Finding:
    """One fault of a recording.

    `kind` is one of `KINDS`. `value` and `std` are in `unit`; where a fault is a matter of yes or
    no, `value` is what the message explains. `channels` are the columns it concerns, `parameters`
    what the catalogue of effects calls them by. `repair` says what to do about it, `edits` do
    it; `doubt` says why the fault might have to be repaired otherwise, or not here at all.
    `axis` is the motion, "yaw" or "surge", whose response to an actuator shows the fault; `cost`
    how far off (m) a minute's track is while it is left in, NaN where that is not known. Texts are
    for people; programs go by the other fields.
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
    axis: str = ""
    cost: float = math.nan

    @property
    def spans(self) -> Spans:
        """When its channels have it (s); empty where that is always, or is not said."""
        return tuple(span for edit in self.edits for span in edit.changed_spans)

    def as_dict(self) -> dict[str, object]:
        """The finding as it stands in audit.json; a size or error that is unknown is null."""
        return {
            "kind": self.kind,
            "recording": self.recording,
            "value": _finite_or_none(self.value),
            "std": _finite_or_none(self.std),
            "unit": self.unit,
            "message": self.message,
            "repair": self.repair,
            "doubt": self.doubt,
            "channels": list(self.channels),
            "parameters": {k: _finite_or_none(value) for k, value in self.parameters.items()},
            "cost": _finite_or_none(self.cost),
        }


def weight(kind: str, doubt: str | None, cost: float | None) -> tuple[bool, float]:
    """By what findings are put in order, the greatest first.

    What is wrong with how the recording is read, without a doubt, comes before all else; then
    what costs most, and last what is not known to cost anything.
    """
    known = cost is not None and math.isfinite(cost)
    return kind in MAPPING_KINDS and not doubt, cost if known and cost is not None else -1.0


_TEXT = importlib.resources.files("diffsea.recordings.auditing") / "findings.toml"
_CATALOGUE = tomllib.loads(_TEXT.read_text(encoding="utf-8"))
CAUSES: dict[str, str] = _CATALOGUE.pop("causes")  # names of causes in messages


def finding_of(
    fault: str,
    channels: tuple[str, ...],
    value: float,
    std: float,
    words: Mapping[str, object],
    *edits: Edit,
    parameters: dict[str, float] | None = None,
    doubt: str = "",
    axis: str = "",
) -> Finding:
    """The finding of a fault in the words of `findings.toml`, into which `words` are filled.

    `value` and `std` are its size and standard error in the unit that is said there; `edits` make
    the repair. The other arguments are fields of the finding. A tuple among `words` names channels:
    the message calls them by words and names, the repair by their names alone.
    """
    entry = _CATALOGUE[fault]
    own = {"value": value, "std": std, "channel": channels[:1], "channels": channels}
    filled = {**own, **words}
    message = entry["message"].format(**_spelled(filled, lambda names: words_and_names(*names)))
    unit, repair = (entry[key].format(**_spelled(filled, ", ".join)) for key in ("unit", "repair"))
    kind = entry.get("kind", fault)
    return Finding(
        kind, value, std, unit, message, repair, channels, parameters or {}, "", edits, doubt, axis
    )


def words_and_names(*channels: str) -> str:
    """Channels for people who have to find them in a file: `heading (psi)`."""
    return f"{', '.join(in_words(channels))} ({', '.join(channels)})"


def _spelled(
    words: Mapping[str, object], spelling: Callable[[tuple[str, ...]], str]
) -> dict[str, object]:
    """Words with the channels among them spelled out."""
    return {k: spelling(one) if isinstance(one, tuple) else one for k, one in words.items()}


def unreadable(recording: str, error: str) -> Finding:
    """A recording that cannot be read, and what is wrong with it."""
    found = finding_of("unreadable", ("t",), math.nan, math.nan, {"error": error})
    return dataclasses.replace(found, recording=recording, channels=())


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def wrong_sign(
    channels: tuple[str, ...],
    message: str,
    value: float = 0.0,
    std: float = 0.0,
    unit: str = "1",
    kind: str = "sign",
    axis: str = "",
) -> Finding:
    """Channels to be multiplied by -1; `kind` is "axes" where an axis points the other way."""
    repair = f"{' and '.join(channels)} = {{ ..., sign = -1 }} in the mapping"
    edits = (Affine(channels, -1.0),)
    return Finding(kind, value, std, unit, message, repair, channels, edits=edits, axis=axis)


def wrong_unit(
    channels: tuple[str, ...], unit: str, gain: float, message: str, value: float, std: float = 0.0
) -> Finding:
    """Channels in another unit, of `gain` times SI, recognised by the ratio `value`."""
    repair = f'unit = "{unit}" for {" and ".join(channels)} in the mapping'
    edits = (Affine(channels, gain, unit=unit),)
    return Finding("unit", value, std, "1", message, repair, channels, edits=edits)


def in_degrees(channel: str, message: str) -> Finding:
    """An angle in degrees where radians were meant."""
    repair = f'{channel} = {{ ..., unit = "deg" }} in the mapping'
    edits = (Affine((channel,), math.pi / 180, unit="deg"),)
    return Finding("unit", 180 / math.pi, 0.0, "1", message, repair, (channel,), edits=edits)


def exchanged_channels(first: str, second: str, message: str) -> Finding:
    """Two channels under each other's name; the size is filled in once it is known."""
    repair = f"exchange the columns of {first} and {second} in the mapping"
    swap = (Swap(first, second),)
    return Finding("swapped-channels", 0.0, 0.0, "1", message, repair, (first, second), edits=swap)
