"""The numbers of a mission by name, as its file writes them: what a grid or a tuning changes.

A name is the path of a key in the file, joined by dots: `controller.lookahead`,
`controller.heading.gain`, `model.mass`, `weather.current.speed`. Its end alone will do where no
other number ends alike.
"""

import copy
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from diffsea.errors import UserError, nearest
from diffsea.missions.controllers import LOOKAHEAD, radius_of, speed_of
from diffsea.missions.document import CONTROLLERS, HEADING_LAWS, SPEED_LAW
from diffsea.missions.record import Controller, Flow, Mission, Weather
from diffsea.parameters import file_parameters, named, replace, spread_over_places
from diffsea.scales import time_scale
from diffsea.simulation.control import FilteredPD, HeadingHold, SpeedHold, WaypointLogic
from diffsea.simulation.control.positioning import HEADING, INTEGRAL_TIME, POSITION
from diffsea.types import Scalar


Values = Mapping[str, Scalar]

_LAWS = {"pid": HeadingHold, "pd": FilteredPD}
_FLOWS = ("current", "wind")
_CALM = Flow((0.0,), (0.0,), (0.0,))


def mission_numbers(mission: Mission) -> dict[str, float]:
    """Every number that can be changed, with its value: as stated, or the usual one.

    Weather is where it is steady; a number that says which of two things is done (a throttle
    beside a speed) only where it is stated.
    """
    found = {f"controller.{k}": v for k, v in _of_controller(mission).items()}
    for whose in ("vessel", "model"):
        vessel = getattr(mission, whose)
        values = named(vessel)
        found |= {
            f"{whose}.{name}": values[places[0]] for name, places in file_parameters(vessel).items()
        }
    for name in _FLOWS:
        flow: Flow = getattr(mission.weather, name) or _CALM
        if len(flow.times) == 1:
            found |= {f"weather.{name}.speed": flow.speeds[0]}
            found |= {f"weather.{name}.direction": flow.directions[0]}
    found["weather.wind.gusts"] = mission.weather.gusts
    return {name: float(value) for name, value in found.items()}


def _of_controller(mission: Mission) -> dict[str, Any]:
    """The controller's numbers by their keys, nested ones joined by a dot."""
    asked, kind = mission.controller, CONTROLLERS[mission.controller.kind]
    usual: dict[str, Any] = {"radius": radius_of(mission)}
    if "heading" in kind.keys:
        fields = HEADING_LAWS[asked.heading.law]
        stated = _defaults(_LAWS[asked.heading.law], fields) | dict(asked.heading.numbers)
        usual |= {f"heading.{name}": value for name, value in stated.items()}
    if "speed_law" in kind.keys and "throttle" not in asked.numbers:
        stated = _defaults(SpeedHold, SPEED_LAW) | dict(asked.speed_law)
        usual |= {f"speed_law.{name}": value for name, value in stated.items()}
    if "speed" in kind.keys and "throttle" not in asked.numbers:
        usual["speed"] = speed_of(mission)
    if "lookahead" in kind.keys:
        length = mission.model.rigid_body.length
        usual |= {"lookahead": LOOKAHEAD * length, "integral_gain": 0.0}
    if "integral_time" in kind.keys:
        length = mission.model.rigid_body.length
        usual |= {
            "position": POSITION * length,
            "heading_error": HEADING,
            "integral_time": INTEGRAL_TIME * time_scale(length),
        }
    if asked.kind == "waypoint-logic":
        usual |= _defaults(WaypointLogic, kind.keys)
    usual |= asked.numbers
    return {name: value for name, value in usual.items() if name.split(".")[0] in kind.keys}


def _defaults(law: type, names: Iterable[str]) -> dict[str, Any]:
    """Defaults of a law's fields, of those that have one."""
    fields = {one.name: one.default for one in dataclasses.fields(law)}
    known = (name for name in names if fields.get(name) not in (dataclasses.MISSING, None))
    return {name: fields[name] for name in known}


def full_names(mission: Mission, names: Sequence[str]) -> list[str]:
    """The whole names of numbers that are given by their ends.

    Raises:
        UserError: a name of no number or of several, or one that is given twice.
    """
    known, whole = mission_numbers(mission), []
    for name in names:
        ends = [name] if name in known else [one for one in known if one.endswith(f".{name}")]
        if len(ends) > 1:
            raise UserError(f"{name!r} may be any of {', '.join(ends)}: write one of these")
        if not ends:
            hint = nearest(name, [*known, *(one.rpartition(".")[2] for one in known)])
            raise UserError(
                f"the mission has no number {name!r} that can be changed{hint}; it "
                f"has {', '.join(n for n in known if not n.startswith(('vessel.', 'model.')))}, "
                "and vessel. or model. with any number of the vessel's file"
            )
        if ends[0] in whole:
            raise UserError(f"{ends[0]} is given twice")
        whole += ends
    return whole


def with_numbers(mission: Mission, values: Values) -> Mission:
    """The mission with some numbers replaced, by their whole names. Pure: differentiate it."""
    groups: dict[str, dict[str, Scalar]] = {}
    for name, value in values.items():
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = value
    changed: dict[str, Any] = {}
    if "controller" in groups:
        changed["controller"] = _with_gains(mission.controller, groups["controller"])
    for whose in groups.keys() & {"vessel", "model"}:
        vessel = getattr(mission, whose)
        places = spread_over_places(file_parameters(vessel), groups[whose])
        changed[whose] = replace(vessel, places)
    if "weather" in groups:
        changed["weather"] = _with_flows(mission.weather, groups["weather"])
    return dataclasses.replace(mission, **changed)


def _with_gains(asked: Controller, values: Values) -> Controller:
    homes: dict[str, dict[str, Scalar]] = {
        "": dict(asked.numbers),
        "heading": dict(asked.heading.numbers),
        "speed_law": dict(asked.speed_law),
    }
    for name, value in values.items():
        group, _, key = name.rpartition(".")
        homes[group][key] = value
    law = dataclasses.replace(asked.heading, numbers=homes["heading"])
    numbers, speed_law = homes[""], homes["speed_law"]
    return dataclasses.replace(asked, numbers=numbers, heading=law, speed_law=speed_law)


def _with_flows(weather: Weather, values: Values) -> Weather:
    """Weather with flows that are steady at what is given, else at what they begin with."""
    changed: dict[str, Any] = {}
    for name in _FLOWS:
        flow: Flow = getattr(weather, name) or _CALM
        speed, direction = f"{name}.speed", f"{name}.direction"
        if speed in values or direction in values:
            now = values.get(speed, flow.speeds[0]), values.get(direction, flow.directions[0])
            changed[name] = Flow((0.0,), *((value,) for value in now))
    if "wind.gusts" in values:
        changed["gusts"] = values["wind.gusts"]
    return dataclasses.replace(weather, **changed)


def settled(mission: Mission, names: Iterable[str]) -> Mission:
    """The mission with its usual numbers stated, so that none follows from those that change.

    Weather that is to change is there, as a calm.
    """
    numbers, flows = mission_numbers(mission), {}
    stated = {name: value for name, value in numbers.items() if name.startswith("controller.")}
    for flow in _FLOWS:
        if any(name.startswith(f"weather.{flow}.") for name in names):
            flows[flow] = getattr(mission.weather, flow) or _CALM
    weather = dataclasses.replace(mission.weather, **flows)
    return with_numbers(dataclasses.replace(mission, weather=weather), stated)


def with_numbers_in_file(
    document: Mapping[str, Any], values: Mapping[str, float]
) -> dict[str, Any]:
    """The content of a mission's file with some numbers replaced, by their whole names.

    The model that was the vessel itself stays what it was where the vessel changes.
    """
    changed = copy.deepcopy(dict(document))
    if any(name.startswith(("vessel.", "model.")) for name in values):
        changed.setdefault("model", copy.deepcopy(changed["vessel"]))
    for name, value in values.items():
        group, _, rest = name.partition(".")
        if group in ("vessel", "model"):
            changed[group].setdefault("parameters", {})[rest] = value
            continue
        table = changed.setdefault(group, {})
        *tables, key = rest.split(".")
        for one in tables:
            table = table.setdefault(one, {})
            table = table[0] if isinstance(table, list) else table
        if group == "weather":
            table |= {"speed": 0.0, "direction": 0.0} | table
        table[key] = value
    return changed
