"""The catalogue's effects as the simulator has them: how large, on what, and what they change.

An effect is counted by one *size* (>= 0, its unit in `unit`), which detection limits and the
power curve use; `draw` adds what else it needs (sides, directions, times). `put` works it into a
model and returns its parameters in the names of the catalogue.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .hulls import Hull
from .model import Model


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


def _sided(rng, hull) -> dict:
    return {"side": sign(rng)}


def _turned(rng, hull) -> dict:
    return {"direction": round(float(rng.uniform(0.0, 2.0 * math.pi)), 4)}


def _timed(rng, hull) -> dict:
    seconds = hull.rows * hull.step
    return {"time": round(float(rng.uniform(0.3, 0.7)) * seconds, 2), "side": sign(rng)}


def catalogue(hull: Hull) -> dict[str, Effect]:
    """Every effect that this hull can have, by key."""
    from . import effects_actuators, effects_hull, effects_sensors

    found = [
        *effects_sensors.effects(hull),
        *effects_hull.effects(hull),
        *effects_actuators.effects(hull),
    ]
    return {e.key: e for e in found}


def apply(model: Model, hull: Hull, key: str, size: float, extra: dict) -> dict:
    """Work the effect into the model; its parameters by the catalogue's names."""
    return catalogue(hull)[key].put(model, hull, size, extra)


def typical_extra(effect: Effect, hull: Hull) -> dict:
    """What the detection limit is computed with, beside the size."""
    return effect.draw(np.random.default_rng(5), hull)
