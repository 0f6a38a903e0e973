"""PX4's `.ulg` logs: every message and instance a stream on the autopilot's one clock."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.logs.streams import (
    Stream,
    ends_within_a_message,
    unreadable,
)
from diffsea.recordings.mappings import Mapping
from diffsea.recordings.rotations import angles_in


# Fields that are not known where another field of the message is below a limit: a flag that is
# not set, or a fix below two dimensions.
_NEEDED = {
    "xy_valid": (1, ("x", "y")),
    "v_xy_valid": (1, ("vx", "vy")),
    "lat_lon_valid": (1, ("lat", "lon")),
    "fix_type": (2, ("lat", "lon", "latitude_deg", "longitude_deg", "vel_n_m_s", "vel_e_m_s")),
}


def contents(path: Path) -> dict[str, list[str]]:
    """The fields of every message; instances other than the first have their number in []."""
    log, *_ = _open_log(path, None)
    found = {}
    for data in sorted(log.data_list, key=lambda data: (data.name, data.multi_id)):
        instance = f"[{data.multi_id}]" if data.multi_id else ""
        found[data.name + instance] = list(_fields(data))
    return found


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the topics that the log has; time is seconds since boot.

    `sensor_gps[1]` is the second instance of a message, `sensor_gps` the first. Quaternions
    `q.0` (w) to `q.3` also give `q.roll`, `q.pitch` and `q.yaw`, in the message's frame,
    north-east-down. Fields that a flag of their message calls invalid are NaN.

    Raises:
        UserError: the file is no ULog, or has no data, or a message without its time.
    """
    del mapping
    wanted = {}
    for topic in topics:
        parts = re.fullmatch(r"(.+)\[(\d+)\]", topic)
        wanted[topic] = (parts[1], int(parts[2])) if parts else (topic, 0)
    log, notes, cut_off = _open_log(path, [name for name, _ in wanted.values()])
    data = {(data.name, data.multi_id): data for data in log.data_list}
    streams = {}
    for topic, instance in wanted.items():
        if instance in data:
            if "timestamp" not in data[instance].data:
                raise UserError(f"{path}: its message {topic} has no timestamp; it is damaged")
            t = data[instance].data["timestamp"] * 1e-6
            fields, clock = _fields(data[instance]), "the autopilot's time since boot"
            streams[topic] = Stream(topic, t, fields, clock, notes, cut_off=cut_off)
    return streams


def _open_log(path: Path, names: list[str] | None) -> tuple[Any, tuple[str, ...], str]:
    """The messages of these names, all if None; a note where the file is damaged or cut off."""
    import pyulog

    with unreadable(path, "a PX4 log (ULog)"), path.open("rb") as file:
        log = pyulog.ULog(file, names)
        if not log.message_formats:
            raise ValueError("it ends before its definitions")
    if log.file_corruption:
        return log, (f"{path.name} is damaged; what could be read of it is used",), ""
    # Every message begins with its length and its kind.
    content, at = path.read_bytes(), 16  # bytes of the file's header
    while at + 3 <= len(content):
        at += 3 + int.from_bytes(content[at : at + 2], "little")
    if at != len(content):
        return log, (), ends_within_a_message(path)
    return log, (), ""


def _fields(data: Any) -> dict[str, np.ndarray]:
    fields = {
        re.sub(r"\[(\d+)\]", r".\1", name): np.asarray(series, dtype=float)
        for name, series in data.data.items()
        if name != "timestamp"
    }
    for level, (least, names) in _NEEDED.items():
        for name in names:
            if level in fields and name in fields:
                fields[name] = np.where(fields[level] >= least, fields[name], np.nan)
    return fields | angles_in(fields)
