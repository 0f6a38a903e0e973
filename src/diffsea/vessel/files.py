"""Vessels as TOML files: reading with checks, writing back, and the ones that ship.

A `VesselFile` keeps the document beside the vessel, so that what a fit or a diagnosis
changes is written into the user's own file and everything else stays as it was.
"""

import copy
import dataclasses
import importlib.resources
import math
import pathlib
from collections.abc import Iterable, Mapping
from typing import Any

import tomli_w

from diffsea.errors import UserError, nearest
from diffsea.outside.documents import read_toml
from diffsea.outside.durable import written_beside
from diffsea.parameters import Parameter, hull_prior, named, priors_of_tables
from diffsea.types import Scalar
from diffsea.vessel.actuators import ACTUATORS
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import with_effect
from diffsea.vessel.forces import AbstractForce
from diffsea.vessel.hull import POWERS, Damping, PrimeDamping, Scaling, is_derivative
from diffsea.vessel.inertia import AddedMass, RigidBody
from diffsea.vessel.tables import Table as Table
from diffsea.vessel.tables import check_keys, needed, numbers, positive, tables_of


_OTHERS = "; all other numbers: "
_TABLES = ("format", "name", "source", "hull", "effect", "prior", *ACTUATORS)
_NEEDED = ("mass", "I_z", "length", "beam", "draught")
_BODY = ("mass", "I_z", "x_G", "length", "beam", "draught", "water_density")
_ADDED = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
_HULL_WORDS = ("added_mass_coriolis", "nondimensional", "exponents")
# Numbers of actuators that a file calls otherwise: by the first of these keys that it states.
_WRITTEN_AS = {
    "curve.0": ("curve.c",),
    "curve.1": ("curve.d",),
    **{
        f"{channel}{end}": (f"{short}_force", f"{short}_speed", f"{short}_angle")
        for end, short in (("lower", "min"), ("upper", "max"))
        for channel in ("", "force.")
    },
    **{f"force.{key}": (key,) for key in ("time_constant", "rate_limit", "deadband", "sharpness")},
    "angle.lower": ("min_angle",),
    "angle.upper": ("max_angle",),
    "angle.time_constant": ("angle_time_constant",),
    "angle.rate_limit": ("angle_rate_limit",),
}
_COMMON_DERIVATIVES = ("X_u", "X_uu", "Y_v", "Y_vv", "Y_r", "Y_rr", "N_v", "N_r", "N_rr")


@dataclasses.dataclass(frozen=True)
class VesselFile:
    """A vessel and the document it was read from."""

    vessel: Vessel
    document: Table
    path: str

    @property
    def priors(self) -> dict[str, Parameter | None]:
        """What the file's `[prior]` says of its numbers; None for one that stays as it is.

        Raises:
            UserError: no table, an unknown name or key, or a value out of bounds.
        """
        tables = self.document.get("prior", {})
        if not isinstance(tables, dict):
            raise UserError("[prior] is a table, for example X_u = { spread = 0.5 }")
        return priors_of_tables(tables, default_priors(self.vessel), "[prior]")


def default_priors(vessel: Vessel) -> dict[str, Parameter]:
    """Priors around every number of the vessel, half of it wide.

    Ends and middle of a scale of orders may be anywhere within half of the scale's reach.
    """
    prime = getattr(vessel.forces.get("damping"), "scaling", None) is not None
    values = {name: float(value) for name, value in named(vessel).items()}
    priors = {name: hull_prior(name, x, nondimensional=prime) for name, x in values.items()}
    for name in values:
        actuator, _, key = name.rpartition(".")
        astern, ahead = (values.get(f"{actuator}.full_{way}") for way in ("astern", "ahead"))
        ends = ("neutral", "full_astern", "full_ahead")
        if key in ends and astern is not None and ahead is not None:
            reach = 0.5 * (ahead - astern)
            priors[name] = Parameter(name, values[name], reach, 0.5)
    return priors


def shipped_vessels() -> dict[str, pathlib.Path]:
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
    if not path.exists() and str(source) in shipped_vessels():
        path = shipped_vessels()[str(source)]
    document = _parse(path)
    try:
        file = VesselFile(build(document), document, str(source))
        file.priors  # noqa: B018  # so that a mistake in it is told now
        return file
    except UserError as error:
        raise UserError(f"{source}: {error}") from None


def _parse(path: pathlib.Path) -> Table:
    if path.is_dir():
        raise UserError(f"{path} is a folder; name the vessel's TOML file")
    if not path.exists():
        names = ", ".join(shipped_vessels())
        meant = nearest(path.stem, shipped_vessels())
        if path.suffix == ".toml":
            meant = f"; `diffsea new {path}` makes one from length, beam and mass"
        raise UserError(
            f"{path}: no such vessel file{meant}; give the path of a TOML file or one of the "
            f"shipped vessels: {names}"
        )
    return read_toml(path, "the vessel")


def build(document: Table) -> Vessel:
    """The vessel a document describes, checked. Raises `UserError` as `read_vessel` does."""
    if document.get("format", 1) != 1:
        raise UserError(f"format = {document['format']!r}; this version reads format = 1")
    check_keys(document, _TABLES, "the file")
    hull = document.get("hull")
    if not isinstance(hull, dict):
        raise UserError("there is no [hull] table; it holds length, beam, draught, mass, I_z ...")
    name, source = str(document.get("name", "vessel")), str(document.get("source", ""))
    vessel = Vessel(*_hull(hull), {}, name=name, source=source)
    for kind, from_table in ACTUATORS.items():
        for number, table in enumerate(tables_of(document, kind), start=1):
            name = str(table.get("name", kind if number == 1 else f"{kind}{number}"))
            if name in vessel.actuators:
                raise UserError(f"two actuators are called {name!r}; give each its own name")
            parts = vessel.actuators | {name: from_table(name, table, vessel)}
            vessel = dataclasses.replace(vessel, actuators=parts)
    for table in tables_of(document, "effect"):
        vessel = with_effect(vessel, table)
    for name in vessel.actuators.keys() & (vessel.forces.keys() | vessel.dependent_forces.keys()):
        raise UserError(f"an actuator is called {name!r}, as a force is; give it another name")
    check(vessel)
    return vessel


def check(vessel: Vessel) -> None:
    """Raise `UserError` where a vessel is impossible.

    Mass, inertia and dimensions are positive, the mass matrix is positive definite, the limits of
    each servo are in order and its stages are not negative.
    """
    for field in (*_NEEDED, "water_density"):
        value = float(getattr(vessel.rigid_body, field))
        if not value > 0:
            raise UserError(f"[hull] {field} = {value:g} must be positive")
    if not vessel.has_inertia():
        raise UserError(
            "[hull] the mass matrix (rigid body plus added mass) is not positive definite; "
            "added masses X_udot, Y_vdot, N_rdot are negative in the SNAME sign convention, "
            "and Y_rdot, N_vdot, x_G must be small against them"
        )
    for channel, servo in vessel.servos.items():
        where, low, high = f"actuator {channel!r}", servo.lower, servo.upper
        if low is not None and high is not None and not float(low) < float(high):
            raise UserError(
                f"{where}: its lower limit {low:g} is not below its upper limit {high:g}"
            )
        for field in ("time_constant", "delay", "deadband", "backlash", "sharpness"):
            value = getattr(servo, field)
            if value is not None and float(value) < 0:
                raise UserError(f"{where}: {field} = {float(value):g} is negative")
        if servo.rate_limit is not None and not float(servo.rate_limit) > 0:
            raise UserError(f"{where}: rate_limit must be positive")


def _hull(hull: Table) -> tuple[RigidBody, AddedMass, dict[str, AbstractForce]]:
    """Rigid body, added mass and forces of a `[hull]` table."""
    known = (*_BODY, *_ADDED, *_HULL_WORDS, "reference_speed")
    derivatives = list(filter(is_derivative, hull))
    for key in derivatives:
        _require_symmetry(key)
    for key in hull:
        if key not in known and key not in derivatives:
            hint = nearest(key, (*known, *_COMMON_DERIVATIVES))
            raise UserError(f"unknown key {key!r} in [hull]{hint}")
    for key in _NEEDED:
        needed(hull, key, "[hull]")
    values = numbers(hull, (key for key in hull if key not in _HULL_WORDS), "[hull]")
    stated: dict[str, Any] = {key: values[key] for key in _BODY if key in values}
    body = RigidBody(**stated)
    terms = hull.get("added_mass_coriolis", "full")
    if terms not in ("full", "no-munk", "none"):
        raise UserError('[hull] added_mass_coriolis is "full", "no-munk" or "none"')
    added = {key: values[key] for key in _ADDED if key in values}
    damping = _damping(hull, body, {key: values[key] for key in derivatives})
    return body, AddedMass(**added, coriolis_terms=terms), {"damping": damping}


def _require_symmetry(name: str) -> None:
    """Refuse a derivative of Y or N that pushes to the same side whichever way a vessel turns.

    The modulus of `monomial` is that of the first letter, which must be a transverse one then.
    """
    axis, letters = name.split("_")
    transverse = [letter for letter in letters if letter in "vrd"]
    if axis in "YN" and transverse and len(transverse) % 2 == 0 and letters[0] == "u":
        place = letters.index(transverse[0])
        other = letters[place] + letters[:place] + letters[place + 1 :]
        raise UserError(
            f"[hull] {name} would push to the same side in turns to port and to starboard; "
            f"{axis}_{other} is odd, by the modulus of its first letter"
        )


def _damping(hull: Table, body: RigidBody, derivatives: dict[str, Scalar]) -> AbstractForce:
    """The derivative set of a `[hull]` table: in SI units, with power laws, or a prime set."""
    kind, speed = hull.get("nondimensional"), hull.get("reference_speed", 0.0)
    if kind not in (None, "mmg", "abkowitz"):
        raise UserError('[hull] nondimensional is "mmg" or "abkowitz"; leave it out for SI units')
    if kind == "abkowitz" and not speed > 0:
        raise UserError("[hull] an Abkowitz set needs reference_speed (m/s)")
    exponents, where = hull.get("exponents", {}), "[hull.exponents]"
    if not isinstance(exponents, dict):
        raise UserError(f"{where} is a table, for example X_u = 1.7")
    check_keys(exponents, POWERS, where)
    if exponents and kind is not None:
        raise UserError(f"{where}: power laws are for derivatives in SI units")
    for key in exponents:
        if key not in derivatives:
            raise UserError(f"{where}: {key} is no power law without {key} in [hull]")
    if kind is None:
        return Damping(derivatives, {key: positive(exponents, key, where) for key in exponents})
    scaling = Scaling(kind, body.length, body.draught, body.water_density, float(speed))
    return PrimeDamping(derivatives, scaling)


def updated_document(
    document: Table, values: Mapping[str, float], effects: list[Table], source: str = ""
) -> Table:
    """A copy of a vessel's document with new hull numbers and more `[[effect]]` tables.

    `source` says where they come from; the numbers that stay keep theirs.

    `values` are by parameter name: `X_u`, `exponents.X_u`, or `port.max_force` and
    `port.thrust_curve.exponent` of an actuator.

    A prior of theirs keeps the mean that it had: another fit with the same recordings then comes
    to the same end, and they do not count twice.

    Raises:
        UserError: no table of the document is that of the actuator.
    """
    new = copy.deepcopy(document)
    stated = new.get("prior", {}).keys() & values.keys()
    before = named(build(document)) if stated else {}
    for name in stated:
        new["prior"][name].setdefault("value", float(before[name]))
    for name, value in values.items():
        place, _, key = name.rpartition(".")
        if place == "":
            table = new["hull"]
        elif place == "exponents":
            table = new["hull"]["exponents"]
        else:
            table, key = _place_in_actuator(new, name)
        table[key] = float(value)
    if source:
        others = str(document.get("source", "")).rpartition(_OTHERS)[2]
        new["source"] = f"{source}{_OTHERS}{others}" if others else source
    if effects:
        new["effect"] = [*new.get("effect", []), *effects]
    return new


def require_writable(document: Table, names: Iterable[str]) -> None:
    """Refuse numbers of the vessel that no key of its file holds, before they are fitted.

    Raises:
        UserError: there is one; says which.
    """
    before = named(build(document))
    # Other values than those: a limit that follows from others would stay as it is.
    others = {name: 0.999 * float(before[name]) or 1e-6 for name in names}
    if _holds(document, others):
        return
    for name, value in others.items():
        if not _holds(document, {name: value}):
            raise UserError(
                f"{name!r} cannot be fitted: no key of the vessel file holds it alone"
                + nearest(name, [known for known in before if known != name])
            )


def _holds(document: Table, values: Mapping[str, float]) -> bool:
    """Whether a document with some numbers is a vessel that has them."""
    try:
        there = named(build(updated_document(document, values, [])))
    except UserError:
        return False
    return all(
        name in there and math.isclose(float(there[name]), value, rel_tol=1e-9)
        for name, value in values.items()
    )


def _place_in_actuator(document: Table, name: str) -> tuple[Any, Any]:
    """The table and its key that hold an actuator's number, `port.max_force` or one further in.

    Of a number in a list, the list and its place there.
    """
    for kind in ACTUATORS:
        for number, table in enumerate(document.get(kind, []), start=1):
            own = table.get("name", kind if number == 1 else f"{kind}{number}")
            if not name.startswith(f"{own}."):
                continue
            path = name.removeprefix(f"{own}.").removeprefix(f"{own}.")
            keys = _WRITTEN_AS.get(path, (path,))
            stated = next((key for key in keys if key in table), keys[0])
            *places, key = stated.split(".")
            holder: Any = table
            for place in places:
                holder = holder.setdefault(place, {}) if isinstance(holder, dict) else None
            if isinstance(holder, list) and key.isdecimal() and int(key) < len(holder):
                return holder, int(key)
            if isinstance(holder, dict):
                return holder, key
    raise UserError(f"{name!r} cannot be written into the vessel file")


def dump(document: Table) -> str:
    """The document as TOML text."""
    return tomli_w.dumps(document)


def write_vessel(file: VesselFile, path: str | pathlib.Path) -> None:
    """Write a vessel's document as a TOML file, whole or not at all."""
    with written_beside(pathlib.Path(path)) as part:
        part.write_text(dump(file.document), encoding="utf-8")
