"""The innovation likelihood as an objective: the default for recordings."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.coordinates import CoordinateLayout, negative_effects
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.estimates import Estimate, Progress, no_progress
from diffsea.identification.filter import kalman
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.fit import estimate, posterior_deviance
from diffsea.identification.objectives.base import AbstractObjective, Starts
from diffsea.identification.problem import Coordinates, Problem
from diffsea.identification.residual import ResidualInputs, gauss_newton, residual_inputs
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.base import Vessel


GATE = 6.0  # standard deviations beyond which a lone sample is an outlier
LONGEST_OUTLIER = 3  # samples in a row that may be outliers; more of them are a mismatch
OUTLIER_SHARE = 0.02  # share of a channel's samples likewise
OUTLIER_ROUNDS = 4  # of leaving out outliers and fitting again
EXPLORING_PASSES = 3  # of exploration: the filter is run anew in each


class Innovations(AbstractObjective):
    """The innovation likelihood of recordings, lone outliers left out."""

    def __init__(self, problem: Problem):
        """Set up; `problem` loses the outliers that fits find."""
        self.problem: Problem = problem
        self.parameters = problem.layout.parameters
        self.outliers = {}

    def fit(
        self,
        free: tuple[str, ...],
        start: Coordinates | None = None,
        progress: Progress = no_progress,
    ) -> Estimate:
        """Fit; where lone samples are impossible under the fit, leave them out and go on."""
        fitted = estimate(self.problem, free, start, progress=progress)
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
            fitted = estimate(
                self.problem, free, fitted.coordinates, fitted.noise, progress=progress
            )
        return fitted

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: Coordinates) -> Estimate:
        """Fit with the noise of an earlier fit."""
        return estimate(self.problem, free, start, fitted.noise, fixed_noise=True)

    def cost(self, coordinates: Coordinates, fitted: Estimate) -> float:
        """-2 log posterior with the noise of a fit."""
        return posterior_deviance(self.problem, coordinates, fitted.noise)

    def explore(
        self, starts: Starts, free: tuple[str, ...]
    ) -> tuple[Starts, Float[np.ndarray, "start"]]:
        """Gauss-Newton from all starts together, the noise as expected beforehand."""
        problem = self.problem
        _, noise = problem.start()
        gains = problem.run_filter(starts[0], noise).gains
        inputs = residual_inputs(problem, gains, starts[0], problem.layout.indices(free))
        ends = jnp.asarray(starts)
        for _ in range(EXPLORING_PASSES):
            ends = _explore_once(inputs, noise, ends)
        ends = np.asarray(ends)
        costs = [
            np.inf
            if negative_effects(problem.layout, end)
            else posterior_deviance(problem, end, noise)
            for end in ends
        ]
        return ends, np.array(costs)

    def _lone_outliers(self, fitted: Estimate) -> Bool[np.ndarray, "row 6"]:
        """Samples that a gated filter rejects, unless they are many, in a row or in all."""
        problem = self.problem
        used = _used_by_gated_filter(
            problem.base,
            problem.layout,
            problem.dataset,
            fitted.noise,
            jnp.asarray(fitted.coordinates),
        )
        known = np.asarray(problem.dataset.known)
        rejected = known & ~np.asarray(used)
        for k in range(6):
            rows = np.flatnonzero(known[:, k])
            bad = rejected[rows, k]
            edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                if end - begin > LONGEST_OUTLIER:
                    rejected[rows[begin:end], k] = False
            if rejected[:, k].sum() > OUTLIER_SHARE * len(rows):
                rejected[:, k] = False
        return rejected


@eqx.filter_jit
def _used_by_gated_filter(
    base: Vessel, layout: CoordinateLayout, dataset: Dataset, noise: Noise, coordinates: Array
) -> Bool[Array, "row 6"]:
    return kalman.run_filter(base, layout, dataset, noise, coordinates, GATE).gains.used


@eqx.filter_jit
def _explore_once(inputs: ResidualInputs, noise: Noise, starts: Array) -> Array:
    """One pass from every start: the filter run there, then Gauss-Newton steps."""

    def one(start: Array) -> Array:
        run = kalman.run_filter(inputs.base, inputs.layout, inputs.dataset, noise, start)
        there = eqx.tree_at(lambda i: i.gains, inputs, run.gains)
        width = inputs.selection.shape[1]
        pulses = jnp.zeros(inputs.colouring.owner.size - width)
        free = gauss_newton(there, jnp.append(inputs.selection.T @ start, pulses)).at
        end = inputs.coordinates(free)
        return jnp.where(jnp.all(jnp.isfinite(end)), end, start)

    return jax.vmap(one)(starts)
