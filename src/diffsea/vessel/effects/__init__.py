"""The catalogue of effects: physics that can be added to a vessel by name.

An entry is an `Effect`, in the module of what it acts on; files state it, fits estimate it and
diagnoses look for it. May import the rest of `vessel`, `kinematics` and `types`.
"""

from diffsea.vessel.effects.catalogue import EFFECTS as EFFECTS
from diffsea.vessel.effects.catalogue import find_effects as find_effects
from diffsea.vessel.effects.catalogue import with_effect as with_effect
from diffsea.vessel.effects.coordinates import Coefficient as Coefficient
from diffsea.vessel.effects.coordinates import Coordinate as Coordinate
from diffsea.vessel.effects.coordinates import Frequency as Frequency
from diffsea.vessel.effects.coordinates import Onset as Onset
from diffsea.vessel.effects.coordinates import Size as Size
from diffsea.vessel.effects.entry import Effect as Effect
from diffsea.vessel.effects.entry import Parametrisation as Parametrisation
from diffsea.vessel.effects.entry import catalogue_name as catalogue_name
