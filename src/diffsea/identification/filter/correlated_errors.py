"""Sensors whose errors follow one another are used as seldom as they err anew.

The filter takes sensor noise for white. A velocity from a receiver's own filter, a yaw rate that
was smoothed or a fix that was interpolated errs alike for some rows: taken for exact, it outweighs
whatever acts slowly, and evidence counts the same error many times. Samples that far apart that
their innovations hardly correlate say what they say once.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
SENSORS = (("x", "y"), ("psi",), ("u",), ("v",), ("r",))  # channels whose errors are of one kind


def independent_sampling(run: FilterRun, data: Dataset, length: float) -> dict[str, int]:
    """Channels whose errors follow one another: of how many samples one is to be used.

    The correlation of a run's innovations falls below 0.2 there, or the samples are 2 sqrt(L / g)
    apart, L the vessel's `length` (m). Both axes of the positions are judged together: which way
    the axes of the world point must not matter.
    """
    longest, found = LONGEST_INTERVAL * time_scale(length), dict[str, int]()
    for group in SENSORS:
        series = [_innovations(run, data, channel) for channel in group]
        series = [one for one in series if len(one.white) >= FEWEST_SAMPLES]
        every = _forgotten_after(series, longest) if series else 1
        if every > 1:
            found |= dict.fromkeys(group, every)
    return found


class _Innovations(NamedTuple):
    """Those of one channel, at its samples."""

    white: Float[np.ndarray, "sample"]
    run: Int[np.ndarray, "sample"]
    t: Float[np.ndarray, "sample"]  # s, on the run's clock


def _innovations(run: FilterRun, data: Dataset, channel: str) -> _Innovations:
    k = MOTION_CHANNELS.index(channel)
    rows = np.flatnonzero(np.asarray(run.gains.used)[:, k])
    times = np.asarray(data.run_time)[rows]
    return _Innovations(np.asarray(run.white)[rows, k], np.asarray(data.run)[rows], times)


def _forgotten_after(series: Sequence[_Innovations], longest: float) -> int:
    """The first lag at which innovations hardly correlate, in samples; within `longest` s."""
    steps = np.concatenate([np.diff(one.t)[one.run[1:] == one.run[:-1]] for one in series])
    most = int(longest / np.median(steps)) if len(steps) else 1
    variance = np.concatenate([one.white**2 for one in series]).mean()
    for lag in range(1, most):
        products = np.concatenate(
            [
                (one.white[lag:] * one.white[:-lag])[one.run[lag:] == one.run[:-lag]]
                for one in series
            ]
        )
        if not products.size or products.mean() < HARDLY_CORRELATED * variance:
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
