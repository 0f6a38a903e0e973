"""Effects on the hull: damping, inertia, and their changes."""

import math
from collections.abc import Callable

import equinox as eqx
import numpy as np

from diffsea.scales import GRAVITY, froude_speed
from diffsea.vessel.base import Vessel
from diffsea.vessel.dependent_forces import Change, MunkMoment, RollCoupling
from diffsea.vessel.effects.coordinates import ALL_LOST_AT_MOST, Bound, Onset, Size
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    add_to,
    free_name,
    with_force,
    with_secondary,
)
from diffsea.vessel.hull import CrossFlowDrag, Damping, PrimeDamping


INERTIA_SHARE = 0.3  # of the inertia terms, or of the mass, that a derivative may be worth
PRIME_SIZE = 0.05  # of a nondimensional derivative: a tenth of the usual mass'
LEVER_SHARE = 0.05  # of the length: a load at one end, or another origin than amidships


def _one_by_one(
    name: str, units: dict[str, str], make: Callable[..., Effect]
) -> tuple[Effect, ...]:
    """An effect of several coefficients: all of them, and each alone.

    What one coefficient explains should not pay for the others' room in the prior.
    """
    alone = (make(f"{name}:{key}", {key: unit}) for key, unit in units.items())
    return (make(name, units), *alone)


# -- damping -----------------------------------------------------------------------------


def _has_prime_damping(vessel: Vessel) -> bool:
    """Whether the derivatives of the hull are nondimensional."""
    return isinstance(vessel.forces.get("damping"), PrimeDamping)


def _add_derivatives(force: str, *names: str) -> Callable[[Vessel, CoordinateValues], Vessel]:
    """Adds derivatives to a force of that name, in the scaling of the hull's own."""

    def apply(vessel: Vessel, values: CoordinateValues) -> Vessel:
        before = getattr(vessel.forces.get(force), "derivatives", {})
        added = {name: before.get(name, 0.0) + v for name, v in zip(names, values, strict=True)}
        derivatives, hull = before | added, vessel.forces["damping"]
        if isinstance(hull, PrimeDamping):
            return with_force(vessel, force, PrimeDamping(derivatives, hull.scaling))
        return with_force(vessel, force, Damping(derivatives))

    return apply


def _derivative_size(name: str) -> Callable[[Vessel], float]:
    """A derivative worth a share of the inertia terms of its kind at Froude number 0.2."""

    def size(vessel: Vessel) -> float:
        if _has_prime_damping(vessel):
            return PRIME_SIZE
        length, mass = float(vessel.rigid_body.length), float(vessel.rigid_body.mass)
        speed = froude_speed(length, 0.2)
        axis, letters = name.split("_")
        force = INERTIA_SHARE * mass * speed**2 / length * (length if axis == "N" else 1.0)
        per = {"u": speed, "v": 0.3 * speed, "r": 0.3 * speed / length}
        return float(force / np.prod([per[letter] for letter in letters]))

    return size


def _derivatives(units: dict[str, str]) -> tuple[Size, ...]:
    """Coordinates that are derivatives."""
    return tuple(Size(name, unit, _derivative_size(name)) for name, unit in units.items())


def _lacks(*names: str, dimensional: bool = False) -> Callable[[Vessel], bool]:
    """Whether no force of a vessel has these derivatives.

    `dimensional`: and the hull's derivatives are dimensional.
    """

    def possible(vessel: Vessel) -> bool:
        if dimensional and _has_prime_damping(vessel):
            return False
        sets = [getattr(force, "derivatives", {}) for force in vessel.forces.values()]
        return not any(name in derivatives for derivatives in sets for name in names)

    return possible


def _quadratic_damping(name: str, unit: str, cubic: str) -> Effect:
    """Drag along one axis: the coordinate is positive for drag."""
    add, lacks = _add_derivatives("quadratic-damping", name), _lacks(name, cubic, dimensional=True)

    def is_possible(vessel: Vessel) -> bool:
        crossed = name != "X_uu" and "crossflow-drag" in vessel.forces
        return lacks(vessel) and not crossed

    def decode(vessel: Vessel, drag: CoordinateValues) -> Numbers:
        return {name: -drag[0]}

    def encode(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
        return (-numbers.get(name, 0.0),)

    return Effect(
        f"quadratic-damping:{name}",
        "hull",
        (Size("drag", unit, _derivative_size(name), positive=True),),
        lambda vessel, drag: add(vessel, -drag),
        law=f"{name} times the modulus of the velocity times the velocity (Fossen 2021, section "
        "6.4); negative for drag",
        phrase="a drag that grows with the square of speed",
        confusables=("crossflow-drag", "thrust-loss-with-speed", "thrust-loss-in-turns"),
        possible=is_possible,
        parametrisation=Parametrisation({name: unit}, decode, encode),
    )


def _coupling(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name,
        "hull",
        _derivatives(units),
        _add_derivatives("sway-yaw-coupling", *units),
        law="Y_r r and N_v v in the scaling of the hull's own derivatives (SNAME 1950)",
        phrase="a linear coupling of sway and yaw",
        confusables=("speed-dependent-damping", "crossflow-drag", "munk-moment"),
        possible=_lacks(*units),
    )


def _lift(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name,
        "hull",
        _derivatives(units),
        _add_derivatives("speed-dependent-damping", *units),
        law="Y_ur u r + Y_uv u v, N likewise: lift of the hull as a low-aspect wing, at small "
        "drift; N_uv alone is the same as a Munk moment and goes by that name",
        phrase="a damping that grows with forward speed",
        confusables=("sway-yaw-coupling", "munk-moment", "crossflow-drag"),
        possible=_lacks(*units, dimensional=True),
    )


_LIFT = {"Y_ur": "N s^2/(m rad)", "N_ur": "N s^2/rad", "Y_uv": "N s^2/m^2", "N_uv": "N s^2/m"}
_LATERAL = ("Y_vv", "Y_vr", "Y_rr", "Y_vvv", "Y_vvr", "N_vv", "N_vr", "N_rrv", "N_vvr")


def _add_cross_flow(vessel: Vessel, cd: CoordinateValues) -> Vessel:
    if "crossflow-drag" in vessel.forces:
        return add_to(vessel, lambda v: v.forces["crossflow-drag"].cd, cd[0])
    body = vessel.rigid_body
    drag = CrossFlowDrag(cd[0], body.length, body.draught, body.water_density)
    return with_force(vessel, "crossflow-drag", drag)


def _change_drag(vessel: Vessel, at: CoordinateValues) -> Vessel:
    change = Change(at[0], at[1], False)
    return with_secondary(vessel, free_name("drag-change", vessel.secondary), change)


# -- inertia -----------------------------------------------------------------------------


_OFF_DIAGONAL: dict[str, Callable[[Vessel], object]] = {
    "Y_rdot": lambda v: v.added_mass.Y_rdot,
    "N_vdot": lambda v: v.added_mass.N_vdot,
    "x_G": lambda v: v.rigid_body.x_G,
}


def _off_diagonal(name: str, units: dict[str, str]) -> Effect:
    """Inertia that couples sway and yaw: added masses, or a centre of gravity off the origin."""

    def apply(vessel: Vessel, at: CoordinateValues) -> Vessel:
        for key, value in zip(units, at, strict=True):
            vessel = add_to(vessel, _OFF_DIAGONAL[key], value)
        return vessel

    def lever(vessel: Vessel) -> float:
        return LEVER_SHARE * float(vessel.rigid_body.length)  # the Otter's x_G is L / 10

    def moment(vessel: Vessel) -> float:
        return lever(vessel) * float(vessel.rigid_body.mass)

    def within_hull(vessel: Vessel) -> Bound:
        # The buoyancy of a box lies at most L / 6 off amidships while both its ends are wet; a
        # quarter leaves room for other shapes and for an origin that is not amidships.
        end = 0.25 * float(vessel.rigid_body.length)
        return -end, end

    def is_possible(vessel: Vessel) -> bool:
        return float(vessel.added_mass.Y_rdot) == 0 and float(vessel.added_mass.N_vdot) == 0

    return Effect(
        name,
        "hull",
        tuple(
            Size(key, unit, lever, within_hull) if key == "x_G" else Size(key, unit, moment)
            for key, unit in units.items()
        ),
        apply,
        law="off-diagonal inertia m x_G - Y_rdot, m x_G - N_vdot (Fossen 2021, section 6.5)",
        phrase="an added mass that couples sway and yaw",
        confusables=("munk-moment", "speed-dependent-damping", "sway-yaw-coupling"),
        possible=is_possible,
    )


def _share_of_mass(share: float) -> Callable[[Vessel], float]:
    return lambda vessel: share * float(vessel.rigid_body.mass)


def _add_munk_moment(vessel: Vessel, at: CoordinateValues) -> Vessel:
    return with_force(vessel, free_name("munk-moment", vessel.forces), MunkMoment(at[0]))


def _add_payload(vessel: Vessel, at: CoordinateValues) -> Vessel:
    def where(v: Vessel) -> tuple[object, object]:
        return v.rigid_body.payload, v.rigid_body.payload_time

    return eqx.tree_at(where, vessel, (vessel.rigid_body.payload + at[0], at[1]))


def _payload_refusal(vessel: Vessel, numbers: Numbers) -> str:
    """Why a second change of mass cannot be stated: a vessel has one time of it."""
    body = vessel.rigid_body
    if float(body.payload) != 0 and float(body.payload_time) != numbers.get("time", 0.0):
        return "a vessel file can hold changes of mass at one time only"
    return ""


# -- roll --------------------------------------------------------------------------------


def _roll_coupling(name: str, units: dict[str, str]) -> Effect:
    """Force and moment of the recorded heel."""

    def apply(vessel: Vessel, at: CoordinateValues) -> Vessel:
        force = RollCoupling(**dict(zip(units, at, strict=True)))
        return with_force(vessel, free_name("roll-coupling", vessel.forces), force)

    def force_size(vessel: Vessel) -> float:
        return 0.02 * (GRAVITY * float(vessel.rigid_body.mass))

    def moment_size(vessel: Vessel) -> float:
        return 0.01 * (GRAVITY * float(vessel.rigid_body.mass)) * float(vessel.rigid_body.length)

    sizes = {"Y_phi": force_size, "N_phi": moment_size}
    return Effect(
        name,
        "hull",
        tuple(Size(key, unit, sizes[key]) for key, unit in units.items()),
        apply,
        law="Y_phi phi and N_phi phi with phi the recorded heel: without a recording of it, the "
        "effect cannot be told",
        phrase="a coupling of roll into sway and yaw",
        confusables=("sway-yaw-coupling", "speed-dependent-damping"),
        needs="phi",
    )


HULL = (
    Effect(
        "crossflow-drag",
        "hull",
        (Size("cd", "1", 1.0, positive=True),),
        _add_cross_flow,
        law="dY = -1/2 rho cd T |v_r + x r| (v_r + x r) dx, dN = x dY (Faltinsen 1990; "
        "Fossen 2021, eq. 6.91), one coefficient along the hull",
        phrase="a cross-flow drag of the hull with coefficient {cd}",
        confusables=("quadratic-damping", "sway-yaw-coupling", "thrust-loss-in-turns"),
        possible=lambda v: _lacks(*_LATERAL)(v) and "crossflow-drag" not in v.forces,
    ),
    _quadratic_damping("X_uu", "N s^2/m^2", "X_uuu"),
    _quadratic_damping("Y_vv", "N s^2/m^2", "Y_vvv"),
    _quadratic_damping("N_rr", "N m s^2/rad^2", "N_rrr"),
    *_one_by_one("sway-yaw-coupling", {"Y_r": "N s/rad", "N_v": "N s"}, _coupling),
    *(e for e in _one_by_one("speed-dependent-damping", _LIFT, _lift) if "N_uv" not in e.name),
    *_one_by_one(
        "added-mass-coupling", {"Y_rdot": "kg m", "N_vdot": "kg m", "x_G": "m"}, _off_diagonal
    ),
    Effect(
        "munk-moment",
        "hull",
        # Of the order of the moment that the model has.
        (Size("Y_vdot - X_udot", "kg", _share_of_mass(INERTIA_SHARE)),),
        _add_munk_moment,
        law="N = (Y_vdot - X_udot) u v beyond that of the model's added masses (Munk 1924)",
        phrase="a Munk moment other than the model's",
        confusables=("speed-dependent-damping", "sway-yaw-coupling"),
        possible=lambda vessel: vessel.added_mass.coriolis_terms == "full",
    ),
    Effect(
        "mass-change",
        "hull",
        (
            Size(
                "mass", "kg", _share_of_mass(0.1), lambda v: (-float(v.rigid_body.mass), math.inf)
            ),
            Onset(),
        ),
        _add_payload,
        law="rigid-body mass m + mass from `time` on the run's clock, amidships, I_z unchanged",
        phrase="a mass that is {mass:size} {mass:larger|smaller} from {time:size} on",
        confusables=("drag-change", "thrust-change"),
        possible=lambda vessel: float(vessel.rigid_body.payload) == 0,
        refusal=_payload_refusal,
    ),
    Effect(
        "drag-change",
        "hull",
        (Size("factor", "1", 0.2, ALL_LOST_AT_MOST), Onset()),
        _change_drag,
        law="damping of the hull times (1 + factor) from `time` on the run's clock",
        phrase="a drag that is {factor:%} {factor:larger|smaller} from {time:size} on",
        confusables=("thrust-change", "mass-change", "shallow-water"),
    ),
    *_one_by_one("roll-coupling", {"Y_phi": "N/rad", "N_phi": "N m/rad"}, _roll_coupling),
)
