"""Effects on what thrusters, propellers and rudders make of an executed order."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.scales import froude_speed
from diffsea.types import Scalar
from diffsea.vessel.actuators import FixedThruster, Propeller, Rudder
from diffsea.vessel.actuators.propeller import ScrewSideForce
from diffsea.vessel.actuators.thrusters import AbstractThruster
from diffsea.vessel.base import AbstractActuator, AbstractPropulsor, Vessel
from diffsea.vessel.characteristics import Characteristic, limit_of_loss, loss_of_limit
from diffsea.vessel.effects.actuators import (
    ENDS,
    ORDER_UNIT,
    SIDES,
    OrderedChannels,
    change_servos,
    chosen_channels,
    largest_order,
)
from diffsea.vessel.effects.coordinates import ALL_LOST_AT_MOST, Onset, Size
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    add_force,
    add_to,
    entry,
    read_table,
)
from diffsea.vessel.hull import Change
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, needed, numbers


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


def _has_two_ends(vessel: Vessel) -> bool:
    """Whether thrusters stand ahead of amidships and behind."""
    ends = [float(part.x) for part in vessel.propulsors.values()]
    return any(x < 0 for x in ends) and any(x > 0 for x in ends)


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
    confusables=(
        *("quadratic-damping", "deadband", "drag-change"),
        *("thrust-saturation", "thrust-curve"),
    ),
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


PROPULSION = OrderedChannels("propulsion")


def _chosen_propulsion(vessel: Vessel, table: Table, where: str) -> set[str]:
    """Channels that push of the actuators that a table names. Raises `UserError` for none."""
    channels = chosen_channels(vessel, table, where) & set(PROPULSION.all_on(vessel))
    if not channels:
        raise UserError(f"{where}: none of its actuators drives the vessel ahead")
    return channels


def _read_change(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """A change of the thrust of the actuators that a table names, of all where it names none."""
    check_keys(table, ("name", "time", "factor", "actuators"), where)
    if "actuators" not in table:
        return read_table(vessel, table, variants[:1], where)
    factor = needed(table, "factor", where)
    time = numbers(table, ("time",), where).get("time", 0.0)
    channels = _chosen_propulsion(vessel, table, where)
    chosen = {n: 1.0 for n, part in vessel.propulsors.items() if channels & set(part.servos)}
    return add_force(vessel, "thrust-change", Change(factor, time, "thrust", chosen))


_CHANGE = Size("factor", "1", 0.1, ALL_LOST_AT_MOST), Onset()


@thrust_effect(
    "thrust-change",
    *_CHANGE,
    phrase="a thrust that is {factor:%} {factor:larger|smaller} from {time:size} on",
    confusables=("drag-change", "mass-change"),
    possible=lambda vessel: bool(vessel.propulsors),
    read=_read_change,
)
def thrust_change(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """All thrusts times (1 + factor) from `time` on the run's clock."""
    return add_force(vessel, "thrust-change", Change(at[0], at[1], "thrust"))


def _change_of_some(where: Literal["port", "starboard", "fore", "aft"]) -> Effect:
    """A change of the thrust on one side or at one end: weed, a damaged propeller, a battery."""
    on_side = where in SIDES
    sign = SIDES[where] if on_side else ENDS[where]

    @thrust_effect(
        f"thrust-change:{where}",
        *_CHANGE,
        phrase="a thrust of {actuators} that is {factor:%} {factor:larger|smaller} from "
        "{time:size} on",
        confusables=("thrust-asymmetry", "actuator-bias", "gyro-bias"),
        possible=_has_two_sides if on_side else _has_two_ends,
        place=OrderedChannels(where),
        read=_read_change,
    )
    def change(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """The thrusts of one side or end times (1 + factor) from `time` on the run's clock."""
        # Not by `if`: under JAX an actuator's place is not known.
        shares = {
            name: jnp.where(jnp.sign(part.y if on_side else part.x) == sign, 1.0, 0.0)
            for name, part in vessel.propulsors.items()
        }
        return add_force(vessel, "thrust-change", Change(at[0], at[1], "thrust", shares))

    return change


LEAST_EXPONENT = 0.5  # of a thrust curve: less, and a square law grows more slowly than orders
LEAST_GAIN = 0.1  # of the thrust that a file states: less is another thruster
LEAST_LOSS = 1e-3  # at the largest order: a limit that takes less is reported as one that takes it


def _largest(vessel: Vessel) -> Scalar:
    return largest_order(vessel, PROPULSION.all_on(vessel))


def _with_curve(vessel: Vessel, channels: Iterable[str], at: CoordinateValues) -> Vessel:
    """The vessel with one characteristic more on each of some channels, before its own law."""
    most, at = _largest(vessel), _possible_curve(at)

    def change(servo: Servo, actuator: AbstractActuator) -> Servo:
        turned = isinstance(actuator, AbstractThruster) and actuator.drive.reversed
        more = Characteristic(most, at[0], at[1], at[2], at[3], turned)
        return dataclasses.replace(servo, characteristics=(*servo.characteristics, more))

    return change_servos(vessel, channels, change)


def _possible_curve(at: CoordinateValues) -> CoordinateValues:
    """Coordinates of a curve with neither dead band nor loss below zero.

    Below, nothing changes any more: a fit that would go there ends with none, and the other numbers
    as they are best then. At zero the derivative is that of what is possible.
    """
    at = jnp.asarray(at)
    amounts = jnp.array([0, 3])
    return at.at[amounts].set(jnp.where(at[amounts] < 0, 0.0, at[amounts]))


def _curve_parameters(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """Dead band, exponent, astern ratio and limit; the last as far as there is one."""
    # An estimate that ends where there is none has the error that its coordinate has.
    at = at + jax.lax.stop_gradient(_possible_curve(at) - at)
    # The derivative is that at the least loss: there a limit is hardly known, and its error wide.
    loss = at[3] + jax.lax.stop_gradient(jnp.maximum(at[3], LEAST_LOSS) - at[3])
    limit = limit_of_loss(loss, _largest(vessel))
    return {"deadband": at[0], "exponent": 1 + at[1], "astern_ratio": 1 + at[2], "limit": limit}


def _curve_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """The inverse; without a limit nothing is lost."""
    loss = 0.0
    if "limit" in numbers:
        loss = float(loss_of_limit(numbers["limit"], float(_largest(vessel))))
    exponent, ratio = numbers.get("exponent", 1.0), numbers.get("astern_ratio", 1.0)
    return numbers.get("deadband", 0.0), exponent - 1, ratio - 1, loss


# Bent in several ways at once it looks like none of them alone: a dead band of a tenth of the
# largest order, an exponent of 1.5 and a limit at 0.7 of it are tried in all combinations.
_CURVE = (
    Size(
        "deadband",
        ORDER_UNIT,
        lambda v: 0.05 * _largest(v),
        lambda v: (0.0, float(_largest(v))),
        secants=(0.0, 2.0),
    ),
    Size("exponent - 1", "1", 0.2, (LEAST_EXPONENT - 1, math.inf), secants=(0.0, 2.5)),
    Size("astern_ratio - 1", "1", 0.2, ALL_LOST_AT_MOST, secants=(0.0,)),
    Size("loss at the largest order", "1", 0.3, (0.0, math.inf), secants=(0.0, 1.4)),
)
_CURVE_UNITS = {"deadband": ORDER_UNIT, "exponent": "1", "astern_ratio": "1", "limit": ORDER_UNIT}
_CURVE_WORDS = (
    "a thrust with a dead band of {deadband}, that goes with the order to the power of "
    "{exponent} and is {astern_ratio} times as strong astern"
)


def _read_curve(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """The curve on the propulsors that a table names, on all of them where it names none."""
    curve, law = variants
    check_keys(table, ("name", "actuators", *law.units), where)
    values = numbers(table, law.units, where)
    for key, value in values.items():
        if value < 0 or (value == 0 and key in ("exponent", "limit", "gain")):
            raise UserError(f"{where}: {key} = {value:g} must be positive")
    channels = _chosen_propulsion(vessel, table, where)
    for loss, amount in (
        ("asymmetry", values.get("gain", 1.0) - 1),
        ("with_speed", values.get("slope", 0.0)),
    ):

        def on_chosen(part: AbstractPropulsor, amount: float = amount) -> float:
            return amount if channels & set(part.servos) else 0.0

        vessel = _add_loss(vessel, loss, on_chosen)
    return _with_curve(vessel, channels, np.asarray(curve.encode(vessel, values)))


@thrust_effect(
    "thrust-curve",
    *_CURVE,
    phrase=_CURVE_WORDS,
    confusables=("deadband", "thrust-saturation", "thrust-loss-with-speed", "thrust-asymmetry"),
    possible=lambda vessel: bool(vessel.propulsors),
    parametrisation=Parametrisation(_CURVE_UNITS, _curve_parameters, _curve_coordinates),
    place=PROPULSION,
    read=_read_curve,
    parts=("deadband", "thrust-saturation"),
)
def thrust_curve(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """Every propulsor acts as at the order n' in place of n, N the largest: a limit L by a knee,
    n_1 = n (1 + (|n| / L)^8)^(-1/8); a dead band b, n_2 = sgn(n_1) max(|n_1| - b, 0); an exponent
    p, n_3 = N sgn(n_2) (|n_2| / N)^p; a ratio a, n' = a n_3 astern and n_3 ahead.
    """
    return _with_curve(vessel, PROPULSION.all_on(vessel), at)


def _law_parameters(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """Those of the curve, and what the law has besides."""
    return _curve_parameters(vessel, at) | {"gain": 1 + at[4], "slope": at[5]}


def _law_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    besides = numbers.get("gain", 1.0) - 1, numbers.get("slope", 0.0)
    return *_curve_coordinates(vessel, numbers), *besides


@thrust_effect(
    "thrust-curve:law",
    # Tried together as well, with fewer combinations of what the curve alone is tried with.
    dataclasses.replace(_CURVE[0], secants=(2.0,)),
    dataclasses.replace(_CURVE[1], secants=(0.0,)),
    *_CURVE[2:],
    Size("gain - 1", "1", 0.2, (LEAST_GAIN - 1, math.inf), secants=(0.0, 2.5)),
    dataclasses.replace(thrust_loss_with_speed.leading, secants=(0.0, 2.0)),
    phrase=f"{_CURVE_WORDS}; {{gain}} times what is stated, and {{slope:%}} "
    "{slope:less|more} for every m/s of speed",
    confusables=(*thrust_curve.confusables, "quadratic-damping", "mass-change", "drag-change"),
    possible=thrust_loss_with_speed.possible,
    parametrisation=Parametrisation(
        _CURVE_UNITS | {"gain": "1", "slope": "s/m"}, _law_parameters, _law_coordinates
    ),
    place=PROPULSION,
    read=_read_curve,
    parts=(*thrust_curve.parts, "thrust-curve", "thrust-loss-with-speed"),
)
def thrust_law(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """The thrust curve times gain (1 - slope u_r): a law stated in advance is off in its scale
    as well, and one measured at a bollard says nothing of the speed of advance.
    """
    vessel = _add_loss(vessel, "asymmetry", lambda part: at[4])
    return thrust_loss_with_speed.apply(thrust_curve.apply(vessel, at[:4]), at[5:])


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
    *(_change_of_some(where) for where in ("port", "starboard", "fore", "aft")),
    thrust_curve,
    thrust_law,
    propeller_side_force,
    rudder_interaction,
)
