"""Missions as TOML files: what is asked of a vessel, read and checked.

A table that is not there takes its defaults; a key that is not known is refused with the nearest
one. All numbers are in SI units and rad, as in vessel files.
"""

import pathlib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from diffsea.errors import UserError, nearest
from diffsea.identification.online.estimator import ESTIMATORS
from diffsea.missions.record import (
    Controller,
    Flow,
    HeadingLaw,
    Mission,
    OnlineEstimator,
    SensorErrors,
    TimedStep,
    Waypoint,
    Weather,
)
from diffsea.outside.documents import read_toml
from diffsea.parameters import check_names, file_parameters, replace, spread_over_places
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel import files
from diffsea.vessel.base import Vessel
from diffsea.vessel.tables import Table, check_keys, needed, numbers, positive, tables_of


_KEYS = (
    "format",
    "name",
    "seed",
    "seconds",
    "period",
    "time_step",
    "vessel",
    "model",
    "start",
    "controller",
    "waypoint",
    "step",
    "weather",
    "sensors",
    "estimator",
)


class ControllerKind(NamedTuple):
    """What a kind of controller follows (`waypoint` or `step` tables), and the keys of its table.

    Besides `kind` and `limits`; `needs` are those without a default.
    """

    follows: str
    keys: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()


_TABLES = ("heading", "speed_law")
_STEERED = ("speed", "throttle", "heading", "speed_law")
_OF_PAIRS = ("K_p", "K_d", "T_f", "base_min", "base_max", "near", "far", "radius")
_OF_LOGIC = ("full_thrust", "full_angle", "wide", "wide_share", "near", "near_share", "sharpness")
CONTROLLERS = {
    "line-of-sight": ControllerKind(
        "waypoint", (*_STEERED, "lookahead", "radius", "integral_gain")
    ),
    "pursuit": ControllerKind("waypoint", (*_STEERED, "radius")),
    "track-keeping": ControllerKind("waypoint", ("speed", "radius", "feedforward")),
    "waypoint-logic": ControllerKind("waypoint", ("radius", *_OF_LOGIC)),
    "dynamic-pd": ControllerKind("waypoint", (*_OF_PAIRS, "largest"), _OF_PAIRS),
    "course": ControllerKind("step", ("heading", "speed_law")),
    "positioning": ControllerKind("step", ("position", "heading_error", "integral_time")),
    "orders": ControllerKind("step"),
}
HEADING_LAWS = {
    "pid": ("gain", "rate_gain", "integral_gain", "largest_angle"),
    "pd": ("gain", "rate_gain", "filter_time", "largest_angle"),
}
SPEED_LAW = ("gain", "integral_gain")
_POSITIVE = (  # of a controller
    *("speed", "lookahead", "radius", "near", "far", "T_f", "largest"),
    *("position", "heading_error", "integral_time"),
)
_OF_STEPS = {
    "orders": ("orders",),
    "course": ("heading", "speed"),
    "positioning": ("x", "y", "heading"),
}
_FLOW = ("speed", "direction")
_SUPERSTRUCTURE = ("frontal_area", "lateral_area", "C_X", "C_Y", "C_N", "C_NY")
_WAVE = ("bias", "amplitude", "frequency", "phase", "direction")
_SENSORS = ("position", "heading", "velocity", "yaw_rate", "heading_offset", "gyro_bias", "delay")
_OF_ESTIMATORS = {"kalman": "drift", "least-squares": "memory"}
_SIGNED_SENSORS = ("heading_offset", "gyro_bias")


def read_mission(path: str | pathlib.Path) -> Mission:
    """Read a mission from a TOML file; files of vessels are relative to its folder.

    Raises:
        UserError: the file cannot be read, a key or a vessel is unknown, a number is missing or
            impossible; with the nearest known name or the repair.
    """
    path = pathlib.Path(path)
    document = read_toml(path, "the mission")
    try:
        return mission_of(document, path.parent, path.stem)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def mission_of(
    document: Table, folder: pathlib.Path = pathlib.Path(), name: str = "mission"
) -> Mission:
    """The mission of a document, checked. Raises `UserError` as `read_mission` does.

    Arguments:
        folder: that files of vessels are relative to.
        name: of the mission where the document has none.
    """
    if document.get("format", 1) != 1:
        raise UserError(f"format = {document['format']!r}; this version reads format = 1")
    check_keys(document, _KEYS, "the file")
    vessel = _vessel(document, "vessel", folder)
    model = _vessel(document, "model", folder) if "model" in document else vessel
    if model.units != vessel.units:
        units = (", ".join(f"{c} ({unit})" for c, unit in v.units.items()) for v in (model, vessel))
        raise UserError("[model] is ordered by {}, the vessel by {}".format(*units))
    controller = _controller(_table(document, "controller"), vessel)
    waypoints, steps = _waypoints(document), _steps(document, controller.kind, vessel)
    follows = CONTROLLERS[controller.kind].follows
    if follows == "waypoint" and (steps or len(waypoints) < 2):
        raise UserError(
            f"[controller] {controller.kind!r} follows [[waypoint]] tables, two or more, and no "
            f"[[step]]; there are {len(waypoints)} and {len(steps)}"
        )
    if follows == "step" and (waypoints or not steps):
        raise UserError(
            f"[controller] {controller.kind!r} follows [[step]] tables and no [[waypoint]]; there "
            f"are {len(steps)} and {len(waypoints)}"
        )
    if follows == "step" and "seconds" not in document:
        raise UserError("seconds is missing: timed steps have no end of their own")
    start = _table(document, "start", {})
    check_keys(start, MOTION_CHANNELS, "[start]")
    seed = document.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise UserError(f"seed = {seed!r} is not a whole number from zero on")
    lengths = ("seconds", "period", "time_step")
    return Mission(
        str(document.get("name", name)),
        vessel,
        model,
        controller,
        waypoints,
        steps,
        numbers(start, MOTION_CHANNELS, "[start]"),
        _weather(_table(document, "weather", {})),
        _sensors(_table(document, "sensors")) if "sensors" in document else None,
        _estimator(_table(document, "estimator"), model) if "estimator" in document else None,
        seed,
        **{key: positive(document, key, "the file") for key in lengths if key in document},
    )


def _table(document: Table, key: str, default: Table | None = None) -> Table:
    """A table of the document; one without a default must be there."""
    if key not in document and default is None:
        raise UserError(f"there is no [{key}] table")
    table = document.get(key, default)
    if not isinstance(table, dict):
        raise UserError(f"write [{key}] as a table with single brackets")
    return table


def _vessel(document: Table, key: str, folder: pathlib.Path) -> Vessel:
    """The vessel of `[vessel]` or `[model]`: shipped or of a file, some of its numbers replaced."""
    table, where = _table(document, key), f"[{key}]"
    check_keys(table, ("name", "file", "parameters"), where)
    if ("name" in table) == ("file" in table):
        raise UserError(f"{where} has either the name of a shipped vessel or a file")
    shipped = files.shipped_vessels()
    name = str(table.get("name", ""))
    if "name" in table and name not in shipped:
        raise UserError(
            f"{where}: no vessel {name!r} ships{nearest(name, shipped)}; give one of "
            f"{', '.join(shipped)}, or a file"
        )
    source = shipped[name] if "name" in table else folder / str(table["file"])
    vessel = files.read_vessel(source).vessel
    parameters = _table(table, "parameters", {})
    values = numbers(parameters, parameters, f"{where} parameters")
    places = file_parameters(vessel)
    check_names(vessel, [name for name in values if name not in places])
    vessel = replace(vessel, spread_over_places(places, values))
    files.check(vessel)
    return vessel


def _controller(table: Table, vessel: Vessel) -> Controller:
    where, kind = "[controller]", str(table.get("kind"))
    if kind not in CONTROLLERS:
        hint = nearest(kind, CONTROLLERS)
        raise UserError(f"{where} kind = {kind!r}{hint}; it is one of {', '.join(CONTROLLERS)}")
    _, keys, needs = CONTROLLERS[kind]
    check_keys(table, ("kind", "limits", *keys), f"{where} of kind {kind!r}")
    for key in needs:
        needed(table, key, where)
    of_numbers = [key for key in keys if key not in (*_TABLES, "feedforward")]
    stated = numbers(table, of_numbers, where)
    for key in _POSITIVE:
        if key in stated:
            positive(table, key, where)
    if "speed" in stated and "throttle" in stated:
        raise UserError(f"{where} has either a speed to hold or a throttle that is left alone")
    if "far" in stated and not stated["far"] > stated["near"]:
        raise UserError(f"{where}: far = {stated['far']:g} must be above near = {stated['near']:g}")
    heading = dict(_table(table, "heading", {}))
    law = str(heading.pop("law", "pid"))
    if law not in HEADING_LAWS:
        raise UserError(f"{where} heading: law = {law!r} is one of {', '.join(HEADING_LAWS)}")
    check_keys(heading, HEADING_LAWS[law], f"{where} heading, law {law!r}")
    speed_law = _table(table, "speed_law", {})
    check_keys(speed_law, SPEED_LAW, f"{where} speed_law")
    return Controller(
        kind,
        stated,
        HeadingLaw(law, numbers(heading, heading, f"{where} heading")),
        numbers(speed_law, speed_law, f"{where} speed_law"),
        _limits(_table(table, "limits", {}), vessel),
        _truth(table, "feedforward", False, where),
    )


def _truth(table: Table, key: str, default: bool, where: str) -> bool:
    """A key that is true or false."""
    value = table.get(key, default)
    if not isinstance(value, bool):
        raise UserError(f"{where}: {key} = {value!r} is neither true nor false")
    return value


def _limits(table: Table, vessel: Vessel) -> dict[str, tuple[float, float]]:
    """Limits of orders by channel, each within reach of its actuator."""
    where, limits = "[controller] limits", {}
    check_keys(table, vessel.channels, where)
    for channel, pair in table.items():
        if not isinstance(pair, list) or len(pair) != 2:
            raise UserError(f"{where}: {channel} = {pair!r} is not [lowest, highest]")
        ends: Table = dict(zip(("lowest", "highest"), pair, strict=True))
        low, high = (needed(ends, end, f"{where}: {channel}") for end in ends)
        if not low < high:
            raise UserError(f"{where}: {channel} is from {low:g} to {high:g}: turn them round")
        servo = vessel.servos[channel]
        lower, upper = (None if end is None else float(end) for end in (servo.lower, servo.upper))
        if (upper is not None and low >= upper) or (lower is not None and high <= lower):
            raise UserError(
                f"{where}: {channel} from {low:g} to {high:g} lies outside what the actuator can "
                f"do, {lower:g} to {upper:g}"
            )
        limits[channel] = (low, high)
    return limits


def _waypoints(document: Table) -> tuple[Waypoint, ...]:
    points: list[Waypoint] = []
    for number, table in enumerate(tables_of(document, "waypoint"), start=1):
        where = f"[[waypoint]] {number}"
        check_keys(table, ("x", "y", "time"), where)
        x, y = needed(table, "x", where), needed(table, "y", where)
        point = Waypoint(x, y, **numbers(table, ("time",), where))
        if points and (x, y) == (points[-1].x, points[-1].y):
            raise UserError(f"{where} is where the one before is: take one of them out")
        points.append(point)
    _require_order("[[waypoint]]", [one.time for one in points if one.time is not None])
    return tuple(points)


def _steps(document: Table, kind: str, vessel: Vessel) -> tuple[TimedStep, ...]:
    """The timed steps; those of kind `orders` state every channel in the first one."""
    steps: list[TimedStep] = []
    for number, table in enumerate(tables_of(document, "step"), start=1):
        where = f"[[step]] {number}"
        keys = _OF_STEPS.get(kind, _OF_STEPS["course"])
        check_keys(table, ("time", *keys), where)
        time = needed(table, "time", where)
        if kind == "orders":
            given = _table(table, "orders")
            check_keys(given, vessel.channels, f"{where} orders")
            before = steps[-1].orders if steps else {}
            orders = {**before, **numbers(given, given, f"{where} orders")}
            for channel in vessel.channels:
                needed(orders, channel, f"{where} orders")
            steps.append(TimedStep(time, orders=orders))
        elif kind == "positioning":
            x, y, heading = (needed(table, key, where) for key in keys)
            steps.append(TimedStep(time, heading, x=x, y=y))
        else:
            heading, speed = needed(table, "heading", where), positive(table, "speed", where)
            steps.append(TimedStep(time, heading, speed))
    _require_order("[[step]]", [one.time for one in steps])
    return tuple(steps)


def _require_order(where: str, times: list[float]) -> None:
    for before, after in zip(times, times[1:], strict=False):
        if not after > before:
            raise UserError(f"{where}: time {after:g} comes after {before:g}: times must increase")


def _weather(table: Table) -> Weather:
    check_keys(table, ("current", "wind", "wave"), "[weather]")
    wave, where = _table(table, "wave", {}), "[weather] wave"
    check_keys(wave, _WAVE, where)
    current = _flow(table, "current", ())
    gusty = ("gusts", "gust_time", *_SUPERSTRUCTURE)
    wind = _flow(table, "wind", gusty)
    first = _first(table.get("wind", {}))
    stated = numbers(first, gusty, "[weather] wind")
    gusts = {key: stated[key] for key in ("gusts", "gust_time") if key in stated}
    if gusts.get("gusts", 0.0) < 0 or not gusts.get("gust_time", 1.0) > 0:
        raise UserError("[weather] wind: gusts are not negative, and gust_time is above zero")
    superstructure = {key: stated[key] for key in _SUPERSTRUCTURE if key in stated}
    waves = numbers(wave, wave, where)
    return Weather(current, wind, **gusts, superstructure=superstructure, wave=waves)


def _first(tables: object) -> Table:
    return tables[0] if isinstance(tables, list) else tables  # type: ignore[return-value]


def _flow(table: Table, key: str, more: Iterable[str]) -> Flow | None:
    """A steady flow of one table, or one that changes of several with their times.

    `more` are other keys of the first table.
    """
    if key not in table:
        return None
    given, where = table[key], f"[weather] {key}"
    tables = given if isinstance(given, list) else [given]
    if not tables or not all(isinstance(one, dict) for one in tables):
        raise UserError(f"{where} is a table with speed and direction, or several with times")
    rows: list[Mapping[str, float]] = []
    for number, one in enumerate(tables):
        check_keys(one, (*_FLOW, "time", *(more if number == 0 else ())), where)
        timed = ("time",) if len(tables) > 1 else ()
        rows.append({name: needed(one, name, where) for name in (*_FLOW, *timed)})
        if rows[-1]["speed"] < 0:
            raise UserError(f"{where}: speed = {rows[-1]['speed']:g} is negative")
    times = [row.get("time", 0.0) for row in rows]
    _require_order(where, times)
    columns = ([row[name] for row in rows] for name in _FLOW)
    return Flow(tuple(times), *map(tuple, columns))


def _estimator(table: Table, model: Vessel) -> OnlineEstimator:
    where, kind = "[estimator]", table.get("kind", ESTIMATORS[0])
    if kind not in ESTIMATORS:
        hint = nearest(str(kind), ESTIMATORS)
        raise UserError(f"{where} kind = {kind!r}{hint}; it is one of {', '.join(ESTIMATORS)}")
    own = _OF_ESTIMATORS[kind]
    check_keys(table, ("kind", "free", "adapt", own), f"{where} of kind {kind!r}")
    free, adapt = table.get("free", []), _truth(table, "adapt", True, where)
    if not isinstance(free, list) or not all(isinstance(name, str) for name in free):
        raise UserError(f'{where}: free = {free!r} is no list of names, for example ["N_r"]')
    check_names(model, free)
    stated = {own: positive(table, own, where)} if own in table else {}
    return OnlineEstimator(kind, tuple(free), **stated, adapt=adapt)


def _sensors(table: Table) -> SensorErrors:
    check_keys(table, _SENSORS, "[sensors]")
    stated = numbers(table, table, "[sensors]")
    for key, value in stated.items():
        if key not in _SIGNED_SENSORS and value < 0:
            raise UserError(f"[sensors]: {key} = {value:g} is negative")
    return SensorErrors(**stated)
