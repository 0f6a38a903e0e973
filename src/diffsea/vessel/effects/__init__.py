"""The catalogue of effects: physics that can be added to a vessel by name.

An entry is an `Effect`, in the module of what it acts on; files state it, fits estimate it and
diagnoses look for it. May import the rest of `vessel`, `kinematics` and `types`.
"""

from diffsea.errors import UserError, nearest_of
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import ACTUATORS
from diffsea.vessel.effects.compass import COMPASS
from diffsea.vessel.effects.coordinates import Coefficient as Coefficient
from diffsea.vessel.effects.coordinates import Coordinate as Coordinate
from diffsea.vessel.effects.coordinates import Frequency as Frequency
from diffsea.vessel.effects.coordinates import Jump as Jump
from diffsea.vessel.effects.coordinates import Onset as Onset
from diffsea.vessel.effects.coordinates import Size as Size
from diffsea.vessel.effects.entry import Effect as Effect
from diffsea.vessel.effects.entry import Parametrisation as Parametrisation
from diffsea.vessel.effects.entry import catalogue_name as catalogue_name
from diffsea.vessel.effects.entry import read_table
from diffsea.vessel.effects.entry import spoken_name as spoken_name
from diffsea.vessel.effects.environment import ENVIRONMENT
from diffsea.vessel.effects.feedback import FEEDBACK
from diffsea.vessel.effects.hull import HULL
from diffsea.vessel.effects.sensors import SENSORS
from diffsea.vessel.effects.thrust import THRUST
from diffsea.vessel.tables import Table


EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (*COMPASS, *SENSORS, *FEEDBACK, *ENVIRONMENT, *ACTUATORS, *THRUST, *HULL)
}


def find_effects(name: str) -> tuple[Effect, ...]:
    """The catalogue's entries of that name, its variants among them.

    Raises:
        UserError: no such entry, with the nearest one.
    """
    found = tuple(e for e in EFFECTS.values() if name in (e.name, catalogue_name(e.name)))
    if not found:
        known = sorted({catalogue_name(effect) for effect in EFFECTS})
        raise UserError(f"unknown effect {name!r}{nearest_of(name, known, 'the page on effects')}")
    return found


def with_effect(vessel: Vessel, table: Table) -> Vessel:
    """The vessel with the effect of an `[[effect]]` table.

    Raises:
        UserError: the effect or a key is unknown, a value is wrong, or the vessel cannot have it.
    """
    name = str(table.get("name", ""))
    variants = find_effects(name)
    if name != (usual := catalogue_name(name)):
        raise UserError(
            f"[[effect]] {name!r} is one way of an entry of the catalogue: a file has its name, "
            f"{usual!r}, and says by other keys on what it acts, and how"
        )
    read = variants[0].read or read_table
    return read(vessel, table, variants, f"[[effect]] {name!r}")
