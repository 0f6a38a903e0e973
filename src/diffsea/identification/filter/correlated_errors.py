"""Sensors whose errors follow one another are used as seldom as they err anew.

The filter takes sensor noise for white. A velocity from a receiver's own filter, a yaw rate that
was smoothed or a fix that was interpolated errs alike for some rows: taken for exact, it outweighs
whatever acts slowly, and evidence counts the same error many times. Samples that far apart that
their innovations hardly correlate say what they say once.
"""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.kalman import FilterRun
from diffsea.scales import time_scale
from diffsea.trajectory import MOTION_CHANNELS


HARDLY_CORRELATED = 0.2  # of an AR(1): errors of what is fitted are stated a fifth too small
LONGEST_INTERVAL = 2.0  # in sqrt(L / g): what stays alike for longer is a mismatch, no sensor
FEWEST_SAMPLES = 50  # of a channel, from which a correlation is told


def independent_sampling(run: FilterRun, data: Dataset, length: float) -> dict[str, int]:
    """Channels whose errors follow one another: of how many samples one is to be used.

    The correlation of a run's innovations falls below 0.2 there, or the samples are 2 sqrt(L / g)
    apart, L the vessel's `length` (m).
    """
    white, used, found = np.asarray(run.white), np.asarray(run.gains.used), dict[str, int]()
    longest = LONGEST_INTERVAL * time_scale(length)
    for k, channel in enumerate(MOTION_CHANNELS):
        rows = np.flatnonzero(used[:, k])
        if len(rows) < FEWEST_SAMPLES:
            continue
        of_run, times = np.asarray(data.run)[rows], np.asarray(data.run_time)[rows]
        steps = np.diff(times)[of_run[1:] == of_run[:-1]]
        most = int(longest / np.median(steps)) if len(steps) else 1
        every = _forgotten_after(white[rows, k], of_run, most)
        if every > 1:
            found[channel] = every
    return found


def _forgotten_after(
    white: Float[np.ndarray, "sample"], run: Int[np.ndarray, "sample"], most: int
) -> int:
    """The first lag, of at most so many samples, at which innovations hardly correlate."""
    for lag in range(1, most):
        same = run[lag:] == run[:-lag]
        if not same.any():
            return lag
        products = (white[lag:] * white[:-lag])[same]
        if products.mean() < HARDLY_CORRELATED * np.mean(white**2):
            return lag
    return max(most, 1)


def thin_channels(dataset: Dataset, every: Mapping[str, int]) -> Dataset:
    """The data with one of so many samples of some channels used, from each run's first on."""
    known, run = np.array(dataset.known), np.asarray(dataset.run)
    for channel, number in every.items():
        k = MOTION_CHANNELS.index(channel)
        for own in np.unique(run):
            rows = np.flatnonzero(known[:, k] & (run == own))
            known[rows, k] = np.arange(len(rows)) % number == 0
    return eqx.tree_at(lambda d: d.known, dataset, jnp.asarray(known))
