"""A vessel from what its owner knows: derivatives by published estimates, with prior widths.

`outline` is what is known and what is taken for the rest, `added_mass`, `resistance` and
`lateral` are the estimates by several methods each, `scatter` makes one value and a prior of them,
`drives` has thrusters, propeller and rudder, and `vessel_text` writes the vessel file, every number
with where it comes from. Everything is plain numbers in SI units. May import scales, errors and
the units of thrusters' orders.
"""

from diffsea.vessel.estimates.drives import Azimuths as Azimuths
from diffsea.vessel.estimates.drives import MotorScale as MotorScale
from diffsea.vessel.estimates.drives import RudderDrive as RudderDrive
from diffsea.vessel.estimates.drives import Thrusters as Thrusters
from diffsea.vessel.estimates.hull import hull_estimates as hull_estimates
from diffsea.vessel.estimates.outline import FORMS as FORMS
from diffsea.vessel.estimates.outline import Known as Known
from diffsea.vessel.estimates.outline import Outline as Outline
from diffsea.vessel.estimates.outline import outline_of as outline_of
from diffsea.vessel.estimates.scatter import DerivativeEstimate as DerivativeEstimate
from diffsea.vessel.estimates.vessel_text import vessel_text as vessel_text
