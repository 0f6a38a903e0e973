"""What a fit can aim at: innovations, output error, or trial numbers."""

from diffsea.identification.objectives.base import AbstractObjective as AbstractObjective
from diffsea.identification.objectives.innovation import Innovations as Innovations
from diffsea.identification.objectives.output_error import OutputError as OutputError
from diffsea.identification.objectives.trial_numbers import TrialNumbers as TrialNumbers
