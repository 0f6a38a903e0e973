"""Estimation of gust and sensor noise from the innovations of a filter.

The filter is linearised once along its own path; the likelihood as a function of the
noise scales then needs no vessel model any more, and Fisher scoring on it is cheap.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.process_noise import (
    Noise,
    gust_propagation,
    measurement_update,
    time_update,
)
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.scales import froude_speed, time_scale
from diffsea.statistics import robust_scale
from diffsea.vessel.base import Vessel


LEAST = 4.0  # scales stay within this of their prior's logarithm below: rounding is not noise


class LinearisedRun(eqx.Module):
    """A filter's path linearised: enough to run it again with other gains."""

    F: Float[Array, "row 6 6"]
    H: Float[Array, "row 6 9"]  # zero rows where nothing was measured
    K: Float[Array, "row 9 6"]
    nu: Float[Array, "row 6"]
    used: Float[Array, "row 6"]
    kick: Float[Array, "row 3"]
    lasting: Float[Array, "row 3"]
    late: Float[Array, "row 6"]


class RowTimes(eqx.Module):
    """When rows begin and runs start, and how little is known of a run's first state."""

    dt: Float[Array, "row"]
    starts: Float[Array, "row"]
    first_variance: Float[Array, "6"]


class NoisePrior(NamedTuple):
    """Normal prior on the logarithms, in the order of `Noise.scales`."""

    mean: np.ndarray
    spread: np.ndarray


def noise_prior(vessel: Vessel, dataset: Dataset) -> NoisePrior:
    """Plausible gusts for a vessel of this size, and sensor noise from the series themselves.

    Gusts that change the speed by a hundredth of that at Froude number 0.3 within
    sqrt(L / g), give or take a factor of e. Lasting gusts remember five times as long and are
    as strong in the long run, each give or take a factor of e. Sensor noise from second
    differences, which white noise dominates: a rough guess, give or take a factor of e^2.
    """
    time = time_scale(float(vessel.rigid_body.length))
    length = float(vessel.rigid_body.length)
    gust = 0.01 * 0.3 * froude_speed(length) / np.sqrt(time)
    gusts = np.array([gust, gust, 2 * gust / length])
    memory = np.full(3, 5 * time)
    slow = gusts / np.sqrt(2 * memory)
    scales = np.concatenate([gusts, slow, memory, _sensor_scales(dataset, length)])
    return NoisePrior(np.log(scales), np.repeat([1.0, 2.0], [9, 6]))


def _sensor_scales(dataset: Dataset, length: float) -> np.ndarray:
    """Standard deviation of second differences over sqrt(6), with a floor."""
    floor = np.array([1e-4 * length, 1e-4 * length, 1e-4, 1e-4, 1e-4, 1e-4])
    scales = floor.copy()
    measured, known, run = (np.asarray(a) for a in (dataset.measured, dataset.known, dataset.run))
    for k in range(6):
        series, runs = measured[known[:, k], k], run[known[:, k]]
        if len(series) < 5:
            continue
        second = np.diff(series, 2)[runs[2:] == runs[:-2]]
        robust = robust_scale(second - np.median(second)) / np.sqrt(6)
        scales[k] = max(robust, 0.3 * np.std(second) / np.sqrt(6), floor[k])
    return scales


EXCERPT = 1024  # rows from which noise is estimated: a fiftieth of each scale is its error
BLOCK = 128  # rows that follow one another
LEVEL = 1.0  # a gain of -2 log posterior after which nothing more is sought before a fit goes on


def take_excerpt(path: LinearisedRun, clock: RowTimes) -> tuple[LinearisedRun, RowTimes]:
    """Blocks of rows spread evenly over a long path, each begun like a run of its own.

    A path that is no longer than the blocks together is one block.
    """
    begin, length = np.zeros(1, int), len(clock.dt)
    if length > EXCERPT:
        # Spare rows at the end of a dataset say nothing.
        rows = 1 + int(np.flatnonzero(np.asarray(path.used).any(1)).max(initial=0))
        blocks = int(np.clip(rows // BLOCK, 1, EXCERPT // BLOCK))
        begin, length = np.linspace(0, max(0, rows - BLOCK), blocks).astype(int), BLOCK
    chosen = begin[:, None] + np.arange(length)
    starts = np.asarray(clock.starts)[chosen]
    starts[:, 0] = True
    part = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[chosen]), path)
    dt = jnp.asarray(np.asarray(clock.dt)[chosen])
    return part, RowTimes(dt, jnp.asarray(starts), clock.first_variance)


def _rerun(path: LinearisedRun, clock: RowTimes, noise: Noise) -> tuple:
    """Sequential innovations and their variances with other noise."""
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([clock.first_variance, jnp.exp(2 * noise.slow)]))
    gusts, Q = gust_propagation(noise, clock.dt)

    def body(carry: tuple, inputs: tuple) -> tuple:
        # d: how far the vessel's state is from the one on the path; a: lasting accelerations
        d, a, P = carry
        at, gust, more, start = inputs
        d, a, P = jnp.where(start, 0.0, d), jnp.where(start, 0.0, a), jnp.where(start, P0, P)
        off = jnp.concatenate([d, a - at.lasting])
        nu = jnp.where(at.used, at.nu - jnp.sum(at.H * off, axis=1), 0.0)
        C, W, P, variance = measurement_update(P, at.H, R, at.used, more, at.late)
        white = jnp.sum(W * nu, axis=1)
        change = jnp.sum(C * nu, axis=1)
        d = d + change[:6] - jnp.sum(at.K * at.nu, axis=1)[:6]
        a = a + change[6:]
        kick = jnp.concatenate([jnp.zeros(3), gust.half * a - at.kick])
        d = jnp.sum(at.F * (d + kick), axis=1) + kick
        return (d, gust.decay * a, time_update(P, at.F, gust, more)), (white, variance)

    start = (jnp.zeros(6), jnp.zeros(3), P0)
    return jax.lax.scan(body, start, (path, gusts, Q, clock.starts))[1]


def _terms(path: LinearisedRun, clock: RowTimes, log: Array) -> tuple[Array, Array]:
    """Whitened innovations of all blocks, and the logarithms of their variances."""

    def block(part: LinearisedRun, dt: Array, starts: Array) -> tuple:
        return _rerun(part, RowTimes(dt, starts, clock.first_variance), Noise.of(log))

    # One step of a compiled loop costs nearly as much for one block as for all.
    white, variance = jax.vmap(block)(path, clock.dt, clock.starts)
    return white.ravel(), jnp.log(variance).ravel()


def _sum(white: Array, log_variance: Array, off: Array) -> Array:
    return jnp.sum(white**2) + jnp.sum(log_variance) + jnp.sum(off**2)


@jax.jit
def _value(path: LinearisedRun, clock: RowTimes, log: Array, prior: NoisePrior) -> Array:
    """Deviance of all blocks with prior."""
    return _sum(*_terms(path, clock, log), (log - prior.mean) / prior.spread)


@jax.jit
def _score(path: LinearisedRun, clock: RowTimes, log: Array, prior: NoisePrior) -> tuple:
    """The same, its gradient and its expected curvature."""
    along = lambda at: _terms(path, clock, at)
    (white, log_variance), (d_white, d_log) = value_and_jacobian(along, log)
    # white = nu / sqrt(s): the innovation's own derivative over sqrt(s) is this.
    d_nu = d_white + 0.5 * white[:, None] * d_log
    gradient = 2 * white @ d_white + d_log.sum(0)
    curvature = 2 * d_nu.T @ d_nu + d_log.T @ d_log
    off = (log - prior.mean) / prior.spread
    return (
        _sum(white, log_variance, off),
        gradient + 2 * off / prior.spread,
        curvature + 2 * jnp.diag(1 / prior.spread**2),
    )


def refine_noise(
    path: LinearisedRun, clock: RowTimes, noise: Noise, prior: NoisePrior, steps: int
) -> Noise:
    """Fisher scoring on the scales from `noise`, halving a step that makes it worse."""
    log, lowest = np.asarray(noise.scales), prior.mean - LEAST
    for _ in range(steps):
        value, gradient, curvature = map(np.asarray, _score(path, clock, jnp.asarray(log), prior))
        step = -np.linalg.solve(curvature, gradient)
        step = np.maximum(np.clip(step, -1.0, 1.0), lowest - log)
        for _ in range(4):
            there = float(_value(path, clock, jnp.asarray(log + step), prior))
            if there <= value:
                break
            step = 0.5 * step
        else:
            break
        log = log + step
        if value - there < LEVEL:
            break
    return Noise.of(log)
