"""A valid file of every kind that is read, small, from which hostile ones are made."""

import dataclasses
import functools
import io
import json
import pathlib
import tempfile

import numpy as np
import pandas as pd
from tests.boats import BOAT


SUPPORT: dict[str, pathlib.Path] = {}  # files that readers need besides the hostile one
MAPPING = """format = 1
[file]
delimiter = ","
header_lines = 1
encoding = "utf-8"
decimal = "."
start = 0.0
velocity_axes = "body"
frame = "NED"
[columns]
t = { column = "t", unit = "s" }
psi = { column = "psi", unit = "rad", offset = 0.1, delay = 0.2 }
u = "u"
"""
PRIORS = "format = 1\n[X_u]\nvalue = -50.0\nstd = 10.0\nlower = -200.0\nupper = 0.0\n"
PRIORS += "[x_G]\nfree = false\n"
SHEET = """format = 1
relative_std = 0.02
[[trial]]
manoeuvre = "turning-circle"
angle = 35.0
side = "starboard"
speed = 1.2
[trial.numbers]
advance_over_L = 3.1
tactical_diameter = { value = 22.4, std = 0.3 }
[[trial]]
manoeuvre = "zigzag"
angle = 10.0
heading = 10.0
[trial.numbers]
overshoot_1 = { value = 8.2, unit = "deg", std = 0.5 }
"""
MANIFEST = """boat,vessel,recording,mapping,role
heron,boat.toml,one.csv,,train
heron,boat.toml,two.csv,map.toml,test
gull,kvlcc2,"other/one, early.csv",,
"""
VESSEL = BOAT + '[[effect]]\nname = "current"\nspeed = 0.3\ndirection = 1.2\n'
VESSEL += "[prior]\nX_u = { spread = 0.5 }\n"
MISSIONS = pathlib.Path(__file__).parents[2] / "examples" / "missions"
TEXTS = {
    "mapping": MAPPING,
    "priors": PRIORS,
    "sheet": SHEET,
    "vessel": VESSEL,
    "mission": (MISSIONS / "survey_that_learns.toml").read_text(encoding="utf-8"),
    "manifest": MANIFEST,
    "battery": (MISSIONS / "batteries" / "tides_and_loads.toml").read_text(encoding="utf-8"),
}
SUFFIXES = {
    **dict.fromkeys(TEXTS, ".toml"),
    "manifest": ".csv",
    "csv": ".csv",
    "parquet": ".parquet",
    "mat": ".mat",
    "ros1": ".bag",
    "ros2": ".db3",
    "rosmcap": ".mcap",
    "mcap": ".mcap",
    "bin": ".bin",
    "log": ".log",
    "tlog": ".tlog",
    "tlogcsv": ".csv",
    "ulg": ".ulg",
    "fit": ".json",
}
KINDS = tuple(SUFFIXES)


def write_support(folder):
    """Write the files that readers need besides."""
    for name, text in {
        "good.csv": table().to_csv(index=False),
        "boat.toml": BOAT,
        "mat.toml": '[columns]\nt = "t"\npsi = "psi"\nu = "u"\n',
    }.items():
        SUPPORT[name] = folder / name
        SUPPORT[name].write_text(text)


def table(rows=30):
    t = np.arange(rows) * 0.5
    motion = {"t": t, "x": t, "y": 0 * t, "psi": 0.05 * t, "u": 1 + 0 * t, "v": 0 * t}
    return pd.DataFrame(motion | {"r": 0.05 + 0 * t, "cmd_port": 50 + t})


@functools.cache
def _boat():
    """Twelve seconds of a boat that turns to both sides."""
    from tests.recordings.driven_boat import drive

    boat = drive()
    part = slice(7100, 7700)
    fields = {f.name: getattr(boat, f.name)[part] for f in dataclasses.fields(boat)}
    return dataclasses.replace(boat, **fields | {"t": boat.t[: fields["t"].size]})


def _bag(kind, folder):
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from tests.recordings.driven_boat import ros_messages
    from tests.recordings.test_logs import EPOCH, SECOND, types

    ros = "ros1" if kind == "ros1" else "db3"
    store, path = types(ros), folder / ("run.bag" if kind == "ros1" else "run")
    plugin = StoragePlugin.SQLITE3 if kind == "ros2" else StoragePlugin.MCAP
    writer = Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
    connections = {}
    with writer as file:
        for topic, received, message in ros_messages(_boat(), ros):
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = file.add_connection(topic, name, typestore=store)
            encode = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
            stamp = EPOCH + round(received * SECOND)
            file.write(connections[topic], stamp, bytes(encode(message, name)))
    return (path if kind == "ros1" else next(path.glob("*[3p]"))).read_bytes()


@functools.cache
def seed(kind):
    """Bytes of a valid file."""
    if kind in TEXTS:
        return TEXTS[kind].encode()
    if kind == "csv":
        return table().to_csv(index=False).encode()
    if kind == "fit":
        row = {"value": -40.0, "interval": [-45.0, -35.0], "determined": 0.9}
        return json.dumps({"format": 1, "parameters": {"X_u": row}}, indent=1).encode()
    if kind == "parquet":
        table().assign(note="a word").to_parquet(found := io.BytesIO())
        return found.getvalue()
    if kind == "mat":
        from scipy.io import savemat

        own = {name: series.to_numpy() for name, series in table().items()}
        savemat(found := io.BytesIO(), own | {"s": {"pos": np.ones((3, 30)), "text": "word"}})
        return found.getvalue()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        if kind in ("ros1", "ros2", "rosmcap"):
            return _bag(kind, folder)
        from tests.recordings import driven_boat

        if kind == "bin":
            return driven_boat.ardupilot_log(_boat())
        if kind == "log":
            from tests.recordings.test_logs import text_log

            return driven_boat.ardupilot_log(_boat(), write=text_log)
        if kind == "ulg":
            return driven_boat.px4_log(_boat())
        if kind == "tlogcsv":
            driven_boat.telemetry_csv(_boat(), folder / "log.csv")
            return (folder / "log.csv").read_bytes()
        write = driven_boat.telemetry_log if kind == "tlog" else driven_boat.json_log
        write(_boat(), folder / "log")
        return (folder / "log").read_bytes()
