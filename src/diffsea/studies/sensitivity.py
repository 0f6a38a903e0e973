"""Derivatives of a trial's numbers with respect to everything in the vessel.

Exact derivatives of the program that runs the trial, in forward mode, through the located
switchings and the interpolated readings; not differences of runs.
"""

from collections.abc import Iterable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.parameters import designed, named, replace, spread
from diffsea.simulation import planning
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.vessel.base import Vessel


Derivatives = dict[str, dict[str, float]]

_TOGETHER = 16  # tangents that are carried through the run at once


def sensitivities(
    vessel: Vessel, plan: TrialPlan, parameters: Iterable[str] | None = None
) -> tuple[dict[str, float], Derivatives]:
    """The numbers of a trial, and d number / d parameter in the SI units of both.

    Arguments:
        parameters: names as the vessel's file has them; all of them if None. A main
            dimension counts in every part that works with it. The approach speed, where it
            is held, the orders and the time step stay as planned.

    A number that the trial does not contain is absent.

    Raises:
        UserError: an unknown name.
    """
    names = parameter_names(vessel, parameters)
    values = named(vessel)
    places = designed(vessel)
    shared = tuple((name, places[name]) for name in names)
    at = jnp.asarray([float(values[places[name][0]]) for name in names])
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    columns = []
    for first in range(0, len(names), _TOGETHER):
        tangents = np.zeros((_TOGETHER, len(names)))
        chosen = np.arange(first, min(first + _TOGETHER, len(names)))
        tangents[chosen - first, chosen] = 1.0
        found, slopes = _tangents(vessel, at, jnp.asarray(tangents), (plan, shared))
        columns.append({k: np.asarray(s)[: chosen.size] for k, s in slopes.items()})
    there = {name: float(value) for name, value in found.items() if np.isfinite(value)}
    derivatives = {}
    for number in there:
        slopes = np.concatenate([column[number] for column in columns])
        derivatives[number] = {name: float(d) for name, d in zip(names, slopes, strict=True)}
    return there, derivatives


def parameter_names(vessel: Vessel, wanted: Iterable[str] | None) -> tuple[str, ...]:
    """The wanted names, checked; all of the vessel's if None."""
    places = designed(vessel)
    names = tuple(places) if wanted is None else tuple(dict.fromkeys(wanted))
    for name in names:
        if name not in places:
            raise UserError(
                f"the vessel has no parameter {name!r}{nearest(name, places)}; "
                f"it has: {', '.join(places)}"
            )
    return names


@eqx.filter_jit
def _tangents(
    vessel: Vessel,
    at: Float[Array, "parameter"],
    tangents: Float[Array, "tangent parameter"],
    trial: tuple[TrialPlan, tuple[tuple[str, tuple[str, ...]], ...]],
) -> tuple[dict[str, Array], dict[str, Float[Array, "tangent"]]]:
    plan, places = trial

    def numbers(values: Float[Array, "parameter"]) -> Numbers:
        chosen = {name: values[k] for k, (name, _) in enumerate(places)}
        changed = replace(vessel, spread(dict(places), chosen))
        return planning.trial_numbers(plan, planning.run_plan(changed, plan))

    def along(tangent: Float[Array, "parameter"]) -> tuple:
        return jax.jvp(numbers, (at,), (tangent,))

    return jax.vmap(along, out_axes=(None, 0))(tangents)


def elasticities(
    vessel: Vessel, found: Mapping[str, float], derivatives: Derivatives
) -> Derivatives:
    """Relative change of a number per relative change of a parameter; zeros left out."""
    values, places = named(vessel), designed(vessel)
    relative = {}
    for number, row in derivatives.items():
        if found[number] == 0:
            continue
        scaled = {n: d * float(values[places[n][0]]) / found[number] for n, d in row.items()}
        relative[number] = {name: value for name, value in scaled.items() if value != 0}
    return relative
