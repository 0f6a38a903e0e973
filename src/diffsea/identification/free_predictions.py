"""Whether a model predicts the motion better than another, free of corrections on the way.

A normalised innovation says how well a model predicts one sample; gusts and sensor noise that a fit
may choose can flatter it. A free prediction knows nothing but the orders, or the measured
actuation, of what follows the state in which it starts: noise cannot help there. That state is what
the filter makes of what came before.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.stats import t

from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.covariance import Noise, gust_propagation
from diffsea.identification.holdout import Split, held_out_coordinates
from diffsea.identification.problem import Problem
from diffsea.identification.run_models import RunModel, held_out_models, is_settled
from diffsea.kinematics import wrap
from diffsea.simulation.replay import prediction_misses
from diffsea.statistics import moving_block_draws
from diffsea.trajectory import Trajectory


HORIZONS = (20.0, 60.0)  # s ahead, at which predictions must not get worse
SPACING = 5.0  # s from start to start
DRAWS = 500  # of the bootstrap
BEYOND_CHANCE = 0.99  # level of both: a cause that is true may cost a little by chance
NOTICEABLE = 1.1  # times the mean square: errors of parameters move all draws alike, unseen
PROBABLE = 0.95  # level at which they speak for a cause that one-step errors leave open
LARGEST_RATIO = 10.0  # of one prediction's loss over the usual one: more says no more


def free_errors(horizons: Sequence[Mapping[str, Any]], model: str) -> dict[str, dict[str, float]]:
    """A model's root-mean-square errors by horizon (s, as text) and quantity (m, rad, m/s, rad/s).

    Arguments:
        horizons: a row for each horizon, with `seconds` and the errors of each model, as
            diagnosis.json and fit.json have them.
    """
    return {f"{row['seconds']:g}": dict(row[model]) for row in horizons if row.get(model)}


class ChanceOfLoss(NamedTuple):
    """Probability that the mean gain is negative, in two ways of which the more doubtful counts."""

    bootstrap: float  # in moving blocks
    student: float  # by Student's t of block means: few blocks scatter less than they err

    @classmethod
    def of(
        cls,
        gain: Float[np.ndarray, "start"],
        run: Int[np.ndarray, "start"],
        length: int,
        rng: np.random.Generator,
    ) -> "ChanceOfLoss":
        """From the gains of successive starts and the number of each one's run.

        Blocks have `length` starts. Student's is one half where blocks are too few or alike.
        """
        drawn = moving_block_draws(gain, run, length, DRAWS, rng)
        blocks = [part.mean() for k in np.unique(run) for part in _blocks(gain[run == k], length)]
        error = np.std(blocks, ddof=1) / np.sqrt(len(blocks)) if len(blocks) > 1 else 0.0
        known = error > 0 and np.isfinite(error)
        student = t.sf(np.mean(blocks) / error, len(blocks) - 1) if known else 0.5
        return cls(float(np.mean(drawn < 0)), float(student))


@dataclasses.dataclass(frozen=True)
class MotionChange:
    """How free predictions of held-out runs change from one model to another.

    Attributes:
        ratio: by horizon (s), mean square error of the second over that of the first.
        worse: by horizon (s), probability that the second is the worse one.
    """

    ratio: dict[float, float]
    worse: dict[float, ChanceOfLoss]

    @property
    def is_worse(self) -> bool:
        """Whether predictions get worse beyond chance, and noticeably, at any horizon."""
        return any(
            min(both) > BEYOND_CHANCE and self.ratio[horizon] > NOTICEABLE
            for horizon, both in self.worse.items()
        )

    @property
    def is_better(self) -> bool:
        """Whether they get better beyond chance at some horizon, and worse at none."""
        return self._is_below(1 - BEYOND_CHANCE) and not self.is_worse

    @property
    def is_probably_better(self) -> bool:
        """Whether they probably get better at some horizon (19 to 1), and so worse at none."""
        return self._is_below(1 - PROBABLE) and not self._is_beyond(PROBABLE)

    @property
    def is_noticeably_better(self) -> bool:
        """Whether they get better beyond chance, and noticeably, at one horizon, and worse at none.

        Probably worse at none: several are compared, and one is soon better by chance.
        """
        noticeable = any(
            max(both) < 1 - BEYOND_CHANCE and self.ratio[horizon] < 1 / NOTICEABLE
            for horizon, both in self.worse.items()
        )
        return noticeable and not self._is_beyond(PROBABLE)

    def holds_by(self, more: "MotionChange") -> bool:
        """Whether what gets better here beyond chance probably does by more runs, too (19 to 1).

        At the same horizon.
        """
        surely, probably = 1 - BEYOND_CHANCE, 1 - PROBABLE
        both = {*self.worse} & {*more.worse}
        return any(max(self.worse[h]) < surely and max(more.worse[h]) < probably for h in both)

    def _is_beyond(self, level: float) -> bool:
        return any(min(both) > level for both in self.worse.values())

    def _is_below(self, level: float) -> bool:
        return any(max(both) < level for both in self.worse.values())

    @classmethod
    def of(cls, losses: "LossesByHorizon", seed: int = 0) -> "MotionChange":
        """From the losses of both models, resampled in blocks as long as the horizon.

        Predictions that overlap go together.
        """
        rng = np.random.default_rng(seed)
        ratio, worse = {}, {}
        for horizon, (old, new, run) in losses.items():
            length = max(1, int(np.ceil(horizon / SPACING)))
            gain = np.clip(old, None, LARGEST_RATIO) - np.clip(new, None, LARGEST_RATIO)
            ratio[horizon] = float(new.mean() / old.mean())
            worse[horizon] = ChanceOfLoss.of(gain, run, length, rng)
        return cls(ratio, worse)


def motion_change(split: Split, before: Estimate, after: Estimate) -> MotionChange:
    """Compare free predictions of the held-out runs by two models.

    The loss of a prediction is the mean of its squared misses of position and heading (of the
    speeds where neither was measured), each over its mean square by the model `before`.
    """
    return MotionChange.of(relative_losses(split, before, after))


def _blocks(values: Float[np.ndarray, "start"], length: int) -> list[np.ndarray]:
    """Values in whole blocks that follow one another; a run shorter than one is a block."""
    return np.array_split(values, max(1, len(values) // length))


class PredictionLosses(NamedTuple):
    """Losses of predictions by two models, and the number of each start's run."""

    before: Float[np.ndarray, "start"]
    after: Float[np.ndarray, "start"]
    run: Int[np.ndarray, "start"]

    def beside(self, other: "PredictionLosses") -> "PredictionLosses":
        """These and those of other runs."""
        runs = int(self.run.max(initial=-1)) + 1
        columns = zip(self, other._replace(run=other.run + runs), strict=True)
        return PredictionLosses(*(np.concatenate(pair) for pair in columns))


LossesByHorizon = dict[float, PredictionLosses]  # by seconds ahead


def pooled_losses(some: LossesByHorizon, others: LossesByHorizon) -> LossesByHorizon:
    """Losses in two groups of runs together."""
    both = set(some) & set(others)
    return some | others | {horizon: some[horizon].beside(others[horizon]) for horizon in both}


def relative_losses(split: Split, before: Estimate, after: Estimate) -> LossesByHorizon:
    """Losses by horizon (s), relative to the mean squares of the first model.

    Infinite where the second diverges; predictions by which the first does are left out. So are
    those that end where only one of them has a sample: a late sensor shows the last rows of a run
    after its end. Horizons longer than every run are absent.
    """
    squares: dict[float, tuple[list[np.ndarray], ...]] = {}
    models = [held_out_models(split, model) for model in (before, after)]
    for number, run in enumerate(split.held_out):
        own, other = (_squared_misses(some[number], run) for some in models)
        for horizon, misses in own.items():
            columns = misses, other[horizon], np.full(len(misses), number)
            for column, kept in zip(
                columns, squares.setdefault(horizon, ([], [], [])), strict=True
            ):
                kept.append(column)
    found = {}
    for horizon, columns in squares.items():
        old, new, run = (np.concatenate(column) for column in columns)
        usual = [
            np.mean(one[np.isfinite(one)]) if np.isfinite(one).any() else np.nan for one in old.T
        ]
        counted = [k for k in (0, 1) if np.isfinite(usual[k])] or [
            k for k in (2, 3, 4) if np.isfinite(usual[k])
        ]
        rows = (np.isfinite(old) & ~np.isnan(new))[:, counted].all(1)
        if counted and rows.any():
            scale = np.array(usual)[counted]
            first, second = ((one[rows][:, counted] / scale).mean(1) for one in (old, new))
            found[horizon] = PredictionLosses(first, second, run[rows])
    return found


def _squared_misses(
    model: RunModel, run: Trajectory
) -> dict[float, Float[np.ndarray, "start quantity"]]:
    """Squared misses of position, heading, u, v and r by horizon.

    NaN where not measured, infinite where the vessel diverged.
    """
    found = {}
    predicted = prediction_misses(model.vessel, run, HORIZONS, SPACING, states=model.states)
    for horizon, misses in predicted.items():
        position = misses["x"] ** 2 + misses["y"] ** 2
        turned = misses["psi"]
        heading = np.where(np.isinf(turned), np.inf, wrap(turned)) ** 2
        speeds = [misses[name] ** 2 for name in ("u", "v", "r")]
        found[horizon] = np.stack([position, heading, *speeds], axis=1)
    return found


@dataclasses.dataclass(frozen=True)
class MotionMisfit:
    """Free predictions of held-out runs beside what noise explains, so many seconds ahead.

    Attributes:
        ratio: mean square miss of position and heading over the expected one, by horizon (s).
        blocks: predictions that share nothing, by horizon (s).
    """

    ratio: dict[float, float]
    blocks: dict[float, int]


def motion_misfit(split: Split, fitted: Estimate) -> MotionMisfit:
    """Mean square misses of free predictions over what gusts and sensor noise explain.

    Gusts count, and are remembered, as far as is plausible for the vessel's size: a fit has bounds
    for them.
    """
    coordinates, models = held_out_coordinates(split, fitted), held_out_models(split, fitted)
    squares: dict[float, list[np.ndarray]] = {}
    for run, model in zip(split.held_out, models, strict=True):
        for horizon, misses in _squared_misses(model, run).items():
            squares.setdefault(horizon, []).append(misses[:, :2])
    ratio, blocks = {}, {}
    for horizon, found in squares.items():
        expected = expected_squares(split.test, coordinates, fitted.noise, horizon)
        columns = np.concatenate(found).T
        measured = [k for k, column in enumerate(columns) if not np.isnan(column).all()]
        if measured and np.isfinite(expected).all():
            ratios = [float(np.nanmean(columns[k])) / expected[k] for k in measured]
            ratio[horizon] = float(np.mean(ratios))
            spans = [float(run.t[-1] - run.t[0]) for run in split.held_out]
            blocks[horizon] = sum(int(span // horizon) for span in spans)
    return MotionMisfit(ratio, blocks)


def expected_squares(
    problem: Problem, coordinates: Float[np.ndarray, "coordinate"], noise: Noise, horizon: float
) -> Float[np.ndarray, "2"]:
    """Mean squares of position (m^2) and heading (rad^2) missed by `horizon` s of free prediction.

    The covariance that gusts add along the linearised motion from where it starts, seen by the
    sensors once more at the end; mean over starts along the data once the filter has settled, NaN
    where there is none. It starts in a state measured by its sensors, or filtered where velocities
    were not recorded: a filter of exact parameters knows it better, and theirs are not counted.
    """
    run = problem.run_filter(coordinates, noise)
    F, data = np.asarray(run.F), problem.dataset
    gusts, Q = (jax.tree.map(np.asarray, part) for part in gust_propagation(noise, data.dt))
    half = np.einsum("ri,ij->rij", gusts.half, np.eye(3))
    A = np.zeros((len(F), 9, 9))
    A[:, :6, :6] = F
    A[:, :6, 6:] = F[:, :, 3:] @ half
    A[:, 3:6, 6:] += half
    A[:, 6:, 6:] = np.einsum("ri,ij->rij", gusts.decay, np.eye(3))
    starts, ends = _spans_of_rows(problem, horizon)
    sensor, slow = np.exp(2 * np.asarray(noise.sensor)), np.exp(2 * np.asarray(noise.slow))
    measured = np.diag(np.concatenate([sensor, slow]))
    covariance, counts = np.asarray(run.covariance).copy(), np.ones(len(F), bool)
    for rows in filter(len, data.rows_of_runs):
        if np.asarray(data.known)[rows, 3:5].any(0).all():
            covariance[rows] = measured
        else:
            counts[rows] = is_settled(covariance[rows])
    starts, ends = starts[counts[starts]], ends[counts[starts]]
    if not len(starts):
        return np.full(2, np.nan)
    P = covariance[starts]
    for step in range(int((ends - starts).max(initial=0))):
        going = starts + step < ends
        rows = (starts + step)[going]
        P[going] = A[rows] @ P[going] @ A[rows].mT + Q[rows]
    variance = np.diagonal(P, axis1=1, axis2=2) + np.append(sensor, np.zeros(3))
    return np.array([variance[:, :2].sum(1).mean(), variance[:, 2].mean()])


def _spans_of_rows(
    problem: Problem, horizon: float
) -> tuple[Int[np.ndarray, "start"], Int[np.ndarray, "start"]]:
    """First rows and last rows of stretches of `horizon` s within runs, every `SPACING` s."""
    times, run = np.asarray(problem.dataset.run_time), np.asarray(problem.dataset.run)
    starts, ends = [], []
    recorded = problem.dataset.recorded_rows
    for number in np.unique(run[recorded]):
        rows = np.flatnonzero((run == number) & recorded)
        first, last = float(times[rows[0]]), float(times[rows[-1]])
        wanted = np.arange(first, last - horizon, SPACING)
        starts.append(rows[np.searchsorted(times[rows], wanted)])
        ends.append(rows[np.searchsorted(times[rows], wanted + horizon).clip(max=len(rows) - 1)])
    return np.concatenate(starts), np.concatenate(ends)
