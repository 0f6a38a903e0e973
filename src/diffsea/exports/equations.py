"""A vessel's equations of motion as plain numbers: what an export has to say in another language.

Equations are terms with numbers; what a vessel has beyond them is named in `left_out`, so that a
format refuses it or leaves it out in words, never in silence.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from diffsea.errors import UserError
from diffsea.scales import is_absent
from diffsea.vessel.actuators import (
    AzimuthThruster,
    DerivativeRudder,
    FixedThruster,
    Propeller,
    Rudder,
    TunnelThruster,
)
from diffsea.vessel.actuators.thrust_curve import PER_REVOLUTION
from diffsea.vessel.base import AbstractActuator, Losses, Vessel
from diffsea.vessel.forces import AbstractForce, MeasuredWind, Wind
from diffsea.vessel.hull import CrossFlowDrag, Damping, PrimeDamping, Scaling, ShallowDamping
from diffsea.vessel.inertia import AddedMass, MunkMoment, RigidBody
from diffsea.vessel.servo import Servo


@dataclasses.dataclass(frozen=True)
class Term:
    """`coefficient` times the product of `letters`, the first in modulus where `modulus` says so.

    `axis` is X, Y or N; letters are u, v, r through the water and d, a rudder's angle. A power law
    has one letter: `c sign(u) |u|^exponent`.
    """

    axis: str
    coefficient: float
    letters: str
    modulus: bool = False
    exponent: float = 1.0

    @property
    def name(self) -> str:
        """The derivative's name, `Y_vv`."""
        return f"{self.axis}_{self.letters or '0'}"


@dataclasses.dataclass(frozen=True)
class Polynomial:
    """A sum of terms, in SI units, or a prime set that `scaling` makes dimensional."""

    terms: tuple[Term, ...]
    scaling: dict[str, Any] | None = None  # kind, length, width, water_density, reference_speed


@dataclasses.dataclass(frozen=True)
class Channel:
    """What is ordered, and how it is executed; a stage that is None is not there.

    The chain is that of `vessel.servo.Servo`: delay, bias, dead band about neutral, limits, and a
    lag `de/dt = -sat(e / time_constant, 1 / slowness)` of the deviation e from what is ordered.
    """

    name: str
    unit: str
    delay: float | None = None  # s
    bias: float = 0.0  # of the unit, as what follows
    deadband: float = 0.0
    neutral: float = 0.0
    lower: float | None = None
    upper: float | None = None
    time_constant: float | None = None  # s
    slowness: float | None = None  # s per unit: the inverse of the slew rate
    endless: bool = False


@dataclasses.dataclass(frozen=True)
class Equations:
    """The planar motion of a vessel through the water, about amidships, SNAME signs, SI units.

    `M d(u, v, r)/dt` is the sum of `polynomials`, the first of which are the Coriolis forces of
    hull and water, of `crossflow` (strip theory) and of `actuators`.

    Attributes:
        body: mass, x_G, I_z (about the centre of gravity), length, beam, draught, water_density.
        added_mass: X_udot ... N_rdot.
        coriolis_terms: "full", "no-munk" or "none", see `vessel.inertia.AddedMass`.
        mass_matrix: elements 11, 22, 23, 32 and 33.
        crossflow: cd, length, draught and water_density, None without.
        actuators: tables with a `kind` and its numbers.
        current: m/s north and east, that the vessel's file has it in.
        left_out: what the vessel has beyond, in words.
    """

    name: str
    source: str
    body: dict[str, float]
    added_mass: dict[str, float]
    coriolis_terms: str
    mass_matrix: tuple[float, ...]
    polynomials: tuple[Polynomial, ...]
    crossflow: dict[str, float] | None
    actuators: tuple[dict[str, Any], ...]
    channels: tuple[Channel, ...]
    current: tuple[float, float]
    left_out: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Everything as a table that JSON can hold."""
        return dataclasses.asdict(self)


def equations_of(vessel: Vessel) -> Equations:
    """The equations of a vessel, and what they leave out of it."""
    left_out: list[str] = []
    body, added = vessel.rigid_body, vessel.added_mass
    coriolis = _coriolis(body, added)
    polynomials, crossflow = [coriolis], None
    for name, force in vessel.forces.items():
        if isinstance(force, CrossFlowDrag):
            crossflow = _numbers(force, ("cd", "length", "draught", "water_density"))
        elif isinstance(force, Damping | PrimeDamping | MunkMoment):
            polynomials.append(_polynomial(force))
        elif not _is_calm(force, vessel):
            left_out.append(f"the force {name!r}")
    for name, force in vessel.dependent_forces.items():
        if not (isinstance(force, ShallowDamping) and is_absent(vessel.environment.shallowness)):
            left_out.append(f"the force {name!r}")
    if any(not is_absent(load.mass) for load in body.loads):
        left_out.append("the mass taken on or lost during a run")
    if not is_absent(vessel.environment.shallowness):
        left_out.append("shallow water")
    channels = [_channel(c, vessel.units[c], servo, left_out) for c, servo in vessel.servos.items()]
    parts = [_actuator(n, part, left_out) for n, part in vessel.actuators.items()]
    M = vessel.mass_matrix()
    return Equations(
        name=vessel.name,
        source=vessel.source,
        body=_numbers(body, ("mass", "x_G", "I_z", "length", "beam", "draught", "water_density")),
        added_mass=_numbers(added, ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")),
        coriolis_terms=added.coriolis_terms,
        mass_matrix=tuple(float(M[i, j]) for i, j in ((0, 0), (1, 1), (1, 2), (2, 1), (2, 2))),
        polynomials=tuple(polynomials),
        crossflow=crossflow,
        actuators=tuple(part for part in parts if part is not None),
        channels=tuple(channels),
        current=(
            float(vessel.environment.current_north),
            float(vessel.environment.current_east),
        ),
        left_out=tuple(left_out),
    )


def require_nothing_lost(left_out: Iterable[str], target: str, allow_loss: bool) -> None:
    """Raise `UserError` where an export would leave something out that nobody has allowed."""
    missing = list(left_out)
    if missing and not allow_loss:
        raise UserError(
            f"--to {target} cannot express: {'; '.join(missing)}. Give --allow-loss to leave that "
            "out, named in the file; motions then differ"
        )


def _numbers(part: Any, fields: Iterable[str]) -> dict[str, float]:
    """Fields of a part as Python's numbers."""
    return {field: float(getattr(part, field)) for field in fields}


def _optional(value: Any) -> float | None:
    return None if value is None else float(value)


def _term(name: str, coefficient: float, u_is_deviation: bool = False) -> Term:
    """The term of a derivative: its modulus by the symmetry rule of `vessel.hull.monomial`."""
    axis, letters = name.split("_")
    letters = "" if letters == "0" else letters
    transverse = sum(letter in "vrd" for letter in letters)
    if axis in "YN":
        odd = transverse > 0 and transverse % 2 == 0
    else:
        odd = bool(letters) and not transverse and len(letters) % 2 == 0 and not u_is_deviation
    return Term(axis, float(coefficient), letters, odd)


def _terms(derivatives: Mapping[str, Any], u_is_deviation: bool = False) -> tuple[Term, ...]:
    return tuple(_term(n, float(c), u_is_deviation) for n, c in derivatives.items())


def _scaling(scaling: Scaling) -> dict[str, Any]:
    """What makes a prime set dimensional; `width` times length is its area."""
    width = scaling.draught if scaling.kind == "mmg" else scaling.length
    return {"kind": scaling.kind, "width": float(width)} | _numbers(
        scaling, ("length", "water_density", "reference_speed")
    )


def _polynomial(force: Damping | PrimeDamping | MunkMoment) -> Polynomial:
    """Hull derivatives as terms."""
    if isinstance(force, MunkMoment):
        return Polynomial((_term("N_uv", float(force.difference)),))
    if isinstance(force, PrimeDamping):
        deviates = force.scaling.kind == "abkowitz"
        return Polynomial(_terms(force.derivatives, deviates), _scaling(force.scaling))
    exponents = {name: float(e) for name, e in force.exponents.items()}
    terms = _terms(force.derivatives)
    return Polynomial(
        tuple(dataclasses.replace(t, exponent=exponents.get(t.name, 1.0)) for t in terms)
    )


def _coriolis(body: RigidBody, added: AddedMass) -> Polynomial:
    """Coriolis and centripetal forces: products of two velocities (Fossen 2021, ch. 3 and 6)."""
    mass, moment = float(body.mass), float(body.mass * body.x_G)
    values = {"X_vr": mass, "X_rr": moment, "Y_ur": -mass, "N_uv": 0.0, "N_ur": -moment}
    if added.coriolis_terms != "none":
        X_udot, Y_vdot = float(added.X_udot), float(added.Y_vdot)
        coupling = -0.5 * float(added.Y_rdot + added.N_vdot)
        values["X_vr"] -= Y_vdot
        values["X_rr"] += coupling
        values["Y_ur"] += X_udot
        values["N_ur"] -= coupling
        if added.coriolis_terms == "full":
            values["N_uv"] += Y_vdot - X_udot
    return Polynomial(_terms({name: value for name, value in values.items() if value}))


def _is_calm(force: AbstractForce, vessel: Vessel) -> bool:
    """Whether a force is that of a wind that does not blow."""
    at = vessel.environment
    is_still = is_absent(float(at.wind_north), float(at.wind_east))
    return isinstance(force, MeasuredWind) or (isinstance(force, Wind) and is_still)


def _channel(name: str, unit: str, servo: Servo, left_out: list[str]) -> Channel:
    """A channel's servo as numbers."""
    for stage, words in (("backlash", "play"), ("sharpness", "softness of the limits")):
        if getattr(servo, stage) is not None and float(getattr(servo, stage)) > 0:
            left_out.append(f"the {words} of {name!r}")
    if servo.characteristics:
        left_out.append(f"the changed characteristic of {name!r}")
    slew = servo.slew
    return Channel(
        name,
        unit,
        delay=_optional(servo.delay) or None,
        bias=_optional(servo.bias) or 0.0,
        deadband=_optional(servo.deadband) or 0.0,
        neutral=_optional(servo.neutral) or 0.0,
        lower=_optional(servo.lower),
        upper=_optional(servo.upper),
        time_constant=_optional(servo.time_constant) or None,
        slowness=_optional(slew) or None,
        endless=servo.endless,
    )


def _losses(losses: Losses) -> dict[str, float]:
    return _numbers(losses, Losses.KEYS)


def _actuator(name: str, part: AbstractActuator, left_out: list[str]) -> dict[str, Any] | None:
    """An actuator's table; None, and words in `left_out`, for a kind that is not known here."""
    table: dict[str, Any] = {"name": name, "kind": "", "channel": next(iter(part.servos))}
    if isinstance(part, FixedThruster | AzimuthThruster):
        table |= {"kind": "thruster", "channel": part.force_channel, "angle": 0.0}
        if isinstance(part, AzimuthThruster):
            table |= {"angle_channel": part.angle_channel}
        else:
            table |= {"angle": float(part.angle)}
        return table | _numbers(part, ("x", "y")) | _drive(part) | {"losses": _losses(part.losses)}
    if isinstance(part, TunnelThruster):
        fading = {"fading_speed": _optional(part.fading_speed)}
        return table | {"kind": "tunnel"} | _numbers(part, ("x", "effectiveness")) | fading
    if isinstance(part, Propeller):
        fields = ("x", "y", "diameter", "water_density", "wake_fraction", "wake_decay")
        fields += ("thrust_deduction", "astern_factor")
        k_T = {"k_T": [float(k) for k in part.k_T], "losses": _losses(part.losses)}
        return table | {"kind": "propeller"} | _numbers(part, fields) | k_T
    if isinstance(part, Rudder):
        fields = ("area", "x", "y", "height", "water_density", "lift_slope", "t_R", "a_H", "x_H")
        fields += ("gamma_R_port", "gamma_R_starboard", "l_R", "epsilon", "kappa")
        fields += ("wake_fraction", "hull_lever")
        return table | {"kind": "rudder", "propeller": part.propeller} | _numbers(part, fields)
    if isinstance(part, DerivativeRudder):
        deviates = part.scaling.kind == "abkowitz"
        terms = [dataclasses.asdict(term) for term in _terms(part.derivatives, deviates)]
        return table | {"kind": "derivatives", "terms": terms, "scaling": _scaling(part.scaling)}
    left_out.append(f"the actuator {name!r} ({type(part).__name__})")
    return None


def _drive(part: FixedThruster | AzimuthThruster) -> dict[str, Any]:
    """How a thruster's order makes thrust, see `vessel.actuators.thrust_curve.Drive`."""
    drive = part.drive
    table: dict[str, Any] = {
        "reversed": drive.reversed,
        "per_revolution": PER_REVOLUTION.get(drive.unit, 1.0),
        "neutral": _optional(part.servos[part.force_channel].neutral) or 0.0,
        "curve": None if drive.curve is None else [float(c) for c in drive.curve],
        "thrust_curve": None,
    }
    if drive.thrust_curve is not None:
        fields = ("full_thrust", "deadband", "exponent", "astern_ratio")
        ends = _numbers(drive, ("full_ahead", "full_astern"))
        table["thrust_curve"] = _numbers(drive.thrust_curve, fields) | ends
    return table
