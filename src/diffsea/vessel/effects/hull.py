"""Effects on the hull: damping, inertia, and their changes."""

import functools
import math
from collections.abc import Callable, Sequence

import equinox as eqx

from diffsea.errors import UserError
from diffsea.scales import GRAVITY, froude_speed
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.coordinates import (
    ALL_LOST_AT_MOST,
    ANY,
    Bound,
    Coefficient,
    Onset,
    Size,
)
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    DegreesOfFreedom,
    Effect,
    Parametrisation,
    Place,
    add_force,
    add_to,
    entry,
    read_names,
    read_table,
    with_force,
)
from diffsea.vessel.hull import Change, CrossFlowDrag, Damping, PrimeDamping, RollCoupling
from diffsea.vessel.inertia import Load, MunkMoment
from diffsea.vessel.tables import Table, needed


hull_effect = functools.partial(entry, "hull")
INERTIA_SHARE = 0.3  # of the inertia terms, or of the mass, that a derivative may be worth
PRIME_SIZE = 0.05  # of a nondimensional derivative: a tenth of the usual mass'
LEVER_SHARE = 0.05  # of the length: a load at one end, or another origin than amidships
# The buoyancy of a box lies at most L / 6 off amidships while both its ends are wet; a quarter
# leaves room for other shapes and for an origin that is not amidships.
LEVER_BOUND = 0.25  # of the length
HELD = 0.99  # of the distance to a bound: a fit never quite reaches it
LOAD_PLACE = 0.2  # of the length: standard deviation of where a load lies, from amidships
_LATERAL = ("Y_vv", "Y_vr", "Y_rr", "Y_vvv", "Y_vvr", "N_vv", "N_vr", "N_rrv", "N_vvr")
_LIFT = {"Y_ur": "N s^2/(m rad)", "N_ur": "N s^2/rad", "Y_uv": "N s^2/m^2", "N_uv": "N s^2/m"}


def _one_by_one(
    units: dict[str, str], make: Callable[[str, dict[str, str]], Effect]
) -> list[Effect]:
    """An effect of several coefficients: all of them, and each alone.

    `make` takes what follows the name, and the coefficients with their units. What one coefficient
    explains should not pay for the others' room in the prior.
    """
    return [make("", units), *(make(f":{key}", {key: unit}) for key, unit in units.items())]


def _with_derivatives(vessel: Vessel, force: str, values: dict[str, Scalar]) -> Vessel:
    """Derivatives added to a force of that name, in the scaling of the hull's own."""
    before = getattr(vessel.forces.get(force), "derivatives", {})
    derivatives = before | {name: before.get(name, 0.0) + v for name, v in values.items()}
    hull = vessel.forces["damping"]
    if isinstance(hull, PrimeDamping):
        return with_force(vessel, force, PrimeDamping(derivatives, hull.scaling))
    return with_force(vessel, force, Damping(derivatives))


def _derivative_size(name: str, vessel: Vessel) -> float:
    """A derivative worth a share of the inertia terms of its kind at Froude number 0.2."""
    if isinstance(vessel.forces.get("damping"), PrimeDamping):
        return PRIME_SIZE
    length, mass = float(vessel.rigid_body.length), float(vessel.rigid_body.mass)
    speed = froude_speed(length, 0.2)
    axis, letters = name.split("_")
    force = INERTIA_SHARE * mass * speed**2 / length * (length if axis == "N" else 1.0)
    per = {"u": speed, "v": 0.3 * speed, "r": 0.3 * speed / length}
    return float(force / math.prod(per[letter] for letter in letters))


def _derivatives(units: dict[str, str]) -> list[Size]:
    """Coordinates that are derivatives."""
    return [Size(n, unit, functools.partial(_derivative_size, n)) for n, unit in units.items()]


def _lacks(vessel: Vessel, *names: str, dimensional: bool = False) -> bool:
    """Whether no force of a vessel has these derivatives, and the hull's are in SI where
    `dimensional`.
    """
    if dimensional and isinstance(vessel.forces.get("damping"), PrimeDamping):
        return False
    sets = [getattr(force, "derivatives", {}) for force in vessel.forces.values()]
    return not any(name in derivatives for derivatives in sets for name in names)


def _quadratic_damping(name: str, unit: str, cubic: str) -> Effect:
    """Drag along one axis; `cubic` is the derivative that may stand in its place."""

    def is_possible(vessel: Vessel) -> bool:
        crossed = name != "X_uu" and "crossflow-drag" in vessel.forces
        return _lacks(vessel, name, cubic, dimensional=True) and not crossed

    @hull_effect(
        f"quadratic-damping:{name}",
        Size("drag", unit, functools.partial(_derivative_size, name), positive=True),
        phrase="a drag that grows with the square of speed",
        confusables=("crossflow-drag", "thrust-loss-with-speed", "thrust-loss-in-turns"),
        possible=is_possible,
        parametrisation=Parametrisation(
            {name: unit},
            lambda vessel, drag: {name: -drag[0]},
            lambda vessel, numbers: (-numbers.get(name, 0.0),),
        ),
    )
    def quadratic_damping(vessel: Vessel, drag: CoordinateValues) -> Vessel:
        """X_uu, Y_vv or N_rr times the modulus of the velocity times the velocity (Fossen 2021,
        section 6.4); negative for drag.
        """
        return _with_derivatives(vessel, "quadratic-damping", {name: -drag[0]})

    return quadratic_damping


def _sway_yaw_coupling(variant: str, units: dict[str, str]) -> Effect:
    @hull_effect(
        f"sway-yaw-coupling{variant}",
        *_derivatives(units),
        phrase="a linear coupling of sway and yaw",
        confusables=("speed-dependent-damping", "crossflow-drag", "munk-moment"),
        possible=lambda vessel: _lacks(vessel, *units),
    )
    def sway_yaw_coupling(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Y_r r and N_v v in the scaling of the hull's own derivatives (SNAME 1950)."""
        return _with_derivatives(vessel, "sway-yaw-coupling", dict(zip(units, at, strict=True)))

    return sway_yaw_coupling


def _speed_dependent_damping(variant: str, units: dict[str, str]) -> Effect:
    name = "speed-dependent-damping"

    @hull_effect(
        f"{name}{variant}",
        *_derivatives(units),
        phrase="a damping that grows with forward speed",
        confusables=("sway-yaw-coupling", "munk-moment", "crossflow-drag"),
        possible=lambda vessel: _lacks(vessel, *units, dimensional=True),
    )
    def lift(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Y_ur u r + Y_uv u v, N likewise: lift of the hull as a low-aspect wing, at small
        drift; N_uv alone is the same as a Munk moment and goes by that name.
        """
        return _with_derivatives(vessel, name, dict(zip(units, at, strict=True)))

    return lift


@hull_effect(
    "crossflow-drag",
    Size("cd", "1", 1.0, positive=True),
    phrase="a cross-flow drag of the hull with coefficient {cd}",
    confusables=("quadratic-damping", "sway-yaw-coupling", "thrust-loss-in-turns"),
    possible=lambda v: _lacks(v, *_LATERAL) and "crossflow-drag" not in v.forces,
)
def crossflow_drag(vessel: Vessel, cd: CoordinateValues) -> Vessel:
    """dY = -1/2 rho cd T |v_r + x r| (v_r + x r) dx, dN = x dY (Faltinsen 1990;
    Fossen 2021, eq. 6.91), one coefficient along the hull.
    """
    drag, body = vessel.forces.get("crossflow-drag"), vessel.rigid_body
    if isinstance(drag, CrossFlowDrag):
        drag = add_to(drag, lambda d: d.cd, cd[0])
    else:
        drag = CrossFlowDrag(cd[0], body.length, body.draught, body.water_density)
    return with_force(vessel, "crossflow-drag", drag)


def _read_drag_change(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str
) -> Vessel:
    """A change of all damping, or of the resistance ahead where a table says so."""
    whole, in_surge = variants
    key = "degrees_of_freedom"
    names = read_names(table, key, where, ' such as ["surge"]')
    if names not in (None, ["surge"]):
        raise UserError(f'{where}: {key} is ["surge"], or left out: the damping in all of them')
    return read_table(vessel, table, [whole if names is None else in_surge], where, (key,))


def _drag_change(name: str, phrase: str, place: Place) -> Effect:
    in_surge = isinstance(place, DegreesOfFreedom)

    @hull_effect(
        name,
        Size("factor", "1", 0.2, ALL_LOST_AT_MOST),
        Onset(),
        phrase=f"{phrase} that is {{factor:%}} {{factor:larger|smaller}} from {{time:size}} on",
        confusables=("thrust-change", "mass-change", "shallow-water"),
        place=place,
        read=_read_drag_change,
    )
    def drag_change(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Damping of the hull, or its force ahead alone, times (1 + factor) from `time` on the
        run's clock.
        """
        change = Change(at[0], at[1], "resistance", in_surge=in_surge)
        return add_force(vessel, "drag-change", change)

    return drag_change


def _may_couple(vessel: Vessel) -> bool:
    """Whether a hull may have the added masses that couple sway and yaw.

    In an ideal fluid they are one number (Newman 1977), and viscosity parts them by less than
    their size: of opposite signs they are what else is wrong with the motion. They are the added
    mass in sway times the distance of its middle from amidships: L / 4 if one half of the hull
    had all of it. A centre of gravity that is held by its bound is what else is wrong, too.
    """
    body, mass = vessel.rigid_body, vessel.added_mass
    lever = LEVER_BOUND * float(body.length)
    couplings = float(mass.Y_rdot), float(mass.N_vdot)
    if couplings[0] * couplings[1] < 0 or abs(float(body.x_G)) > HELD * lever:
        return False
    return max(map(abs, couplings)) <= lever * abs(float(mass.Y_vdot))


def _added_mass_coupling(variant: str, units: dict[str, str]) -> Effect:
    def is_possible(vessel: Vessel) -> bool:
        return float(vessel.added_mass.Y_rdot) == 0 and float(vessel.added_mass.N_vdot) == 0

    def size(name: str, vessel: Vessel) -> float:
        lever = LEVER_SHARE * float(vessel.rigid_body.length)  # the Otter's x_G is L / 10
        return lever if name == "x_G" else lever * float(vessel.rigid_body.mass)

    def bounds(name: str, vessel: Vessel) -> Bound:
        end = LEVER_BOUND * float(vessel.rigid_body.length)
        return (-end, end) if name == "x_G" else ANY

    @hull_effect(
        f"added-mass-coupling{variant}",
        *(
            Size(key, unit, functools.partial(size, key), functools.partial(bounds, key))
            for key, unit in units.items()
        ),
        phrase="an added mass that couples sway and yaw",
        confusables=("munk-moment", "speed-dependent-damping", "sway-yaw-coupling"),
        possible=is_possible,
        plausible=_may_couple,
    )
    def off_diagonal(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Off-diagonal inertia m x_G - Y_rdot, m x_G - N_vdot (Fossen 2021, section 6.5)."""
        for key, value in zip(units, at, strict=True):
            part = "rigid_body" if key == "x_G" else "added_mass"
            vessel = add_to(vessel, lambda v, k=key, p=part: getattr(getattr(v, p), k), value)
        return vessel

    return off_diagonal


@hull_effect(
    "munk-moment",
    # Of the order of the moment that the model has.
    Size("Y_vdot - X_udot", "kg", lambda v: INERTIA_SHARE * float(v.rigid_body.mass)),
    phrase="a Munk moment other than the model's",
    confusables=("speed-dependent-damping", "sway-yaw-coupling"),
    possible=lambda vessel: vessel.added_mass.coriolis_terms == "full",
)
def munk_moment(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """N = (Y_vdot - X_udot) u v beyond that of the model's added masses (Munk 1924)."""
    return add_force(vessel, "munk-moment", MunkMoment(at[0]))


def _read_mass_change(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str
) -> Vessel:
    """A load amidships, or at the `x` that a table states."""
    amidships, placed = variants
    laden = read_table(vessel, table, [placed if "x" in table else amidships], where, ("x",))
    needed(table, "mass", where)
    return laden


def _mass_change(name: str, phrase: str, *place: Coefficient) -> Effect:
    @hull_effect(
        name,
        Size(
            "mass",
            "kg",
            lambda vessel: 0.1 * float(vessel.rigid_body.mass),
            # Less than half of itself is another vessel, and more than twice itself sinks it.
            lambda vessel: (
                -0.5 * float(vessel.rigid_body.mass),
                float(vessel.rigid_body.mass),
            ),
        ),
        Onset(),
        *place,
        phrase=phrase,
        confusables=("drag-change", "thrust-change", "added-mass-coupling"),
        possible=lambda vessel: not vessel.rigid_body.loads,
        read=_read_mass_change,
    )
    def mass_change(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Rigid-body mass m + mass from `time` on the run's clock, a point at x: it adds mass x
        to the moment m x_G, and mass x^2 to the inertia about amidships.
        """
        load = Load(at[0], at[1], at[2] if place else 0.0)
        loads = (*vessel.rigid_body.loads, load)
        return eqx.tree_at(lambda v: v.rigid_body.loads, vessel, loads)

    return mass_change


def _load_place() -> Coefficient:
    """Where a load lies (m), tried at both ends as well."""
    half = lambda vessel: 0.5 * float(vessel.rigid_body.length)
    return Coefficient(
        "x",
        "m",
        lambda vessel: LOAD_PLACE * float(vessel.rigid_body.length),
        lambda vessel: (-half(vessel), half(vessel)),
        trials=(-1.5, 1.5),
    )


def _roll_coupling(variant: str, units: dict[str, str]) -> Effect:
    def size(name: str, vessel: Vessel) -> float:
        weight = GRAVITY * float(vessel.rigid_body.mass)
        length = float(vessel.rigid_body.length)
        return 0.02 * weight if name == "Y_phi" else 0.01 * weight * length

    @hull_effect(
        f"roll-coupling{variant}",
        *(Size(key, unit, functools.partial(size, key)) for key, unit in units.items()),
        phrase="a coupling of roll into sway and yaw",
        confusables=("sway-yaw-coupling", "speed-dependent-damping"),
        needs=("phi",),
    )
    def roll_coupling(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """Y_phi phi and N_phi phi with phi the recorded heel: without a recording of it, the
        effect cannot be told.
        """
        force = RollCoupling(**dict(zip(units, at, strict=True)))
        return add_force(vessel, "roll-coupling", force)

    return roll_coupling


HULL = (
    crossflow_drag,
    _quadratic_damping("X_uu", "N s^2/m^2", "X_uuu"),
    _quadratic_damping("Y_vv", "N s^2/m^2", "Y_vvv"),
    _quadratic_damping("N_rr", "N m s^2/rad^2", "N_rrr"),
    *_one_by_one({"Y_r": "N s/rad", "N_v": "N s"}, _sway_yaw_coupling),
    *_one_by_one(_LIFT, _speed_dependent_damping)[:-1],  # N_uv alone is a Munk moment
    *_one_by_one({"Y_rdot": "kg m", "N_vdot": "kg m", "x_G": "m"}, _added_mass_coupling),
    munk_moment,
    _mass_change(
        "mass-change", "a mass that is {mass:size} {mass:larger|smaller} from {time:size} on"
    ),
    _mass_change(
        "mass-change:placed",
        "a mass that is {mass:size} {mass:larger|smaller} from {time:size} on, {x:size} "
        "{x:ahead of|aft of} amidships",
        _load_place(),
    ),
    _drag_change("drag-change", "a drag", Place()),
    _drag_change("drag-change:surge", "a drag ahead", DegreesOfFreedom(("surge",))),
    *_one_by_one({"Y_phi": "N/rad", "N_phi": "N m/rad"}, _roll_coupling),
)
