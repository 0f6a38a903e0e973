"""Effects on what thrusters, propellers and rudders make of an executed order."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.scales import froude_speed
from diffsea.types import Scalar
from diffsea.vessel.actuators import FixedThruster, Propeller, Rudder
from diffsea.vessel.actuators.propeller import ScrewSideForce
from diffsea.vessel.base import AbstractActuator, AbstractPropulsor, Vessel
from diffsea.vessel.effects.coordinates import ALL_LOST_AT_MOST, Onset, Size
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Numbers,
    Parametrisation,
    add_force,
    add_to,
    entry,
)
from diffsea.vessel.hull import Change


Actuator = TypeVar("Actuator", bound=AbstractActuator)
thrust_effect = functools.partial(entry, "actuator")


def _of_kind(vessel: Vessel, kind: type[Actuator]) -> dict[str, Actuator]:
    """Actuators of one kind by name."""
    return {n: part for n, part in vessel.actuators.items() if isinstance(part, kind)}


def _change_each(
    vessel: Vessel, kind: type[Actuator], change: Callable[[Actuator], Actuator]
) -> Vessel:
    """The vessel with every actuator of one kind changed."""
    parts = {name: change(part) for name, part in _of_kind(vessel, kind).items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, vessel.actuators | parts)


def _add_loss(vessel: Vessel, loss: str, by: Callable[[AbstractPropulsor], Scalar]) -> Vessel:
    """The vessel with more of one of the `Losses` of every propulsor."""
    where = lambda part: getattr(part.losses, loss)
    return _change_each(vessel, AbstractPropulsor, lambda part: add_to(part, where, by(part)))


def _has_two_sides(vessel: Vessel) -> bool:
    """Whether thrusters stand on both sides of the centreline."""
    sides = [float(part.y) for part in vessel.propulsors.values()]
    return any(y < 0 for y in sides) and any(y > 0 for y in sides)


@thrust_effect(
    "thrust-asymmetry",
    Size("ratio", "1", 0.1, (-1.0, 1.0)),
    phrase="thrust {ratio:%} stronger than stated on the {ratio:starboard|port} side and weaker on "
    "the {ratio:port|starboard} side",
    confusables=("thruster-misalignment", "actuator-bias", "gyro-bias", "wind"),
    possible=_has_two_sides,
)
def thrust_asymmetry(vessel: Vessel, ratio: CoordinateValues) -> Vessel:
    """Port and starboard thrust times (1 - ratio) and (1 + ratio)."""
    return _add_loss(vessel, "asymmetry", lambda part: jnp.sign(part.y) * ratio[0])


@thrust_effect(
    "thruster-misalignment",
    Size("angle", "rad", 0.05, (-math.pi / 2, math.pi / 2)),
    phrase="a thrust line turned {angle:size} to {angle:starboard|port}",
    confusables=("thrust-asymmetry", "actuator-bias", "heading-offset", "gyro-bias"),
    possible=lambda vessel: _has_two_sides(vessel) and bool(_of_kind(vessel, FixedThruster)),
)
def thruster_misalignment(vessel: Vessel, angle: CoordinateValues) -> Vessel:
    """The push of every fixed thruster turned by `angle`, clockwise from above."""
    return _change_each(vessel, FixedThruster, lambda p: add_to(p, lambda q: q.angle, angle[0]))


@thrust_effect(
    "thrust-loss-with-speed",
    Size(
        "slope",
        "s/m",
        # A fiftieth of the thrust at a tenth of the speed at Froude number 0.3.
        lambda vessel: 0.02 / float(froude_speed(vessel.rigid_body.length, 0.03)),
        # No thruster pushes harder the faster it goes, at one order.
        lambda v: (-min(float(p.losses.with_speed) for p in v.propulsors.values()), math.inf),
    ),
    phrase="a thrust that {slope:falls|rises} by {slope:%} for every m/s of speed",
    confusables=("quadratic-damping", "deadband", "drag-change", "thrust-saturation"),
    # Where some thruster's force does not depend on the speed of advance.
    possible=lambda v: any(part.bollard_coefficient is None for part in v.propulsors.values()),
)
def thrust_loss_with_speed(vessel: Vessel, slope: CoordinateValues) -> Vessel:
    """T (1 - slope u_r): the tangent of a propeller's falling K_T(J)."""
    return _add_loss(vessel, "with_speed", lambda part: slope[0])


@thrust_effect(
    "thrust-loss-in-turns",
    Size("slope", "s/rad", 0.3, positive=True),
    phrase="a thrust that {slope:falls|rises} by {slope:%/deg} for every deg/s of yaw rate",
    confusables=("crossflow-drag", "quadratic-damping", "speed-dependent-damping"),
    possible=lambda vessel: bool(vessel.propulsors),
)
def thrust_loss_in_turns(vessel: Vessel, slope: CoordinateValues) -> Vessel:
    """T (1 - slope |r|): ventilation and shadowing in turns."""
    return _add_loss(vessel, "in_turns", lambda part: slope[0])


@thrust_effect(
    "thrust-change",
    Size("factor", "1", 0.1, ALL_LOST_AT_MOST),
    Onset(),
    phrase="a thrust that is {factor:%} {factor:larger|smaller} from {time:size} on",
    confusables=("drag-change", "mass-change"),
    possible=lambda vessel: bool(vessel.propulsors),
)
def thrust_change(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """All thrusts times (1 + factor) from `time` on the run's clock."""
    return add_force(vessel, "thrust-change", Change(at[0], at[1], "thrust"))


def _lacks(kind: type[AbstractActuator]) -> Callable[[Vessel, Numbers], str]:
    """Why a vessel without an actuator of that kind has no such effect."""
    why = f"the vessel has no [[{kind.__name__.lower()}]]"
    return lambda vessel, numbers: "" if _of_kind(vessel, kind) else why


@thrust_effect(
    "propeller-side-force",
    Size("Y_ahead", "1", 0.02),
    Size("N_ahead", "1", 0.01),
    Size("Y_astern", "1", 0.05),
    Size("N_astern", "1", 0.025),
    phrase="a side force of the propeller",
    confusables=("actuator-bias", "wind"),
    possible=lambda vessel: len(_of_kind(vessel, Propeller)) == 1,
    refusal=_lacks(Propeller),
)
def propeller_side_force(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """Y = Y_a |X_P|, N = N_a L |X_P| with X_P the screw's own force, other coefficients ahead and
    astern (Brix 1993, section 1.3).
    """
    force = ScrewSideForce(next(iter(_of_kind(vessel, Propeller))), *at)
    return add_force(vessel, "propeller-side-force", force)


def _has_plain_rudders(vessel: Vessel) -> bool:
    """Whether there are rudders that neither act on the hull nor have their flow straightened."""
    rudders = _of_kind(vessel, Rudder).values()
    plain = [float(p.a_H) == 0 and float(p.gamma_R_port) == 1 for p in rudders]
    return bool(plain) and all(plain)


def _interaction_parameters(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """a_H, x_H (m) and gamma_R of a_H, a_H x_H / L and 1 - gamma_R."""
    x_H = at[1] * vessel.rigid_body.length / jnp.where(jnp.abs(at[0]) > 1e-9, at[0], 1.0)
    return {"a_H": at[0], "x_H": x_H, "gamma_R": 1 - at[2]}


def _interaction_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """The inverse; an x_H that is not stated is that of the first rudder."""
    a_H, length = numbers.get("a_H", 0.0), float(vessel.rigid_body.length)
    own = next((float(part.x_H) for part in _of_kind(vessel, Rudder).values()), 0.0)
    return a_H, a_H * numbers.get("x_H", own) / length, 1 - numbers.get("gamma_R", 1.0)


@thrust_effect(
    "rudder-interaction",
    # Bounds: twice what was measured on models, a_H 0.5, a force near x_H = -0.5 L, gamma_R 0.2
    # to 0.7.
    Size("a_H", "1", 0.1, (0.0, 1.0)),
    Size("a_H x_H / L", "1", 0.05, (-1.0, 0.0)),
    Size("1 - gamma_R", "1", 0.2, (-0.5, 1.0)),
    phrase="an interaction of hull, propeller and rudder",
    confusables=("sway-yaw-coupling", "munk-moment"),
    possible=_has_plain_rudders,
    parametrisation=Parametrisation(
        {"a_H": "1", "x_H": "m", "gamma_R": "1"}, _interaction_parameters, _interaction_coordinates
    ),
    refusal=_lacks(Rudder),
)
def rudder_interaction(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """MMG: Y = -(1 + a_H) F_N cos delta, N = -(x_R + a_H x_H) F_N cos delta, inflow angle
    straightened by gamma_R (Yasukawa and Yoshimura 2015).
    """
    length = vessel.rigid_body.length

    def change(rudder: Rudder) -> Rudder:
        return dataclasses.replace(
            rudder,
            a_H=rudder.a_H + at[0],
            hull_lever=rudder.hull_lever + at[1] * length - at[0] * rudder.x_H,
            gamma_R_port=rudder.gamma_R_port - at[2],
            gamma_R_starboard=rudder.gamma_R_starboard - at[2],
        )

    return _change_each(vessel, Rudder, change)


THRUST = (
    thrust_asymmetry,
    thruster_misalignment,
    thrust_loss_with_speed,
    thrust_loss_in_turns,
    thrust_change,
    propeller_side_force,
    rudder_interaction,
)
