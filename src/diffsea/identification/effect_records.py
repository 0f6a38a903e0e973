"""Fitted effects as people and files have them: SI units, standard errors, tables."""

import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import norm

from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import COMMANDED, EFFECTS, Effect, catalogue_name, channels_of


NINETY_FIVE = float(norm.ppf(0.95))  # standard errors that one of twenty draws exceeds

Entry = dict[str, Any]  # value, std, unit


def parameter_records(problem: Problem, fitted: Estimate, name: str) -> list[dict[str, Entry]]:
    """An effect's parameters with standard errors, one dictionary for each copy.

    Standard errors by linear propagation from coordinates to parameters. What is endless while
    the effect is absent (a rate limit, a depth) and not seen has neither, but the `beyond` that it
    exceeds with a probability of 95 %.
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
        unseen = _unseen(problem.base, effect, values, spread)
        out.append(unseen or _with_errors(problem.base, effect, values, spread))
    return out


def is_known(parameters: Mapping[str, Entry]) -> bool:
    """Whether the numbers of a reported effect are known: not those of one that is not seen."""
    return all(entry["value"] is not None for entry in parameters.values())


def _unseen(
    vessel: Vessel, effect: Effect, values: np.ndarray, covariance: np.ndarray
) -> dict[str, Entry] | None:
    """Entries of an effect that is not told from none, if it is endless then; else None."""
    absent = effect.parameters(vessel, jnp.zeros(len(values)))
    error = NINETY_FIVE * math.sqrt(covariance[0, 0])
    if len(values) > 1 or np.isfinite(list(absent.values())).all() or values[0] > error:
        return None
    beyond = effect.parameters(vessel, jnp.array([max(values[0], 0.0) + error]))
    return {
        name: {"value": None, "std": None, "unit": _unit(vessel, effect, unit),
               "beyond": float(beyond[name])}
        for name, unit in effect.units.items()
    }  # fmt: skip


def _with_errors(
    vessel: Vessel, effect: Effect, values: np.ndarray, covariance: np.ndarray
) -> dict[str, Entry]:
    def listed(at: jax.Array) -> jax.Array:
        return jnp.stack([jnp.asarray(v) for v in effect.parameters(vessel, at).values()])

    at = jnp.asarray(values)
    J = np.asarray(jax.jacfwd(listed)(at))
    std = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    numbers = zip(effect.units.items(), np.asarray(listed(at)), std, strict=True)
    parameters: dict[str, Entry] = {
        name: {"value": float(value), "std": float(error), "unit": _unit(vessel, effect, unit)}
        for (name, unit), value, error in numbers
    }
    return parameters


def _unit(vessel: Vessel, effect: Effect, unit: str) -> str:
    """The unit on this vessel, of a number in what its channels are commanded in."""
    channels = channels_of(vessel, effect.where["kind"]) if "kind" in effect.where else ()
    own = {vessel.units[channel] for channel in channels}
    return unit.replace(COMMANDED, own.pop()) if len(own) == 1 else unit


def effect_table(vessel: Vessel, name: str, parameters: dict[str, dict]) -> dict:
    """An `[[effect]]` table for a vessel file."""
    table: dict = {"name": catalogue_name(name)}
    table |= {key: float(entry["value"]) for key, entry in parameters.items()}
    return table | place_of(vessel, name)


def place_of(vessel: Vessel, name: str) -> dict[str, list[str]]:
    """What a variant acts on, as files say it: channels of sensors, or some of the actuators."""
    where = EFFECTS[name].where
    if "kind" not in where:
        return where
    channels = channels_of(vessel, where["kind"])
    return {} if len(channels) == len(vessel.channels) else {"actuators": list(channels)}
