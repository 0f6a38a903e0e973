"""Runs of a vessel: standard trials, runs under a controller, and replays of recordings.

Everything is pure in the vessel and can be compiled, batched and differentiated. The room may
import vessels, metrics and recordings, and nothing that identifies or diagnoses. `control` has
controllers, `standard` the trials by name; how one is added is in docs/adding-a-trial.md.
"""

from diffsea.simulation.closed_loop import ClosedLoop as ClosedLoop
from diffsea.simulation.closed_loop import run_controlled as run_controlled
from diffsea.simulation.planning import plan_trial as plan_trial
from diffsea.simulation.planning import run_and_measure as run_and_measure
from diffsea.simulation.planning import run_plan as run_plan
from diffsea.simulation.planning import summarise_trial as summarise_trial
from diffsea.simulation.planning import trial_numbers as trial_numbers
from diffsea.simulation.replay import horizon_errors as horizon_errors
from diffsea.simulation.replay import replay_errors as replay_errors
from diffsea.simulation.standard import STANDARD_TRIALS as STANDARD_TRIALS
from diffsea.simulation.standard import StandardTrial as StandardTrial
from diffsea.simulation.standard import TrialPlan as TrialPlan
from diffsea.simulation.trials import Trial as Trial
from diffsea.simulation.trials import TrialSettings as TrialSettings
from diffsea.simulation.trials import run_trial as run_trial
