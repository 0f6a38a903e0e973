"""Identification: a vessel's parameters from recordings, with how well they are known.

`problem` sets up what is estimated from which data, `filter` predicts the data one sample ahead,
`objectives` are what a fit can aim at, `fit` and `least_squares` find the best estimate,
`uncertainty` and `holdout` say how far to trust it, and `study` goes from start to end. `online`
estimates while the vessel sails. The room may import vessels, their simulation and recordings;
nothing here knows of diagnoses, reports or the command line.
"""
