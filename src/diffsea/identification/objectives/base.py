"""What a fit can aim at: one interface, three objectives.

`innovation.Innovations` predicts each sample from those before it, gusts and sensor noise
estimated; the default, efficient and with honest errors. `output_error.OutputError` predicts whole
runs from their first state. `trial_numbers.TrialNumbers` fits advance, diameters and overshoots.
"""

import abc
import dataclasses

import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate, Progress, no_progress
from diffsea.identification.problem import Coordinates, Names, Problem
from diffsea.parameters import Parameter


Starts = Float[np.ndarray, "start coordinate"]
Costs = Float[np.ndarray, "start"]  # -2 log posterior, infinite where it is impossible


@dataclasses.dataclass(frozen=True)
class NumberResidual:
    """A trial number as it was given and as a fit has it, in SI units."""

    trial: str
    number: str
    given: float
    std: float
    fitted: float  # NaN where the simulated trial does not reach it


class AbstractObjective(abc.ABC):
    """Something that data say about the parameters of a vessel.

    Attributes:
        parameters: those that coordinates belong to, in order.
        problem: the recordings'; None where there are no recordings.
        outliers: how many samples of each motion channel the fit has left out.
    """

    parameters: tuple[Parameter, ...]
    problem: Problem | None
    outliers: dict[str, int]

    @abc.abstractmethod
    def fit(
        self, free: Names, start: Coordinates | None = None, progress: Progress = no_progress
    ) -> Estimate:
        """Fit the free parameters by name, from coordinates `start` or the prior mean."""

    @abc.abstractmethod
    def refit(self, fitted: Estimate, free: Names, start: Coordinates) -> Estimate:
        """Fit again with the noise or weights of an earlier fit."""

    @abc.abstractmethod
    def cost(self, coordinates: Coordinates, fitted: Estimate) -> float:
        """-2 log posterior, without its constant, with the noise or weights of a fit."""

    @abc.abstractmethod
    def explore(self, starts: Starts, free: Names) -> tuple[Starts, Costs]:
        """Where a few steps lead from several starts at once, and the costs there.

        Infinite where the steps lead to what cannot be.
        """

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """The numbers of trials at some coordinates; none where recordings are fitted."""
        return []
