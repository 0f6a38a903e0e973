"""One effect as the simulator has it, and what is drawn besides its size."""

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """One entry (or one variant of it) of the catalogue."""

    name: str
    variant: str
    main: tuple[str, ...]  # parameters whose error is scored
    dofs: tuple[str, ...]  # where the force is missing; none for sensors
    first: float  # a size to start the search of the detection limit from
    most: float  # largest plausible size
    put: Callable  # (model, hull, size, extra) -> parameters
    draw: Callable = lambda rng, hull: {}
    circular: tuple[str, ...] = ()
    onset: bool = False

    @property
    def key(self) -> str:
        """`name` or `name:variant`."""
        return f"{self.name}:{self.variant}" if self.variant else self.name


def sign(rng) -> float:
    """Either side."""
    return float(rng.choice([-1.0, 1.0]))


def sided(rng, hull) -> dict:
    """A side."""
    return {"side": sign(rng)}


def turned(rng, hull) -> dict:
    """A direction, rad."""
    return {"direction": round(float(rng.uniform(0.0, 2.0 * math.pi)), 4)}


def timed(rng, hull) -> dict:
    """A time within the middle of a run, s, and a side."""
    seconds = hull.rows * hull.step
    return {"time": round(float(rng.uniform(0.3, 0.7)) * seconds, 2), "side": sign(rng)}
