"""Estimation of gust and sensor noise from the innovations of a filter.

The filter is linearised once along its own run; the likelihood as a function of the noise scales
then needs no vessel model any more, and to search along it is cheap.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.linalg import solve_triangular
from scipy.optimize import BFGS, lsq_linear
from scipy.stats import chi2

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.covariance import (
    Noise,
    gust_propagation,
    matrix_vector,
    scalar_update,
    time_update,
)
from diffsea.identification.filter.kalman import FilterRun
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.scales import froude_speed, time_scale
from diffsea.vessel.base import Vessel


EXCERPT_ROWS = 8192  # from which noise is estimated: a hundredth of each scale is its error
BLOCK_ROWS = 1024  # of the excerpt that follow one another
LARGEST_FALL = 4.0  # of a scale's logarithm below its prior's mean: rounding is not noise
PLAUSIBLE_NOISE = 2.0  # standard deviations of the prior, above which a gust is a missing force
LARGEST_STEP = 1.0  # of a scale's logarithm: a factor of e
LINE_SHARES = (1.0, 0.5, 0.25, 0.125)  # of a step, of which the best is taken
ENOUGH_OF_PROMISE = 0.5  # of what a whole step should gain: with so much it is taken
FEWEST_VALUES = 5  # of a channel, from which its noise can be guessed
TIED = 10  # the scale of y is that of x: positions err alike to the north and to the east
ISOTROPIC = np.insert(np.eye(15), TIED, np.eye(15)[TIED - 1], axis=0)  # all from those that move
SCALES_AT_ONCE = 4  # that the likelihood is differentiated by: twice as fast as all sixteen
NO_WALK = 1e-6  # times what is expected
WALK_TIME = 10.0  # in sqrt(L / g): in it fixes are expected to wander by as much as they scatter
SMALLEST = float(np.finfo(float).tiny)  # a bound that is no step at all
ENOUGH_GAIN = 0.1  # of -2 log posterior: after less, nothing more is sought before a fit goes on


class RowTimes(eqx.Module):
    """How long rows last, the run of each, and how little is known of a run's first state."""

    dt: Float[Array, "row"]  # s
    run: Int[Array, "row"]
    first_variance: Float[Array, "6"]


Excerpt = tuple[FilterRun, RowTimes]  # some of a run's rows, block after block


class NoisePrior(NamedTuple):
    """Normal prior on the logarithms, in the order of `Noise.scales`."""

    mean: Float[np.ndarray, "scale"]
    spread: Float[np.ndarray, "scale"]

    @property
    def lowest(self) -> Float[np.ndarray, "scale"]:
        """Below which a scale is rounding."""
        return self.mean - LARGEST_FALL

    @property
    def highest(self) -> Float[np.ndarray, "scale"]:
        """Above which a gust, its memory or a walk of fixes is none, but has a cause."""
        highest = Noise.of(self.mean + PLAUSIBLE_NOISE * self.spread)
        unbounded = jnp.full_like(highest.sensor, jnp.inf)
        return np.asarray(dataclasses.replace(highest, sensor=unbounded).scales)


def noise_prior(vessel: Vessel, dataset: Dataset) -> NoisePrior:
    """Plausible gusts for a vessel of this size, and sensor noise from the series themselves.

    Gusts that change the speed by a hundredth of that at Froude number 0.3 within
    sqrt(L / g), give or take a factor of e. Lasting gusts remember five times as long and are
    as strong in the long run, each give or take a factor of e, and at most of e^2: a force that is
    stronger, or lasts longer, has a cause that is to be found. Sensor noise from second
    differences, which white noise dominates: a rough guess, give or take a factor of e^2. So is
    that fixes wander by as much within ten sqrt(L / g). Where velocities were recorded they do not:
    if these err for a while, fixes would seem to, and data do not tell which of the two it is.
    """
    length = float(vessel.rigid_body.length)
    time = time_scale(length)
    gust = 0.01 * 0.3 * froude_speed(length) / np.sqrt(time)
    gusts = np.array([gust, gust, 2 * gust / length])
    memory = np.full(3, 5 * time)
    slow = gusts / np.sqrt(2 * memory)
    sensor = _sensor_scales(dataset, length)
    walk = sensor[:1] / np.sqrt(WALK_TIME * time)
    if dataset.recorded_channels[3:5].all():
        walk = NO_WALK * walk
    scales = np.concatenate([gusts, slow, memory, sensor, walk])
    return NoisePrior(np.log(scales), np.repeat([1.0, 2.0], [9, 7]))


def _sensor_scales(dataset: Dataset, length: float) -> Float[np.ndarray, "6"]:
    """Standard deviation of second differences over sqrt(6), with a floor.

    That of positions is one number for both axes, by the length of their differences: it must not
    depend on which way north lies.
    """
    floor = np.array([1e-4 * length, 1e-4 * length, 1e-4, 1e-4, 1e-4, 1e-4])
    measured, known, run = (np.asarray(a) for a in (dataset.measured, dataset.known, dataset.run))
    squares = [_second_differences(measured[:, k], known[:, k], run) ** 2 for k in range(6)]
    scales = np.maximum([_scale_of_squares(own, 1) for own in squares], floor)
    fixes = known[:, 0] & known[:, 1]
    north, east = (_second_differences(measured[:, k], fixes, run) for k in (0, 1))
    if len(north):
        scales[:2] = max(_scale_of_squares(north**2 + east**2, 2), floor[0])
    else:
        scales[:2] = scales[:2].max()
    return scales


def _second_differences(
    values: Float[np.ndarray, "row"], known: Bool[np.ndarray, "row"], run: Int[np.ndarray, "row"]
) -> Float[np.ndarray, "difference"]:
    """Second differences of the known values within each run, less their median."""
    run = run[known]
    if len(run) < FEWEST_VALUES:
        return np.zeros(0)
    second = np.diff(values[known], 2)[run[2:] == run[:-2]]
    return second - np.median(second) if len(second) else second


def _scale_of_squares(squares: Float[np.ndarray, "difference"], axes: int) -> float:
    """Standard deviation of a value on each of so many axes, from squared second differences.

    Robust, by their median, but not less than three tenths of the plain one.
    """
    if not len(squares):
        return 0.0
    robust = np.median(squares) / float(chi2.median(axes))
    return float(np.sqrt(max(robust, 0.09 * np.mean(squares) / axes) / 6))


def take_excerpt(run: FilterRun, times: RowTimes) -> Excerpt:
    """Blocks of rows spread evenly over each of long runs, each begun like a run of its own.

    Runs that together are no longer than the excerpt are taken whole. Where blocks lie depends on
    nothing but the run itself, so that the order of runs does not matter.
    """
    rows = len(times.dt)
    if rows <= EXCERPT_ROWS:
        return run, times
    # Spare rows at the end of a data set are not recorded.
    recorded = np.count_nonzero(np.asarray(run.gains.used), axis=1) > 0
    number = np.where(recorded, np.asarray(times.run), -1)
    begin = _block_starts(number, min(EXCERPT_ROWS, int(np.sum(recorded))))
    chosen = np.minimum(begin[:, None] + np.arange(BLOCK_ROWS), rows - 1)
    restarts = np.asarray(run.gains.placement.restarts)[chosen]
    restarts[:, 0] = True
    number = np.asarray(times.run)[chosen]

    def rows_of(leaf: Array) -> Array:
        return jnp.asarray(np.asarray(leaf)[chosen.ravel()])

    part = jax.tree.map(rows_of, run)
    own = (number == number[:, :1]).reshape(-1, 1)
    part = eqx.tree_at(
        lambda p: (p.gains.used, p.gains.placement.restarts),
        part,
        (part.gains.used & own, jnp.asarray(restarts.ravel())),
    )
    return part, RowTimes(rows_of(times.dt), rows_of(times.run), times.first_variance)


def _block_starts(run: Int[np.ndarray, "row"], rows: int) -> Int[np.ndarray, "block"]:
    """First rows of blocks that hold so many rows of all runs together; negative runs are none."""
    begin = []
    for number in np.unique(run[run >= 0]):
        own = np.flatnonzero(run == number)
        first, last = own[0], max(own[0], own[-1] + 1 - BLOCK_ROWS)
        count = max(1, round(rows / BLOCK_ROWS * len(own) / np.count_nonzero(run >= 0)))
        begin.append(np.linspace(first, last, count).astype(int))
    return np.concatenate(begin)


def rerun_linearised(
    run: FilterRun, times: RowTimes, noise: Noise
) -> tuple[Float[Array, "row 6"], Float[Array, "row 6"]]:
    """Whitened sequential innovations of a run with other noise, and their variances."""
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([times.first_variance, jnp.exp(2 * noise.slow)]))
    gusts, Q = gust_propagation(noise, times.dt)

    # Backwards a row is calculated anew: to keep all that is in it takes three times as long.
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def body(carry: tuple, inputs: tuple) -> tuple:
        # d: how far the vessel's state is from the one of the run; a: lasting accelerations
        d, a, P = carry
        at, gust, more, before = inputs
        start = at.gains.placement.restarts
        d, a, P = jnp.where(start, 0.0, d), jnp.where(start, 0.0, a), jnp.where(start, P0, P)

        def correct(carry: tuple[Array, Array], channel: tuple[Array, ...]) -> tuple:
            off, P = carry
            h, noise, used, shown, late = channel
            one = scalar_update(P, h, noise, used, before, late)
            innovation = jnp.where(used, shown - jnp.sum(one.h * off), 0.0)
            white = innovation / jnp.sqrt(one.variance)
            return (off + one.gain * innovation, one.covariance), (white, one.variance)

        off = jnp.concatenate([d, a - at.gust_acceleration])
        channels = at.H, R, at.gains.used, at.innovation, at.late
        (off, P), found = jax.lax.scan(correct, (off, P), channels)
        d = off[:6] - matrix_vector(at.gains.correction, at.innovation)[:6]
        a = off[6:] + at.gust_acceleration
        impulse = jnp.concatenate([jnp.zeros(3), gust.half * a - at.gust_impulse])
        d = matrix_vector(at.F, d + impulse) + impulse
        P = time_update(P, at.F, gust, more)
        return (d, gust.decay * a, P), found

    start = jnp.zeros(6), jnp.zeros(3), P0
    return jax.lax.scan(body, start, (run, gusts, Q, jnp.roll(Q, 1, axis=0)))[1]


def _terms(
    run: FilterRun, times: RowTimes, log: Float[Array, "scale"]
) -> tuple[Float[Array, "row 6"], Float[Array, "row 6"]]:
    """Whitened innovations of all rows, and the logarithms of their variances."""
    white, variance = rerun_linearised(run, times, Noise.of(log))
    return white, jnp.log(variance)


@jax.jit
def _deviance(
    run: FilterRun, times: RowTimes, log: Float[Array, "scale"], prior: NoisePrior
) -> Float[Array, ""]:
    """Deviance of all rows with prior."""
    white, log_variance = _terms(run, times, log)
    strains = (log - prior.mean) / prior.spread
    return jnp.sum(white**2) + jnp.sum(log_variance) + jnp.sum(strains**2)


@jax.jit
def _expected_curvature(
    run: FilterRun, times: RowTimes, log: Float[Array, "scale"], prior: NoisePrior
) -> Float[Array, "scale scale"]:
    """The deviance's, by Fisher's information of the scales."""
    (white, _), (d_white, d_log) = value_and_jacobian(
        lambda at: _terms(run, times, at), log, SCALES_AT_ONCE
    )
    # white = nu / sqrt(s): the innovation's own derivative over sqrt(s) is this.
    d_nu = (d_white + 0.5 * white[..., None] * d_log).reshape(-1, log.size)
    d_log = d_log.reshape(-1, log.size)
    return 2 * d_nu.T @ d_nu + d_log.T @ d_log + 2 * jnp.diag(1 / prior.spread**2)


@jax.jit
def _slope(
    run: FilterRun, times: RowTimes, log: Float[Array, "scale"], prior: NoisePrior
) -> tuple[Float[Array, ""], Float[Array, "scale"]]:
    """The same and its gradient."""
    return jax.value_and_grad(lambda at: _deviance(run, times, at, prior))(log)


def search_programs(
    run: FilterRun, times: RowTimes, prior: NoisePrior
) -> list[Callable[[], object]]:
    """Calls of all compiled programs of a search for noise, from whatever run of that shape."""
    given = *take_excerpt(run, times), jnp.asarray(prior.mean), prior
    programs = (_expected_curvature, _slope, _deviance)
    return [functools.partial(program, *given) for program in programs]


class RefinedNoise(NamedTuple):
    """Noise after some steps of its search, and what another one near by may borrow."""

    noise: Noise
    curvature: Float[np.ndarray, "free free"] | None  # of the deviance; None where the run diverges


def refine_noise(
    run: FilterRun,
    times: RowTimes,
    noise: Noise,
    prior: NoisePrior,
    steps: int,
    borrowed: Float[np.ndarray, "free free"] | None = None,
) -> RefinedNoise:
    """The scales after so many steps from `noise`, fewer where nothing is gained any more.

    From an excerpt of the run; as they are where the run diverges. The first step is one of Fisher
    scoring. Its expected curvature is right where innovations are white; where the model lacks
    something they are not, and steps would be too long in some directions and too short in others:
    how the gradient changes corrects it (BFGS; Nocedal and Wright 2006, chapter 6).

    Arguments:
        borrowed: curvature of a search near by. It is as good as the expected one, which is six
            times as dear as a gradient, if the first step gains what it promises, neither less
            nor more.
    """
    excerpt = take_excerpt(run, times)
    log = np.delete(np.asarray(noise.scales), TIED)

    def at(log: Float[np.ndarray, "free"]) -> tuple[FilterRun, RowTimes, Array, NoisePrior]:
        return *excerpt, jnp.asarray(ISOTROPIC @ log), prior

    def expected_at(log: Float[np.ndarray, "free"]) -> Float[np.ndarray, "free free"]:
        curvature = ISOTROPIC.T @ np.asarray(_expected_curvature(*at(log))) @ ISOTROPIC
        return 0.5 * (curvature + curvature.T)

    def deviance_at(log: Float[np.ndarray, "free"]) -> float:
        return float(_deviance(*at(log)))

    def slope_at(log: Float[np.ndarray, "free"]) -> tuple[float, Float[np.ndarray, "free"]]:
        value, gradient = map(np.asarray, _slope(*at(log)))
        return float(value), ISOTROPIC.T @ gradient

    value, gradient = slope_at(log)
    curvature = expected_at(log) if borrowed is None else borrowed
    learnt, left = _learning(curvature), steps
    while left and np.isfinite(gradient).all() and np.isfinite(curvature).all():
        step = _bounded_step(log, gradient, curvature, prior)
        promised = -float(gradient @ step + 0.5 * step @ curvature @ step)
        share, there = _share_of_step(deviance_at, log, step, value, promised)
        gained, step = value - there, share * step
        kept = abs(gained - promised) < ENOUGH_OF_PROMISE * promised
        if borrowed is not None and promised > ENOUGH_GAIN and not kept:
            curvature, borrowed = expected_at(log), None
            learnt = _learning(curvature)
            continue
        if not gained > 0:
            break
        log, left, borrowed = log + step, left - 1, None
        if gained < ENOUGH_GAIN or not left:
            break
        before, (value, gradient) = gradient, slope_at(log)
        if np.isfinite(gradient).all():
            learnt.update(step, gradient - before)
            curvature = learnt.get_matrix()
    is_known = bool(np.isfinite(curvature).all())
    return RefinedNoise(Noise.of(ISOTROPIC @ log), curvature if is_known else None)


def _learning(curvature: Float[np.ndarray, "free free"]) -> BFGS:
    """A curvature that changes of the gradient correct."""
    learnt = BFGS(init_scale=curvature)  # pyright: ignore[reportArgumentType]
    learnt.initialize(len(curvature), "hess")
    return learnt


def _share_of_step(
    deviance: Callable[[Float[np.ndarray, "free"]], float],
    log: Float[np.ndarray, "free"],
    step: Float[np.ndarray, "free"],
    value: float,
    promised: float,
) -> tuple[float, float]:
    """The share of a step that is best, and the deviance there; the whole one where it is good."""
    there = {LINE_SHARES[0]: deviance(log + LINE_SHARES[0] * step)}
    if not value - there[LINE_SHARES[0]] > ENOUGH_OF_PROMISE * promised:
        there |= {share: deviance(log + share * step) for share in LINE_SHARES[1:]}
    best = min(there, key=lambda one: np.nan_to_num(there[one], nan=np.inf))
    return best, there[best]


def _bounded_step(
    log: Float[np.ndarray, "free"],
    gradient: Float[np.ndarray, "free"],
    curvature: Float[np.ndarray, "free free"],
    prior: NoisePrior,
) -> Float[np.ndarray, "free"]:
    """To where the quadratic model has its minimum within its bounds.

    A step that is cut off at them afterwards may lead nowhere.
    """
    lowest, highest = np.delete([prior.lowest, prior.highest], TIED, axis=1)
    least = np.clip(lowest - log, -LARGEST_STEP, -SMALLEST)
    most = np.clip(highest - log, SMALLEST, LARGEST_STEP)
    root = np.linalg.cholesky(curvature)
    target = -solve_triangular(root, gradient, lower=True)
    return lsq_linear(root.T, target, (least, most), method="bvls").x
