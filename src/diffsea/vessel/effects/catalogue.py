"""The list of all effects, and finding them by name."""

from diffsea.errors import UserError, nearest
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import ACTUATORS
from diffsea.vessel.effects.entry import Effect, catalogue_name
from diffsea.vessel.effects.environment import ENVIRONMENT
from diffsea.vessel.effects.hull import HULL
from diffsea.vessel.effects.sensors import SENSORS
from diffsea.vessel.effects.tables import read_table
from diffsea.vessel.effects.thrust import THRUST
from diffsea.vessel.tables import Table


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


def with_effect(vessel: Vessel, table: Table) -> Vessel:
    """The vessel with the effect of an `[[effect]]` table.

    Raises:
        UserError: the effect or a key is unknown, a value is wrong, or the vessel cannot have it.
    """
    name = str(table.get("name", ""))
    variants = find_effects(name)
    read = variants[0].read or read_table
    return read(vessel, table, variants, f"[[effect]] {name!r}")
