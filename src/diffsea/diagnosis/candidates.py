"""Which effects a diagnosis considers."""

from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, AbstractEffect


def candidates(vessel: Vessel) -> tuple[AbstractEffect, ...]:
    """Effects of the catalogue that this vessel could have and its model lacks."""
    return tuple(effect for effect in EFFECTS.values() if effect.possible(vessel))
