"""What an entry of the catalogue of effects says of itself, and how a file's table states it.

An effect is an ordinary part of the vessel once applied: a force, a servo stage, a field
of the environment or a term of the sensors. Its coordinates are numbers that are zero
when it is absent and in which the motion has a derivative there; its parameters are
what people and files say (a current's speed and direction).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import AbstractDependentForce, Vessel
from diffsea.vessel.effects.coordinates import (
    Bound,
    Coefficient,
    Coordinate,
    ScannedCoordinate,
    Size,
    value_on,
)
from diffsea.vessel.forces import AbstractForce
from diffsea.vessel.sensors import Step
from diffsea.vessel.tables import Table, check_keys, needed, numbers


CoordinateValues = Float[Array, "coordinate"] | Float[np.ndarray, "coordinate"]
Numbers = dict[str, Any]  # parameter name to a number, of a file or traced
Part = TypeVar("Part", bound=eqx.Module)
Family = Literal["sensor", "environment", "actuator", "hull"]


@dataclasses.dataclass(frozen=True)
class Parametrisation:
    """The parameters in which files and reports state an effect, where they are no coordinates.

    The first of `units` states how much of the effect there is; it is lower for larger effects
    where `inverse` (a depth, a limit). `notes` say in reports what a parameter is measured from.
    """

    units: dict[str, str] = dataclasses.field(hash=False)  # parameter to unit, in order
    decode: Callable[[Vessel, CoordinateValues], Numbers]  # parameters, in the order of `units`
    encode: Callable[[Vessel, Numbers], tuple[float, ...]] | None = None  # None: read otherwise
    inverse: bool = False
    notes: dict[str, str] = dataclasses.field(default_factory=dict, hash=False)


@dataclasses.dataclass(frozen=True)
class Place:
    """What a variant of an effect acts on: the whole vessel, some channels or some actuators."""

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """The key and the names by which a file of this vessel says it; empty for all there is."""
        return {}

    def all_on(self, vessel: Vessel) -> tuple[str, ...]:
        """Channels of a vessel's actuators, if it is these that it acts on."""
        return ()

    def unit_on(self, vessel: Vessel, unit: str) -> str:
        """A unit of the catalogue on this vessel."""
        return unit


@dataclasses.dataclass(frozen=True)
class MeasuredChannels(Place):
    """Channels of the motion that are measured wrongly."""

    names: tuple[str, ...]

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """All of them by name."""
        return {"channels": list(self.names)}


@dataclasses.dataclass(frozen=True)
class DegreesOfFreedom(Place):
    """Some of surge, sway and yaw."""

    names: tuple[str, ...]

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """All of them by name."""
        return {"degrees_of_freedom": list(self.names)}


@dataclasses.dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    The `name` may have a variant after a colon (`sensor-latency:position`): variants share the
    name that files and reports say. Where there is no `parametrisation`, the coordinates are the
    parameters.

    The `phrase` names the effect with its size in a sentence of a report. Braces hold a parameter
    and how to say it: `{speed}` its value, `{angle:size}` without its sign, `{ratio:%}` in per
    cent without its sign, `{slope:%/deg}` in per cent per degree, `{angle:high|low}` one word where
    it is positive and another where not. `{actuators}` and `{channels}` are what it acts on.
    """

    name: str
    family: Family
    coordinates: tuple[Coordinate, ...]
    apply: Callable[[Vessel, CoordinateValues], Vessel]  # exactly the same motion at zero
    law: str = ""  # equation, validity, source
    phrase: str = ""
    confusables: tuple[str, ...] = ()  # names of the catalogue
    possible: Callable[[Vessel], bool] = lambda vessel: True  # could it have it, and lacks it?
    parametrisation: Parametrisation | None = None
    place: Place = Place()
    per_run: bool = False  # whether each recording may have its own: a field of the environment
    needs: tuple[str, ...] = ()  # channels beside position and heading that runs must have
    needs_feedback: bool = False  # whether recordings must have measured what it acts on
    refusal: Callable[[Vessel, Numbers], str] | None = None  # why a file cannot state it, or ""
    read: "Callable[[Vessel, Table, Sequence[Effect], str], Vessel] | None" = None  # own table keys
    mirror: str = ""  # the entry that this would be, were its leading size negative
    nearly: bool = False  # whether it is a law that holds but nearly, as of hull and actuators
    parts: tuple[str, ...] = ()  # names of those that it is where some of its amounts are zero
    # Whether it is asked of a vessel though nothing points at it; else only where an audit does.
    usual: Callable[[Vessel], bool] = lambda vessel: True
    # Whether a vessel, as fitted, may have it with her other numbers; None: each within its bounds.
    plausible: Callable[[Vessel], bool] | None = None
    # Of what surely acts where what it needs was measured: about how much, in SI units.
    usual_coordinates: tuple[float, ...] = ()

    @property
    def is_law(self) -> bool:
        """Whether its amounts are coefficients of one law, which real vessels follow nearly.

        Others are components of a flow, or of an error of kinematics, which holds exactly.
        """
        return self.nearly or self.family in ("actuator", "hull")

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter, in the order in which they are said: when, then how much."""
        if self.parametrisation is not None:
            return self.parametrisation.units
        scanned = [one for one in self.coordinates if isinstance(one, ScannedCoordinate)]
        rest = [one for one in self.coordinates if one not in scanned]
        return {one.key: one.unit for one in (*scanned, *rest)}

    @property
    def stated_key(self) -> str:
        """The parameter that states how much of the effect there is."""
        return next(iter(self.units)) if self.parametrisation else self.coordinates[0].key

    @property
    def stated_inversely(self) -> bool:
        """Whether that parameter is lower for larger effects."""
        return self.parametrisation is not None and self.parametrisation.inverse

    @property
    def amounts(self) -> Bool[np.ndarray, "coordinate"]:
        """Which coordinates say how much of the effect there is, not when, where or how."""
        return np.array([one.is_amount for one in self.coordinates])

    @property
    def has_coefficients(self) -> bool:
        """Whether it comes with coefficients of the vessel's own, which all runs share."""
        return any(isinstance(one, Coefficient) for one in self.coordinates)

    @property
    def sized(self) -> tuple[Size, ...]:
        """The coordinates that say how much of it there is."""
        return tuple(one for one in self.coordinates if isinstance(one, Size))

    @property
    def leading(self) -> Size:
        """The first coordinate: the one amount whose sign and secants matter."""
        first = self.coordinates[0]
        assert isinstance(first, Size), f"the first coordinate of {self.name} is no size"
        return first

    @property
    def scanned(self) -> tuple[int, ScannedCoordinate] | None:
        """The coordinate that is tried over a range, with its position; None without one."""
        for k, one in enumerate(self.coordinates):
            if isinstance(one, ScannedCoordinate):
                return k, one
        return None

    def is_part_of(self, other: "Effect") -> bool:
        """Whether the other is this with something more, on the same channels."""
        is_named = catalogue_name(self.name) in other.parts and self.place == other.place
        return is_named and self.name != other.name

    def sizes(self, vessel: Vessel) -> tuple[float, ...]:
        """Size of each coordinate that would be noticeable on this vessel, in SI units.

        A fit moves multiples of these: they are the unit of its coordinates.
        """
        return tuple(value_on(one.size, vessel) for one in self.coordinates)

    def bounds(self, vessel: Vessel) -> tuple[Bound, ...]:
        """Least and largest value of each coordinate that this vessel could have, in SI units."""
        bounds = (one.bounds for one in self.coordinates)
        return tuple(bound(vessel) if callable(bound) else bound for bound in bounds)

    def decode(self, vessel: Vessel, values: CoordinateValues) -> Numbers:
        """Parameters from coordinates in SI units, in the order of `units`."""
        if self.parametrisation is not None:
            return self.parametrisation.decode(vessel, values)
        found = dict(zip((one.key for one in self.coordinates), values, strict=True))
        return {key: found[key] for key in self.units}

    def encode(self, vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
        """Coordinates in SI units from parameters; those not given say that nothing is there."""
        if self.parametrisation is not None and self.parametrisation.encode is not None:
            return self.parametrisation.encode(vessel, numbers)
        return tuple(numbers.get(one.key, 0.0) for one in self.coordinates)


def entry(
    family: Family, name: str, *coordinates: Coordinate, **fields: Any
) -> Callable[[Callable[[Vessel, CoordinateValues], Vessel]], Effect]:
    """Decorates the function that applies an effect: its docstring is the law.

    `fields` are those of the `Effect` that are named here.
    """

    def make(apply: Callable[[Vessel, CoordinateValues], Vessel]) -> Effect:
        law = " ".join((apply.__doc__ or "").split())
        return Effect(name, family, coordinates, apply, law, **fields)

    return make


def catalogue_name(effect: str) -> str:
    """The name in the catalogue: variants of one effect share it."""
    return effect.split(":")[0]


def spoken_name(effect: str) -> str:
    """The name in a message, with its variant: `sensor-latency (heading)`."""
    name, _, variant = effect.partition(":")
    return f"{name} ({variant.replace('_', ' ')})" if variant else name


def add_to(part: Part, where: Callable[[Part], Any], by: Scalar) -> Part:
    """A vessel, or a part of one, with something added to one of its numbers.

    `where` picks the number from the part; `by` is in its unit.
    """
    return eqx.tree_at(where, part, replace_fn=lambda value: value + by)


def add_step(vessel: Vessel, sensor: str, at: CoordinateValues) -> Vessel:
    """The vessel with a sensor that is off by a size from a time on."""
    steps = (*getattr(vessel.sensors, sensor), Step(at[0], at[1]))
    sensors = dataclasses.replace(vessel.sensors, **{sensor: steps})
    return dataclasses.replace(vessel, sensors=sensors)


def with_force(vessel: Vessel, name: str, force: AbstractForce | AbstractDependentForce) -> Vessel:
    """The vessel with a force of that name, instead of the one of its kind that it may have."""
    if isinstance(force, AbstractForce):
        return eqx.tree_at(lambda v: v.forces, vessel, vessel.forces | {name: force})
    forces = vessel.dependent_forces | {name: force}
    return eqx.tree_at(lambda v: v.dependent_forces, vessel, forces)


def add_force(vessel: Vessel, name: str, force: AbstractForce | AbstractDependentForce) -> Vessel:
    """The vessel with one force more, numbered where it has that name: effects add up."""
    taken = vessel.forces if isinstance(force, AbstractForce) else vessel.dependent_forces
    names = [name, *(f"{name} {k}" for k in range(2, 100))]
    return with_force(vessel, next(n for n in names if n not in taken), force)


def read_table(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str, others: Sequence[str] = ()
) -> Vessel:
    """The vessel with the effect of a table, whose keys are the effect's parameters.

    `where` names the table in messages; `others` are keys that have been read before.

    Raises:
        UserError: a key is unknown, a value is no number, or the vessel cannot have the effect.
    """
    keys = [key for variant in variants for key in variant.units]
    check_keys(table, tuple(dict.fromkeys(("name", *keys, *others))), where)
    # Where an effect has an entry of all its coefficients, its parts are of no use here.
    whole = [variant for variant in variants if variant.name == table["name"]]
    if not table.keys() & {*keys, *others}:
        raise UserError(f"{where} states no number; its keys are {', '.join(dict.fromkeys(keys))}")
    for variant in whole or variants:
        values = numbers(table, variant.units, where)
        if not values and not whole:
            continue
        why = "" if variant.refusal is None else variant.refusal(vessel, values)
        if why:
            raise UserError(f"{where}: {why}")
        vessel = variant.apply(vessel, np.asarray(variant.encode(vessel, values)))
    return vessel


def read_from_an_instant(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str
) -> Vessel:
    """An error of all the run, or from the `time` on that a table states."""
    constant, stepped = variants
    check_keys(table, ("name", constant.stated_key, "time"), where)
    needed(table, constant.stated_key, where)
    chosen = stepped if "time" in table else constant
    return read_table(vessel, table, [chosen], where, others=("time",))


def read_names(table: Table, key: str, where: str, example: str = "") -> list[str] | None:
    """A list of names; None where the key is missing. Raises `UserError` for anything else."""
    names = table.get(key)
    if names is None or (isinstance(names, list) and all(isinstance(n, str) for n in names)):
        return names
    raise UserError(f"{where}: {key} = {names!r} is not a list of names{example}")
