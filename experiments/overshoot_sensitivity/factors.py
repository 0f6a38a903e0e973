"""The parameters of a vessel as relative factors: what is varied, and by which name."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea import Vessel, named, replace
from diffsea.parameters import file_parameters


# Limits that no trial reaches, and a dimension that enters no force.
_IDLE = ("lower", "upper", "beam")
_SIDES = ("port.", "starboard.")


@dataclasses.dataclass(frozen=True)
class Factor:
    """One parameter, or the same parameter of port and starboard, times `exp(x)`."""

    label: str
    places: tuple[str, ...]
    value: float  # SI units of the vessel file; of the starboard one where there are two


def factors(vessel: Vessel) -> tuple[Factor, ...]:
    """Every non-zero number of a vessel that can act in a trial.

    Twin thrusters change together. A number that is zero has no relative change.
    """
    values, grouped = named(vessel), {}
    for name, places in file_parameters(vessel).items():
        value = float(values[places[0]])
        if value == 0 or name.rsplit(".", 1)[-1] in _IDLE:
            continue
        label = name
        for side in _SIDES:
            if name.startswith(side):
                label = "thrusters." + name.removeprefix(side)
        before = grouped.get(label, ((), value))[0]
        grouped[label] = ((*before, *places), value)
    return tuple(Factor(label, *entry) for label, entry in grouped.items())


def scaled(vessel: Vessel, chosen: Sequence[Factor], x: Float[Array, "factor"]) -> Vessel:
    """The vessel with every factor's numbers times `exp(x)`."""
    values, changed = named(vessel), {}
    for k, factor in enumerate(chosen):
        for place in factor.places:
            changed[place] = values[place] * jnp.exp(x[k])
    return replace(vessel, changed)
