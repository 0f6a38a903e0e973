"""Effects on what thrusters, propellers and rudders make of an executed order."""

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from diffsea.types import Scalar
from diffsea.vessel.actuators import FixedThruster, Propeller, Rudder
from diffsea.vessel.base import Vessel
from diffsea.vessel.dependent_forces import Change, ScrewSideForce
from diffsea.vessel.effects.entry import (
    ALL_LOST_AT_MOST,
    ANY,
    Bound,
    Coordinates,
    Effect,
    Numbers,
    fresh,
    onset_size,
    onsets,
    speed_scale,
    with_secondary,
)


def _of(vessel: Vessel, kind: type) -> dict[str, eqx.Module]:
    return {n: part for n, part in vessel.actuators.items() if isinstance(part, kind)}


def _map(vessel: Vessel, parts: dict, change: Callable[[eqx.Module], eqx.Module]) -> Vessel:
    changed = {name: change(part) for name, part in parts.items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, vessel.actuators | changed)


def _sided(vessel: Vessel) -> bool:
    """Whether thrusters stand on both sides of the centreline."""
    sides = [float(part.y) for part in vessel.propulsors.values()]
    return any(y < 0 for y in sides) and any(y > 0 for y in sides)


def _asymmetry(vessel: Vessel, ratio: Coordinates) -> Vessel:
    def change(part: eqx.Module) -> eqx.Module:
        by = jnp.sign(part.y) * ratio[0]
        return eqx.tree_at(lambda p: p.losses.asymmetry, part, part.losses.asymmetry + by)

    return _map(vessel, vessel.propulsors, change)


def _misalignment(vessel: Vessel, angle: Coordinates) -> Vessel:
    def change(part: eqx.Module) -> eqx.Module:
        return eqx.tree_at(lambda p: p.angle, part, part.angle + angle[0])

    return _map(vessel, _of(vessel, FixedThruster), change)


def _loss(field: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, slope: Coordinates) -> Vessel:
        def change(part: eqx.Module) -> eqx.Module:
            now = getattr(part.losses, field)
            return eqx.tree_at(lambda p: getattr(p.losses, field), part, now + slope[0])

        return _map(vessel, vessel.propulsors, change)

    return add


def _ordered_in_newtons(vessel: Vessel) -> bool:
    """Whether some thruster's force does not depend on the speed of advance."""
    return any(part.bollard_coefficient is None for part in vessel.propulsors.values())


def _with_speed_bounds(vessel: Vessel) -> tuple[Bound, ...]:
    """No thruster pushes harder the faster it goes, at one order."""
    own = [float(part.losses.with_speed) for part in vessel.propulsors.values()]
    return ((-min(own), math.inf),)


def _change(vessel: Vessel, at: Coordinates) -> Vessel:
    change = Change(at[0], at[1], True)
    return with_secondary(vessel, fresh("thrust-change", vessel.secondary), change)


def _screw(vessel: Vessel) -> list[str]:
    return list(_of(vessel, Propeller))


def _side_force(vessel: Vessel, at: Coordinates) -> Vessel:
    name = fresh("propeller-side-force", vessel.secondary)
    return with_secondary(vessel, name, ScrewSideForce(_screw(vessel)[0], *at))


def _lone_rudders(vessel: Vessel) -> bool:
    """Whether there are rudders that neither act on the hull nor have their flow straightened."""
    rudders = _of(vessel, Rudder).values()
    alone = [float(p.a_H) == 0 and float(p.gamma_R_port) == 1 for p in rudders]
    return bool(alone) and all(alone)


def _interaction(vessel: Vessel, at: Coordinates) -> Vessel:
    """Coordinates a_H, a_H x_H / L and 1 - gamma_R."""
    length = vessel.rigid_body.length

    def change(part: eqx.Module) -> eqx.Module:
        port, starboard = part.gamma_R_port - at[2], part.gamma_R_starboard - at[2]
        return eqx.tree_at(
            lambda p: (p.a_H, p.hull_lever, p.gamma_R_port, p.gamma_R_starboard),
            part,
            (
                part.a_H + at[0],
                part.hull_lever + at[1] * length - at[0] * part.x_H,
                port,
                starboard,
            ),
        )

    return _map(vessel, _of(vessel, Rudder), change)


def _interaction_bounds(vessel: Vessel) -> tuple[Bound, ...]:
    """Twice what was measured on models: a_H 0.5, a force near x_H = -0.5 L, gamma_R 0.2 to 0.7."""
    return (0.0, 1.0), (-1.0, 0.0), (-0.5, 1.0)


def _interaction_parameters(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
    x_H = at[1] * vessel.rigid_body.length / jnp.where(jnp.abs(at[0]) > 1e-9, at[0], 1.0)
    return {"a_H": at[0], "x_H": x_H, "gamma_R": 1 - at[2]}


def _interaction_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    a_H, length = numbers.get("a_H", 0.0), float(vessel.rigid_body.length)
    own = next((float(part.x_H) for part in _of(vessel, Rudder).values()), 0.0)
    return a_H, a_H * numbers.get("x_H", own) / length, 1 - numbers.get("gamma_R", 1.0)


THRUST = (
    Effect(
        "thrust-asymmetry", "actuator", {"ratio": "1"}, _asymmetry, lambda v: (0.1,), _sided,
        bounds=lambda v: ((-1.0, 1.0),),
        law="port and starboard thrust times (1 - ratio) and (1 + ratio)",
        confusables=("thruster-misalignment", "actuator-bias", "gyro-bias", "wind"),
    ),
    Effect(
        "thruster-misalignment", "actuator", {"angle": "rad"}, _misalignment, lambda v: (0.05,),
        lambda v: _sided(v) and bool(_of(v, FixedThruster)),
        bounds=lambda v: ((-math.pi / 2, math.pi / 2),),
        law="the push of every fixed thruster turned by `angle`, clockwise from above",
        confusables=("thrust-asymmetry", "actuator-bias", "heading-offset", "gyro-bias"),
    ),
    Effect(
        "thrust-loss-with-speed", "actuator", {"slope": "s/m"}, _loss("with_speed"),
        lambda v: (0.02 / speed_scale(v),), _ordered_in_newtons, bounds=_with_speed_bounds,
        law="T (1 - slope u_r): the tangent of a propeller's falling K_T(J)",
        confusables=("quadratic-damping", "deadband", "drag-change", "thrust-saturation"),
    ),
    Effect(
        "thrust-loss-in-turns", "actuator", {"slope": "s/rad"}, _loss("in_turns"),
        lambda v: (0.3,), lambda v: bool(v.propulsors), positive=True,
        law="T (1 - slope |r|): ventilation and shadowing in turns",
        confusables=("crossflow-drag", "quadratic-damping", "speed-dependent-damping"),
    ),
    Effect(
        "thrust-change", "actuator", {"time": "s", "factor": "1"}, _change,
        lambda v: (0.1, onset_size(v)), lambda v: bool(v.propulsors),
        bounds=lambda v: (ALL_LOST_AT_MOST, ANY), shape=1, grid=onsets,
        decode=lambda v, at: {"time": at[1], "factor": at[0]},
        encode=lambda v, n: (n.get("factor", 0.0), n.get("time", 0.0)),
        coordinate_names=("factor", "time"),
        law="all thrusts times (1 + factor) from `time` on the run's clock",
        confusables=("drag-change", "mass-change"),
    ),
    Effect(
        "propeller-side-force", "actuator",
        {"Y_ahead": "1", "N_ahead": "1", "Y_astern": "1", "N_astern": "1"}, _side_force,
        lambda v: (0.02, 0.01, 0.05, 0.025), lambda v: len(_screw(v)) == 1,
        law="Y = Y_a |X_P|, N = N_a L |X_P| with X_P the screw's own force, other coefficients "
        "ahead and astern (Brix 1993, section 1.3)",
        confusables=("actuator-bias", "wind"),
    ),
    Effect(
        "rudder-interaction", "actuator", {"a_H": "1", "x_H": "m", "gamma_R": "1"}, _interaction,
        lambda v: (0.1, 0.05, 0.2), _lone_rudders, bounds=_interaction_bounds,
        decode=_interaction_parameters, encode=_interaction_coordinates,
        coordinate_names=("a_H", "a_H x_H / L", "1 - gamma_R"),
        law="MMG: Y = -(1 + a_H) F_N cos delta, N = -(x_R + a_H x_H) F_N cos delta, inflow angle "
        "straightened by gamma_R (Yasukawa and Yoshimura 2015)",
        confusables=("sway-yaw-coupling", "munk-moment"),
    ),
)  # fmt: skip
