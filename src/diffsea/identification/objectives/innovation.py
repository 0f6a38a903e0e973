"""The innovation likelihood as an objective: the default for recordings."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from diffsea.budget import on_every_core
from diffsea.identification.descent import filter_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.correlated_errors import independent_sampling, thin_channels
from diffsea.identification.fit import Start, estimate, estimate_surely
from diffsea.identification.objectives.base import AbstractObjective, Costs, Starts
from diffsea.identification.problem import Coordinates, Names, Problem
from diffsea.progress import Progress, no_progress
from diffsea.series import stretches
from diffsea.trajectory import MOTION_CHANNELS


GATE = 6.0  # standard deviations beyond which a lone sample is an outlier
LONGEST_OUTLIER = 3  # samples in a row that may be outliers; more of them are a mismatch
OUTLIER_SHARE = 0.02  # share of a channel's samples likewise
OUTLIER_ROUNDS = 4  # of leaving out outliers and fitting again
EXPLORING_ROUNDS = 6  # of exploration


class Innovations(AbstractObjective):
    """The innovation likelihood of recordings, lone outliers left out.

    Of channels whose errors follow one another only samples count that err anew.
    """

    def __init__(self, problem: Problem, keeps_samples: bool = False):
        """Set up; `problem` loses the samples that fits leave out, unless it `keeps_samples`."""
        self.problem: Problem = problem
        self.keeps_samples = keeps_samples
        self.base, self.parameters = problem.base, problem.layout.parameters
        self.effects = problem.layout.effects
        self.outliers, self.one_sample_in = {}, {}

    def fit(
        self, free: Names, start: Coordinates | None = None, progress: Progress = no_progress
    ) -> Estimate:
        """Fit; where lone samples are impossible under the fit, leave them out and go on.

        How seldom a channel errs anew is found in the first fit. Neither where samples are kept.
        """
        if self.keeps_samples:
            begin = None if start is None else Start(start)
            return estimate_surely(self.problem, free, begin, progress)
        fitted = self._without_outliers(free, start, progress)
        if self.one_sample_in:
            return fitted
        run = fitted.filter_run(self.problem)
        length = float(self.problem.base.rigid_body.length)
        self.one_sample_in = independent_sampling(run, self.problem.dataset, length)
        if not self.one_sample_in:
            return fitted
        often = ", ".join(f"{name} every {number}" for name, number in self.one_sample_in.items())
        progress(f"neighbouring samples err alike; used are of {often}")
        dataset = thin_channels(self.problem.dataset, self.one_sample_in)
        self.problem = dataclasses.replace(self.problem, dataset=dataset)
        return estimate(self.problem, free, Start.of_other_data(fitted), progress=progress)

    def _without_outliers(
        self, free: Names, start: Coordinates | None, progress: Progress
    ) -> Estimate:
        """A fit, and the problem without the lone samples that are impossible under it."""
        begin = None if start is None else Start(start)
        fitted = estimate(self.problem, free, begin, progress=progress)
        for _ in range(OUTLIER_ROUNDS):
            lone = self._lone_outliers(fitted)
            if not lone.any():
                break
            dataset = self.problem.dataset
            dataset = eqx.tree_at(lambda d: d.known, dataset, dataset.known & ~jnp.asarray(lone))
            self.problem = dataclasses.replace(self.problem, dataset=dataset)
            for name, count in zip(MOTION_CHANNELS, lone.sum(0), strict=True):
                if count:
                    self.outliers[name] = self.outliers.get(name, 0) + int(count)
            progress(f"{int(lone.sum())} outliers left out")
            fitted = estimate(self.problem, free, Start.at(fitted), progress=progress)
        return fitted

    def refit(self, fitted: Estimate, free: Names, start: Coordinates) -> Estimate:
        """Fit with the noise of an earlier fit."""
        return estimate(self.problem, free, Start.beside(fitted, start), fixed_noise=True)

    def cost(self, coordinates: Coordinates, fitted: Estimate) -> float:
        """-2 log posterior with the noise of a fit."""
        return filter_at(self.problem, coordinates, fitted.noise).deviance

    def squares(self, fitted: Estimate) -> tuple[float, int]:
        """Sum of squared innovations over their standard deviations, and how many there are."""
        run = fitted.filter_run(self.problem)
        return float((np.asarray(run.white) ** 2).sum()), int(np.asarray(run.gains.used).sum())

    def explore(self, starts: Starts, free: Names) -> tuple[Starts, Costs]:
        """A few steps from every start, the noise as expected beforehand."""
        problem = self.problem
        _, noise = problem.start()

        def one(start: Coordinates) -> tuple[Coordinates, float]:
            begin = Start(start, noise)
            end = estimate(problem, free, begin, rounds=EXPLORING_ROUNDS, fixed_noise=True)
            return end.coordinates, end.deviance

        ends, costs = zip(*on_every_core(one, starts), strict=True)
        return np.array(ends), np.array(costs)

    def _lone_outliers(self, fitted: Estimate) -> Bool[np.ndarray, "row 6"]:
        """Samples that a gated filter rejects, unless they are many, in a row or in all."""
        gains = self.problem.run_filter(fitted.coordinates, fitted.noise, GATE).gains
        known = np.asarray(self.problem.dataset.known)
        refused = np.asarray(gains.placement.is_sampled & ~gains.used)
        rejected, source = np.zeros_like(known), np.asarray(gains.placement.source)
        for k in range(6):
            rejected[source[refused[:, k], k], k] = True
        for k in range(6):
            rows = np.flatnonzero(known[:, k])
            for stretch in stretches(rejected[rows, k]):
                if stretch.stop - stretch.start > LONGEST_OUTLIER:
                    rejected[rows[stretch], k] = False
            if rejected[:, k].sum() > OUTLIER_SHARE * len(rows):
                rejected[:, k] = False
        return rejected
