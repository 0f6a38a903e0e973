"""The catalogue of effects: physics that can be added to a vessel by name."""

from diffsea.errors import UserError, nearest
from diffsea.vessel.effects.actuators import ACTUATORS, COMMANDED, STAGES, channels_of
from diffsea.vessel.effects.entry import Coordinates, Effect, catalogue_name
from diffsea.vessel.effects.environment import ENVIRONMENT, default_wind
from diffsea.vessel.effects.hull import HULL
from diffsea.vessel.effects.sensors import LATENCY_CHANNELS, SENSORS
from diffsea.vessel.effects.thrust import THRUST


__all__ = [
    "COMMANDED", "EFFECTS", "LATENCY_CHANNELS", "STAGES", "Coordinates", "Effect",
    "catalogue_name", "channels_of", "default_wind", "find_effects",
]  # fmt: skip

EFFECTS: dict[str, Effect] = {
    effect.name: effect for effect in (*SENSORS, *ENVIRONMENT, *ACTUATORS, *THRUST, *HULL)
}


def find_effects(name: str) -> tuple[Effect, ...]:
    """The catalogue's entries of that name, its variants among them.

    Raises:
        UserError: no such entry, with the nearest one.
    """
    found = tuple(e for e in EFFECTS.values() if name in (e.name, catalogue_name(e.name)))
    if not found:
        known = sorted({catalogue_name(effect) for effect in EFFECTS})
        raise UserError(
            f"unknown effect {name!r}{nearest(name, known)}; the catalogue has: {', '.join(known)}"
        )
    return found
