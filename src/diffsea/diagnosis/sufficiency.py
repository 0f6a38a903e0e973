"""Whether data tell enough to say that a model agrees with them.

That nothing is found to be missing means little where parameters may be anything, or where held-out
runs are not predicted: then the data do not tell.
"""

import enum

import numpy as np
from scipy.stats import chi2

from diffsea.identification.estimates import Estimate
from diffsea.identification.free_predictions import motion_misfit
from diffsea.identification.holdout import Split, held_out_coordinates
from diffsea.statistics import block_sums


DETERMINED = 0.5  # share of a parameter's estimate that is due to the data
LEAST_SHARE = 0.5  # of the parameters that must be determined
LARGEST_MISFIT = 2.0  # mean square normalised innovation: twice the variance that noise explains
LARGEST_MISS = 4.0  # mean square over the expected one: off by twice what noise explains
LEVEL = 0.99  # of the tests
BLOCK_ROWS = 32  # rows whose innovations count as one


class Shortfall(enum.StrEnum):
    """What a model that nothing was found to be missing from still owes."""

    PARAMETERS = "parameters"
    MISFIT = "misfit"
    MOTION = "motion"

    @property
    def sentence(self) -> str:
        """In words."""
        return _SENTENCES[self]


_SENTENCES = {
    Shortfall.PARAMETERS: "most parameters are not determined by these recordings",
    Shortfall.MISFIT: "runs kept back are not predicted as well as the noise would allow",
    Shortfall.MOTION: "free predictions go further astray than gusts and sensor noise explain",
}


def shortfalls(data: Split, fitted: Estimate) -> tuple[Shortfall, ...]:
    """What keeps a fitted model from being called in agreement with the data."""
    found = []
    if len(fitted.free) and np.mean(fitted.shrinkage >= DETERMINED) < LEAST_SHARE:
        found.append(Shortfall.PARAMETERS)
    run = data.test.run_filter(held_out_coordinates(data, fitted), fitted.noise)
    used = np.asarray(run.gains.used)
    rows = used.any(1)
    if rows.any():
        squares = (np.asarray(run.white) ** 2).sum(1)[rows]
        sums = block_sums(np.stack([squares, used[rows].sum(1)], axis=1), BLOCK_ROWS)
        mean = float(sums[:, 0].sum() / sums[:, 1].sum())
        scatter = float(np.std(sums[:, 0] / sums[:, 1]) / np.sqrt(len(sums)))
        # Also where the model diverges and there is no number.
        if not (mean < LARGEST_MISFIT or mean - 2 * scatter < 1.0):
            found.append(Shortfall.MISFIT)
    misfit = motion_misfit(data, fitted)
    for horizon, ratio in misfit.ratio.items():
        freedom = 2 * max(misfit.blocks[horizon], 1)
        limit = max(LARGEST_MISS, float(chi2.ppf(LEVEL, freedom)) / freedom)
        if not ratio < limit:
            found.append(Shortfall.MOTION)
            break
    return tuple(found)
