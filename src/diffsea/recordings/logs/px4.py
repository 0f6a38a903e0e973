"""PX4's `.ulg` logs: every message and instance a stream on the autopilot's one clock."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from diffsea.recordings.logs.streams import Stream, euler_angles, unreadable
from diffsea.recordings.mappings import Mapping


# Where a flag is not set, or a fix is below two dimensions, these fields are not known.
_FLAGS = {
    "xy_valid": ("x", "y"),
    "v_xy_valid": ("vx", "vy"),
    "lat_lon_valid": ("lat", "lon"),
}
_FIX_NEEDED = ("lat", "lon", "latitude_deg", "longitude_deg", "vel_n_m_s", "vel_e_m_s")
_SATELLITE = "fix_type"
_TWO_DIMENSIONS = 2


def contents(path: Path) -> dict[str, list[str]]:
    """The fields of every message; instances other than the first have their number in []."""
    log, _ = _open_log(path, None)
    return {name: list(_fields(data)) for name, data in _data_by_topic(log).items()}


def streams(path: Path, mapping: Mapping, topics: list[str]) -> dict[str, Stream]:
    """The streams of those of the topics that the log has; time is seconds since boot.

    Quaternions `q.0` (w) to `q.3` also give `q.roll`, `q.pitch` and `q.yaw`, in the message's
    frame, north-east-down. Fields that a flag of their message calls invalid are NaN.

    Raises `UserError` for a file that is no ULog, or has no data.
    """
    del mapping
    log, notes = _open_log(path, [_name_and_instance(topic)[0] for topic in topics])
    data = {(data.name, data.multi_id): data for data in log.data_list}
    streams = {}
    for topic in topics:
        found = data.get(_name_and_instance(topic))
        if found is not None:
            t = found.data["timestamp"] * 1e-6
            clock = "the autopilot's time since boot"
            streams[topic] = Stream(topic, t, _fields(found), clock, notes)
    return streams


def _open_log(path: Path, names: list[str] | None) -> tuple[Any, tuple[str, ...]]:
    """The messages of these names, all if None, and a note where the file is damaged."""
    import pyulog

    with unreadable(path, "a PX4 log (ULog)"):
        log = pyulog.ULog(str(path), names)
        if not log.message_formats:
            raise ValueError("it ends before its definitions")
    if log.file_corruption:
        return log, (f"{path.name} is damaged; what could be read of it is used",)
    if _ends_within_message(path):
        return log, (f"{path.name} ends within a message; what is before it is used",)
    return log, ()


def _ends_within_message(path: Path) -> bool:
    """Whether the last message is incomplete; each begins with its length and its kind."""
    log = path.read_bytes()
    at = 16  # bytes of the file's header
    while at + 3 <= len(log):
        at += 3 + int.from_bytes(log[at : at + 2], "little")
    return at != len(log)


def _data_by_topic(log: Any) -> dict[str, Any]:
    sets = sorted(log.data_list, key=lambda data: (data.name, data.multi_id))
    return {
        data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]": data for data in sets
    }


def _name_and_instance(topic: str) -> tuple[str, int]:
    """Name and instance: `sensor_gps[1]` is the second, `sensor_gps` the first."""
    parts = re.fullmatch(r"(.+)\[(\d+)\]", topic)
    return (parts[1], int(parts[2])) if parts else (topic, 0)


def _fields(data: Any) -> dict[str, np.ndarray]:
    fields = {
        re.sub(r"\[(\d+)\]", r".\1", name): np.asarray(series, dtype=float)
        for name, series in data.data.items()
        if name != "timestamp"
    }
    for flag, names in _FLAGS.items():
        _mask(fields, names, fields.get(flag), 1)
    _mask(fields, _FIX_NEEDED, fields.get(_SATELLITE), _TWO_DIMENSIONS)
    for base in [
        name.removesuffix(".3") for name in fields if re.fullmatch(r"(.+\.)?q(_\w+)?\.3", name)
    ]:
        for angle, series in euler_angles(*(fields[f"{base}.{i}"] for i in range(4))).items():
            fields[f"{base}.{angle}"] = series
    return fields


def _mask(
    fields: dict[str, np.ndarray], names: tuple[str, ...], level: np.ndarray | None, least: int
) -> None:
    for name in names:
        if level is not None and name in fields:
            fields[name] = np.where(level >= least, fields[name], np.nan)
