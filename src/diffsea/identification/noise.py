"""Estimation of gust and sensor noise from the innovations of a filter.

The filter is linearised once along its own path; the likelihood as a function of the nine
noise scales then needs no vessel model any more, and Fisher scoring on it is cheap.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.likelihood import Noise, product, updated
from diffsea.identification.tape import Tape, natural_time
from diffsea.vessel.base import Vessel


class Path(eqx.Module):
    """A filter's path linearised: enough to run it again with other gains."""

    F: Float[Array, "row 6 6"]
    H: Float[Array, "row 6 6"]  # zero rows where nothing was measured
    K: Float[Array, "row 6 6"]
    nu: Float[Array, "row 6"]
    used: Float[Array, "row 6"]
    first_variance: Float[Array, "6"]


class Prior(NamedTuple):
    """Normal prior on the nine logarithms, in the order gust, sensor."""

    mean: np.ndarray
    spread: np.ndarray


def noise_prior(vessel: Vessel, tape: Tape) -> Prior:
    """Plausible gusts for a vessel of this size, and sensor noise from the series themselves.

    Gusts that change the speed by a hundredth of that at Froude number 0.3 within
    sqrt(L / g), give or take a factor of e. Sensor noise from second differences, which
    white noise dominates: a rough guess, give or take a factor of e^2.
    """
    time = natural_time(vessel)
    length = float(vessel.rigid_body.length)
    gust = 0.01 * 0.3 * np.sqrt(9.81 * length) / np.sqrt(time)
    gusts = np.log([gust, gust, 2 * gust / length])
    return Prior(
        np.concatenate([gusts, np.log(_sensor_scales(tape, length))]),
        np.concatenate([np.full(3, 1.0), np.full(6, 2.0)]),
    )


def _sensor_scales(tape: Tape, length: float) -> np.ndarray:
    """Standard deviation of second differences over sqrt(6), with a floor."""
    floor = np.array([1e-4 * length, 1e-4 * length, 1e-4, 1e-4, 1e-4, 1e-4])
    scales = floor.copy()
    measured, known, run = (np.asarray(a) for a in (tape.measured, tape.known, tape.run))
    for k in range(6):
        series, runs = measured[known[:, k], k], run[known[:, k]]
        if len(series) < 5:
            continue
        second = np.diff(series, 2)[runs[2:] == runs[:-2]]
        robust = 1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6)
        scales[k] = max(robust, 0.3 * np.std(second) / np.sqrt(6), floor[k])
    return scales


def _rerun(path: Path, dt: Array, starts: Array, log: Float[Array, "9"]) -> tuple:
    """Sequential innovations and their variances with other noise."""
    Q = jnp.diag(jnp.concatenate([jnp.zeros(3), jnp.exp(2 * log[:3])]))
    R = jnp.exp(2 * log[3:])
    P0 = jnp.diag(path.first_variance)

    def body(carry: tuple, row: tuple) -> tuple:
        d, P = carry  # d: how far the state is from the one on the path
        F, H, K, nu0, used, step, start = row
        d, P = jnp.where(start, 0.0, d), jnp.where(start, P0, P)
        nu = jnp.where(used, nu0 - jnp.sum(H * d, axis=1), 0.0)
        C, W, P, variance = updated(P, H, R, used)
        white = jnp.sum(W * nu, axis=1)
        d = d + jnp.sum(C * nu, axis=1) - jnp.sum(K * nu0, axis=1)
        P = product(product(F, P), F.T) + Q * step
        return (jnp.sum(F * d, axis=1), P), (white, variance)

    rows = (path.F, path.H, path.K, path.nu, path.used, dt, starts)
    return jax.lax.scan(body, (jnp.zeros(6), P0), rows)[1]


@jax.jit
def _score(path: Path, dt: Array, starts: Array, log: Array, prior: Prior) -> tuple:
    """Deviance with prior, its gradient and its expected curvature."""

    def both(at: Array) -> tuple:
        white, variance = _rerun(path, dt, starts, at)
        return white.ravel(), jnp.log(variance).ravel()

    white, _ = value = both(log)
    d_white, d_log = jax.jacfwd(both)(log)
    # white = nu / sqrt(s): the innovation's own derivative over sqrt(s) is this.
    d_nu = d_white + 0.5 * white[:, None] * d_log
    gradient = 2 * white @ d_white + d_log.sum(0)
    curvature = 2 * d_nu.T @ d_nu + d_log.T @ d_log
    off = (log - prior.mean) / prior.spread
    return (
        jnp.sum(white**2) + jnp.sum(value[1]) + jnp.sum(off**2),
        gradient + 2 * off / prior.spread,
        curvature + 2 * jnp.diag(1 / prior.spread**2),
    )


def refine(path: Path, tape: Tape, noise: Noise, prior: Prior, steps: int = 6) -> Noise:
    """Fisher scoring on the nine scales from `noise`, halving a step that makes it worse."""
    log = np.concatenate([np.asarray(noise.gust), np.asarray(noise.sensor)])
    value, gradient, curvature = _score(path, tape.dt, tape.starts, jnp.asarray(log), prior)
    for _ in range(steps):
        step = -np.linalg.solve(np.asarray(curvature), np.asarray(gradient))
        step = np.clip(step, -1.0, 1.0)
        for _ in range(4):
            trial = _score(path, tape.dt, tape.starts, jnp.asarray(log + step), prior)
            if float(trial[0]) <= float(value):
                break
            step = 0.5 * step
        else:
            break
        gain = float(value) - float(trial[0])
        log, (value, gradient, curvature) = log + step, trial
        if gain < 0.1:
            break
    return Noise(jnp.asarray(log[:3]), jnp.asarray(log[3:]))
