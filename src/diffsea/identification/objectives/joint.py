"""Recordings and trial numbers in one fit.

With y the recordings, m the given trial numbers of standard deviations s, and theta the
coordinates,

    -2 log p(theta | y, m) = D(theta; y) + sum_k ((m_k(theta) - m_k) / s_k)^2 + |prior strains|^2

up to a constant: errors of the sheet are independent of those of the recordings, so that their
squares add up. D is what the recordings' own objective minimises: the deviance of the innovations
at gusts and sensor noise that are estimated with theta, or the soft squares of output errors over
scales that are. Both sides are so weighed by their statistical errors, and by nothing else: a
recording with thousands of samples outweighs a sheet of six numbers wherever it tells anything of
what they tell. A model that cannot follow both has errors of its own, which neither side knows of:
the standard deviations of the sheet are where they belong, as variances that add up.

One prior, one Gauss-Newton iteration and one covariance serve both, whose information is the sum of
the two. The recordings' objectives take the numbers as `Problem.further`: rows of their residual
and Jacobian, linear in each round and evaluated exactly at each step.
"""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
    TrialNumbers,
    acts_in_trials,
)
from diffsea.identification.problem import Coordinates, NumberResidual, Problem


def with_trial_numbers(problem: Problem, trials: Sequence[MeasuredTrial]) -> Problem:
    """The problem of recordings with a sheet's numbers beside them, on the same coordinates.

    Raises:
        UserError: when it is fitted, a number that a trial does not have.
    """
    return dataclasses.replace(problem, further=NumbersBeside(problem, trials))


class NumbersBeside:
    """The numbers of trials by the coordinates of the recordings' problem: `FurtherData`."""

    is_before: ClassVar[bool] = False

    def __init__(self, problem: Problem, trials: Sequence[MeasuredTrial]):
        layout = problem.layout
        effects = [effect for effect in layout.effects if acts_in_trials(effect)]
        names = (*(p.name for p in layout.parameters), *(effect.name for effect in effects))
        self.numbers = TrialNumbers(problem.base, layout.parameters, trials, effects)
        self._places, self._size = np.array(layout.indices(names), int), layout.size
        self._last: tuple[bytes, tuple[np.ndarray, np.ndarray]] | None = None

    def misfits_and_jacobian(
        self, coordinates: Coordinates
    ) -> tuple[Float[np.ndarray, "value"], Float[np.ndarray, "value coordinate"]]:
        """Misfits over their standard deviations, and their exact Jacobian."""
        own = np.asarray(coordinates, float)[self._places]
        # A fit asks for the same place several times in a row, and for others in other threads.
        key, last = own.tobytes(), self._last
        if last is None or last[0] != key:
            misfit, slopes = self.numbers.misfits_and_jacobian(own)
            J = np.zeros((len(misfit), self._size))
            J[:, self._places] = slopes
            last = self._last = key, (misfit, J)
        return last[1]

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """All numbers as they were given and as they are simulated."""
        return self.numbers.residuals(np.asarray(coordinates, float)[self._places])
