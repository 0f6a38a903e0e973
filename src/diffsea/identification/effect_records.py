"""Fitted effects as people and files have them: SI units, standard errors, tables.

Fits work on coordinates that are zero where an effect is absent; nobody else should have to.
"""

import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.tables import Table


ONE_SIDED_95 = float(norm.ppf(0.95))  # standard errors that one of twenty draws exceeds

ParameterRecord = dict[str, Any]  # value, std, unit


def parameter_records(
    problem: Problem, fitted: Estimate, name: str
) -> list[dict[str, ParameterRecord]]:
    """A fitted effect's parameters with standard errors, one dictionary for each instance.

    An instance is the effect itself, or that of one run where each has an environment of its own.
    Every parameter has `value`, `std` and `unit`, as `parameters_with_errors` says.
    """
    layout = problem.layout
    effect = next(e for e in layout.effects if e.name == name)
    sizes = np.array(layout.sizes[layout.effects.index(effect)])
    place = layout.slices()[name]
    positions = [list(fitted.index).index(k) for k in range(place.start, place.stop)]
    covariance = fitted.covariance[np.ix_(positions, positions)]
    out = []
    for instance, values in enumerate(layout.physical(name, fitted.coordinates)):
        part = slice(instance * len(sizes), (instance + 1) * len(sizes))
        own = covariance[part, part] * np.outer(sizes, sizes)
        out.append(parameters_with_errors(problem.base, effect, values, own))
    return out


def parameters_with_errors(
    vessel: Vessel,
    effect: Effect,
    values: Float[np.ndarray, "coordinate"],
    covariance: Float[np.ndarray, "coordinate coordinate"],
) -> dict[str, ParameterRecord]:
    """Parameters of an effect from its coordinates and their covariance, in SI units.

    Standard errors by linear propagation. What is endless while the effect is absent (a rate
    limit, a depth) and not told from none has neither value nor error, but the `beyond` that it
    exceeds with a probability of 95 %.
    """
    units = {key: effect.place.unit_on(vessel, unit) for key, unit in effect.units.items()}
    absent = effect.decode(vessel, jnp.zeros(len(values)))
    error = ONE_SIDED_95 * math.sqrt(covariance[0, 0])
    endless = len(values) == 1 and not np.isfinite(list(absent.values())).all()
    if endless and not values[0] > error:
        beyond = effect.decode(vessel, jnp.array([max(values[0], 0.0) + error]))
        return {
            key: {"value": None, "std": None, "unit": unit, "beyond": float(beyond[key])}
            for key, unit in units.items()
        }

    def parameters(at: jax.Array) -> jax.Array:
        return jnp.stack([jnp.asarray(v) for v in effect.decode(vessel, at).values()])

    at = jnp.asarray(values)
    J = np.asarray(jax.jacfwd(parameters)(at))
    std = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    numbers = zip(units.items(), np.asarray(parameters(at)), std, strict=True)
    return {
        key: {"value": float(value), "std": float(spread), "unit": unit}
        for (key, unit), value, spread in numbers
    }


def is_known(parameters: Mapping[str, ParameterRecord]) -> bool:
    """Whether the numbers of a reported effect are known: not those of one that is not seen."""
    return all(entry["value"] is not None for entry in parameters.values())


def effect_table(vessel: Vessel, name: str, parameters: Mapping[str, ParameterRecord]) -> Table:
    """An `[[effect]]` table for a vessel file: the values, and what the variant acts on.

    Reading it (`vessel.effects.with_effect`) attaches the effect as it was fitted.
    """
    values = {key: float(entry["value"]) for key, entry in parameters.items()}
    return {"name": catalogue_name(name), **values, **EFFECTS[name].place.in_file(vessel)}
