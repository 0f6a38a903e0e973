"""Identification: a vessel's parameters from recordings, with how well they are known.

`problem` sets up what is estimated from which data, `filter` predicts the data one sample ahead,
`objectives` are what a fit can aim at, `fit` and `least_squares` find the best estimate,
`uncertainty` and `holdout` say how far to trust it, and `study` goes from start to end. `online`
estimates while the vessel sails. The room may import vessels, their simulation and recordings;
nothing here knows of diagnoses, reports or the command line.
"""

from diffsea.identification.estimates import Estimate as Estimate
from diffsea.identification.problem import Problem as Problem
from diffsea.identification.problem import make_problem as make_problem
from diffsea.identification.study import FitSettings as FitSettings
from diffsea.identification.study import Study as Study
from diffsea.identification.study import identify as identify
