"""What MAVLink messages have in common, whatever file they stand in: sender, clock, arming, no fix.

Fields are in the units of MAVLink (`lat` in 1e-7 deg, `vx` of GLOBAL_POSITION_INT in cm/s).
`HEARTBEAT:armed` is one while orders reach the actuators.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from diffsea.recordings.logs.streams import Stream
from diffsea.recordings.mappings import Mapping as ChannelMapping
from diffsea.trajectory import Samples


_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: a ground station, a camera, a gimbal
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED in HEARTBEAT.base_mode
_WRAPPED = 2.0**32  # us at which the time of SERVO_OUTPUT_RAW begins again, every 71 min
_ALIKE = 1.0  # s: stamps within it of the autopilot's clock are of that clock
_RESTARTED = 1.0  # s by which the time since boot falls where the autopilot was restarted


class Message(NamedTuple):
    """One message of a telemetry log."""

    name: str  # in capitals, as MAVLink has it
    system: int  # that sent it
    received: float  # s
    fields: dict[str, float | str]


class MessageLog(NamedTuple):
    """How logs of messages are read, by a function that gives all in the order of a file.

    The function says also whether the file is cut off, in words, and raises `UserError` where there
    are no messages.
    """

    messages: Callable[[Path], tuple[list[Message], str]]

    def contents(self, path: Path) -> dict[str, list[str]]:
        """The numeric fields of every message of the vehicle."""
        found = self._streams(path)
        return {topic: list(found[topic].fields) for topic in sorted(found)}

    def streams(self, path: Path, mapping: ChannelMapping, topics: list[str]) -> dict[str, Stream]:
        """The streams of those of the messages that the log has; time is seconds since boot."""
        del mapping
        found = self._streams(path)
        return {topic: found[topic] for topic in topics if topic in found}

    def parameters(self, path: Path) -> list[tuple[str, float]]:
        """The vehicle's parameters as they were told (PARAM_VALUE), in the order of the file."""
        messages, _ = self.messages(path)
        told = [one.fields for one in of_the_vehicle(messages) if one.name == "PARAM_VALUE"]
        return [
            (str(fields["param_id"]).rstrip("\x00"), float(fields["param_value"]))
            for fields in told
            if "param_id" in fields and isinstance(fields.get("param_value"), float)
        ]

    def _streams(self, path: Path) -> dict[str, Stream]:
        messages, cut_off = self.messages(path)
        return streams_of_messages(of_the_vehicle(messages), path.name, cut_off)


def of_the_vehicle(messages: Sequence[Message]) -> list[Message]:
    """The messages of the vehicle: of several the one with the most heartbeats of an autopilot."""

    def is_foreign(one: Message) -> bool:
        return one.name == "HEARTBEAT" and one.fields.get("autopilot") == _NO_AUTOPILOT

    beats = Counter(
        one.system for one in messages if one.name == "HEARTBEAT" and not is_foreign(one)
    )
    vehicle = beats.most_common(1)[0][0] if beats else messages[0].system
    return [one for one in messages if one.system == vehicle and not is_foreign(one)]


def streams_of_messages(
    messages: Sequence[Message], file: str, cut_off: str = ""
) -> dict[str, Stream]:
    """A stream of each message's numbers; further outputs are `SERVO_OUTPUT_RAW[1]` and so on."""
    rows: dict[str, list[dict[str, float]]] = {}
    received: dict[str, list[float]] = {}
    for one in messages:
        topic = one.name
        fields = {name: n for name, n in one.fields.items() if isinstance(n, float)}
        if topic == "SERVO_OUTPUT_RAW" and fields.get("port"):
            topic = f"{topic}[{fields['port']:.0f}]"
        rows.setdefault(topic, []).append(fields)
        received.setdefault(topic, []).append(one.received)
    series = {
        topic: {
            name: np.array([row.get(name, np.nan) for row in own], dtype=float)
            for name in dict.fromkeys(name for row in own for name in row)
        }
        for topic, own in rows.items()
    }
    times = {topic: np.array(stamps, dtype=float) for topic, stamps in received.items()}
    return mavlink_streams(times, series, file, cut_off)


def mavlink_streams(
    received: Mapping[str, Samples],
    fields: Mapping[str, dict[str, Samples]],
    file: str,
    cut_off: str = "",
) -> dict[str, Stream]:
    """Streams of MAVLink messages on the autopilot's clock, seconds since boot.

    Messages with `time_boot_ms` have that time, those with `time_usec` this one where it is of the
    same clock, and all others the time of reception less the median delay of the clocks. A file in
    which the autopilot was restarted has times of reception throughout, counted from the first.

    Arguments:
        received: times of reception, s, by topic.
        fields: series of the same lengths by topic; their names may be paths that end in the
            names of MAVLink's fields.
        file: for the note on a restart.
        cut_off: as a stream has it.
    """
    boots = {topic: _field(own, "time_boot_ms") for topic, own in fields.items()}
    since_boot = {topic: ms * 1e-3 for topic, ms in boots.items() if ms is not None}
    restarted = any(np.any(np.diff(t) < -_RESTARTED) for t in since_boot.values())
    if restarted or not since_boot:
        first = min(float(t[0]) for t in received.values()) if received else 0.0
        times = {topic: t - first for topic, t in received.items()}
        clock = "time of reception"
        notes = (f"{file}: the autopilot was restarted, so times are those of reception",)
        notes = notes if restarted else ()
    else:
        delays = [received[topic] - t for topic, t in since_boot.items()]
        zero = float(np.median(np.concatenate(delays)))
        times = {
            t: _boot_time(received[t], own, since_boot.get(t), zero) for t, own in fields.items()
        }
        clock, notes = "the autopilot's time since boot", ()
    return {
        topic: _stream(topic, times[topic], fields[topic], clock, notes, cut_off)
        for topic in fields
    }


def _boot_time(
    received: Samples, fields: dict[str, Samples], since_boot: Samples | None, zero: float
) -> Samples:
    """Seconds since boot of one topic's messages; `zero` is when the autopilot booted, received."""
    if since_boot is not None:
        return since_boot
    stamps = _field(fields, "time_usec")
    if stamps is not None:
        candidate = np.unwrap(stamps, period=_WRAPPED) * 1e-6
        if abs(float(np.median(received - candidate)) - zero) < _ALIKE:
            return candidate
    return received - zero


def _stream(
    topic: str,
    t: Samples,
    fields: dict[str, Samples],
    clock: str,
    notes: tuple[str, ...],
    cut_off: str,
) -> Stream:
    """The stream in the order of its times, with what the messages say of themselves."""
    order = np.argsort(t, kind="stable")
    fields = {name: series[order] for name, series in fields.items()}
    mode = _field(fields, "base_mode")
    mode = _field(fields, "base_mode.bits") if mode is None else mode
    if mode is not None:
        fields["armed"] = np.where(mode.astype(int) & _ARMED, 1.0, 0.0)
    places = [_name(fields, name) for name in ("lat", "lon")]
    if all(places):  # zero and zero stand for no fix
        none = np.all([fields[name] == 0 for name in places], axis=0)
        fields |= {name: np.where(none, np.nan, fields[name]) for name in places}
    return Stream(topic, t[order], fields, clock, notes, cut_off=cut_off)


def _name(fields: Mapping[str, Samples], name: str) -> str:
    """The full name of a field that is named by its end, empty where there is none."""
    ends = (full for full in fields if full == name or full.endswith(f".{name}"))
    return next(ends, "")


def _field(fields: Mapping[str, Samples], name: str) -> Samples | None:
    full = _name(fields, name)
    return fields[full] if full else None
