"""Recordings as a fitted model with its fitted gusts and noise would have made them."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.batching import scan
from diffsea.identification.data.dataset import Tape
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.kalman import faster, propagate, restarted, rows
from diffsea.identification.filter.latency import Trail, on_order_clock, shown
from diffsea.identification.filter.process_noise import Noise, gust_model
from diffsea.identification.problem import Problem, Static
from diffsea.vessel.base import Vessel


def simulated(problem: Problem, fitted: Estimate, rng: np.random.Generator) -> Problem:
    """The same problem with other measurements, drawn from the estimate.

    Inputs, times, gaps and first guesses are those of the recordings. Each run starts where the
    filter found it, lasting gusts with their stationary spread. A run that diverges has
    measurements that are not finite.
    """
    tape = problem.tape
    tuned = problem.tuned(fitted.coordinates, fitted.noise)
    starts = np.asarray(tape.starts)
    first = np.asarray(tuned.state)[starts][np.cumsum(starts) - 1]
    scale = np.exp(np.asarray(fitted.noise.sensor))
    error = scale * rng.standard_normal((len(starts), 6))
    begin = np.exp(np.asarray(fitted.noise.slow)) * rng.standard_normal((len(starts), 3))
    measured = _measured(
        problem.base, Static(problem.layout), tape, jnp.asarray(fitted.coordinates),
        fitted.noise, jnp.asarray(first), jnp.asarray(begin),
        jnp.asarray(_shocks(fitted.noise, tape, rng)),
    )  # fmt: skip
    measured = jnp.where(tape.known, measured + error, 0.0)
    made = eqx.tree_at(lambda t: t.measured, tape, measured)
    return dataclasses.replace(problem, tape=made)


def _shocks(noise: Noise, tape: Tape, rng: np.random.Generator) -> Float[np.ndarray, "row 9"]:
    """What gusts add to the filter's state over each row."""
    Q = np.asarray(gust_model(noise, tape.dt)[1])
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
    base: Vessel, layout: Static, tape: Tape, coordinates: Array, noise: Noise, first: Array,
    begin: Array, shocks: Array,
) -> Float[Array, "row 6"]:  # fmt: skip
    """What sensors without noise show along a tape that gusts have shaken."""
    shape: CoordinateLayout = layout.value
    vessel, flows = vessel_at(base, shape, coordinates)
    vessel, tape = on_order_clock(vessel, tape)
    gusts, _ = gust_model(noise, tape.dt)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, blown, shock = inputs
        z, trail = restarted(*carry, row, tape.memory)
        z = z + jnp.where(row["starts"], 1.0, 0.0) * jnp.concatenate([jnp.zeros(6), blown])
        seen = shown(vessel, z[:6], row, trail)
        trail = trail.after(z[:6], row["run_time"], row["dt"])
        kick = gust.half * z[6:]
        x = propagate(vessel, faster(z[:6], kick), row, row["flow"], tape.substeps)
        z = jnp.concatenate([faster(x, kick), gust.decay * z[6:]]) + shock
        return (z, trail), seen

    given = eqx.tree_at(lambda t: t.first, tape, first)
    inputs = rows(vessel, flows, given), gusts, begin, shocks
    start = jnp.zeros(9), Trail.begun(jnp.zeros(6), tape.memory)
    return scan(body, start, inputs, tape.lanes)
