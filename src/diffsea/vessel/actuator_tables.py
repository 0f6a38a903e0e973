"""Actuators from the tables of a vessel file."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

from diffsea.errors import UserError
from diffsea.vessel import actuators as act
from diffsea.vessel.base import AbstractActuator, RigidBody
from diffsea.vessel.hull import Scaling, is_rudder_derivative
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, needed, number, positive


_COMMON = ("name", "time_constant", "rate_limit", "delay", "deadband", "sharpness")
_LOSSES = ("asymmetry", "with_speed", "in_turns")


def _servo(table: Table, where: str, low: str | None, high: str | None) -> Servo:
    stages = {key: number(table, key, where) for key in _COMMON if key != "name"}
    lower = None if low is None else number(table, low, where)
    upper = None if high is None else number(table, high, where)
    return Servo(lower=lower, upper=upper, **stages)


def _losses(table: Table, where: str) -> act.Losses:
    return act.Losses(*(number(table, key, where, 0.0) for key in _LOSSES))


def _position(table: Table, where: str) -> dict[str, float]:
    return {key: number(table, key, where, 0.0) for key in ("x", "y")}


def _thruster(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[thruster]] {name!r}"
    speeds = ("max_speed", "min_speed") if "curve" in table else ()
    keys = (*_COMMON, *_LOSSES, "x", "y", "angle", "curve", "max_force", "min_force", *speeds)
    check_keys(table, keys, where)
    curve = _curve(table, where)
    if curve is None:
        servo = _servo(table, where, "min_force", "max_force")
    else:
        servo = _servo(_in_speeds(table, curve[1], where), where, "min_speed", "max_speed")
    angle = number(table, "angle", where, 0.0)
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
    c, d = needed(curve, "c", where), positive(curve, "d", where)
    return c, d


def _in_speeds(table: Table, d: float, where: str) -> Table:
    """The table with limits of force as the speeds (rev/s) that reach them at the bollard."""
    speeds = {}
    for side in ("max", "min"):
        force = number(table, f"{side}_force", where)
        if force is not None and f"{side}_speed" not in table:
            speeds[f"{side}_speed"] = math.copysign(math.sqrt(abs(force) / d), force)
    return table | speeds


def _azimuth(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[azimuth_thruster]] {name!r}"
    angle_keys = ("max_angle", "min_angle", "angle_time_constant", "angle_rate_limit")
    keys = (*_COMMON, *_LOSSES, "x", "y", "max_force", "min_force", *angle_keys)
    check_keys(table, keys, where)
    force = _servo(table, where, "min_force", "max_force")
    angle = Servo(
        lower=number(table, "min_angle", where),
        upper=number(table, "max_angle", where),
        time_constant=number(table, "angle_time_constant", where),
        rate_limit=number(table, "angle_rate_limit", where),
        delay=force.delay,
    )
    servos = {f"{name}.force": force, f"{name}.angle": angle}
    return act.AzimuthThruster(servos, **_position(table, where), losses=_losses(table, where))


def _tunnel(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[tunnel_thruster]] {name!r}"
    limits = ("min_force", "max_force")
    check_keys(table, (*_COMMON, *limits, "x", "fading_speed", "effectiveness"), where)
    x, fading = needed(table, "x", where), number(table, "fading_speed", where)
    effectiveness = number(table, "effectiveness", where, 1.0)
    return act.TunnelThruster({name: _servo(table, where, *limits)}, x, fading, effectiveness)


def _propeller(name: str, table: Table, body: RigidBody, _: Any) -> AbstractActuator:
    where = f"[[propeller]] {name!r}"
    optional = ("wake_fraction", "wake_decay", "thrust_deduction", "astern_factor")
    limits = ("max_speed", "min_speed")
    check_keys(table, (*_COMMON, *_LOSSES, "x", "y", "diameter", "k_T", *optional, *limits), where)
    k_T = table.get("k_T")
    if not isinstance(k_T, list) or len(k_T) != 3:
        raise UserError(f"{where}: k_T = [k_0, k_1, k_2] of K_T(J) = k_0 + k_1 J + k_2 J^2")
    numbers = {key: number(table, key, where) for key in optional if key in table}
    polynomial = {f"k_T[{i}]": k for i, k in enumerate(k_T)}
    return act.Propeller(
        {name: _servo(table, where, "min_speed", "max_speed")},
        diameter=positive(table, "diameter", where),
        k_T=tuple(needed(polynomial, key, where) for key in polynomial),
        water_density=body.water_density,
        losses=_losses(table, where),
        **_position(table, where),
        **numbers,
    )


def _rudder(name: str, table: Table, body: RigidBody, scaling: Scaling | None) -> AbstractActuator:
    where = f"[[rudder]] {name!r}"
    limits = ("max_angle", "min_angle")
    derivatives = {key: needed(table, key, where) for key in table if is_rudder_derivative(key)}
    servo = _servo(table, where, "min_angle", "max_angle")
    if servo.upper is not None and servo.lower is None:
        servo = dataclasses.replace(servo, lower=-servo.upper)
    if derivatives:
        check_keys(table, (*_COMMON, *limits, *derivatives), where)
        if scaling is None:
            raise UserError(f"{where}: rudder derivatives need [hull] nondimensional")
        return act.DerivativeRudder({name: servo}, derivatives, scaling)
    numeric = (
        "y", "lift_slope", "t_R", "a_H", "x_H", "gamma_R_port", "gamma_R_starboard", "l_R",
        "epsilon", "kappa", "wake_fraction",
    )  # fmt: skip
    check_keys(table, (*_COMMON, *limits, "area", "x", "height", "propeller", *numeric), where)
    area = positive(table, "area", where)
    return act.Rudder(
        {name: servo},
        area=area,
        x=number(table, "x", where, -0.5 * body.length),
        height=positive({"height": math.sqrt(1.6 * area)} | table, "height", where),
        water_density=body.water_density,
        propeller=table.get("propeller"),
        **{key: number(table, key, where) for key in numeric if key in table},
    )


ACTUATORS: dict[str, Callable[..., AbstractActuator]] = {
    "thruster": _thruster,
    "azimuth_thruster": _azimuth,
    "tunnel_thruster": _tunnel,
    "propeller": _propeller,
    "rudder": _rudder,
}
