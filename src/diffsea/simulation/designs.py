"""Which designs a sweep runs: grids and samples, generated part by part and never held as a whole.

Any design follows from its number alone, so that a sweep can be divided, stopped and gone on with.
"""

import abc
import dataclasses
import math
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, UInt
from scipy.stats import qmc

from diffsea.errors import UserError


# Swept like parameters of the vessel, though they are no part of it, and their units.
OF_THE_TRIAL = {"speed": "m/s", "thrust": "N"}
AT_ONCE = 1_000_000  # designs that are held together at most
MOST = 1_000_000_000_000  # designs of a sweep
_ROUNDS = 6  # of mixing; with four a permutation cannot be told from a random one


class Designs(NamedTuple):
    """Values of named parameters, one row per design."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "design name"]

    def slowest(self) -> dict[str, float]:
        """The lowest approach speed (m/s) or thrust (N) that is swept: time limits follow it."""
        columns = zip(self.names, self.values.T, strict=True)
        return {name: float(column.min()) for name, column in columns if name in OF_THE_TRIAL}


@dataclasses.dataclass(frozen=True)
class DesignSpace(abc.ABC):
    """Numbered designs. `axes` has from and to (SI units) by name, and whatever else there is."""

    axes: Mapping[str, tuple[Any, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are swept."""
        return tuple(self.axes)

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """How many designs there are."""

    @abc.abstractmethod
    def rows(self, begin: int, end: int) -> Designs:
        """The designs of some numbers; `end` is not among them."""

    @abc.abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """What the designs follow from."""

    def all(self) -> Designs:
        """Every design.

        Raises:
            UserError: more than a million.
        """
        check_count(self.count, AT_ONCE)
        return self.rows(0, self.count)

    def slowest(self) -> dict[str, float]:
        """The lowest approach speed (m/s) or thrust (N) that is swept: time limits follow it."""
        return {n: float(min(axis[:2])) for n, axis in self.axes.items() if n in OF_THE_TRIAL}


@dataclasses.dataclass(frozen=True)
class Grid(DesignSpace):
    """All combinations of evenly spaced values: from, to and how many, by name."""

    @property
    def count(self) -> int:
        return math.prod(count for *_, count in self.axes.values())

    def rows(self, begin: int, end: int) -> Designs:
        counts = tuple(count for *_, count in self.axes.values())
        places = np.unravel_index(np.arange(begin, end), counts)
        lines = [np.linspace(start, stop, count) for start, stop, count in self.axes.values()]
        columns = [line[place] for line, place in zip(lines, places, strict=True)]
        return Designs(self.names, np.stack(columns, axis=-1))

    def as_dict(self) -> dict[str, Any]:
        return {"grid": {name: list(axis) for name, axis in self.axes.items()}}


@dataclasses.dataclass(frozen=True)
class Sample(DesignSpace):
    """So many designs drawn by a seed, from and to by name."""

    kind: ClassVar[str]

    number: int
    seed: int = 0

    @property
    def count(self) -> int:
        return self.number

    def as_dict(self) -> dict[str, Any]:
        axes = {name: list(axis) for name, axis in self.axes.items()}
        return {self.kind: axes, "count": self.number, "seed": self.seed}


@dataclasses.dataclass(frozen=True)
class LatinHypercube(Sample):
    """Designs that cover every axis evenly (McKay, Beckman and Conover 1979).

    On each axis every design has an interval of its own, and a place in it by chance. Which one is
    a permutation by a Feistel network, calculated of the design's number.
    """

    kind = "sample"

    def rows(self, begin: int, end: int) -> Designs:
        numbers = np.arange(begin, end, dtype=np.uint64)
        columns = []
        for k, (low, high) in enumerate(self.axes.values()):
            key = int(_mixed(np.array([(self.seed * 1_000_003 + k) % 2**64], np.uint64))[0])
            inside = (_mixed(numbers ^ np.uint64(key)) >> np.uint64(11)) * 2.0**-53
            share = (permuted(numbers, self.number, key) + inside) / self.number
            columns.append(low + share * (high - low))
        return Designs(self.names, np.stack(columns, axis=-1))


@dataclasses.dataclass(frozen=True)
class SobolSequence(Sample):
    """A scrambled Sobol sequence, by SciPy.

    The first designs cover all ranges evenly, and every further one fills a gap; best where their
    number is a power of two.
    """

    kind = "sobol"

    def rows(self, begin: int, end: int) -> Designs:
        sequence = qmc.Sobol(len(self.axes), rng=np.random.default_rng(self.seed))
        if begin:
            sequence.fast_forward(begin)
        with warnings.catch_warnings():
            # Of a part: its balance is that of the whole sequence.
            warnings.filterwarnings("ignore", message="The balance properties of Sobol")
            unit = sequence.random(end - begin)
        low, high = np.array([axis[:2] for axis in self.axes.values()]).T
        return Designs(self.names, low + unit * (high - low))


def permuted(numbers: UInt[np.ndarray, "n"], count: int, key: int) -> UInt[np.ndarray, "n"]:
    """Where a permutation of `count` numbers, drawn by a key, leads some of them."""
    half = max((count - 1).bit_length() + 1, 2) // 2
    mask, shift = np.uint64((1 << half) - 1), np.uint64(half)
    keys = _mixed(np.arange(1, _ROUNDS + 1, dtype=np.uint64) ^ np.uint64(key))

    def once(at: np.ndarray) -> np.ndarray:
        left, right = at >> shift, at & mask
        for one in keys:
            left, right = right, left ^ (_mixed(right ^ one) & mask)
        return (left << shift) | right

    found = once(numbers)
    while (outside := found >= count).any():  # of a power of four: on until it is inside
        found[outside] = once(found[outside])
    return found


def _mixed(bits: np.ndarray) -> np.ndarray:
    """64 bits from 64 bits, every one depending on all (the finaliser of SplitMix64)."""
    bits = bits + np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


def check_count(count: int, most: int = MOST) -> None:
    """Raise `UserError` for more designs than there may be."""
    if count > most:
        raise UserError(f"{count} designs are too many; at most {most} are run at once")


def grid(axes: Mapping[str, tuple[float, float, int]]) -> Designs:
    """All combinations of evenly spaced values: from, to and how many, by name (SI units).

    Raises:
        UserError: more than a million designs.
    """
    return Grid(axes).all()


def sample(axes: Mapping[str, tuple[float, float]], count: int, seed: int = 0) -> Designs:
    """A Latin hypercube: designs that cover every axis evenly.

    Arguments:
        axes: from and to by name, SI units.
        count: how many designs.

    Raises:
        UserError: more than a million designs.
    """
    return LatinHypercube(axes, count, seed).all()
