"""Studies of trials: exact derivatives of their numbers, and sweeps over many designs.

May import the simulation and what lies below it. `sweep` is a module, and the function in it.
"""

from diffsea.simulation.designs import Designs as Designs
from diffsea.studies.sensitivity import TrialSensitivities as TrialSensitivities
from diffsea.studies.sensitivity import sensitivities as sensitivities
from diffsea.studies.sweep import SweepResult as SweepResult
