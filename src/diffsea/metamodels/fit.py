"""Norrbin's metamodel from several trials at once: one set of coefficients for all of them.

`identify` minimises the output error, as Gavrilin and Steen (2017) do, every trial with a first
yaw rate of its own and all that disturbs taken for white noise of the sensor.
`identify_by_likelihood` estimates each trial's steady wind and lasting gusts with the coefficients.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.data.dataset import ANY_SHAPE, DatasetShape
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.metamodels.norrbin import Norrbin
from diffsea.parameters import Parameter
from diffsea.recordings.conditioning import resample
from diffsea.trajectory import Trajectory
from diffsea.types import Scalar
from diffsea.vessel.effects import EFFECTS


MAX_STEPS = 25  # of Levenberg and Marquardt: enough from the regression's start
COMMON_MOMENT = 1e9  # a tie so stiff that trials have no moment of their own
OWN_MOMENTS = 1e-2  # a tie so weak that every trial's moment is free
NORRBIN_PARAMETERS = ("norrbin.a0", "norrbin.a1", "norrbin.a2", "norrbin.a3", "rudder.N_d")
# Rudder angle that wind of 10 m/s would ask for: it sets how far the trials' own moments may be
# from zero, three times as far for 15 m/s.
WIND_ANGLE = math.radians(1.0)  # rad


class Trials(eqx.Module):
    """Several trials on uniform clocks, padded to one length.

    One of which nothing is known is none: sets of different numbers can share a shape.
    """

    dt: Scalar  # s
    delta: Float[Array, "trial time"]  # rad, executed
    r: Float[Array, "trial time"]  # rad/s, measured; anything where not known
    known: Bool[Array, "trial time"]


class NorrbinFit(eqx.Module):
    """What least squares found. Coefficients in the order a_0, a_1, a_2, a_3, b."""

    model: Norrbin
    own: Float[Array, "trial 2"]  # first yaw rate (rad/s); own moment (rad/s^2), added to a_0
    predicted: Float[Array, "trial time"]  # rad/s
    scatter: Scalar  # rad/s, standard deviation of the residuals
    white: Float[Array, "5 5"]  # covariance, residuals taken for white noise
    clustered: Float[Array, "5 5"]  # covariance from the scatter between trials
    converged: Bool[Array, ""]


def trials_of(recordings: Sequence[Trajectory], dt: float, channel: str = "rudder") -> Trials:
    """Trials from recordings, resampled to `dt` s.

    Executed angles of the `channel` where they were measured, else the orders.

    Raises:
        UserError: a recording has no such channel or no yaw rate.
    """
    columns = []
    for run in recordings:
        if channel not in run.executed and channel not in run.commanded:
            names = ", ".join([*run.executed, *run.commanded]) or "none"
            raise UserError(f"{run.name} has no channel {channel!r}; it has: {names}")
        if not run.has("r"):
            message = "has no yaw rate (r); map one, or differentiate the heading"
            raise UserError(f"{run.name} {message}")
        even = resample(run, dt)
        group = even.executed if channel in even.executed else even.commanded
        columns.append((np.asarray(group[channel], float), np.asarray(even.r, float)))
    count = max(len(r) for _, r in columns)
    delta = np.stack([np.pad(a, (0, count - len(a)), "edge") for a, _ in columns])
    r = np.stack([np.pad(r, (0, count - len(r)), constant_values=np.nan) for _, r in columns])
    known = np.isfinite(r)
    measured = np.where(known, r, 0.0)
    return Trials(*(jnp.asarray(part) for part in (dt, delta, measured, known)))


def identify(trials: Trials, tie: Scalar = COMMON_MOMENT, steps: int = MAX_STEPS) -> NorrbinFit:
    """Coefficients that reproduce the yaw rates of all trials best, by least squares.

    With a `tie` of `COMMON_MOMENT` as published: all that disturbs is white noise. With
    `OWN_MOMENTS` every trial has a steady moment of its own (wind, trim, what the autopilot works
    against), and `a_0` is their mean: an autopilot answers a moment with rudder, so that without
    it rudder and disturbance are correlated and every coefficient is biased. The tie is the
    stiffness to the mean in units of what a trial itself says of its moment.

    Pure: `vmap` it over sets of trials, `jit` it. Starts from the regression of the integrated
    equation, which needs no first guess; at most `steps` of Levenberg and Marquardt.
    """
    theta, early = regression(trials), trials.known[:, :5]
    first_rates = jnp.sum(jnp.where(early, trials.r[:, :5], 0.0), 1) / jnp.maximum(
        early.sum(1, dtype=float), 1
    )
    own = jnp.stack([first_rates, jnp.zeros(trials.r.shape[0])], axis=1)
    stiffness = _normal_equations(theta, own, trials, 0.0)[0][:, 6, 6] * tie + 1e-300
    start = theta, own, _cost(theta, own, trials, stiffness), jnp.asarray(1e-2)

    def step(carry: tuple, _: None) -> tuple[tuple, None]:
        """Of Levenberg and Marquardt, withdrawn where it makes things worse."""
        theta, own, cost, damping = carry
        H, g = _normal_equations(theta, own, trials, stiffness)
        A, scores, share, alone = _eliminate_own(H, g, damping)
        size = jnp.sqrt(jnp.diag(A)) + 1e-150
        scaled = A / jnp.outer(size, size) + damping * jnp.eye(5)
        change = -jnp.linalg.solve(scaled, scores.sum(0) / size) / size
        mine = alone - jnp.einsum("nij,i->nj", share, change)
        after = _cost(theta + change, own + mine, trials, stiffness)
        better = after < cost
        damping = jnp.clip(jnp.where(better, damping / 10, damping * 10), 1e-12, 1e8)
        moved = theta + change, own + mine, after
        kept = jax.tree.map(lambda new, old: jnp.where(better, new, old), moved, carry[:3])
        return (*kept, damping), None

    theta, own, cost, _ = jax.lax.scan(step, start, length=steps)[0]
    return _summarise(theta, own, cost, trials, stiffness)


def regression(trials: Trials) -> Float[Array, "5"]:
    """Coefficients by linear least squares on the equation integrated once over each trial.

    `r(t) - r(0) = b I(delta) - a_0 t - a_1 I(r) - a_2 I(r^2) - a_3 I(r^3)`, the first yaw rate
    free. Integrals do not magnify noise as derivatives do; but noise in `r` biases it a little.
    """

    def columns(delta: Array, r: Array, known: Array) -> Array:
        known = known.astype(float)
        parts = jnp.stack([-jnp.ones_like(r), -r, -(r**2), -(r**3), delta])
        middle = 0.5 * (parts[:, 1:] + parts[:, :-1]) * trials.dt
        integral = jnp.concatenate([jnp.zeros((5, 1)), jnp.cumsum(middle, axis=1)], axis=1)
        rows = jnp.concatenate([integral, r[None]]) * known
        # The free first yaw rate takes the mean of everything out.
        return (rows - known * rows.sum(1, keepdims=True) / jnp.maximum(known.sum(), 1)).T

    rows = jax.vmap(columns)(trials.delta, trials.r, trials.known).reshape(-1, 6)
    A, y = rows[:, :5], rows[:, 5]
    size = jnp.sqrt(jnp.sum(A**2, axis=0)) + 1e-300
    A = A / size
    # A touch of ridge: trials under one angle alone do not tell the terms apart.
    return jnp.linalg.solve(A.T @ A + 1e-6 * jnp.eye(5), A.T @ y) / size


def _simulate(theta: Array, own: Array, trials: Trials) -> Array:
    def simulate(mine: Array, delta: Array) -> Array:
        return Norrbin.of(theta.at[0].add(mine[1])).simulate(mine[0], delta, trials.dt)

    return jax.vmap(simulate)(own, trials.delta)


def _residual(predicted: Array, trials: Trials) -> Array:
    """Simulated less measured; large but finite where a simulation runs away."""
    wild = 1e3 * jnp.max(jnp.abs(trials.r))
    off = jnp.where(jnp.isfinite(predicted), predicted - trials.r, wild)
    return jnp.where(trials.known, jnp.clip(off, -wild, wild), 0.0)


def _cost(theta: Array, own: Array, trials: Trials, stiffness: Array) -> Array:
    misfit = jnp.sum(_residual(_simulate(theta, own, trials), trials) ** 2)
    return misfit + jnp.sum(stiffness * own[:, 1] ** 2)


def _normal_equations(
    theta: Array, own: Array, trials: Trials, stiffness: Scalar
) -> tuple[Array, Array]:
    """Per trial: the Gauss-Newton matrix of the coefficients and its own numbers; the gradient."""

    def one(mine: Array, delta: Array, measured: Array, known: Array) -> tuple[Array, Array]:
        alone = Trials(trials.dt, delta[None], measured[None], known[None])

        def residual(seven: Array) -> Array:
            return _residual(_simulate(seven[:5], seven[None, 5:], alone), alone)[0]

        seven = jnp.append(theta, mine)
        J = jax.jacfwd(residual)(seven)
        return J.T @ J, J.T @ residual(seven)

    H, g = jax.vmap(one)(own, trials.delta, trials.r, trials.known)
    return H.at[:, 6, 6].add(stiffness), g.at[:, 6].add(stiffness * own[:, 1])


def _eliminate_own(H: Array, g: Array, damping: Scalar) -> tuple[Array, Array, Array, Array]:
    """Matrix and gradients of the coefficients, each trial's own numbers eliminated.

    Besides: how those follow the coefficients, and their own steps.
    """
    size = jnp.sqrt(jnp.diagonal(H[:, 5:, 5:], axis1=1, axis2=2))
    size = jnp.where(size > 0, size, 1.0)  # of a trial of which nothing is known
    both = size[:, :, None] * size[:, None, :]
    inner = H[:, 5:, 5:] / both + (damping + 1e-12) * jnp.eye(2)
    inverse = jnp.linalg.inv(inner) / both
    share = jnp.einsum("nij,njk->nik", H[:, :5, 5:], inverse)
    A = jnp.sum(H[:, :5, :5] - jnp.einsum("nij,njk->nik", share, H[:, 5:, :5]), axis=0)
    scores = g[:, :5] - jnp.einsum("nij,nj->ni", share, g[:, 5:])
    return A, scores, share, -jnp.einsum("nij,nj->ni", inverse, g[:, 5:])


def _summarise(
    theta: Array, own: Array, cost: Array, trials: Trials, stiffness: Array
) -> NorrbinFit:
    A, scores, _, _ = _eliminate_own(*_normal_equations(theta, own, trials, stiffness), 0.0)
    size = jnp.sqrt(jnp.diag(A)) + 1e-150
    inverse = jnp.linalg.inv(A / jnp.outer(size, size)) / jnp.outer(size, size)
    predicted = _simulate(theta, own, trials)
    count = trials.known.sum(dtype=float)
    number = trials.known.any(axis=1).sum(dtype=float)
    left = jnp.sum(_residual(predicted, trials) ** 2)
    # What another Gauss-Newton step promises to gain, against what is left or was there at all.
    gain = scores.sum(0) @ inverse @ scores.sum(0)
    little = 1e-3 * cost + 1e-12 * jnp.sum(jnp.where(trials.known, trials.r, 0.0) ** 2)
    variance = left / jnp.maximum(count - 5 - number, 1)
    spread = scores.T @ scores * number / jnp.maximum(number - 1, 1)
    return NorrbinFit(
        model=Norrbin.of(theta),
        own=own,
        predicted=predicted,
        scatter=jnp.sqrt(variance),
        white=variance * inverse,
        clustered=inverse @ spread @ inverse,
        converged=gain < little,
    )


class LikelihoodFit(NamedTuple):
    """What the likelihood found."""

    model: Norrbin
    covariance: Float[np.ndarray, "5 5"]  # in the order a_0, a_1, a_2, a_3, b


def identify_by_likelihood(
    recordings: Sequence[Trajectory],
    start: Norrbin,
    length: float,
    speed: float,
    least: DatasetShape = ANY_SHAPE,
) -> LikelihoodFit:
    """Coefficients by the innovation likelihood, disturbances of every trial as nuisances.

    Arguments:
        recordings: trials with yaw rate, heading or both, and the rudder (rad).
        start: where to start from, such as what `identify` found.
        length: of the vessel, m; with it sizes of gusts are judged.
        speed: of the trials, m/s.
        least: shape of the dataset; fits of one shape share their compiled programs.

    Wind is each trial's own, two components in the earth, zero on average over trials; gusts
    of yaw acceleration that last have their strength and memory estimated.
    """
    runs = [_yaw_only(run, speed) for run in recordings]
    b = float(start.b)
    vessel = start.vessel(length, speed, wind_moment=WIND_ANGLE * b)
    # Wide normal priors about the start: they rule nothing out.
    T, usual = 1 / max(abs(float(start.a1)), 1e-6), math.radians(0.5)  # s, rad/s
    sizes = (abs(b) * math.radians(2.0), 1 / T, 1 / (T * usual), 1 / (T * usual**2), abs(b))
    values = zip(NORRBIN_PARAMETERS, jax.tree.leaves(start), sizes, strict=True)
    priors = {name: Parameter(name, float(x), float(size), 3.0) for name, x, size in values}
    problem = make_problem(
        vessel,
        runs,
        NORRBIN_PARAMETERS,
        (EFFECTS["wind"],),
        per_run=True,
        priors=priors,
        least=least,
    )
    found = estimate(problem, (*NORRBIN_PARAMETERS, "wind"))
    parameters = problem.layout.parameters
    values = {p.name: p.decode(c) for p, c in zip(parameters, found.coordinates, strict=False)}
    scale = np.array([p.scale for p in parameters])
    order = [problem.layout.indices((name,))[0] for name in NORRBIN_PARAMETERS]
    place = [list(found.index).index(k) for k in order]
    covariance = found.covariance[np.ix_(place, place)] * np.outer(scale[order], scale[order])
    model = Norrbin(*(float(values[name]) for name in NORRBIN_PARAMETERS))
    return LikelihoodFit(model, covariance)


def _yaw_only(run: Trajectory, speed: float) -> Trajectory:
    """The recording without what the metamodel says nothing of, at its constant speed."""
    nothing, steady = (np.full(np.shape(run.t), value) for value in (np.nan, speed))
    rudder = {
        group: {c: s for c, s in getattr(run, group).items() if c == "rudder"}
        for group in ("commanded", "executed")
    }
    return dataclasses.replace(
        run, x=nothing, y=nothing, u=steady, v=0 * steady, extra={}, **rudder
    )
