"""Vessels as TOML files: reading with checks, writing back, and the ones that ship.

A `VesselFile` keeps the document beside the vessel, so that what a fit or a diagnosis
changes is written into the user's own file and everything else stays as it was.
"""

import copy
import dataclasses
import importlib.resources
import math
import pathlib
import tomllib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import tomli_w

from diffsea.errors import UserError, nearest
from diffsea.vessel import actuators as act
from diffsea.vessel.base import AbstractActuator, AbstractForce, AddedMass, RigidBody, Vessel
from diffsea.vessel.effects import (
    LATENCY_CHANNELS,
    STAGES,
    channels_of,
    default_wind,
    find_effects,
)
from diffsea.vessel.hull import (
    POWERS,
    Damping,
    PrimeDamping,
    Scaling,
    is_derivative,
    is_rudder_derivative,
)
from diffsea.vessel.servo import Servo


Table = dict[str, Any]

_BODY = ("mass", "I_z", "x_G", "length", "beam", "draught", "water_density")
_ADDED = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
_HULL_WORDS = ("added_mass_coriolis", "nondimensional", "exponents", "reference_speed")
_COMMON = ("name", "time_constant", "rate_limit", "delay", "deadband", "sharpness")
_LOSSES = ("asymmetry", "with_speed", "in_turns")
_TABLES = ("thruster", "azimuth_thruster", "tunnel_thruster", "propeller", "rudder")


@dataclasses.dataclass(frozen=True)
class VesselFile:
    """A vessel and the document it was read from."""

    vessel: Vessel
    document: Table
    path: str


def shipped() -> dict[str, pathlib.Path]:
    """The vessels that come with the package, by name."""
    folder = importlib.resources.files("diffsea.vessel") / "data"
    paths = sorted(pathlib.Path(str(folder)).glob("*.toml"))
    return {path.stem: path for path in paths}


def read_vessel(source: str | pathlib.Path) -> VesselFile:
    """Read a vessel from a TOML file, or a shipped one by its name.

    Raises:
        UserError: the file cannot be read, a key or an effect is unknown, a value is not a
            number or impossible; with the nearest known name or the repair.
    """
    path = pathlib.Path(source)
    if not path.exists() and str(source) in shipped():
        path = shipped()[str(source)]
    document = _parse(path)
    try:
        return VesselFile(build(document), document, str(source))
    except UserError as error:
        raise UserError(f"{source}: {error}") from None


def _parse(path: pathlib.Path) -> Table:
    if path.is_dir():
        raise UserError(f"{path} is a folder; name the vessel's TOML file")
    if not path.exists():
        names = ", ".join(shipped())
        raise UserError(
            f"{path}: no such vessel file{nearest(path.stem, shipped())}; "
            f"give the path of a TOML file or one of the shipped vessels: {names}"
        )
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise UserError(f"{path}: not a text file; a vessel is a TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not valid TOML: {error}") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None


def build(document: Table) -> Vessel:
    """The vessel a document describes, checked. Raises `UserError` as `read_vessel` does."""
    if document.get("format", 1) != 1:
        raise UserError(f"format = {document['format']!r}; this version reads format = 1")
    _known(document, ("format", "name", "source", "hull", "effect", *_TABLES), "the file")
    hull = document.get("hull")
    if not isinstance(hull, dict):
        raise UserError("there is no [hull] table; it holds length, beam, draught, mass, I_z ...")
    body, added, forces, scaling = _hull(hull)
    parts: dict[str, AbstractActuator] = {}
    for kind in _TABLES:
        for number, table in enumerate(_tables(document, kind), start=1):
            name = str(table.get("name", kind if number == 1 else f"{kind}{number}"))
            if name in parts:
                raise UserError(f"two actuators are called {name!r}; give each its own name")
            parts[name] = _ACTUATORS[kind](name, table, body, scaling)
    _check_propellers(parts)
    vessel = Vessel(
        body, added, forces, parts,
        name=str(document.get("name", "vessel")), source=str(document.get("source", "")),
    )  # fmt: skip
    for table in _tables(document, "effect"):
        vessel = _apply_effect(vessel, table)
    check(vessel)
    return vessel


def check(vessel: Vessel) -> None:
    """Raise `UserError` where a vessel is impossible."""
    body = vessel.rigid_body
    for field in ("mass", "I_z", "length", "beam", "draught", "water_density"):
        if not float(getattr(body, field)) > 0:
            raise UserError(f"[hull] {field} = {float(getattr(body, field)):g} must be positive")
    mass = np.asarray(vessel.mass_matrix(), float)
    if np.linalg.eigvalsh(0.5 * (mass + mass.T)).min() <= 0:
        raise UserError(
            "[hull] the mass matrix (rigid body plus added mass) is not positive definite; "
            "added masses X_udot, Y_vdot, N_rdot are negative in the SNAME sign convention, "
            "and Y_rdot, N_vdot, x_G must be small against them"
        )
    for channel, servo in vessel.servos.items():
        _check_servo(channel, servo)


def _check_servo(channel: str, servo: Servo) -> None:
    low, high = servo.lower, servo.upper
    if low is not None and high is not None and not float(low) < float(high):
        raise UserError(
            f"actuator {channel!r}: its lower limit {low:g} is not below its upper limit {high:g}"
        )
    for field in ("time_constant", "delay", "deadband", "backlash", "sharpness"):
        value = getattr(servo, field)
        if value is not None and float(value) < 0:
            raise UserError(f"actuator {channel!r}: {field} = {float(value):g} is negative")
    if servo.rate_limit is not None and not float(servo.rate_limit) > 0:
        raise UserError(f"actuator {channel!r}: rate_limit must be positive")


def _check_propellers(parts: Mapping[str, AbstractActuator]) -> None:
    propellers = [name for name, part in parts.items() if isinstance(part, act.Propeller)]
    for name, part in parts.items():
        wanted = getattr(part, "propeller", None)
        if wanted is not None and wanted not in propellers:
            raise UserError(
                f"rudder {name!r} stands behind propeller {wanted!r}, which the file does not "
                f"have; it has: {', '.join(propellers) or 'none'}"
            )


def _known(table: Mapping, keys: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in keys:
            raise UserError(f"unknown key {key!r} in {where}{nearest(key, keys)}")


def _tables(document: Table, kind: str) -> list[Table]:
    tables = document.get(kind, [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise UserError(f"write [[{kind}]] with double brackets: there can be several")
    return tables


def _number(table: Table, key: str, where: str, default: float | None = None) -> float | None:
    value = table.get(key, default)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"{where}: {key} = {value!r} is not a finite number")
    return float(value)


def _needed(table: Table, key: str, where: str) -> float:
    value = _number(table, key, where)
    if value is None:
        raise UserError(f"{where}: {key} is missing")
    return value


def _positive(table: Table, key: str, where: str) -> float:
    value = _needed(table, key, where)
    if not value > 0:
        raise UserError(f"{where}: {key} = {value:g} must be positive")
    return value


def _hull(
    hull: Table,
) -> tuple[RigidBody, AddedMass, dict[str, AbstractForce], Scaling | None]:
    known = (*_BODY, *_ADDED, *_HULL_WORDS)
    names = [key for key in hull if is_derivative(key)]
    suggestions = (*known, "X_u", "X_uu", "Y_v", "Y_vv", "Y_r", "Y_rr", "N_v", "N_r", "N_rr")
    for key in hull:
        if key not in known and key not in names:
            raise UserError(f"unknown key {key!r} in [hull]{nearest(key, suggestions)}")
    for key in ("mass", "I_z", "length", "beam", "draught"):
        _needed(hull, key, "[hull]")
    numbers = {key: _needed(hull, key, "[hull]") for key in hull if key not in _HULL_WORDS[:3]}
    body = RigidBody(**{key: numbers[key] for key in _BODY if key in numbers})
    terms = hull.get("added_mass_coriolis", "full")
    if terms not in ("full", "no-munk", "none"):
        raise UserError('[hull] added_mass_coriolis is "full", "no-munk" or "none"')
    added = AddedMass(
        **{key: numbers[key] for key in _ADDED if key in numbers}, coriolis_terms=terms
    )
    derivatives = {name: numbers[name] for name in names}
    scaling = _scaling(hull, body, numbers)
    exponents = _exponents(hull, derivatives)
    if scaling is None:
        return body, added, {"damping": Damping(derivatives, exponents)}, None
    return body, added, {"damping": PrimeDamping(derivatives, scaling)}, scaling


def _exponents(hull: Table, derivatives: dict[str, float]) -> dict[str, float]:
    """Exponents of power laws: `[hull.exponents]` with some of X_u, Y_v and N_r."""
    table, where = hull.get("exponents", {}), "[hull.exponents]"
    if not isinstance(table, dict):
        raise UserError(f"{where} is a table, for example X_u = 1.7")
    _known(table, POWERS, where)
    if table and "nondimensional" in hull:
        raise UserError(f"{where}: power laws are for derivatives in SI units")
    for key in table:
        if key not in derivatives:
            raise UserError(f"{where}: {key} is no power law without {key} in [hull]")
    return {key: _positive(table, key, where) for key in table}


def _scaling(hull: Table, body: RigidBody, numbers: dict[str, float]) -> Scaling | None:
    kind = hull.get("nondimensional")
    if kind is None:
        return None
    if kind not in ("mmg", "abkowitz"):
        raise UserError('[hull] nondimensional is "mmg" or "abkowitz"; leave it out for SI units')
    speed = numbers.get("reference_speed", 0.0)
    if kind == "abkowitz" and not speed > 0:
        raise UserError("[hull] an Abkowitz set needs reference_speed (m/s)")
    return Scaling(kind, body.length, body.draught, body.water_density, speed)


def _servo(table: Table, where: str, low: str | None, high: str | None) -> Servo:
    stages = {key: _number(table, key, where) for key in _COMMON if key != "name"}
    lower = None if low is None else _number(table, low, where)
    upper = None if high is None else _number(table, high, where)
    return Servo(lower=lower, upper=upper, **stages)


def _losses(table: Table, where: str) -> act.Losses:
    return act.Losses(*(_number(table, key, where, 0.0) for key in _LOSSES))


def _position(table: Table, where: str) -> dict[str, float]:
    return {key: _number(table, key, where, 0.0) for key in ("x", "y")}


def _thruster(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[thruster]] {name!r}"
    speeds = ("max_speed", "min_speed") if "curve" in table else ()
    keys = (*_COMMON, *_LOSSES, "x", "y", "angle", "curve", "max_force", "min_force", *speeds)
    _known(table, keys, where)
    curve = _curve(table, where)
    if curve is None:
        servo = _servo(table, where, "min_force", "max_force")
    else:
        servo = _servo(_in_speeds(table, curve[1], where), where, "min_speed", "max_speed")
    angle = _number(table, "angle", where, 0.0)
    place = _position(table, where)
    return act.FixedThruster(
        {name: servo}, **place, angle=angle, curve=curve, losses=_losses(table, where)
    )


def _curve(table: Table, where: str) -> tuple[float, float] | None:
    curve = table.get("curve")
    if curve is None:
        return None
    if not isinstance(curve, dict) or set(curve) != {"c", "d"}:
        raise UserError(f"{where}: curve = {{c = .., d = ..}} for T = c V n + d |n| n")
    c, d = _needed(curve, "c", where), _positive(curve, "d", where)
    return c, d


def _in_speeds(table: Table, d: float, where: str) -> Table:
    """The table with limits of force as the speeds (rev/s) that reach them at the bollard."""
    speeds = {}
    for side in ("max", "min"):
        force = _number(table, f"{side}_force", where)
        if force is not None and f"{side}_speed" not in table:
            speeds[f"{side}_speed"] = math.copysign(math.sqrt(abs(force) / d), force)
    return table | speeds


def _azimuth(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[azimuth_thruster]] {name!r}"
    angle_keys = ("max_angle", "min_angle", "angle_time_constant", "angle_rate_limit")
    keys = (*_COMMON, *_LOSSES, "x", "y", "max_force", "min_force", *angle_keys)
    _known(table, keys, where)
    force = _servo(table, where, "min_force", "max_force")
    angle = Servo(
        lower=_number(table, "min_angle", where),
        upper=_number(table, "max_angle", where),
        time_constant=_number(table, "angle_time_constant", where),
        rate_limit=_number(table, "angle_rate_limit", where),
        delay=force.delay,
    )
    servos = {f"{name}.force": force, f"{name}.angle": angle}
    return act.AzimuthThruster(servos, **_position(table, where), losses=_losses(table, where))


def _tunnel(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[tunnel_thruster]] {name!r}"
    limits = ("min_force", "max_force")
    _known(table, (*_COMMON, *limits, "x", "fading_speed", "effectiveness"), where)
    x, fading = _needed(table, "x", where), _number(table, "fading_speed", where)
    effectiveness = _number(table, "effectiveness", where, 1.0)
    return act.TunnelThruster({name: _servo(table, where, *limits)}, x, fading, effectiveness)


def _propeller(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[propeller]] {name!r}"
    optional = ("wake_fraction", "wake_decay", "thrust_deduction", "astern_factor")
    limits = ("max_speed", "min_speed")
    _known(table, (*_COMMON, *_LOSSES, "x", "y", "diameter", "k_T", *optional, *limits), where)
    k_T = table.get("k_T")
    if not isinstance(k_T, list) or len(k_T) != 3:
        raise UserError(f"{where}: k_T = [k_0, k_1, k_2] of K_T(J) = k_0 + k_1 J + k_2 J^2")
    numbers = {key: _number(table, key, where) for key in optional if key in table}
    polynomial = {f"k_T[{i}]": k for i, k in enumerate(k_T)}
    return act.Propeller(
        {name: _servo(table, where, "min_speed", "max_speed")},
        diameter=_positive(table, "diameter", where),
        k_T=tuple(_needed(polynomial, key, where) for key in polynomial),
        water_density=body.water_density,
        losses=_losses(table, where),
        **_position(table, where),
        **numbers,
    )


def _rudder(name: str, table: Table, body: RigidBody, scaling: Scaling | None) -> AbstractActuator:
    where = f"[[rudder]] {name!r}"
    limits = ("max_angle", "min_angle")
    derivatives = {key: _needed(table, key, where) for key in table if is_rudder_derivative(key)}
    servo = _servo(table, where, "min_angle", "max_angle")
    if servo.upper is not None and servo.lower is None:
        servo = dataclasses.replace(servo, lower=-servo.upper)
    if derivatives:
        _known(table, (*_COMMON, *limits, *derivatives), where)
        if scaling is None:
            raise UserError(f"{where}: rudder derivatives need [hull] nondimensional")
        return act.DerivativeRudder({name: servo}, derivatives, scaling)
    numeric = (
        "y", "lift_slope", "t_R", "a_H", "x_H", "gamma_R_port", "gamma_R_starboard", "l_R",
        "epsilon", "kappa", "wake_fraction",
    )  # fmt: skip
    _known(table, (*_COMMON, *limits, "area", "x", "height", "propeller", *numeric), where)
    area = _positive(table, "area", where)
    return act.Rudder(
        {name: servo},
        area=area,
        x=_number(table, "x", where, -0.5 * body.length),
        height=_positive({"height": math.sqrt(1.6 * area)} | table, "height", where),
        water_density=body.water_density,
        propeller=table.get("propeller"),
        **{key: _number(table, key, where) for key in numeric if key in table},
    )


_ACTUATORS: dict[str, Callable[..., AbstractActuator]] = {
    "thruster": _thruster,
    "azimuth_thruster": _azimuth,
    "tunnel_thruster": _tunnel,
    "propeller": _propeller,
    "rudder": _rudder,
}


def _apply_effect(vessel: Vessel, table: Table) -> Vessel:
    name = str(table.get("name", ""))
    variants = find_effects(name)
    where = f"[[effect]] {name!r}"
    if name == "sensor-latency":
        return _apply_latency(vessel, table)
    if name in STAGES:
        return _apply_stage(vessel, table)
    wind_keys = ("frontal_area", "lateral_area", "C_X", "C_Y", "C_N") if name == "wind" else ()
    units = [key for variant in variants for key in variant.units]
    _known(table, ("name", *units, *wind_keys), where)
    if wind_keys:
        given = {key: _number(table, key, where) for key in wind_keys if key in table}
        wind = dataclasses.replace(default_wind(vessel), **given)
        vessel = dataclasses.replace(vessel, forces=vessel.forces | {"wind": wind})
    # Where an effect has an entry of all its coefficients, its parts are of no use here.
    whole = [variant for variant in variants if variant.name == name]
    for variant in whole or variants:
        values = {key: _needed(table, key, where) for key in variant.units if key in table}
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
    _known(table, ("name", stage.parameter, "actuators"), where)
    value = _needed(table, stage.parameter, where)
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
    _known(table, ("name", "delay", "channels"), "[[effect]] 'sensor-latency'")
    delay = _needed(table, "delay", "[[effect]] 'sensor-latency'")
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


def updated_document(document: Table, values: Mapping[str, float], effects: list[Table]) -> Table:
    """A copy of a vessel's document with new hull numbers and more `[[effect]]` tables."""
    new = copy.deepcopy(document)
    for name, value in values.items():
        if name.startswith("exponents."):
            new["hull"]["exponents"][name.removeprefix("exponents.")] = float(value)
        elif "." in name:
            _set_actuator(new, name, value)
        else:
            new["hull"][name] = float(value)
    if effects:
        new["effect"] = [*new.get("effect", []), *effects]
    return new


def _set_actuator(document: Table, name: str, value: float) -> None:
    actuator, key = name.rsplit(".", 1)
    for kind in _TABLES:
        for table in document.get(kind, []):
            if table.get("name", kind) == actuator:
                table[key] = float(value)
                return
    raise UserError(f"{name!r} cannot be written into the vessel file")


def dump(document: Table) -> str:
    """The document as TOML text."""
    return tomli_w.dumps(document)
