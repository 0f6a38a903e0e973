"""Recordings as a fitted model with its fitted gusts and noise would have made them.

For a parametric bootstrap.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.batching import batched_scan
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.corrections import as_shown, corrected
from diffsea.identification.filter.covariance import Noise, gust_propagation
from diffsea.identification.filter.kalman import (
    filter_rows,
    mean_acceleration,
    propagate,
    restart,
    with_impulse,
)
from diffsea.identification.filter.latency import SamplePlacement, shown_samples
from diffsea.identification.problem import Problem
from diffsea.vessel.base import Vessel


def resimulate(problem: Problem, fitted: Estimate, rng: np.random.Generator) -> Problem:
    """The same problem with other measurements, drawn from the estimate.

    Inputs, times, gaps and first guesses are those of the recordings. Each run starts where the
    filter found it, lasting gusts with their stationary spread. A run that diverges has
    measurements that are not finite.
    """
    dataset, noise = problem.dataset, fitted.noise
    run, part = fitted.filter_run(problem), np.asarray(dataset.part)
    placement = run.gains.placement
    # The last row at which the filter begins anew in each part is that of the first sample.
    begins = np.zeros(part[-1] + 1, int)
    restarts = np.flatnonzero(np.asarray(placement.restarts))
    begins[part[restarts]] = restarts
    error = np.exp(np.asarray(noise.sensor)) * rng.standard_normal((len(part), 6))
    begin = np.exp(np.asarray(noise.slow)) * rng.standard_normal((len(part), 3))
    placed = _shown_in_gusts(
        problem.base,
        problem.layout,
        eqx.tree_at(lambda d: d.first, dataset, run.state[begins[part]]),
        placement,
        jnp.asarray(fitted.coordinates),
        noise,
        jnp.asarray(begin),
        jnp.asarray(draw_process_noise(noise, dataset, rng)),
    )
    source, shown = np.asarray(placement.source), np.asarray(placed) + error
    measured = np.array(dataset.measured)
    for k in range(6):
        at = source[:, k] >= 0
        measured[source[at, k], k] = shown[at, k]
    vessel, _ = vessel_at(problem.base, problem.layout, jnp.asarray(fitted.coordinates))
    drawn = dataclasses.replace(dataset, measured=jnp.asarray(measured))
    return dataclasses.replace(problem, dataset=as_shown(vessel, drawn))


def draw_process_noise(
    noise: Noise, dataset: Dataset, rng: np.random.Generator
) -> Float[np.ndarray, "row 9"]:
    """What gusts and the walk of fixes add to the filter's state over each row, at random."""
    Q = np.asarray(gust_propagation(noise, dataset.dt)[1])
    walk, speed, left, both = (
        np.diagonal(Q[:, a : a + 3, b : b + 3], axis1=1, axis2=2)
        for a, b in ((0, 0), (3, 3), (6, 6), (3, 6))
    )
    walked, one, other = rng.standard_normal((3, len(Q), 3))
    spread = np.sqrt(np.maximum(speed, 1e-300))
    along = both / spread
    across = np.sqrt(np.maximum(left - along**2, 0.0))
    shaken = spread * one, along * one + across * other
    return np.concatenate([np.sqrt(walk) * walked, *shaken], axis=1)


@eqx.filter_jit
def _shown_in_gusts(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    placement: SamplePlacement,
    coordinates: Float[Array, "coordinate"],
    noise: Noise,
    begin: Float[Array, "row 3"],
    process_noise: Float[Array, "row 9"],
) -> Float[Array, "row 6"]:
    """What sensors without noise show; each run begins with lasting gusts `begin`."""
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = corrected(vessel, dataset)
    gusts, _ = gust_propagation(noise, dataset.dt)

    def body(carry: tuple[Float[Array, "9"], Float[Array, "3"]], inputs: tuple) -> tuple:
        row, gust, blown, shock = inputs
        z, acceleration = restart(*carry, row)
        z = z + jnp.where(row.starts, 1.0, 0.0) * jnp.concatenate([jnp.zeros(6), blown])
        seen = shown_samples(vessel, z[:6], acceleration, row.moved)
        impulse = gust.half * z[6:]
        x = with_impulse(
            propagate(vessel, with_impulse(z[:6], impulse), row, dataset.substeps), impulse
        )
        acceleration = mean_acceleration(row, z, x)
        return (jnp.concatenate([x, gust.decay * z[6:]]) + shock, acceleration), seen

    inputs = filter_rows(vessel, flows, dataset, placement), gusts, begin, process_noise
    return batched_scan(body, (jnp.zeros(9), jnp.zeros(3)), inputs, dataset.batches)
