"""The catalogue's effects as the simulator has them: how large, on what, and what they change.

An effect is counted by one *size* (>= 0, its unit in `unit`), which detection limits and the
power curve use; `draw` adds what else it needs (sides, directions, times). `put` works it into a
model and returns its parameters in the names of the catalogue.
"""

import numpy as np

from . import effects_actuators, effects_hull, effects_sensors
from .effect import Effect
from .hulls import Hull
from .model import Model


def catalogue(hull: Hull) -> dict[str, Effect]:
    """Every effect that this hull can have, by key."""
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
