"""Effects on the hull: damping, inertia, and their changes."""

import math
from collections.abc import Callable

import equinox as eqx
import numpy as np

from diffsea.scales import GRAVITY, froude_speed
from diffsea.vessel.base import Vessel
from diffsea.vessel.dependent_forces import Change, MunkMoment, RollCoupling
from diffsea.vessel.effects.entry import (
    ALL_LOST_AT_MOST,
    ANY,
    Bound,
    Coordinates,
    Effect,
    fresh,
    onset_size,
    onsets,
    shifted,
    with_force,
    with_secondary,
)
from diffsea.vessel.hull import CrossFlowDrag, Damping, PrimeDamping


def _cross_flow(vessel: Vessel, cd: Coordinates) -> Vessel:
    if "crossflow-drag" in vessel.forces:
        return shifted(vessel, lambda v: v.forces["crossflow-drag"].cd, cd[0])
    body = vessel.rigid_body
    drag = CrossFlowDrag(cd[0], body.length, body.draught, body.water_density)
    return with_force(vessel, "crossflow-drag", drag)


def _is_prime(vessel: Vessel) -> bool:
    return isinstance(vessel.forces.get("damping"), PrimeDamping)


def _derivatives(effect: str, *names: str) -> Callable[[Vessel, Coordinates], Vessel]:
    """Adds derivatives, in the scaling of the hull's own."""

    def add(vessel: Vessel, values: Coordinates) -> Vessel:
        before = getattr(vessel.forces.get(effect), "derivatives", {})
        extra = {name: before.get(name, 0.0) + v for name, v in zip(names, values, strict=True)}
        extra = before | extra
        hull = vessel.forces["damping"]
        force = PrimeDamping(extra, hull.scaling) if _is_prime(vessel) else Damping(extra)
        return with_force(vessel, effect, force)

    return add


def _derivative_sizes(*names: str) -> Callable[[Vessel], tuple[float, ...]]:
    """A tenth of the inertia terms of the same kind at Froude number 0.2; primes of 0.05."""

    def sizes(vessel: Vessel) -> tuple[float, ...]:
        if _is_prime(vessel):
            return (0.05,) * len(names)
        body = vessel.rigid_body
        length, mass = float(body.length), float(body.mass)
        speed = froude_speed(length, 0.2)

        def size(name: str) -> float:
            axis, letters = name.split("_")
            force = 0.3 * mass * speed**2 / length * (length if axis == "N" else 1.0)
            per = {"u": speed, "v": 0.3 * speed, "r": 0.3 * speed / length}
            return float(force / np.prod([per[letter] for letter in letters]))

        return tuple(size(name) for name in names)

    return sizes


def _without(*names: str, si: bool = False) -> Callable[[Vessel], bool]:
    """Whether no force of the vessel has these derivatives, nor cross-flow drag their place.

    `si`: and the hull's derivatives are dimensional.
    """

    def when(vessel: Vessel) -> bool:
        if si and _is_prime(vessel):
            return False
        sets = [getattr(force, "derivatives", {}) for force in vessel.forces.values()]
        return not any(name in derivatives for derivatives in sets for name in names)

    return when


def _quadratic(name: str, unit: str, instead: tuple[str, ...]) -> Effect:
    """Drag along one axis: the coordinate is positive for drag."""
    add, size = _derivatives("quadratic-damping", name), _derivative_sizes(name)
    absent = _without(*instead, si=True)

    def when(vessel: Vessel) -> bool:
        crossed = name != "X_uu" and "crossflow-drag" in vessel.forces
        return absent(vessel) and not crossed

    return Effect(
        f"quadratic-damping:{name}", "hull", {name: unit}, lambda v, at: add(v, -at), size, when,
        True, decode=lambda v, at: {name: -at[0]}, encode=lambda v, n: (-n.get(name, 0.0),),
        coordinate_names=("drag",),
        law=f"{name} times the modulus of the velocity times the velocity (Fossen 2021, section "
        "6.4); negative for drag",
        confusables=("crossflow-drag", "thrust-loss-with-speed", "thrust-loss-in-turns"),
    )  # fmt: skip


def _no_cross_flow(vessel: Vessel) -> bool:
    lateral = ("Y_vv", "Y_vr", "Y_rr", "Y_vvv", "Y_vvr", "N_vv", "N_vr", "N_rrv", "N_vvr")
    return _without(*lateral)(vessel) and "crossflow-drag" not in vessel.forces


_OFF_DIAGONAL = {
    "Y_rdot": lambda v: v.added_mass.Y_rdot,
    "N_vdot": lambda v: v.added_mass.N_vdot,
    "x_G": lambda v: v.rigid_body.x_G,
}


def _inertia(*names: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, at: Coordinates) -> Vessel:
        for name, value in zip(names, at, strict=True):
            vessel = shifted(vessel, _OFF_DIAGONAL[name], value)
        return vessel

    return add


def _no_coupling(vessel: Vessel) -> bool:
    added = vessel.added_mass
    return float(added.Y_rdot) == 0 and float(added.N_vdot) == 0


def _inertia_sizes(*names: str) -> Callable[[Vessel], tuple[float, ...]]:
    def sizes(vessel: Vessel) -> tuple[float, ...]:
        # A load at one end, or another origin than amidships: the Otter's x_G is L / 10.
        length = 0.05 * float(vessel.rigid_body.length)
        moment = length * float(vessel.rigid_body.mass)
        return tuple(length if name == "x_G" else moment for name in names)

    return sizes


def _inertia_bounds(*names: str) -> Callable[[Vessel], tuple[Bound, ...]]:
    def bounds(vessel: Vessel) -> tuple[Bound, ...]:
        # The buoyancy of a box lies at most L / 6 off amidships while both its ends are wet; a
        # quarter leaves room for other shapes and for an origin that is not amidships.
        end = 0.25 * float(vessel.rigid_body.length)
        return tuple((-end, end) if name == "x_G" else ANY for name in names)

    return bounds


def _munk(vessel: Vessel, at: Coordinates) -> Vessel:
    return with_force(vessel, fresh("munk-moment", vessel.forces), MunkMoment(at[0]))


def _payload(vessel: Vessel, at: Coordinates) -> Vessel:
    where = lambda v: (v.rigid_body.payload, v.rigid_body.payload_time)  # noqa: E731
    return eqx.tree_at(where, vessel, (vessel.rigid_body.payload + at[0], at[1]))


def _fouling(vessel: Vessel, at: Coordinates) -> Vessel:
    change = Change(at[0], at[1], False)
    return with_secondary(vessel, fresh("drag-change", vessel.secondary), change)


def _roll(*names: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, at: Coordinates) -> Vessel:
        force = RollCoupling(**dict(zip(names, at, strict=True)))
        return with_force(vessel, fresh("roll-coupling", vessel.forces), force)

    return add


def _roll_sizes(*names: str) -> Callable[[Vessel], tuple[float, ...]]:
    def sizes(vessel: Vessel) -> tuple[float, ...]:
        weight, length = GRAVITY * float(vessel.rigid_body.mass), float(vessel.rigid_body.length)
        known = {"Y_phi": 0.02 * weight, "N_phi": 0.01 * weight * length}
        return tuple(known[name] for name in names)

    return sizes


def _some(name: str, units: dict[str, str], make: Callable[..., Effect]) -> tuple[Effect, ...]:
    """An effect of several coefficients: all of them, and each alone.

    What one coefficient explains should not pay for the others' room in the prior.
    """
    return (
        make(name, units),
        *(make(f"{name}:{key}", {key: unit}) for key, unit in units.items()),
    )


def _coupling(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name, "hull", units, _derivatives("sway-yaw-coupling", *units),
        _derivative_sizes(*units), _without(*units),
        law="Y_r r and N_v v in the scaling of the hull's own derivatives (SNAME 1950)",
        confusables=("speed-dependent-damping", "crossflow-drag", "munk-moment"),
    )  # fmt: skip


def _lift(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name, "hull", units, _derivatives("speed-dependent-damping", *units),
        _derivative_sizes(*units), _without(*units, si=True),
        law="Y_ur u r + Y_uv u v, N likewise: lift of the hull as a low-aspect wing, at small "
        "drift; N_uv alone is the same as a Munk moment and goes by that name",
        confusables=("sway-yaw-coupling", "munk-moment", "crossflow-drag"),
    )  # fmt: skip


def _off_diagonal(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name, "hull", units, _inertia(*units), _inertia_sizes(*units), _no_coupling,
        bounds=_inertia_bounds(*units),
        law="off-diagonal inertia m x_G - Y_rdot, m x_G - N_vdot (Fossen 2021, section 6.5)",
        confusables=("munk-moment", "speed-dependent-damping", "sway-yaw-coupling"),
    )  # fmt: skip


def _rolling(name: str, units: dict[str, str]) -> Effect:
    return Effect(
        name, "hull", units, _roll(*units), _roll_sizes(*units), needs="phi",
        law="Y_phi phi and N_phi phi with phi the recorded heel: without a recording of it, the "
        "effect cannot be told",
        confusables=("sway-yaw-coupling", "speed-dependent-damping"),
    )  # fmt: skip


_LIFT = {"Y_ur": "N s^2/(m rad)", "N_ur": "N s^2/rad", "Y_uv": "N s^2/m^2", "N_uv": "N s^2/m"}

HULL = (
    Effect(
        "crossflow-drag", "hull", {"cd": "1"}, _cross_flow, lambda v: (1.0,), _no_cross_flow, True,
        law="dY = -1/2 rho cd T |v_r + x r| (v_r + x r) dx, dN = x dY (Faltinsen 1990; "
        "Fossen 2021, eq. 6.91), one coefficient along the hull",
        confusables=("quadratic-damping", "sway-yaw-coupling", "thrust-loss-in-turns"),
    ),
    _quadratic("X_uu", "N s^2/m^2", ("X_uu", "X_uuu")),
    _quadratic("Y_vv", "N s^2/m^2", ("Y_vv", "Y_vvv")),
    _quadratic("N_rr", "N m s^2/rad^2", ("N_rr", "N_rrr")),
    *_some("sway-yaw-coupling", {"Y_r": "N s/rad", "N_v": "N s"}, _coupling),
    *(e for e in _some("speed-dependent-damping", _LIFT, _lift) if not e.name.endswith("N_uv")),
    *_some(
        "added-mass-coupling", {"Y_rdot": "kg m", "N_vdot": "kg m", "x_G": "m"}, _off_diagonal
    ),
    Effect(
        "munk-moment", "hull", {"Y_vdot - X_udot": "kg"}, _munk,
        # Of the order of the moment that the model has; N_uv is the same by another name.
        lambda v: (0.3 * float(v.rigid_body.mass),),
        lambda v: v.added_mass.coriolis_terms == "full",
        law="N = (Y_vdot - X_udot) u v beyond that of the model's added masses (Munk 1924)",
        confusables=("speed-dependent-damping", "sway-yaw-coupling"),
    ),
    Effect(
        "mass-change", "hull", {"time": "s", "mass": "kg"}, _payload,
        lambda v: (0.1 * float(v.rigid_body.mass), onset_size(v)),
        lambda v: float(v.rigid_body.payload) == 0,
        bounds=lambda v: ((-float(v.rigid_body.mass), math.inf), ANY), shape=1, grid=onsets,
        decode=lambda v, at: {"time": at[1], "mass": at[0]},
        encode=lambda v, n: (n.get("mass", 0.0), n.get("time", 0.0)),
        coordinate_names=("mass", "time"),
        law="rigid-body mass m + mass from `time` on the run's clock, amidships, I_z unchanged",
        confusables=("drag-change", "thrust-change"),
    ),
    Effect(
        "drag-change", "hull", {"time": "s", "factor": "1"}, _fouling,
        lambda v: (0.2, onset_size(v)), bounds=lambda v: (ALL_LOST_AT_MOST, ANY), shape=1,
        grid=onsets,
        decode=lambda v, at: {"time": at[1], "factor": at[0]},
        encode=lambda v, n: (n.get("factor", 0.0), n.get("time", 0.0)),
        coordinate_names=("factor", "time"),
        law="damping of the hull times (1 + factor) from `time` on the run's clock",
        confusables=("thrust-change", "mass-change", "shallow-water"),
    ),
    *_some("roll-coupling", {"Y_phi": "N/rad", "N_phi": "N m/rad"}, _rolling),
)  # fmt: skip
