"""One step of a fit downhill: where it stands, and where the deviance of the filter is lower.

The direction is Gauss and Newton's with the gains of the filter held fixed. Data that leave some
parameters nearly undetermined make a valley that is narrow and bent: along its tangent no step
leads far. Steps therefore follow a parabola, whose bow the filter tells on both sides of where it
stands (geodesic acceleration; Transtrum and Sethna 2012, arXiv:1201.5885). What held gains leave
out of the slope is found by differences where such a step leads nowhere, and serves the steps that
follow. It vanishes where the model is right; where something is missing from it, the slope of held
gains may be none where the deviance still falls.
"""

import enum
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from diffsea.budget import on_every_core
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun, deviance
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.identification.residual import Linearisation, linearise


STEP_SHARES = (1.0, 1 / 2, 1 / 4, 1 / 16, 1 / 64, 1 / 256)  # of a step, tried one after the other
BOW_SHARE = 0.1  # of a step, to both sides, over which the bow of its path is found
SHORT_SHARE = 1 / 16  # of a step: where the parabola leads no further, the bow may be wrong
ENOUGH_OF_PROMISE = 0.25  # of what the model promised: a step that gains so much is taken
NEGLIGIBLE_PROMISE = 1e-3  # of -2 log posterior: a thirtieth of a standard error
CORRECTED_PROMISE = 0.05  # that was not kept: from it on the slope is found by differences
ROUNDING = 1e-13  # of the largest curvature: a smaller one may be negative
DIFFERENCE = 0.05  # standard errors to both sides, by which slopes are found: valleys are bent


class Correction(enum.Enum):
    """When what held gains leave out of the slope is found anew."""

    NEVER = enum.auto()
    WHERE_REFUSED = enum.auto()  # a step that promised something
    AT_ONCE = enum.auto()  # before a fit ends: a slope that is none may be one


class FilteredPoint(NamedTuple):
    """The filter's run at some coordinates and noise, and how likely they are."""

    coordinates: Coordinates
    noise: Noise
    run: FilterRun
    residual: Float[np.ndarray, "value"]  # rows of `Linearisation`: innovations, prior, further
    deviance: float  # -2 log posterior without its constant; priors, further data included

    def better_than(self, other: "FilteredPoint") -> bool:
        """Whether it is more likely; where the filter diverged, any other point is."""
        mended = np.isfinite(self.deviance) and not np.isfinite(other.deviance)
        return self.deviance < other.deviance or bool(mended)


class Descent(NamedTuple):
    """Where a step ended, and what the next one may use."""

    point: FilteredPoint
    left_out: Float[np.ndarray, "free"]  # of the gradient by gains held fixed, as last found
    model: Linearisation | None = None  # where the step began
    promised: float = np.inf  # what the whole step would have gained
    refused: bool = False  # whether nothing that was tried was better
    corrected: bool = False  # whether what held gains leave out was found anew for it

    @property
    def is_last(self) -> bool:
        """Whether from where it ended no step would lead on."""
        return self.refused and self.corrected


def filter_at(
    problem: Problem,
    coordinates: Coordinates,
    noise: Noise,
    placement: SamplePlacement | None = None,
) -> FilteredPoint:
    """Run the filter at some coordinates and noise, with samples placed as late as they are there.

    Arguments:
        placement: of the samples instead of that.
    """
    run = problem.run_filter(coordinates, noise, placement=placement)
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    layout = problem.layout
    away = np.asarray(layout.strains(coordinates, layout.spreads()))
    further = problem.further_misfits(coordinates)
    value = float(deviance(run)) + float(off @ off) + float(away @ away) + float(further @ further)
    residual = np.concatenate([np.asarray(run.white).ravel(), away, further])
    return FilteredPoint(coordinates, noise, run, residual, value)


def descend(
    problem: Problem,
    now: FilteredPoint,
    index: FreeIndex,
    left_out: Float[np.ndarray, "free"],
    corrects: Correction,
    least: float = NEGLIGIBLE_PROMISE,
) -> Descent:
    """One step of the free coordinates; none where nothing that is tried is better.

    Where samples fall in other rows when a latency changes, the deviance jumps. A fit may end at
    such a jump: a latency that no step leads across stays, and the others go on.

    Arguments:
        left_out: of the gradient by gains held fixed; zeros at first.
        corrects: when to find that anew.
        least: of -2 log posterior: where less is promised, no way but the straight one is tried.
    """
    model = linearise(problem, now.run.gains, now.coordinates, index)
    there, promised, failed = now, np.inf, corrects is Correction.AT_ONCE
    if not failed:
        gradient = model.gradient + left_out
        there, promised = _along_parabola(problem, now, index, model, gradient, least)
        failed = not now.deviance - there.deviance > ENOUGH_OF_PROMISE * promised
    corrected = corrects is not Correction.NEVER and failed and promised > CORRECTED_PROMISE
    if corrected:
        gradient = gradient_by_differences(problem, now, index, model)
        left_out = gradient - model.gradient
        again, promised = _along_parabola(problem, now, index, model, gradient, least)
        there = again if again.better_than(there) else there
    if there is now and promised >= least:
        gradient = model.gradient + left_out
        kept = ~_at_jumps(problem, now, index, -np.linalg.solve(model.curvature, gradient))
        if not kept.all():
            part = Linearisation(model.residual, model.jacobian[:, kept])
            there, promised = _along_parabola(
                problem, now, index[kept], part, gradient[kept], least
            )
    return Descent(there, left_out, model, promised, there is now, corrected)


def _at_jumps(
    problem: Problem, now: FilteredPoint, index: FreeIndex, step: Float[np.ndarray, "free"]
) -> Bool[np.ndarray, "free"]:
    """Which coordinates the smallest share of a step takes where samples fall in other rows."""
    here, found = np.asarray(now.run.gains.placement.source), np.zeros(len(index), bool)
    for place, one in enumerate(index):
        coordinates = now.coordinates.copy()
        coordinates[one] += STEP_SHARES[-1] * step[place]
        found[place] = (np.asarray(problem.placement(coordinates).source) != here).any()
    return found


def _along_parabola(
    problem: Problem,
    now: FilteredPoint,
    index: FreeIndex,
    model: Linearisation,
    gradient: Float[np.ndarray, "free"],
    least: float = NEGLIGIBLE_PROMISE,
) -> tuple[FilteredPoint, float]:
    """The first good point on the way to the model's minimum, or the best; what that promises.

    The way is the parabola along which the residual's second derivative vanishes, as far as the
    model can tell (by the gains of each place; held ones lead to the same ends). A kink, or a
    side on which the filter diverges, may bend it wrongly: where it leads not far, the straight
    line is tried as well.
    """
    step = -np.linalg.solve(model.curvature, gradient)
    promised = -0.5 * float(gradient @ step)
    if promised < NEGLIGIBLE_PROMISE:
        return now, promised

    def at(
        change: Float[np.ndarray, "free"], placement: SamplePlacement | None = None
    ) -> FilteredPoint:
        coordinates = now.coordinates.copy()
        coordinates[index] += change
        return filter_at(problem, coordinates, now.noise, placement)

    def beside(change: Float[np.ndarray, "free"]) -> FilteredPoint:
        return at(change, now.run.gains.placement)

    if promised < least:
        whole = at(step)
        return whole if whole.better_than(now) else now, promised
    above, below = on_every_core(beside, [BOW_SHARE * step, -BOW_SHARE * step])
    bend = (above.residual + below.residual - 2 * now.residual) / BOW_SHARE**2
    bow = -np.linalg.solve(model.curvature, 2 * model.jacobian.T @ bend)
    best, straight = now, np.zeros(len(step))
    for path in (bow, straight):
        found, share = _walk(at, now, step, path, promised)
        best = found if found.better_than(best) else best
        if share > SHORT_SHARE:
            break
    return best, promised


def _walk(
    at: Callable[[Float[np.ndarray, "free"]], FilteredPoint],
    now: FilteredPoint,
    step: Float[np.ndarray, "free"],
    bow: Float[np.ndarray, "free"],
    promised: float,
) -> tuple[FilteredPoint, float]:
    """The first good point on a way, or the best, and the share of the step that leads there."""
    best, reached = now, 0.0
    for share in STEP_SHARES:
        point = at(share * step + 0.5 * share**2 * bow)
        if best is not now and not point.better_than(best):
            break
        best, reached = (point, share) if point.better_than(best) else (best, reached)
        if now.deviance - best.deviance >= ENOUGH_OF_PROMISE * share * (2 - share) * promised:
            break
    return best, reached


def gradient_by_differences(
    problem: Problem, now: FilteredPoint, index: FreeIndex, model: Linearisation
) -> Float[np.ndarray, "free"]:
    """Gradient of the filter's own deviance: central differences along the model's principal axes.

    Where the filter diverges at either side of an axis, the model's slope is kept.
    """
    values, axes = np.linalg.eigh(model.curvature)
    values = np.maximum(values, ROUNDING * values[-1])
    axes = axes * np.sqrt(2 / values)  # one unit raises the model's deviance by one

    def deviance_along(axis: Float[np.ndarray, "free"]) -> float:
        coordinates = now.coordinates.copy()
        coordinates[index] += axis
        return filter_at(problem, coordinates, now.noise, now.run.gains.placement).deviance

    sides = np.concatenate([DIFFERENCE * axes.T, -DIFFERENCE * axes.T])
    above, below = np.array(on_every_core(deviance_along, sides)).reshape(2, -1)
    slope = (above - below) / (2 * DIFFERENCE)
    return np.where(np.isfinite(slope), slope, model.gradient @ axes) @ np.linalg.inv(axes)
