"""What a fit can aim at: innovations, output error, trial numbers, or recordings and numbers."""

from diffsea.identification.objectives.base import AbstractObjective as AbstractObjective
from diffsea.identification.objectives.innovation import Innovations as Innovations
from diffsea.identification.objectives.joint import with_trial_numbers as with_trial_numbers
from diffsea.identification.objectives.output_error import OutputError as OutputError
from diffsea.identification.objectives.trial_numbers import TrialNumbers as TrialNumbers
