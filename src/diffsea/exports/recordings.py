"""Recordings, measured or simulated, for viewers and tables: MCAP for Foxglove, Parquet by rows.

MCAP files have messages in JSON by the published schemas `foxglove.PoseInFrame` and
`foxglove.FrameTransform` (Foxglove, 2026), whose axes are x east, y north, z up, and x ahead,
y to port, z up in the body; and the native channels as they are under `/diffsea`, x north, y east.
"""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from diffsea.errors import UserError
from diffsea.recordings.known.recognition import OWN_PREFIXES, OWN_TOPICS
from diffsea.recordings.readers import to_frame
from diffsea.trajectory import CHANNEL_UNITS, MOTION_CHANNELS, Trajectory


Message = tuple[float, str, dict[str, Any]]  # time (s), topic, content

MAP, BODY = "map", "base_link"  # frames

_NUMBER = {"type": "number"}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_TIME = _object(sec={"type": "integer"}, nsec={"type": "integer"})
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_TEXT = {"type": "string"}
_FOXGLOVE = {
    "/pose": (
        "foxglove.PoseInFrame",
        _object(
            timestamp=_TIME,
            frame_id=_TEXT,
            pose=_object(position=_VECTOR, orientation=_QUATERNION),
        ),
    ),
    "/tf": (
        "foxglove.FrameTransform",
        _object(
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_QUATERNION,
        ),
    ),
}


def long_table(run: Trajectory) -> pd.DataFrame:
    """A row for each value: `run`, `t` (s), `channel`, `value`, `unit`.

    Orders and executed values are in their actuator's own unit, which a recording does not have:
    theirs is empty.
    """
    long = to_frame(run).melt("t", var_name="channel").dropna(subset="value")
    long.insert(0, "run", run.name)
    units = [CHANNEL_UNITS.get(channel, "") for channel in long["channel"]]
    return long.assign(unit=units).reset_index(drop=True)


def write_mcap(run: Trajectory, path: Path) -> None:
    """Write a run as an MCAP file with messages in JSON, one for each row that has the values.

    Raises:
        UserError: the extra `mcap` is not installed, or times that the format cannot have.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise UserError("MCAP needs the extra: pip install 'diffsea[mcap]'") from None
    run = on_a_clock_of_mcap(run)
    native = {
        f"{OWN_TOPICS}{group}": (f"diffsea.{group.capitalize()}", channels)
        for group, channels in groups_of(run).items()
    }
    schemas = _FOXGLOVE | {
        topic: (name, _object(timestamp=_TIME, **{channel: _described(channel) for channel in of}))
        for topic, (name, of) in native.items()
    }
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="diffsea")
        channels = {}
        for topic, (name, schema) in schemas.items():
            text = json.dumps(schema | {"title": name}).encode()
            number = writer.register_schema(name=name, encoding="jsonschema", data=text)
            channels[topic] = writer.register_channel(topic, "json", number)
        for number, (t, topic, content) in enumerate(_messages(run, native)):
            at, data = round(t * 1e9), json.dumps(content).encode()
            writer.add_message(channels[topic], at, data, at, number)
        writer.finish()


def on_a_clock_of_mcap(run: Trajectory) -> Trajectory:
    """The rows that count. Raises `UserError` where an MCAP file cannot have their times."""
    run = run.counted()
    if not (run.t[0] >= 0 and run.t[-1] < 2**63 / 1e9):
        raise UserError(
            f"{run.name}: an MCAP file has times from 0 s on, and the run is from {run.t[0]:g} to "
            f"{run.t[-1]:g} s; shift its clock with a mapping"
        )
    return run


def groups_of(run: Trajectory) -> dict[str, dict[str, np.ndarray]]:
    """The native channels by what they are: `motion`, `orders`, `executed`, `surroundings`."""
    groups: dict[str, dict[str, np.ndarray]] = {}
    of_prefix = {prefix: group for group, prefix in OWN_PREFIXES.items()}
    for name, column in to_frame(run).drop(columns="t").items():
        prefix, underscore, _ = str(name).partition("_")
        usual = "motion" if name in MOTION_CHANNELS else "surroundings"
        group = of_prefix.get(prefix + underscore, usual)
        groups.setdefault(group, {})[str(name)] = column.to_numpy(float)
    return groups


def in_viewers_axes(run: Trajectory, row: int) -> tuple[dict[str, float], dict[str, float]] | None:
    """Position and quaternion of a row, x east, y north, z up; None where one is not known."""
    north, east, psi = (float(run.motion[channel][row]) for channel in ("x", "y", "psi"))
    if not all(map(math.isfinite, (north, east, psi))):
        return None
    half = 0.5 * (0.5 * math.pi - psi)  # of the angle from east, counter-clockwise
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
    return {"x": east, "y": north, "z": 0.0}, turn


def _described(channel: str) -> dict[str, str]:
    return _NUMBER | {"description": CHANNEL_UNITS.get(channel, "the actuator's own unit")}


def _messages(
    run: Trajectory, native: Mapping[str, tuple[str, dict[str, np.ndarray]]]
) -> Iterator[Message]:
    """The messages in the order of time; a value that is missing is left out."""
    for row, t in enumerate(run.t):
        stamp = {
            "timestamp": dict(zip(("sec", "nsec"), divmod(round(t * 1e9), 10**9), strict=True))
        }
        if placed := in_viewers_axes(run, row):
            at, turn = placed
            pose = {"position": at, "orientation": turn}
            yield t, "/pose", stamp | {"frame_id": MAP, "pose": pose}
            frames = {"parent_frame_id": MAP, "child_frame_id": BODY}
            yield t, "/tf", stamp | frames | {"translation": at, "rotation": turn}
        for topic, (_, channels) in native.items():
            values = {name: float(series[row]) for name, series in channels.items()}
            known = {name: value for name, value in values.items() if math.isfinite(value)}
            if known:
                yield t, topic, stamp | known
