"""What a fit can aim at: one interface, three objectives.

`Innovations` predicts each sample from those before it, gusts and sensor noise estimated; the
default, efficient and with honest errors. `free_run.FreeRun` predicts whole runs from their
first state. `trial_numbers.TrialNumbers` fits advance, diameters and overshoots of a sheet.
"""

import dataclasses
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.coordinates import negative_effects
from diffsea.identification.estimates import Estimate, Progress, no_progress
from diffsea.identification.filter import kalman
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.fit import estimate, negative_log_posterior
from diffsea.identification.problem import Inputs, Problem, Static, minimised, selection, traced
from diffsea.parameters import Parameter
from diffsea.trajectory import MOTION_CHANNELS


Starts = Float[np.ndarray, "start coordinate"]


class AbstractObjective(Protocol):
    """Something that data say about the parameters of a vessel."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that coordinates belong to, in order."""
        ...

    def fit(
        self,
        free: tuple[str, ...],
        start: np.ndarray | None = None,
        progress: Progress = no_progress,
    ) -> Estimate:
        """Fit the free parameters by name, from coordinates `start` or the prior mean."""
        ...

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: np.ndarray) -> Estimate:
        """Fit again with the noise or weights of an earlier fit."""
        ...

    def explore(
        self, starts: Float[np.ndarray, "start coordinate"], free: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where a few steps lead from several starts at once, and the costs there.

        Infinite where the steps lead to what cannot be.
        """
        ...


GATE = 6.0  # standard deviations beyond which a lone sample is an outlier
LONE = 3  # samples in a row that may be outliers; more of them are a mismatch
MOST = 0.02  # share of a channel's samples likewise
PASSES = 3  # of exploration: filter run anew in each


class Innovations:
    """The innovation likelihood of recordings, lone outliers left out."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.outliers: dict[str, int] = {}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The vessel's parameters."""
        return self.problem.layout.parameters

    def fit(
        self,
        free: tuple[str, ...],
        start: np.ndarray | None = None,
        progress: Progress = no_progress,
    ) -> Estimate:
        """Fit; where lone samples are impossible under the fit, leave them out and go on."""
        fitted = estimate(self.problem, free, start, progress=progress)
        for _ in range(4):
            lone = self._lone(fitted)
            if not lone.any():
                break
            self._leave_out(lone)
            progress(f"{int(lone.sum())} outliers left out")
            fitted = estimate(
                self.problem, free, fitted.coordinates, fitted.noise, progress=progress
            )
        return fitted

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: np.ndarray) -> Estimate:
        """Fit with the noise of an earlier fit."""
        return estimate(self.problem, free, start, fitted.noise, fixed_noise=True)

    def cost(self, coordinates: np.ndarray, fitted: Estimate) -> float:
        """-2 log posterior with the noise of a fit."""
        return negative_log_posterior(self.problem, coordinates, fitted.noise)

    def explore(
        self, starts: Float[np.ndarray, "start coordinate"], free: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton from all starts together, the noise as expected beforehand."""
        _, matrix = selection(self.problem.layout, free, self.problem.width)
        _, noise = self.problem.start()
        gains = self.problem.run_filter(starts[0], noise).gains
        inputs, layout = traced(self.problem, gains, starts[0], matrix)
        ends = jnp.asarray(starts)
        for _ in range(PASSES):
            ends = _explored(inputs, layout, noise, ends)
        ends = np.asarray(ends)
        costs = [
            np.inf
            if negative_effects(self.problem.layout, end)
            else negative_log_posterior(self.problem, end, noise)
            for end in ends
        ]
        return ends, np.array(costs)

    def _lone(self, fitted: Estimate) -> Bool[np.ndarray, "row 6"]:
        """Samples that a gated filter rejects, unless they are many, in a row or in all."""
        problem = self.problem
        run = _gated(
            problem.base, Static(problem.layout), problem.dataset, fitted.noise,
            jnp.asarray(fitted.coordinates),
        )  # fmt: skip
        known = np.asarray(problem.dataset.known)
        rejected = known & ~np.asarray(run)
        for k in range(6):
            rows = np.flatnonzero(known[:, k])
            bad = rejected[rows, k]
            edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                if end - begin > LONE:
                    rejected[rows[begin:end], k] = False
            if rejected[:, k].sum() > MOST * len(rows):
                rejected[:, k] = False
        return rejected

    def _leave_out(self, lone: Bool[np.ndarray, "row 6"]) -> None:
        dataset = self.problem.dataset
        dataset = eqx.tree_at(lambda t: t.known, dataset, dataset.known & ~jnp.asarray(lone))
        self.problem = dataclasses.replace(self.problem, dataset=dataset)
        for name, count in zip(MOTION_CHANNELS, lone.sum(0), strict=True):
            if count:
                self.outliers[name] = self.outliers.get(name, 0) + int(count)


@eqx.filter_jit
def _gated(problem_base, layout: Static, dataset, noise: Noise, coordinates: Array) -> Array:
    return kalman.run_filter(
        problem_base, layout.value, dataset, noise, coordinates, GATE
    ).gains.used


@eqx.filter_jit
def _explored(inputs: Inputs, layout: Static, noise: Noise, starts: Array) -> Array:
    """One pass from every start: the filter run there, then Gauss-Newton steps."""

    def one(start: Array) -> Array:
        run = kalman.run_filter(inputs.base, layout.value, inputs.dataset, noise, start)
        there = eqx.tree_at(lambda i: i.gains, inputs, run.gains)
        width = inputs.selection.shape[1]
        begin = jnp.append(inputs.selection.T @ start, jnp.zeros(inputs.owner.size - width))
        free = minimised(there, layout, begin)[0]
        end = inputs.fixed + inputs.selection @ free[:width]
        return jnp.where(jnp.all(jnp.isfinite(end)), end, start)

    return jax.vmap(one)(starts)
