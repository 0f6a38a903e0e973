"""Recordings as a fitted model with its fitted gusts and noise would have made them."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.batching import batched_scan
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.kalman import filter_rows, propagate, restart, with_impulse
from diffsea.identification.filter.latency import (
    StateHistory,
    align_to_order_clock,
    shown_measurements,
)
from diffsea.identification.filter.process_noise import Noise, gust_propagation
from diffsea.identification.problem import Problem, Static
from diffsea.vessel.base import Vessel


def resimulate(problem: Problem, fitted: Estimate, rng: np.random.Generator) -> Problem:
    """The same problem with other measurements, drawn from the estimate.

    Inputs, times, gaps and first guesses are those of the recordings. Each run starts where the
    filter found it, lasting gusts with their stationary spread. A run that diverges has
    measurements that are not finite.
    """
    dataset = problem.dataset
    run = problem.run_filter(fitted.coordinates, fitted.noise)
    starts = np.asarray(dataset.starts)
    first = np.asarray(run.state)[starts][np.cumsum(starts) - 1]
    scale = np.exp(np.asarray(fitted.noise.sensor))
    error = scale * rng.standard_normal((len(starts), 6))
    begin = np.exp(np.asarray(fitted.noise.slow)) * rng.standard_normal((len(starts), 3))
    measured = _measured(
        problem.base, Static(problem.layout), dataset, jnp.asarray(fitted.coordinates),
        fitted.noise, jnp.asarray(first), jnp.asarray(begin),
        jnp.asarray(_shocks(fitted.noise, dataset, rng)),
    )  # fmt: skip
    measured = jnp.where(dataset.known, measured + error, 0.0)
    made = eqx.tree_at(lambda t: t.measured, dataset, measured)
    return dataclasses.replace(problem, dataset=made)


def _shocks(noise: Noise, dataset: Dataset, rng: np.random.Generator) -> Float[np.ndarray, "row 9"]:
    """What gusts add to the filter's state over each row."""
    Q = np.asarray(gust_propagation(noise, dataset.dt)[1])
    speed, left, both = (
        np.diagonal(Q[:, a:a + 3, b:b + 3], axis1=1, axis2=2) for a, b in ((3, 3), (6, 6), (3, 6))
    )  # fmt: skip
    one, other = rng.standard_normal((2, len(Q), 3))
    spread = np.sqrt(np.maximum(speed, 1e-300))
    along = both / spread
    across = np.sqrt(np.maximum(left - along**2, 0.0))
    still = np.zeros_like(one)
    return np.concatenate([still, spread * one, along * one + across * other], axis=1)


@eqx.filter_jit
def _measured(
    base: Vessel, layout: Static, dataset: Dataset, coordinates: Array, noise: Noise, first: Array,
    begin: Array, shocks: Array,
) -> Float[Array, "row 6"]:  # fmt: skip
    """What sensors without noise show along a dataset that gusts have shaken."""
    shape: CoordinateLayout = layout.value
    vessel, flows = vessel_at(base, shape, coordinates)
    vessel, dataset = align_to_order_clock(vessel, dataset)
    gusts, _ = gust_propagation(noise, dataset.dt)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, blown, shock = inputs
        z, trail = restart(*carry, row, dataset.memory)
        z = z + jnp.where(row["starts"], 1.0, 0.0) * jnp.concatenate([jnp.zeros(6), blown])
        seen = shown_measurements(vessel, z[:6], row, trail)
        trail = trail.after(z[:6], row["run_time"], row["dt"])
        kick = gust.half * z[6:]
        x = propagate(vessel, with_impulse(z[:6], kick), row, row["flow"], dataset.substeps)
        z = jnp.concatenate([with_impulse(x, kick), gust.decay * z[6:]]) + shock
        return (z, trail), seen

    given = eqx.tree_at(lambda t: t.first, dataset, first)
    inputs = filter_rows(vessel, flows, given), gusts, begin, shocks
    start = jnp.zeros(9), StateHistory.begun(jnp.zeros(6), dataset.memory)
    return batched_scan(body, start, inputs, dataset.lanes)
