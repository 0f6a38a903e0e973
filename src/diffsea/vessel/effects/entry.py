"""What an entry of the catalogue of effects says of itself.

An effect is an ordinary part of the vessel once applied: a force, a servo stage, a field
of the environment or a term of the sensors. Its `coordinates` are numbers that are zero
when it is absent and in which the motion has a derivative there; its `parameters` are
what people and files say (a current's speed and direction).
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from diffsea import scales
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


Coordinates = Float[Array, "coordinate"] | Float[np.ndarray, "coordinate"]
Numbers = dict[str, Any]  # parameter name to a number
Bound = tuple[float, float]
ANY: Bound = (-math.inf, math.inf)
ALL_LOST_AT_MOST: Bound = (-1.0, math.inf)  # of a share that is added


def _always(vessel: Vessel) -> bool:
    return True


@dataclasses.dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    `name` may have a variant after a colon (`sensor-latency:position`): variants share the
    name that files and reports say. Where `decode` is None the coordinates are the parameters.

    A `shape` is a coordinate that does nothing while the others are zero (the time of a
    change); `grid` gives its values to look at in recordings from one time to another. A
    `periodic` one is a frequency, looked at where a spectrum has peaks; its coordinate counts
    from the one value of `grid`. At the `finite` sizes of its first coordinate, in prior sizes,
    an effect is looked at, too: one that far from zero looks like its derivative there no more,
    and a `flat` one has none. No vessel is beyond its `bounds`.

    `idle` coordinates do nothing while the others are zero, as a shape, but about as much is known
    of them as their sizes say (the coefficients of a superstructure in a wind). They are zero at
    first, and as each of `places` says, where the effect is looked at, too.
    """

    name: str
    group: str  # "sensor", "environment", "actuator" or "hull"
    units: dict[str, str]  # parameter name to unit, in order
    add: Callable[[Vessel, Coordinates], Vessel]
    size: Callable[[Vessel], tuple[Scalar, ...]]  # of each coordinate that would be noticeable
    when: Callable[[Vessel], bool] = _always  # whether a vessel could have it and lacks it
    positive: bool = False  # only positive values of the first coordinate are physical
    bounds: Callable[[Vessel], tuple[Bound, ...]] | None = None  # of each coordinate
    own: bool = False  # whether each recording may have its own: a field of the environment
    decode: Callable[[Vessel, Coordinates], Numbers] | None = None
    encode: Callable[[Vessel, Numbers], tuple[float, ...]] | None = None
    shape: int | None = None
    grid: Callable[[Vessel, float, float], tuple[float, ...]] | None = None
    periodic: bool = False
    finite: tuple[float, ...] = ()
    flat: bool = False  # no derivative at zero
    idle: tuple[int, ...] = ()
    places: tuple[tuple[float, ...], ...] = ()  # values of the idle ones, in prior sizes
    valid: float = math.inf  # size of the first coordinate, in prior sizes, up to which it holds
    needs: str = ""  # extra channel that recordings must have
    coordinate_names: tuple[str, ...] = ()  # where they are not the parameters
    where: dict[str, Any] = dataclasses.field(default_factory=dict, hash=False)  # said in files
    law: str = ""  # equation, validity, source
    confusables: tuple[str, ...] = ()  # names of the catalogue

    def sizes(self, vessel: Vessel) -> tuple[float, ...]:
        """Size of each coordinate that would be noticeable on this vessel (its prior)."""
        return tuple(float(size) for size in self.size(vessel))

    def apply(self, vessel: Vessel, coordinates: Coordinates) -> Vessel:
        """The vessel with the effect; exactly the same motion at zero coordinates."""
        return self.add(vessel, coordinates)

    def parameters(self, vessel: Vessel, coordinates: Coordinates) -> dict[str, Scalar]:
        """What a file says, from coordinates."""
        if self.decode is not None:
            return self.decode(vessel, coordinates)
        return dict(zip(self.units, coordinates, strict=True))

    def coordinates(self, vessel: Vessel, parameters: Numbers) -> tuple[float, ...]:
        """Coordinates, from what a file says."""
        if self.encode is not None:
            return self.encode(vessel, parameters)
        return tuple(parameters.get(name, 0.0) for name in self.units)

    def possible(self, vessel: Vessel) -> bool:
        """Whether the vessel could have it and does not have it in its base model."""
        return self.when(vessel)


def catalogue_name(effect: str) -> str:
    """The name in the catalogue: variants of one effect share it."""
    return effect.split(":")[0]


def shifted(vessel: Vessel, where: Callable, by: Scalar) -> Vessel:
    """The vessel with something added to one of its numbers."""
    return eqx.tree_at(where, vessel, replace_fn=lambda value: value + by)


def with_force(vessel: Vessel, name: str, force: eqx.Module) -> Vessel:
    """The vessel with a force of that name, instead of the one it may have."""
    return eqx.tree_at(lambda v: v.forces, vessel, vessel.forces | {name: force})


def with_secondary(vessel: Vessel, name: str, force: eqx.Module) -> Vessel:
    """The vessel with a secondary force of that name, instead of the one it may have."""
    return eqx.tree_at(lambda v: v.secondary, vessel, vessel.secondary | {name: force})


def fresh(name: str, taken: Iterable[str]) -> str:
    """The name, or a numbered one where it is taken: effects given twice add up."""
    names = [name, *(f"{name} {k}" for k in range(2, 100))]
    return next(n for n in names if n not in taken)


def time_scale(vessel: Vessel) -> Scalar:
    """The time gravity takes over a ship's length, s."""
    return scales.time_scale(vessel.rigid_body.length)


def speed_scale(vessel: Vessel) -> float:
    """A tenth of the speed at Froude number 0.3, m/s."""
    return float(scales.froude_speed(vessel.rigid_body.length, 0.03))


def onsets(vessel: Vessel, first: float, last: float) -> tuple[float, ...]:
    """Times at which a change may have happened: eleven, evenly within the recordings."""
    return tuple(first + (last - first) * k / 12 for k in range(1, 12))


def onset_size(vessel: Vessel) -> Scalar:
    """Size of a time of change, s: with its prior, some hundred times sqrt(L / g)."""
    return 40 * time_scale(vessel)
