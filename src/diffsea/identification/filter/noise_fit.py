"""Estimation of gust and sensor noise from the innovations of a filter.

The filter is linearised once along its own run; the likelihood as a function of the noise scales
then needs no vessel model any more, and Fisher scoring on it is cheap.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.covariance import (
    Noise,
    gust_propagation,
    matrix_vector,
    measurement_update,
    time_update,
)
from diffsea.identification.filter.kalman import FilterRun
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.scales import froude_speed, time_scale
from diffsea.statistics import robust_scale
from diffsea.vessel.base import Vessel


EXCERPT_ROWS = 1024  # from which noise is estimated: a fiftieth of each scale is its error
BLOCK_ROWS = 128  # of the excerpt that follow one another
LARGEST_FALL = 4.0  # of a scale's logarithm below its prior's mean: rounding is not noise
LARGEST_STEP = 1.0  # of a scale's logarithm: a factor of e
HALVINGS = 4  # of a step that makes the likelihood worse
ENOUGH_GAIN = 1.0  # of -2 log posterior: after less, nothing more is sought before a fit goes on


class RowTimes(eqx.Module):
    """When rows begin and runs start, and how little is known of a run's first state."""

    dt: Float[Array, "*block row"]  # s
    starts: Bool[Array, "*block row"]
    first_variance: Float[Array, "6"]


class NoisePrior(NamedTuple):
    """Normal prior on the logarithms, in the order of `Noise.scales`."""

    mean: Float[np.ndarray, "15"]
    spread: Float[np.ndarray, "15"]


def noise_prior(vessel: Vessel, dataset: Dataset) -> NoisePrior:
    """Plausible gusts for a vessel of this size, and sensor noise from the series themselves.

    Gusts that change the speed by a hundredth of that at Froude number 0.3 within
    sqrt(L / g), give or take a factor of e. Lasting gusts remember five times as long and are
    as strong in the long run, each give or take a factor of e. Sensor noise from second
    differences, which white noise dominates: a rough guess, give or take a factor of e^2.
    """
    length = float(vessel.rigid_body.length)
    time = time_scale(length)
    gust = 0.01 * 0.3 * froude_speed(length) / np.sqrt(time)
    gusts = np.array([gust, gust, 2 * gust / length])
    memory = np.full(3, 5 * time)
    slow = gusts / np.sqrt(2 * memory)
    floor = np.array([1e-4 * length, 1e-4 * length, 1e-4, 1e-4, 1e-4, 1e-4])
    sensors = floor.copy()
    measured, known, run = (np.asarray(a) for a in (dataset.measured, dataset.known, dataset.run))
    for k in range(6):
        series, runs = measured[known[:, k], k], run[known[:, k]]
        if len(series) < 5:
            continue
        # White noise of unit variance has second differences of variance 6.
        second = np.diff(series, 2)[runs[2:] == runs[:-2]]
        robust = robust_scale(second - np.median(second)) / np.sqrt(6)
        sensors[k] = max(robust, 0.3 * np.std(second) / np.sqrt(6), floor[k])
    scales = np.concatenate([gusts, slow, memory, sensors])
    return NoisePrior(np.log(scales), np.repeat([1.0, 2.0], [9, 6]))


def take_excerpt(run: FilterRun, times: RowTimes) -> tuple[FilterRun, RowTimes]:
    """Blocks of rows spread evenly over a long run, each begun like a run of its own.

    A run that is no longer than the blocks together is one block.
    """
    begin, length = np.zeros(1, int), len(times.dt)
    if length > EXCERPT_ROWS:
        # Spare rows at the end of a data set say nothing.
        rows = 1 + int(np.flatnonzero(np.asarray(run.gains.used).any(1)).max(initial=0))
        blocks = int(np.clip(rows // BLOCK_ROWS, 1, EXCERPT_ROWS // BLOCK_ROWS))
        begin = np.linspace(0, max(0, rows - BLOCK_ROWS), blocks).astype(int)
        length = BLOCK_ROWS
    chosen = begin[:, None] + np.arange(length)
    starts = np.asarray(times.starts)[chosen]
    starts[:, 0] = True
    part, dt = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[chosen]), (run, times.dt))
    return part, RowTimes(dt, jnp.asarray(starts), times.first_variance)


def rerun_linearised(
    run: FilterRun, times: RowTimes, noise: Noise
) -> tuple[Float[Array, "row 6"], Float[Array, "row 6"]]:
    """Whitened sequential innovations of a run with other noise, and their variances."""
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([times.first_variance, jnp.exp(2 * noise.slow)]))
    gusts, Q = gust_propagation(noise, times.dt)

    def body(carry: tuple, inputs: tuple) -> tuple:
        # d: how far the vessel's state is from the one of the run; a: lasting accelerations
        d, a, P = carry
        at, gust, more, start = inputs
        d, a, P = jnp.where(start, 0.0, d), jnp.where(start, 0.0, a), jnp.where(start, P0, P)
        off = jnp.concatenate([d, a - at.gust_acceleration])
        used = at.gains.used
        innovation = jnp.where(used, at.innovation - matrix_vector(at.H, off), 0.0)
        C, W, P, variance = measurement_update(P, at.H, R, used, more, at.rows_late)
        change = matrix_vector(C, innovation)
        d = d + change[:6] - matrix_vector(at.gains.correction, at.innovation)[:6]
        a = a + change[6:]
        impulse = jnp.concatenate([jnp.zeros(3), gust.half * a - at.gust_impulse])
        d = matrix_vector(at.F, d + impulse) + impulse
        P = time_update(P, at.F, gust, more)
        return (d, gust.decay * a, P), (matrix_vector(W, innovation), variance)

    start = jnp.zeros(6), jnp.zeros(3), P0
    return jax.lax.scan(body, start, (run, gusts, Q, times.starts))[1]


def _terms(
    run: FilterRun, times: RowTimes, log: Float[Array, "15"]
) -> tuple[Float[Array, "value"], Float[Array, "value"]]:
    """Whitened innovations of all blocks, and the logarithms of their variances."""

    def block(part: FilterRun, dt: Array, starts: Array) -> tuple[Array, Array]:
        return rerun_linearised(part, RowTimes(dt, starts, times.first_variance), Noise.of(log))

    # One step of a compiled loop costs nearly as much for one block as for all.
    white, variance = jax.vmap(block)(run, times.dt, times.starts)
    return white.ravel(), jnp.log(variance).ravel()


def _total(white: Array, log_variance: Array, strains: Array) -> Float[Array, ""]:
    return jnp.sum(white**2) + jnp.sum(log_variance) + jnp.sum(strains**2)


@jax.jit
def _deviance(
    run: FilterRun, times: RowTimes, log: Float[Array, "15"], prior: NoisePrior
) -> Float[Array, ""]:
    """Deviance of all blocks with prior."""
    return _total(*_terms(run, times, log), (log - prior.mean) / prior.spread)


@jax.jit
def _score(
    run: FilterRun, times: RowTimes, log: Float[Array, "15"], prior: NoisePrior
) -> tuple[Float[Array, ""], Float[Array, "15"], Float[Array, "15 15"]]:
    """The same, its gradient and its expected curvature."""
    along = lambda at: _terms(run, times, at)
    (white, log_variance), (d_white, d_log) = value_and_jacobian(along, log)
    # white = nu / sqrt(s): the innovation's own derivative over sqrt(s) is this.
    d_nu = d_white + 0.5 * white[:, None] * d_log
    gradient = 2 * white @ d_white + d_log.sum(0)
    curvature = 2 * d_nu.T @ d_nu + d_log.T @ d_log
    off = (log - prior.mean) / prior.spread
    return (
        _total(white, log_variance, off),
        gradient + 2 * off / prior.spread,
        curvature + 2 * jnp.diag(1 / prior.spread**2),
    )


def refine_noise(
    run: FilterRun, times: RowTimes, noise: Noise, prior: NoisePrior, steps: int
) -> Noise:
    """Fisher scoring on the scales from `noise`, halving a step that makes it worse.

    From an excerpt of the run.
    """
    run, times = take_excerpt(run, times)
    log, lowest = np.asarray(noise.scales), prior.mean - LARGEST_FALL
    for _ in range(steps):
        value, gradient, curvature = map(np.asarray, _score(run, times, jnp.asarray(log), prior))
        step = -np.linalg.solve(curvature, gradient)
        step = np.maximum(np.clip(step, -LARGEST_STEP, LARGEST_STEP), lowest - log)
        for _ in range(HALVINGS):
            there = float(_deviance(run, times, jnp.asarray(log + step), prior))
            if there <= value:
                break
            step = 0.5 * step
        else:
            break
        log = log + step
        if value - there < ENOUGH_GAIN:
            break
    return Noise.of(log)
