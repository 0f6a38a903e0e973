"""What a fit can aim at: one interface, three objectives.

`innovation.Innovations` predicts each sample from those before it, gusts and sensor noise
estimated; the default, efficient and with honest errors. `output_error.OutputError` predicts whole
runs from their first state. `trial_numbers.TrialNumbers` fits advance, diameters and overshoots;
the first two take them besides (`joint`).
"""

import abc

import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate, ParameterRecord, parameter_records
from diffsea.identification.problem import Coordinates, Names, NumberResidual, Problem
from diffsea.parameters import Parameter
from diffsea.progress import Progress, no_progress
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


Starts = Float[np.ndarray, "start coordinate"]
Costs = Float[np.ndarray, "start"]  # -2 log posterior, infinite where it is impossible


class AbstractObjective(abc.ABC):
    """Something that data say about the parameters of a vessel.

    Attributes:
        base: the vessel as it was.
        effects: of the catalogue, estimated besides.
        parameters: those that coordinates belong to, in order.
        problem: the recordings'; None where there are no recordings.
        outliers: how many samples of each motion channel the fit has left out.
        one_sample_in: channels whose errors follow one another: of how many samples one is used.
    """

    base: Vessel
    parameters: tuple[Parameter, ...]
    effects: tuple[Effect, ...]
    problem: Problem | None
    outliers: dict[str, int]
    one_sample_in: dict[str, int]

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
    def squares(self, fitted: Estimate) -> tuple[float, int]:
        """Sum of squared misfits over their standard deviations at a fit, and how many there are.

        Those of recordings where these and trial numbers are fitted.
        """

    @abc.abstractmethod
    def explore(self, starts: Starts, free: Names) -> tuple[Starts, Costs]:
        """Where a few steps lead from several starts at once, and the costs there."""

    def effect_records(self, fitted: Estimate) -> dict[str, list[dict[str, ParameterRecord]]]:
        """Parameters of each effect with standard errors, for each of its per-run instances."""
        assert self.problem is not None
        return {one.name: parameter_records(self.problem, fitted, one.name) for one in self.effects}

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """The numbers of trials at some coordinates; none where recordings alone are fitted."""
        further = None if self.problem is None else self.problem.further
        return [] if further is None else further.residuals(coordinates)
