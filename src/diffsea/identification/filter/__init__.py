"""An extended Kalman filter along a data set, its noise, and delayed sensors.

It imports the data and the coordinates of a fit, and nothing of the fit itself.
"""

from diffsea.identification.filter.covariance import Noise as Noise
from diffsea.identification.filter.kalman import FilterRun as FilterRun
from diffsea.identification.filter.kalman import Gains as Gains
from diffsea.identification.filter.kalman import deviance as deviance
from diffsea.identification.filter.kalman import run_filter as run_filter
