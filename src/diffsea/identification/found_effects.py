"""Fitted effects as people and files have them: SI units, standard errors, tables."""

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import LATENCY_CHANNELS, AbstractEffect


def catalogue_name(effect: str) -> str:
    """The name in the catalogue: variants of one effect share it."""
    return effect.split(":")[0]


def reported(problem: Problem, fitted: Estimate, name: str) -> list[dict[str, dict]]:
    """An effect's parameters with standard errors, one dictionary for each copy.

    Standard errors by linear propagation from coordinates to parameters.
    """
    layout = problem.layout
    effect = next(e for e in layout.effects if e.name == name)
    sizes = np.array(layout.sizes[layout.effects.index(effect)])
    place = layout.slices()[name]
    positions = [list(fitted.index).index(k) for k in range(place.start, place.stop)]
    covariance = fitted.covariance[np.ix_(positions, positions)]
    out = []
    for copy, values in enumerate(layout.physical(name, fitted.coordinates)):
        part = slice(copy * len(sizes), (copy + 1) * len(sizes))
        spread = covariance[part, part] * np.outer(sizes, sizes)
        out.append(_with_errors(effect, values, spread))
    return out


def _with_errors(effect: AbstractEffect, values: np.ndarray, covariance: np.ndarray) -> dict:
    def listed(at: jax.Array) -> jax.Array:
        return jnp.stack([jnp.asarray(v) for v in effect.parameters(at).values()])

    at = jnp.asarray(values)
    J = np.asarray(jax.jacfwd(listed)(at))
    std = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    numbers = zip(effect.units.items(), np.asarray(listed(at)), std, strict=True)
    parameters: dict[str, dict] = {
        name: {"value": float(value), "std": float(error), "unit": unit}
        for (name, unit), value, error in numbers
    }
    return parameters


def effect_table(name: str, parameters: dict[str, dict]) -> dict:
    """An `[[effect]]` table for a vessel file."""
    table: dict = {"name": catalogue_name(name)}
    table |= {key: float(entry["value"]) for key, entry in parameters.items()}
    if ":" in name:
        table["channels"] = list(LATENCY_CHANNELS[name.split(":")[1]])
    return table
