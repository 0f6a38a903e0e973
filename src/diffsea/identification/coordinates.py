"""The coordinates of a fit: which numbers may move, and the vessel that they describe.

They are zero at the vessel as it is stated; those of an effect count sizes that would be
noticeable, so that one prior suits all effects.

An absent effect is screened by derivatives at `expansion_points`: its onset or frequency has to be
chosen, and what is strong soon is better seen by a secant than by the tangent at zero.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diffsea.parameters import Parameter, named, replace
from diffsea.types import Environment
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Coefficient, Effect
from diffsea.vessel.effects.coordinates import NO_PEAKS, Peaks, Size, TimeSpan


# Degrees of freedom of the Student t of an effect's amounts: it may be far larger than expected.
TAIL_DEGREES = 3.0

CoordinateVector = Float[Array, "coordinate"] | Float[np.ndarray, "coordinate"]


def free_by_default(vessel: Vessel) -> tuple[str, ...]:
    """Hull derivatives and added masses that the vessel has.

    Mass, moment of inertia, centre of gravity and the actuators stay as they are: they
    anchor the common factor of mass, drag and thrust that motion alone cannot fix.
    """
    added = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
    hull = getattr(vessel.forces.get("damping"), "derivatives", {})
    return tuple(
        name
        for name, value in named(vessel).items()
        if (name in hull or name in added) and float(value) != 0.0
    )


@dataclasses.dataclass(frozen=True)
class CoordinateLayout:
    """Which coordinates there are: first the parameters, then each effect's.

    Environment effects have one set per run where `per_run`, all others one set. `sizes` are those
    of the effects' coordinates in SI units: coordinates count them. `latest` (s) is the time
    furthest from zero on the runs' clocks: the time of a change may be as far.
    """

    parameters: tuple[Parameter, ...]
    effects: tuple[Effect, ...]
    sizes: tuple[tuple[float, ...], ...]
    runs: int
    per_run: bool
    latest: float = dataclasses.field(default=0.0, compare=False)

    def __hash__(self) -> int:
        """Of names and counts: a layout is a static input of compiled programs."""
        names = tuple(p.name for p in self.parameters), tuple(e.name for e in self.effects)
        return hash((names, self.runs, self.per_run))

    def instances(self, effect: Effect) -> int:
        """How many sets of coordinates an effect has."""
        return self.runs if self.per_run and effect.per_run else 1

    @functools.cached_property
    def slices(self) -> dict[str, slice]:
        """Where each effect's coordinates stand."""
        out, start = {}, len(self.parameters)
        for effect in self.effects:
            stop = start + self.instances(effect) * len(effect.coordinates)
            out[effect.name] = slice(start, stop)
            start = stop
        return out

    def present(
        self, coordinates: Float[np.ndarray, "coordinate"]
    ) -> tuple["CoordinateLayout", Float[np.ndarray, "present"]]:
        """The layout without effects whose amounts are all zero, and its coordinates."""
        kept = list(range(len(self.parameters)))
        there = []
        for number, effect in enumerate(self.effects):
            place = np.arange(self.size)[self.slices[effect.name]]
            amounts = np.tile(effect.amounts, self.instances(effect))
            if np.any(coordinates[place][amounts] != 0):
                there.append(number)
                kept.extend(place)
        effects = tuple(self.effects[number] for number in there)
        sizes = tuple(self.sizes[number] for number in there)
        layout = dataclasses.replace(self, effects=effects, sizes=sizes)
        return layout, coordinates[kept]

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return max((s.stop for s in self.slices.values()), default=len(self.parameters))

    def kinds(self) -> tuple[Int[np.ndarray, "coordinate"], Int[np.ndarray, "coordinate"]]:
        """What each coordinate is, the same number in every instance, and its run or -1."""
        kind, run = list(range(len(self.parameters))), [-1] * len(self.parameters)
        for effect in self.effects:
            instances, first, count = self.instances(effect), len(kind), len(effect.coordinates)
            for instance in range(instances):
                kind += range(first, first + count)
                run += [instance if instances > 1 else -1] * count
        return np.array(kind), np.array(run)

    def spreads(self) -> Float[np.ndarray, "coordinate"]:
        """Prior standard deviation of every coordinate, of an effect's the one at its centre."""
        out = [parameter.spread for parameter in self.parameters]
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            pairs = zip(effect.coordinates, sizes, strict=True)
            own = [one.prior_spread(size, self.latest) for one, size in pairs]
            out += own * self.instances(effect)
        return np.array(out)

    @functools.cached_property
    def _tails(
        self,
    ) -> tuple[Float[np.ndarray, "coordinate coordinate"], Float[np.ndarray, "coordinate"]]:
        """Ones where coordinates share a tail, and how heavy it is (infinite: a normal prior)."""
        together = np.zeros((self.size, self.size))
        heavy = np.full(self.size, np.inf)
        for effect in self.effects:
            places = np.arange(self.size)[self.slices[effect.name]]
            for instance in places.reshape(self.instances(effect), -1):
                amounts = instance[effect.amounts]
                together[np.ix_(amounts, amounts)] = 1.0
                heavy[amounts] = TAIL_DEGREES + len(amounts)
        return together, heavy

    def strains(
        self, coordinates: CoordinateVector, spreads: CoordinateVector
    ) -> Float[Array, "coordinate"]:
        """Deviations from the prior: the sum of their squares is -2 log of its density.

        Parameters of the vessel are normal. The amounts of an effect are a multivariate Student t
        (Kotz and Nadarajah 2004), because what would be noticeable is a guess: k log(1 + s / k),
        with s the sum of squares of their normal deviations and k = `TAIL_DEGREES` + their number.
        """
        together, heavy = self._tails
        scaled = coordinates / spreads
        off = (together @ scaled**2) / heavy
        some = off > 1e-8
        safe = jnp.where(some, off, 1.0)
        return jnp.where(some, jnp.sqrt(jnp.log1p(safe) / safe), 1.0 - off / 4) * scaled

    def local_spreads(
        self, coordinates: Float[np.ndarray, "coordinate"]
    ) -> Float[np.ndarray, "coordinate"]:
        """Standard deviations of the normal prior of the same slope at an estimate."""
        together, heavy = self._tails
        spreads = self.spreads()
        return spreads * np.sqrt(1.0 + together @ (coordinates / spreads) ** 2 / heavy)

    def tail_cost(self, effect: Effect, instances: int) -> float:
        """-2 log of the prior's density at its centre over that of a normal one."""
        d = int(effect.amounts.sum())
        peak = math.lgamma((TAIL_DEGREES + d) / 2) - math.lgamma(TAIL_DEGREES / 2)
        return -2.0 * instances * (peak + d / 2 * math.log(2 / (TAIL_DEGREES + d)))

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of the coordinates of parameters, then of effects, by name."""
        slices = self.slices
        found = [k for k, parameter in enumerate(self.parameters) if parameter.name in names]
        for name in names:
            found += range(slices[name].start, slices[name].stop) if name in slices else []
        return found

    def physical(
        self, name: str, coordinates: Float[np.ndarray, "coordinate"]
    ) -> Float[np.ndarray, "instance own"]:
        """An effect's coordinates in SI units, one row per instance."""
        index = [effect.name for effect in self.effects].index(name)
        scaled = np.asarray(coordinates)[self.slices[name]]
        return scaled.reshape(-1, len(self.sizes[index])) * np.array(self.sizes[index])


def negative_effects(
    layout: CoordinateLayout, coordinates: Float[np.ndarray, "coordinate"]
) -> list[str]:
    """Effects with a size that cannot be negative, and is, in every instance."""

    def is_negative(effect: Effect) -> bool:
        sizes = layout.physical(effect.name, coordinates)
        positive = [isinstance(one, Size) and one.positive for one in effect.coordinates]
        return bool(np.any(np.all(sizes[:, positive] < 0, axis=0)))

    return [effect.name for effect in layout.effects if is_negative(effect)]


def vessel_at(
    base: Vessel, layout: CoordinateLayout, coordinates: CoordinateVector
) -> tuple[Vessel, Environment]:
    """The vessel at these coordinates, and the environment of each run (leaves of shape run).

    An impossible vessel predicts nothing (`Vessel.if_possible`).
    """
    values = {p.name: p.decode(coordinates[k]) for k, p in enumerate(layout.parameters)}
    vessel = replace(base, values)
    zero = jnp.zeros(layout.runs)
    flow = jax.tree.map(lambda leaf: leaf + zero, vessel.environment)
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        scaled = coordinates[layout.slices[effect.name]].reshape(-1, len(sizes))
        physical = scaled * jnp.asarray(sizes)
        if not effect.per_run:
            vessel = effect.apply(vessel, physical[0])
            continue
        # The parts are attached by applying the effect without its flow, which is each run's own.
        still = effect.apply(vessel, jnp.where(effect.amounts, 0.0, physical[0]))
        changed = jax.vmap(lambda p, e=effect, v=vessel: e.apply(v, p).environment)(physical)
        added = jax.tree.map(lambda new, old: new - old, changed, vessel.environment)
        flow = jax.tree.map(lambda now, more: now + more + zero, flow, added)
        vessel = still
    return vessel.if_possible(), flow


@dataclasses.dataclass(frozen=True)
class ExpansionPoint:
    """One point at which the residuals are expanded in an effect.

    `at` are its coordinates in noticeable sizes: amounts are zero, unless this is a `secant` from
    the effect's absence to its size there. `directions` are the coordinates to differentiate by; of
    a secant, the first that is not zero there, by whose size its change is measured.
    """

    effect: str
    at: tuple[float, ...]
    directions: tuple[int, ...]
    secant: bool = False


def expansion_points(
    effect: Effect,
    vessel: Vessel,
    spans: Sequence[TimeSpan],
    peaks: Peaks = NO_PEAKS,
) -> list[ExpansionPoint]:
    """All points for one effect in what was recorded during these spans of time.

    `peaks` say where an effect that swings, or that sets in at once, is looked for.
    """
    absent = [0.0] * len(effect.coordinates)

    def at(place: int, value: float) -> tuple[float, ...]:
        return (*absent[:place], value, *absent[place + 1 :])

    tangents: list[tuple[float, ...]] = []
    if effect.scanned is not None:
        place, scanned = effect.scanned
        size = effect.sizes(vessel)[place]
        tangents += [at(place, v / size) for v in scanned.scan(vessel, spans, peaks)]
    elif effect.leading.tangent:
        tangents.append(tuple(absent))
        for place, one in enumerate(effect.coordinates):
            trials = one.trials if isinstance(one, Coefficient) else ()
            tangents += [at(place, trial) for trial in trials]
    amounts = tuple(np.flatnonzero(effect.amounts).tolist())
    secants = [at(0, size) for size in effect.leading.secants]
    if effect.parts:  # which act together: what is late in two ways looks like neither
        secants += itertools.product(*(one.secants for one in effect.sized))
    return [
        *(ExpansionPoint(effect.name, point, amounts) for point in tangents),
        *(
            ExpansionPoint(effect.name, point, (int(np.flatnonzero(point)[0]),), True)
            for point in dict.fromkeys(secants)
            if any(point)
        ),
    ]
