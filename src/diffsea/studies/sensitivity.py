"""Derivatives of a trial's numbers with respect to everything in the vessel.

Exact derivatives of the program that runs the trial, in forward mode, through the located
switchings and the interpolated readings; not differences of runs.
"""

import dataclasses
from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest_of
from diffsea.parameters import (
    PARAMETERS_LISTED,
    file_parameters,
    named,
    replace,
    spread_over_places,
)
from diffsea.simulation import planning
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.types import as_inputs
from diffsea.vessel.base import Vessel


_TANGENTS = 16  # carried through the run at once; more of them leave the processor's cache

Places = tuple[tuple[str, tuple[str, ...]], ...]  # parameters and where they stand in a vessel


@dataclasses.dataclass(frozen=True)
class TrialSensitivities:
    """A trial's numbers and their derivatives, in the SI units of both.

    `derivatives[number][parameter]`; a number that the trial does not contain is absent.
    """

    numbers: dict[str, float]
    parameters: dict[str, float]
    derivatives: dict[str, dict[str, float]]

    @property
    def elasticities(self) -> dict[str, dict[str, float]]:
        """Relative change of a number per relative change of a parameter; zeros left out."""
        relative = {}
        for number, row in self.derivatives.items():
            scale = self.numbers[number]
            if scale != 0:
                scaled = {name: d * self.parameters[name] / scale for name, d in row.items()}
                relative[number] = {name: value for name, value in scaled.items() if value != 0}
        return relative


def sensitivities(
    vessel: Vessel, plan: TrialPlan, parameters: Iterable[str] | None = None
) -> TrialSensitivities:
    """The numbers of a trial, and their derivatives by the vessel's parameters.

    Arguments:
        parameters: names as the vessel's file has them; all of them if None. A main
            dimension counts in every part that works with it. The approach speed, where it
            is held, the orders and the time step stay as planned.

    Raises:
        UserError: an unknown name.
    """
    names = parameter_names(vessel, parameters)
    values, places = named(vessel), file_parameters(vessel)
    at = {name: float(values[places[name][0]]) for name in names}
    shared = tuple((name, places[name]) for name in names)
    vessel = as_inputs(vessel)
    start = jnp.asarray(list(at.values()))
    groups = -(-len(names) // _TANGENTS)
    directions = np.eye(groups * _TANGENTS, len(names)).reshape(groups, _TANGENTS, len(names))
    found, columns = {}, []
    for tangents in directions:
        found, slopes = _numbers_and_slopes(vessel, start, jnp.asarray(tangents), plan, shared)
        columns.append(slopes)
    numbers = {name: float(value) for name, value in found.items() if np.isfinite(value)}
    derivatives = {}
    for number in numbers:
        slopes = np.concatenate([column[number] for column in columns])[: len(names)]
        derivatives[number] = {name: float(d) for name, d in zip(names, slopes, strict=True)}
    return TrialSensitivities(numbers, at, derivatives)


def parameter_names(vessel: Vessel, wanted: Iterable[str] | None) -> tuple[str, ...]:
    """The wanted names, checked; all of the vessel's if None. Raises `UserError` for others."""
    places = file_parameters(vessel)
    names = tuple(places) if wanted is None else tuple(dict.fromkeys(wanted))
    for name in names:
        if name not in places:
            raise UserError(
                f"the vessel has no parameter {name!r}{nearest_of(name, places, PARAMETERS_LISTED)}"
            )
    return names


@eqx.filter_jit
def _numbers_and_slopes(
    vessel: Vessel,
    at: Float[Array, "parameter"],
    tangents: Float[Array, "tangent parameter"],
    plan: TrialPlan,
    places: Places,
) -> tuple[Numbers, dict[str, Float[Array, "tangent"]]]:
    """The numbers, and how each changes along every tangent."""

    def numbers(values: Float[Array, "parameter"]) -> Numbers:
        chosen = {name: values[k] for k, (name, _) in enumerate(places)}
        changed = replace(vessel, spread_over_places(dict(places), chosen))
        return planning.trial_numbers(plan, planning.run_plan(changed, plan))

    def along(tangent: Float[Array, "parameter"]) -> tuple[Numbers, Numbers]:
        return jax.jvp(numbers, (at,), (tangent,))

    return jax.vmap(along, out_axes=(None, 0))(tangents)
