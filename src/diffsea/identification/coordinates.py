"""The coordinates of a fit: which numbers may move, and the vessel that they describe."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.parameters import Parameter, replace
from diffsea.types import Environment
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


PRIOR_SPREAD = 3.0  # prior scale of an effect's coordinates, in prior sizes
TAIL_DEGREES = 3.0  # degrees of freedom of that prior, a Student t: an effect may be far larger


@dataclasses.dataclass(frozen=True)
class CoordinateLayout:
    """Which coordinates there are: first the parameters, then each effect's.

    Environment effects have one set per run where `per_run`, all others one set. `latest` (s) is
    the time furthest from zero on the runs' clocks: the time of a change may be as far.
    """

    parameters: tuple[Parameter, ...]
    effects: tuple[Effect, ...]
    sizes: tuple[tuple[float, ...], ...]
    runs: int
    per_run: bool
    latest: float = dataclasses.field(default=0.0, compare=False)

    def instances(self, effect: Effect) -> int:
        """How many sets of coordinates an effect has."""
        return self.runs if self.per_run and effect.own else 1

    def slices(self) -> dict[str, slice]:
        """Where each effect's coordinates stand."""
        out, start = {}, len(self.parameters)
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            stop = start + self.instances(effect) * len(sizes)
            out[effect.name] = slice(start, stop)
            start = stop
        return out

    @property
    def size(self) -> int:
        """Number of coordinates."""
        counts = [self.instances(e) * len(s) for e, s in zip(self.effects, self.sizes, strict=True)]
        return len(self.parameters) + sum(counts)

    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """What each coordinate is, the same number for its copies, and its run or -1."""
        kind, run = list(range(len(self.parameters))), [-1] * len(self.parameters)
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            copies, first = self.instances(effect), len(kind)
            for copy in range(copies):
                kind += range(first, first + len(sizes))
                run += [copy if copies > 1 else -1] * len(sizes)
        return np.array(kind), np.array(run)

    def spreads(self) -> np.ndarray:
        """Prior standard deviation of every coordinate, of an effect's the one at its centre."""
        out = [p.spread for p in self.parameters]
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            own = [PRIOR_SPREAD] * len(sizes)
            if effect.shape is not None and not effect.periodic:
                own[effect.shape] = max(PRIOR_SPREAD, self.latest / sizes[effect.shape])
            for k in effect.idle:
                own[k] = 1.0
            out += own * self.instances(effect)
        return np.array(out)

    def _tails(self) -> tuple[np.ndarray, np.ndarray]:
        """Which coordinates lie in one tail, and how heavy it is (infinite: a normal prior)."""
        together = np.zeros((self.size, self.size))
        heavy = np.full(self.size, np.inf)
        for effect in self.effects:
            places = np.arange(self.size)[self.slices()[effect.name]]
            for copy in places.reshape(self.instances(effect), -1):
                amounts = copy[_amounts(effect, len(copy))]
                together[np.ix_(amounts, amounts)] = 1.0
                heavy[amounts] = TAIL_DEGREES + len(amounts)
        return together, heavy

    def strains(
        self, coordinates: Float[Array, "coordinate"], spreads: Float[Array, "coordinate"]
    ) -> Float[Array, "coordinate"]:
        """Deviations from the prior: the sum of their squares is -2 log of its density.

        Parameters of the vessel are normal. The sizes of an effect are a multivariate Student t
        (Kotz and Nadarajah 2004), because what would be noticeable is a guess: k log(1 + s / k),
        with s the sum of squares of their normal deviations and k = `TAIL` + their number.
        """
        together, heavy = self._tails()
        scaled = coordinates / spreads
        off = (together @ scaled**2) / heavy
        some = off > 1e-8
        safe = jnp.where(some, off, 1.0)
        return scaled * jnp.where(some, jnp.sqrt(jnp.log1p(safe) / safe), 1.0 - off / 4)

    def local_spreads(self, coordinates: np.ndarray) -> np.ndarray:
        """Standard deviations of the normal prior of the same slope at an estimate."""
        together, heavy = self._tails()
        spreads = self.spreads()
        return spreads * np.sqrt(1.0 + together @ (coordinates / spreads) ** 2 / heavy)

    def tail_cost(self, effect: Effect, copies: int) -> float:
        """-2 log of the prior's density at its centre over that of a normal one."""
        d = int(_amounts(effect, len(self.sizes[self.effects.index(effect)])).sum())
        peak = math.lgamma((TAIL_DEGREES + d) / 2) - math.lgamma(TAIL_DEGREES / 2)
        return -2.0 * copies * (peak + d / 2 * math.log(2 / (TAIL_DEGREES + d)))

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of the coordinates of parameters and effects by name."""
        slices = self.slices()
        found: list[int] = []
        for number, parameter in enumerate(self.parameters):
            found += [number] if parameter.name in names else []
        for name in names:
            found += range(slices[name].start, slices[name].stop) if name in slices else []
        return found

    def physical(self, name: str, coordinates: np.ndarray) -> np.ndarray:
        """An effect's coordinates in SI units, one row per copy."""
        index = [effect.name for effect in self.effects].index(name)
        scaled = np.asarray(coordinates)[self.slices()[name]]
        return scaled.reshape(-1, len(self.sizes[index])) * np.array(self.sizes[index])


def negative_effects(layout: CoordinateLayout, coordinates: np.ndarray) -> list[str]:
    """Effects that cannot be negative, and are, in every copy."""
    return [
        effect.name
        for effect in layout.effects
        if effect.positive and np.all(layout.physical(effect.name, coordinates)[:, 0] < 0)
    ]


def _amounts(effect: Effect, count: int) -> np.ndarray:
    """Which of an effect's coordinates say how much of it there is, not when, where or how."""
    return ~np.isin(np.arange(count), [*effect.idle, -1 if effect.shape is None else effect.shape])


def vessel_at(
    base: Vessel, layout: CoordinateLayout, coordinates: Float[Array, "coordinate"]
) -> tuple[Vessel, Environment]:
    """The vessel at these coordinates, and the environment of each run (leaves of shape run).

    An impossible vessel predicts nothing (`Vessel.if_possible`).
    """
    values = {p.name: p.decode(coordinates[k]) for k, p in enumerate(layout.parameters)}
    vessel = replace(base, values)
    zero = jnp.zeros(layout.runs)
    flow = jax.tree.map(lambda leaf: leaf + zero, vessel.environment)
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        scaled = coordinates[layout.slices()[effect.name]].reshape(-1, len(sizes))
        physical = scaled * jnp.asarray(sizes)
        if not effect.own:
            vessel = effect.apply(vessel, physical[0])
            continue
        # The parts are attached by applying the effect without its flow, which is each run's own.
        still = effect.apply(vessel, jnp.where(_amounts(effect, len(sizes)), 0.0, physical[0]))
        changed = jax.vmap(lambda p, e=effect, v=vessel: e.apply(v, p).environment)(physical)
        added = jax.tree.map(lambda new, old: new - old, changed, vessel.environment)
        flow = jax.tree.map(lambda now, more: now + more + zero, flow, added)
        vessel = still
    return vessel.if_possible(), flow
