"""Effects from the `[[effect]]` tables of a vessel file."""

import dataclasses
from typing import Any

import numpy as np

from diffsea.errors import UserError, nearest
from diffsea.vessel import actuators as act
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import (
    LATENCY_CHANNELS,
    STAGES,
    channels_of,
    default_wind,
    find_effects,
)
from diffsea.vessel.tables import Table, check_keys, needed, number


def with_effect(vessel: Vessel, table: Table) -> Vessel:
    """The vessel with the effect of a table. Raises `UserError` where the table is wrong."""
    name = str(table.get("name", ""))
    variants = find_effects(name)
    where = f"[[effect]] {name!r}"
    if name == "sensor-latency":
        return _apply_latency(vessel, table)
    if name in STAGES:
        return _apply_stage(vessel, table)
    wind_keys = ("frontal_area", "lateral_area", "C_X", "C_Y", "C_N") if name == "wind" else ()
    units = [key for variant in variants for key in variant.units]
    check_keys(table, ("name", *units, *wind_keys), where)
    if wind_keys:
        given = {key: number(table, key, where) for key in wind_keys if key in table}
        # What an earlier table says of the superstructure holds for a wind that is added.
        wind = dataclasses.replace(vessel.forces.get("wind", default_wind(vessel)), **given)
        vessel = dataclasses.replace(vessel, forces=vessel.forces | {"wind": wind})
    # Where an effect has an entry of all its coefficients, its parts are of no use here.
    whole = [variant for variant in variants if variant.name == name]
    for variant in whole or variants:
        values = {key: needed(table, key, where) for key in variant.units if key in table}
        if values or whole:
            _check_effect(vessel, name, values, where)
            vessel = variant.apply(vessel, np.asarray(variant.coordinates(vessel, values)))
    return vessel


def _check_effect(vessel: Vessel, name: str, values: dict[str, float], where: str) -> None:
    draught = float(vessel.rigid_body.draught)
    body = vessel.rigid_body
    aboard = name == "mass-change" and float(body.payload) != 0
    if aboard and float(body.payload_time) != values.get("time", 0.0):
        raise UserError(f"{where}: a vessel file can hold changes of mass at one time only")
    if name == "shallow-water" and not values.get("depth", 2 * draught) > draught:
        raise UserError(
            f"{where}: depth = {values['depth']:g} m is not more than the draught of {draught:g} m"
        )
    kinds = {"propeller-side-force": act.Propeller, "rudder-interaction": act.Rudder}
    parts = list(vessel.actuators.values())
    if name in kinds and sum(isinstance(part, kinds[name]) for part in parts) < 1:
        raise UserError(f"{where}: the vessel has no [[{kinds[name].__name__.lower()}]]")


def _apply_stage(vessel: Vessel, table: Table) -> Vessel:
    """A stage of the servos of some actuators, of all of them where the table names none."""
    stage = STAGES[str(table["name"])]
    where = f"[[effect]] {stage.name!r}"
    check_keys(table, ("name", stage.parameter, "actuators"), where)
    value = needed(table, stage.parameter, where)
    if stage.positive and value < 0:
        raise UserError(f"{where}: {stage.parameter} = {value:g} is negative")
    channels = _chosen(vessel, table.get("actuators"), where)
    kinds = [set(channels_of(vessel, kind)) & set(channels) for kind in ("propulsion", "steering")]
    if all(kinds) and not stage.timed:
        raise UserError(
            f"{where}: {stage.parameter} is in the unit of the orders, and the vessel has thrusts "
            f"and angles; say which with actuators = [...] (it has: {', '.join(vessel.channels)})"
        )
    if value == 0 and stage.name in ("rate-limit", "thrust-saturation"):
        raise UserError(f"{where}: {stage.parameter} must be positive; leave it out for none")
    return stage.say(vessel, channels, value)


def _chosen(vessel: Vessel, names: Any, where: str) -> tuple[str, ...]:
    """Channels by their own names or those of their actuators; all of them for None."""
    if names is None:
        return vessel.channels
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UserError(f"{where}: actuators = {names!r} is not a list of names")
    known = {c: (c,) for c in vessel.channels}
    known |= {name: tuple(part.servos) for name, part in vessel.actuators.items()}
    for name in names:
        if name not in known:
            raise UserError(f"{where}: no actuator {name!r}{nearest(name, known)}")
    return tuple(channel for name in names for channel in known[name])


def _apply_latency(vessel: Vessel, table: Table) -> Vessel:
    check_keys(table, ("name", "delay", "channels"), "[[effect]] 'sensor-latency'")
    delay = needed(table, "delay", "[[effect]] 'sensor-latency'")
    channels = table.get("channels", ["x", "y"])
    if not isinstance(channels, list) or not all(isinstance(name, str) for name in channels):
        raise UserError(
            f"[[effect]] 'sensor-latency': channels = {channels!r} is not a list of names "
            'such as ["x", "y"]'
        )
    groups = [g for g, members in LATENCY_CHANNELS.items() if set(members) & set(channels)]
    if not groups:
        raise UserError("[[effect]] 'sensor-latency': channels are among x, y, psi, u, v, r")
    for group in groups:
        vessel = find_effects(f"sensor-latency:{group}")[0].apply(vessel, np.array([delay]))
    return vessel
