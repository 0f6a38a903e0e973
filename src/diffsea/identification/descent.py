"""One step of a fit downhill: where it stands, and where the deviance of the filter is lower.

A step is Gauss and Newton's with the gains of the filter held fixed, shortened where the filter,
with its own gains, is no better there. What held gains leave out of the slope is found by
differences where such a step leads nowhere, and serves the steps that follow.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffsea.budget import on_every_core
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun, deviance
from diffsea.identification.least_squares import dogleg_steps
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.identification.residual import Linearisation, linearise


STEP_SHARES = (1.0, 1 / 2, 1 / 4, 1 / 16, 1 / 64, 1 / 256)  # of a step, tried one after the other
ENOUGH_OF_PROMISE = 0.25  # of what the model promised: a step that gains so much is taken
NEGLIGIBLE_PROMISE = 1e-3  # of -2 log posterior: a thirtieth of a standard error
CORRECTED_PROMISE = 0.05  # that was not kept: from it on the slope is found by differences
DIFFERENCE = 0.5  # standard errors to both sides, by which slopes are found
LEAST_BEND = 0.25  # of what the model says: a deviance that is concave is taken for flat


class FilteredPoint(NamedTuple):
    """The filter's run at some coordinates and noise, and how likely they are."""

    coordinates: Coordinates
    noise: Noise
    run: FilterRun
    deviance: float  # -2 log posterior without its constant; priors, further data included

    def better_than(self, other: "FilteredPoint") -> bool:
        """Whether it is more likely; where the filter diverged, any other point is."""
        mended = np.isfinite(self.deviance) and not np.isfinite(other.deviance)
        return self.deviance < other.deviance or bool(mended)


class Slopes(NamedTuple):
    """First and second derivatives of a deviance by the free coordinates."""

    gradient: Float[np.ndarray, "free"]
    curvature: Float[np.ndarray, "free free"]

    @classmethod
    def none(cls, size: int) -> "Slopes":
        """Of a constant."""
        return cls(np.zeros(size), np.zeros((size, size)))

    def plus(self, other: "Slopes") -> "Slopes":
        """Those of a sum."""
        return Slopes(self.gradient + other.gradient, self.curvature + other.curvature)

    def promise(self, step: Float[np.ndarray, "free"]) -> float:
        """What a step would gain."""
        return -float(self.gradient @ step + 0.5 * step @ self.curvature @ step)


class Descent(NamedTuple):
    """Where a step ended, and what the next one may use."""

    point: FilteredPoint
    left_out: Slopes  # by gains held fixed, as last found
    model: Linearisation | None = None  # where the step began
    promised: float = np.inf  # what the whole step would have gained
    refused: bool = False  # whether nothing that was tried was better
    corrected: bool = False  # whether what held gains leave out was found anew for it

    @property
    def is_last(self) -> bool:
        """Whether from where it ended no step would lead on."""
        return self.refused and (self.corrected or self.promised < CORRECTED_PROMISE)


def filter_at(problem: Problem, coordinates: Coordinates, noise: Noise) -> FilteredPoint:
    """Run the filter at some coordinates and noise."""
    run = problem.run_filter(coordinates, noise)
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    value = float(deviance(run)) + float(off @ off) + float(away @ away)
    value += problem.further_cost(coordinates)
    return FilteredPoint(coordinates, noise, run, value)


def descend(
    problem: Problem, now: FilteredPoint, index: FreeIndex, left_out: Slopes, corrects: bool
) -> Descent:
    """One step of the free coordinates; none where nothing that is tried is better.

    Arguments:
        left_out: by gains held fixed; none at first.
        corrects: whether to find that anew where a step that promised something is refused.
    """
    model = linearise(problem, now.run.gains, now.coordinates, index)
    held = Slopes(model.gradient, model.curvature)
    there, promised = _along_dogleg(problem, now, index, held.plus(left_out))
    failed = not now.deviance - there.deviance > ENOUGH_OF_PROMISE * promised
    corrected = corrects and failed and promised > CORRECTED_PROMISE
    if corrected:
        found = slopes_by_differences(problem, now, index, held)
        left_out = found.plus(Slopes(-held.gradient, -held.curvature))
        again, promised = _along_dogleg(problem, now, index, found)
        there = again if again.better_than(there) else there
    return Descent(there, left_out, model, promised, there is now, corrected)


def _along_dogleg(
    problem: Problem, now: FilteredPoint, index: FreeIndex, slopes: Slopes
) -> tuple[FilteredPoint, float]:
    """The first good point on the way to the model's minimum, or the best; what that promises."""
    steps = np.asarray(dogleg_steps(slopes.gradient, slopes.curvature, np.array(STEP_SHARES)))
    promised, best = slopes.promise(steps[0]), now
    if promised < NEGLIGIBLE_PROMISE:
        return now, promised
    for step in steps:
        coordinates = now.coordinates.copy()
        coordinates[index] += step
        there = filter_at(problem, coordinates, now.noise)
        if best is not now and not there.better_than(best):
            break
        best = there if there.better_than(best) else best
        if now.deviance - best.deviance >= ENOUGH_OF_PROMISE * slopes.promise(step):
            break
    return best, promised


def slopes_by_differences(
    problem: Problem, now: FilteredPoint, index: FreeIndex, held: Slopes
) -> Slopes:
    """Slopes of the filter's own deviance: central differences along the model's principal axes.

    Its bends are those along the axes; where the filter diverges at either side, the model's are
    kept.
    """
    values, axes = np.linalg.eigh(held.curvature)
    axes = axes * np.sqrt(2 / values)  # one unit raises the model's deviance by one

    def deviance_along(axis: Float[np.ndarray, "free"]) -> float:
        coordinates = now.coordinates.copy()
        coordinates[index] += axis
        return filter_at(problem, coordinates, now.noise).deviance

    sides = np.array([DIFFERENCE * sign * axes.T for sign in (-1, 1)])
    found = on_every_core(deviance_along, sides.reshape(-1, len(index)))
    below, above = np.array(found).reshape(2, -1)
    is_known = np.isfinite(below) & np.isfinite(above)
    slope = np.where(is_known, (above - below) / (2 * DIFFERENCE), held.gradient @ axes)
    bend = np.where(is_known, (above + below - 2 * now.deviance) / DIFFERENCE**2, 2.0)
    back = np.linalg.inv(axes)
    return Slopes(slope @ back, back.T * np.maximum(bend, 2 * LEAST_BEND) @ back)
