# pyright: reportArgumentType=false
"""Foreign files made of native recordings: other names, units, frames, layouts.

`disguise` writes a file such as somebody else's logger would have written, and `judged` reads
it back through a proposed mapping and says which channels came out as they were. What a
disguise did is known only to the values: nothing here knows how a proposal is made.
"""

import dataclasses
import math

import numpy as np
import pandas as pd

from diffsea import read_recording


KNOT = 1852.0 / 3600.0
# Per style, names for: t x y psi u v r port starboard rudder propeller, of body velocities;
# then names of velocities north and east.
STYLES = {
    "letters": ("t", "x", "y", "psi", "u", "v", "r", "T_port", "T_stbd", "delta", "n", "vx", "vy"),
    "words": (
        "Time", "Pos X", "Pos Y", "Heading", "Surge velocity", "Sway velocity", "Yaw rate",
        "Thrust port", "Thrust starboard", "Rudder angle", "Propeller speed", "Velocity X",
        "Velocity Y",
    ),
    "snake": (
        "time_stamp", "x_pos", "y_pos", "yaw", "surge", "sway", "yaw_rate", "thr_left",
        "thr_right", "rudder", "n_prop", "vel_x", "vel_y",
    ),
    "german": (
        "Zeit", "x", "y", "Kurs", "Geschwindigkeit u", "Geschwindigkeit v", "Drehrate",
        "Schub Backbord", "Schub Steuerbord", "Ruderwinkel", "Drehzahl", "vx", "vy",
    ),
    "ros": (
        "stamp", "odom:pose.x", "odom:pose.y", "imu:yaw", "odom:twist.linear.x",
        "odom:twist.linear.y", "imu:angular_velocity.z", "thrusters/left", "thrusters/right",
        "rudder:angle", "propeller:data", "odom:twist.vx", "odom:twist.vy",
    ),
    "surveyor": (
        "UTC", "Northing", "Easting", "HDG", "Vx", "Vy", "ROT", "PORT", "STBD", "RUDDER", "RPM",
        "Vel North", "Vel East",
    ),
}  # fmt: skip
_ORDER = ("t", "x", "y", "psi", "u", "v", "r", "port", "starboard", "rudder", "propeller")
# Frames: what the file's x, y, heading, v and r are of north, east, psi, v and r.


@dataclasses.dataclass(frozen=True)
class Disguise:
    """Choices of one disguise, for messages."""

    style: str
    frame: str
    earth: bool
    stated: bool
    masked: bool
    heading: str
    rate: str
    speed: str
    time: str
    geographic: bool
    layout: str
    reversed_rudder: bool


def choose(rng: np.random.Generator) -> Disguise:
    """A disguise at random; the usual is more frequent than the odd."""

    def pick(options: dict):
        names = list(options)
        odds = np.array([options[name] for name in names], float)
        return names[rng.choice(len(names), p=odds / odds.sum())]

    return Disguise(
        style=pick(dict.fromkeys(STYLES, 1)),
        frame=pick({"ned": 6, "enu": 2, "east first": 1, "port sway": 1, "west": 0.5}),
        earth=bool(rng.random() < 0.15),
        stated=bool(rng.random() < 0.5),
        masked=bool(rng.random() < 0.25),
        heading=pick({"rad": 2, "deg": 2, "deg 360": 1}),
        rate=pick({"rad/s": 3, "deg/s": 3, "deg/min": 0.7}),
        speed=pick({"m/s": 4, "kn": 1, "km/h": 0.3}),
        time=pick({"s": 4, "ms": 2, "us": 1, "epoch": 1}),
        geographic=bool(rng.random() < 0.12),
        layout=pick({"csv": 3, "semicolon": 1, "comma decimals": 1, "blanks": 1, "tab": 1,
            "preamble": 1, "units below": 1, "bare": 0.5}),
        reversed_rudder=bool(rng.random() < 0.15),
    )  # fmt: skip


def disguise(native: pd.DataFrame, how: Disguise, rng: np.random.Generator, path) -> None:
    """Write `native` (SI, north-east-down) to `path` in disguise."""
    values, units = _frames(native, how), {}
    _units(values, units, how)
    names = dict(zip((*_ORDER, "ve1", "ve2"), STYLES[how.style], strict=True))
    if how.earth:
        names |= {"u": names["ve1"], "v": names["ve2"]}
    if how.style == "surveyor" and how.frame in ("enu", "east first"):
        names |= {"x": "Easting", "y": "Northing"}
        if how.earth:
            names |= {"u": "Vel East", "v": "Vel North"}
    if how.frame in ("enu", "west") and how.style in ("words", "german", "surveyor"):
        names |= {"psi": "Yaw angle"}  # nobody calls an angle counter-clockwise a heading
    if how.geographic:
        names |= {"x": "Latitude", "y": "Longitude"}
        if how.frame in ("enu", "east first"):
            names |= {"x": "Longitude", "y": "Latitude"}
    columns = {}
    for channel, series in values.items():
        name = names[channel]
        if how.masked and channel != "t" and rng.random() < 0.4:
            name = f"ch{rng.integers(10, 99)}{chr(97 + len(columns))}"
        columns[name] = (series, units.get(channel, ""))
    columns["Battery"] = (np.round(12.6 - 0.001 * np.arange(len(native)), 3), "V")
    columns["flags"] = (np.full(len(native), 4.0), "")
    order = [n for n in columns if n != names["t"]]
    rng.shuffle(order)
    order = [names["t"], *order]
    _write({name: columns[name] for name in order}, how, path)


def _frames(native: pd.DataFrame, how: Disguise) -> dict[str, np.ndarray]:
    get = {name: native[name].to_numpy(float) for name in native.columns}
    values = {name: get[name] for name in ("t", "x", "y", "psi", "u", "v", "r")}
    for channel in ("port", "starboard", "rudder", "propeller"):
        for prefix in ("cmd_", "exec_"):
            if prefix + channel in get and channel not in values:
                values[channel] = get[prefix + channel]
    if how.geographic:
        values |= _geographic(values)
    if how.earth:
        flow = (get["u"] + 1j * get["v"]) * np.exp(1j * get["psi"])
        values |= {"u": flow.real, "v": flow.imag}
    if how.frame == "enu":
        values |= {"x": values["y"], "y": values["x"], "psi": np.pi / 2 - get["psi"]}
        values |= {"r": -get["r"]}
        values |= {"u": values["v"], "v": values["u"]} if how.earth else {"v": -values["v"]}
    elif how.frame == "east first":
        values |= {"x": values["y"], "y": values["x"]}
        values |= {"u": values["v"], "v": values["u"]} if how.earth else {}
    elif how.frame == "port sway" and not how.earth:
        values["v"] = -values["v"]
    elif how.frame == "west":
        values |= {"y": -values["y"], "psi": -get["psi"], "r": -get["r"], "v": -values["v"]}
        if how.geographic:
            values["y"] = -values["y"]
    if how.reversed_rudder and "rudder" in values:
        values["rudder"] = -values["rudder"]
    return values


def _geographic(values: dict) -> dict[str, np.ndarray]:
    """Latitude and longitude, on an ellipsoid, of a place in Norway."""
    latitude, a, e2 = math.radians(63.4), 6378137.0, 6.69437999014e-3
    narrow = 1 - e2 * math.sin(latitude) ** 2
    meridian, normal = a * (1 - e2) / narrow**1.5, a / math.sqrt(narrow)
    return {
        "x": 63.4 + np.degrees(values["x"] / meridian),
        "y": 10.4 + np.degrees(values["y"] / (normal * math.cos(latitude))),
    }


def _units(values: dict, units: dict, how: Disguise) -> None:
    wrapped = np.angle(np.exp(1j * values["psi"]))
    values["psi"] = {
        "rad": wrapped, "deg": np.degrees(wrapped), "deg 360": np.degrees(wrapped) % 360,
    }[how.heading]  # fmt: skip
    values["r"] = values["r"] * {
        "rad/s": 1.0, "deg/s": 180 / np.pi, "deg/min": 10800 / np.pi,
    }[how.rate]  # fmt: skip
    factor = {"m/s": 1.0, "kn": 1 / KNOT, "km/h": 3.6}[how.speed]
    values["u"], values["v"] = factor * values["u"], factor * values["v"]
    values["t"] = {
        "s": values["t"], "ms": 1e3 * values["t"], "us": 1e6 * values["t"],
        "epoch": 1.7e9 + values["t"],
    }[how.time]  # fmt: skip
    angle = "rad" if how.heading == "rad" else "deg"
    if "rudder" in values and angle == "deg":
        values["rudder"] = np.degrees(values["rudder"])
    if how.stated:
        units |= {"psi": angle, "r": how.rate, "u": how.speed, "v": how.speed, "rudder": angle}
        units |= {"t": "s" if how.time == "epoch" else how.time, "port": "N", "starboard": "N"}
        units |= {"propeller": "rev/s"}
        units |= dict.fromkeys(("x", "y"), "deg" if how.geographic else "m")


def _write(columns: dict, how: Disguise, path) -> None:
    mark = {"semicolon": ";", "comma decimals": ";", "blanks": None, "tab": "\t"}.get(
        how.layout, ","
    )
    beneath = how.layout == "units below"
    titles = [f"{n} [{u}]" if u and not beneath else n for n, (_, u) in columns.items()]
    cells = [[_cell(v) for v in series] for series, _ in columns.values()]
    if how.layout == "comma decimals":
        cells = [[cell.replace(".", ",") for cell in column] for column in cells]
    rows = [list(row) for row in zip(*cells, strict=True)]
    if mark is None:
        titles = [title.replace(" ", "_") for title in titles]
    lines = []
    if how.layout == "preamble":
        lines += ["Messfahrt 12.03., Wind 3 Bft, Luft 4 °C", "Logger 7; channels: all"]
    if how.layout == "bare":
        lines += ["some vessel, somewhere"]
    else:
        lines.append(_joined(titles, mark))
    if beneath:
        lines.append(_joined([f"({u})" if u else "(-)" for _, u in columns.values()], mark))
    lines += [_joined(row, mark) for row in rows]
    encoding = "cp1252" if how.layout == "preamble" else "utf-8"
    path.write_text("\n".join(lines) + "\n", encoding=encoding)


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.12g}" if abs(value) < 1e8 else f"{value:.3f}"


def _joined(cells: list[str], mark: str | None) -> str:
    if mark is None:
        return "  ".join(f"{cell or 'nan':>14s}" for cell in cells)
    return mark.join(cells)


def judged(native: pd.DataFrame, path, mapping) -> dict[str, bool]:
    """Which channels of the original come out of the file as they were, by name.

    A channel that is missing, or there although the original has none, is wrong. Positions
    count from where they start, heading by its direction, orders under either prefix.
    """
    run = read_recording(path, mapping)
    found = {name: np.asarray(getattr(run, name)) for name in ("t", "x", "y", "psi", "u", "v", "r")}
    found = {name: series for name, series in found.items() if np.any(np.isfinite(series))}
    for group in (run.commanded, run.executed):
        found |= {name: np.asarray(series) for name, series in group.items()}
    truth = {name: native[name].to_numpy(float) for name in ("t", "x", "y", "psi", "u", "v", "r")}
    for column in native.columns:
        if column.startswith(("cmd_", "exec_")):
            truth.setdefault(column.split("_", 1)[1], native[column].to_numpy(float))
    return {
        name: name in truth and name in found and _same(name, found[name], truth[name])
        for name in {*truth, *found}
    }


def _same(name: str, found: np.ndarray, truth: np.ndarray) -> bool:
    if found.size != truth.size:
        return False
    if name == "psi":
        apart = np.abs(np.angle(np.exp(1j * (found - truth))))
        return bool(np.nanmax(apart) < 1e-3)
    if name in ("t", "x", "y"):
        found, truth = found - found[0], truth - truth[0]
    size = max(float(np.nanmax(np.abs(truth))), 1e-9)
    return bool(np.nanmax(np.abs(found - truth)) < 2e-3 * size)
