"""Numbers of the standard trials, from simulated and measured runs alike.

`crossings` reads curves at interpolated instants, `manoeuvres` has the numbers, `orders` finds what
was ordered in a recording, `recorded` which trial it is. The room imports nothing above
trajectories and rotations: not vessels, nor recordings.
"""

from diffsea.metrics.crossings import Curve as Curve
from diffsea.metrics.crossings import DifferencedCurve as DifferencedCurve
from diffsea.metrics.crossings import curve as curve
from diffsea.metrics.crossings import first_crossing as first_crossing
from diffsea.metrics.crossings import highest as highest
from diffsea.metrics.crossings import slopes as slopes
from diffsea.metrics.crossings import value_at as value_at
from diffsea.metrics.imo import imo_verdicts as imo_verdicts
from diffsea.metrics.manoeuvres import stopping_metrics as stopping_metrics
from diffsea.metrics.manoeuvres import turning_metrics as turning_metrics
from diffsea.metrics.manoeuvres import zigzag_metrics as zigzag_metrics
from diffsea.metrics.orders import find_orders as find_orders
from diffsea.metrics.preparation import prepare_recording as prepare_recording
from diffsea.metrics.recorded import RECORDED_TRIALS as RECORDED_TRIALS
from diffsea.metrics.recorded import RecordedTrial as RecordedTrial
from diffsea.metrics.recorded import recognise_trial as recognise_trial
from diffsea.metrics.recorded import recording_metrics as recording_metrics
from diffsea.metrics.repeats import fit_percent as fit_percent
from diffsea.metrics.repeats import mean_and_half_width as mean_and_half_width
