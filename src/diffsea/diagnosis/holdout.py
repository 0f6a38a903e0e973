"""Judging a model on runs that it did not see."""

import dataclasses
from typing import NamedTuple

import numpy as np

from diffsea.identification.fit import Estimate, Problem, block_sums, estimate
from diffsea.recordings.conditioning import cut
from diffsea.types import Trajectory


TRAIN_SHARE = 0.7  # of each recording, where no test recordings are given


class Gain(NamedTuple):
    """Predictive gain of one model over another on held-out data."""

    total: float  # difference of -2 log likelihood, positive where the second is better
    std: float  # from block sums

    @property
    def clear(self) -> bool:
        """Whether the gain is beyond two standard errors."""
        return self.total > 2 * self.std


@dataclasses.dataclass(frozen=True)
class Split:
    """Training and held-out data as two problems with the same layout."""

    train: Problem
    test: Problem
    recordings: tuple[Trajectory, ...]
    held_out: tuple[Trajectory, ...]
    by_time: bool  # held out the end of each recording rather than whole ones


def split(problem_of, recordings: list[Trajectory], test: list[Trajectory]) -> Split:
    """Hold out `test`, or the end of each recording where there is none.

    `problem_of` makes a problem from recordings.
    """
    if test:
        return Split(
            problem_of(recordings), problem_of(test), tuple(recordings), tuple(test), False
        )
    heads, tails = zip(*(_parts(recording) for recording in recordings), strict=True)
    return Split(problem_of(list(heads)), problem_of(list(tails)), heads, tails, True)


def _parts(recording: Trajectory) -> tuple[Trajectory, Trajectory]:
    t = np.asarray(recording.t)
    at = float(t[0] + TRAIN_SHARE * (t[-1] - t[0]))
    return cut(recording, float(t[0]), at), cut(recording, at, float(t[-1]))


def transferred(split: Split, fitted: Estimate) -> np.ndarray:
    """The fitted coordinates as coordinates of the held-out problem.

    An environment of its own for each run is not transferable to other runs: there it is
    estimated on the held-out run itself, everything else fixed.
    """
    train, test = split.train.layout, split.test.layout
    out = np.zeros(test.size)
    out[: len(test.parameters)] = fitted.coordinates[: len(train.parameters)]
    own = []
    for effect in train.effects:
        a, b = train.slices()[effect.name], test.slices()[effect.name]
        if a.stop - a.start == b.stop - b.start:
            out[b] = fitted.coordinates[a]
        elif effect.name in fitted.free:
            own.append(effect.name)
    if own:
        out = estimate(
            split.test, tuple(own), start=out, noise=fitted.noise, rounds=2, fixed_noise=True
        ).coordinates
    return out


def row_deviance(problem: Problem, coordinates: np.ndarray, fitted: Estimate) -> np.ndarray:
    """-2 log likelihood of each row."""
    tuned = problem.tuned(coordinates, fitted.noise)
    return (np.asarray(tuned.white) ** 2 + np.log(np.asarray(tuned.variance))).sum(1)


def gain(split: Split, nominal: Estimate, fitted: Estimate) -> Gain:
    """How much better `fitted` predicts the held-out runs than `nominal`."""
    old = row_deviance(split.test, transferred(split, nominal), nominal)
    new = row_deviance(split.test, transferred(split, fitted), fitted)
    known = np.asarray(split.test.tape.known).any(1)
    difference = (old - new)[known][:, None]
    length = max(8, len(difference) // 30)
    sums = block_sums(difference, length)[:, 0]
    return Gain(float(sums.sum()), float(np.std(sums, ddof=1) * np.sqrt(len(sums))))
