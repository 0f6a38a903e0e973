"""Recursive least squares on the equations of motion, with stabilised forgetting.

For parameters theta in which the equations of motion are linear,

    M(theta) nu_r_dot - tau(theta; nu_r, actuation) = 0   becomes   y = Phi theta.

Phi is the derivative of the left side by theta, so that every model of the library that is
linear in what is chosen can be used, hull derivatives and masses alike. Both sides pass the
same low-pass filter `b^2 / (s + b)^2` (state-variable filter: Young 1981, Automatica 17(1);
Garnier and Wang 2008, chapter 1): the filtered acceleration is then a difference of two
filter states, and no noise is differentiated. What a filter takes from both sides alike
biases nothing. Left over is the bias of noise in the regressors, about the square of the
noise-to-signal ratio of the measured speeds.

Forgetting is the stabilised one of Kulhavy and Zarrop (1993, Int. J. Control 58(4)): the
geometric mean, with weights mu and 1 - mu, of what is known now and of the prior,

    R <- mu R + (1 - mu) R_0 + Phi' W Phi,   mu = exp(-dt / memory).

This is exponential forgetting whose loss is made up from the prior. Plain exponential
forgetting loses information that a straight run does not replace; its covariance grows
exponentially and the next manoeuvre throws the estimate anywhere (wind-up). Here the
covariance never exceeds the prior's, in any direction, and needs no rule for when a run is
exciting enough; what has not been excited for longer than `memory` returns to the prior mean.
"""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.online.choice import Choice, chosen, linear
from diffsea.kinematics import through_water
from diffsea.parameters import Parameter, replace
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation.integrate import history_length
from diffsea.types import Scalar, State
from diffsea.vessel.base import Force, Vessel
from diffsea.vessel.servo import OrderHistory


_SETTLING = 8.0  # over the bandwidth, s: 0.3 % of the filters' start is left
_PRIOR_SAMPLES = 5.0  # what the first guess of the noise counts
_LINEAR = 1e-9  # relative change of a column of Phi that is rounding


class Regression(eqx.Module):
    """What does not change while the estimator runs."""

    vessel: Vessel
    inertia: Float[Array, "3 3"]  # mass matrix at the prior mean
    inertia_slope: Float[Array, "3 3 parameter"]
    prior: Float[Array, "parameter parameter"]  # information of the prior, 1 / spread^2
    memory: Scalar  # s; infinite for none forgotten
    bandwidth: Scalar  # rad/s
    correlation: Scalar  # s in which the residual becomes another one
    fixed: Bool[Array, ""]  # whether the noise stays as first given
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    def at(self, coordinates: Float[Array, "parameter"]) -> Vessel:
        """The vessel with its parameters at these coordinates."""
        return _at(self.vessel, self.parameters, coordinates)


class Running(eqx.Module):
    """What has been learned by one instant."""

    t: Scalar  # s
    motion: Float[Array, "6"]  # last complete measurement
    executed: dict[str, Scalar]
    histories: dict[str, OrderHistory]
    since: Scalar  # s since that measurement
    impulse: dict[str, Scalar]  # executed value integrated since then
    age: Scalar  # s of data; negative before the first measurement
    velocity: Float[Array, "2 3"]  # the two filter states of the velocity through the water
    force: Float[Array, "2 3 column"]  # of the force at the prior mean, then of its derivatives
    information: Float[Array, "parameter parameter"]
    vector: Float[Array, "parameter"]
    variance: Float[Array, "3"]  # of the residual, N^2, N^2, (N m)^2
    samples: Scalar  # that the variance rests on
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    @property
    def coordinates(self) -> Float[Array, "parameter"]:
        """Estimate, in the prior's units from the prior mean."""
        return jnp.linalg.solve(self.information, self.vector)

    @property
    def spread(self) -> Float[Array, "parameter parameter"]:
        """Covariance of the coordinates."""
        return jnp.linalg.inv(self.information)

    @property
    def values(self) -> dict[str, Scalar]:
        """The parameters in SI units."""
        return {p.name: p.decode(c) for p, c in zip(self.parameters, self.coordinates, strict=True)}


class Residual(eqx.Module):
    """One row of the regression, filtered, and what it said."""

    target: Float[Array, "3"]  # y in N, N, N m
    regressor: Float[Array, "3 parameter"]  # Phi, per unit of coordinate
    weight: Float[Array, "3"]  # inverse variance times the row's share; zero where not used
    white: Float[Array, "3"]  # y less its prediction, in unit variance
    share: Float[Array, "3"]  # independent samples that the row counts for, 0 to 1
    change: Float[Array, "parameter"]  # of the coordinates, by this row
    settled: Float[Array, "parameter"]  # variance of the coordinates that it took away


def init(
    vessel: Vessel,
    free: Choice,
    *,
    memory: float = math.inf,
    bandwidth: float | None = None,
    disturbance_memory: float | None = None,
    noise: tuple[float, float, float] | None = None,
    orders: Mapping[str, float] | None = None,
    interval: float = 0.2,
    t: float = 0.0,
) -> tuple[Regression, Running]:
    """An estimator and what it knows before the first measurement.

    Arguments:
        free: the parameters to estimate, by name or as `Parameter`; bounds do not count here.
        memory: time constant of forgetting, s; infinite for ordinary least squares.
        bandwidth: of the low-pass filters, rad/s; by default sqrt(g / L), about that of the
            vessel itself.
        disturbance_memory: how long unmodelled forces last, s; by default 5 sqrt(L / g). With
            the filters' own it sets how much of each row is news: 2 T + 4 / bandwidth seconds
            of residual count as one sample.
        noise: standard deviation of the residual force (N, N, N m), then held fixed; by default
            it is estimated.
        orders: orders under which the actuators have settled; zero by default.
        interval: time between measurements, s: how many orders a delay must remember.

    Raises:
        UserError: an unknown name, a parameter in which the equations of motion are not
            linear, alone or together with another, or which they do not contain.
    """
    parameters = tuple(linear(parameter) for parameter in chosen(vessel, free))
    if not memory > 0:
        raise UserError("the memory of the forgetting must be a positive number of seconds")
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    _check_linear(vessel, parameters)
    scale, count = time_scale(float(vessel.rigid_body.length)), len(parameters)
    bandwidth = 1 / scale if bandwidth is None else bandwidth
    lasting = 5 * scale if disturbance_memory is None else disturbance_memory

    def inertia(coordinates: Float[Array, "parameter"]) -> Float[Array, "3 3"]:
        return _at(vessel, parameters, coordinates).mass_matrix()

    zero = jnp.zeros(count)
    regression = Regression(
        vessel,
        inertia(zero),
        jax.jacfwd(inertia)(zero),
        jnp.diag(jnp.array([parameter.spread**-2 for parameter in parameters])),
        *(jnp.asarray(x, float) for x in (memory, bandwidth, 2 * lasting + 4 / bandwidth)),
        jnp.asarray(noise is not None),
        parameters,
    )
    settled = {c: jnp.asarray(float((orders or {}).get(c, 0.0))) for c in vessel.channels}
    histories = {
        c: OrderHistory(jnp.linspace(-1e9, -1e8, n), jnp.full(n, settled[c]))
        for c, n in ((c, history_length(s, interval, 3.0)) for c, s in vessel.servos.items())
    }
    nothing = {c: jnp.zeros(()) for c in vessel.channels}
    std = _first_guess(vessel) if noise is None else jnp.array(noise)
    running = Running(
        jnp.asarray(t, float), jnp.zeros(6),
        {c: s.target(settled[c]) for c, s in vessel.servos.items()}, histories,
        jnp.zeros(()), nothing, jnp.asarray(-1.0), jnp.zeros((2, 3)),
        jnp.zeros((2, 3, count + 1)), regression.prior, zero, std**2,
        jnp.asarray(_PRIOR_SAMPLES), parameters,
    )  # fmt: skip
    return regression, running


def step(
    regression: Regression,
    running: Running,
    orders: dict[str, Scalar],
    measurement: Float[Array, "6"],
    dt: Scalar,
) -> tuple[Running, Residual]:
    """What is known `dt` s later, after a measurement there.

    Pure, for `jit` and `lax.scan`. A measurement without heading or one of the velocities
    waits for the next complete one.

    Arguments:
        orders: what held since the last step, by channel in that channel's unit.
        measurement: (x, y, psi, u, v, r) in m, rad, m/s, rad/s; NaN where there is none.
        dt: s since the last step; zero for the first measurement of a run.
    """
    vessel = regression.vessel
    histories = {c: h.push(running.t, orders[c]) for c, h in running.histories.items()}
    answer = {
        c: s.respond(running.executed[c], histories[c], running.t, dt)
        for c, s in vessel.servos.items()
    }
    since = running.since + dt
    impulse = {
        c: running.impulse[c] + dt / 6 * (a.start + 4 * a.middle + a.end) for c, a in answer.items()
    }
    complete = jnp.all(jnp.isfinite(measurement[2:]))
    first = running.age < 0
    held = {c: jnp.where(since > 0, i / jnp.where(since > 0, since, 1.0), answer[c].start)
            for c, i in impulse.items()}  # fmt: skip
    motion = jnp.where(complete, jnp.nan_to_num(measurement), running.motion)
    before, after = (
        _columns(regression, row, held, running.t)
        for row in (jnp.where(first, motion, running.motion), motion)
    )
    begin, end = (_through_water(vessel, row) for row in (running.motion, motion))
    velocity = jnp.where(
        first, jnp.stack([end, end]),
        _filtered(running.velocity, begin, end, since, regression.bandwidth),
    )  # fmt: skip
    force = jnp.where(
        first, jnp.stack([after, after]),
        _filtered(running.force, before, after, since, regression.bandwidth),
    )  # fmt: skip
    moved = Running(
        running.t + dt, motion, {c: a.final for c, a in answer.items()}, histories,
        jnp.where(complete, 0.0, since),
        {c: jnp.where(complete, 0.0, i) for c, i in impulse.items()},
        jnp.where(complete, jnp.maximum(running.age, 0.0) + jnp.where(first, 0.0, since),
                  running.age),
        jnp.where(complete, velocity, running.velocity),
        jnp.where(complete, force, running.force),
        running.information, running.vector, running.variance, running.samples,
        running.parameters,
    )  # fmt: skip
    return _learned(regression, moved, jnp.where(complete & ~first, since, 0.0))


def reset(
    regression: Regression, running: Running, coordinates: Float[Array, "parameter"]
) -> Running:
    """The same filters, the parameters back at `coordinates` with their prior's uncertainty.

    Forgetting still leads back to the prior mean.
    """
    prior = regression.prior
    learned = lambda r: (r.information, r.vector)
    return eqx.tree_at(learned, running, (prior, prior @ coordinates))


def _learned(regression: Regression, running: Running, span: Scalar) -> tuple[Running, Residual]:
    """One row of the regression that stands for `span` s; nothing where that is zero."""
    b = regression.bandwidth
    acceleration = b * (running.velocity[0] - running.velocity[1])
    target = running.force[1, :, 0] - regression.inertia @ acceleration
    slope = jnp.einsum("ijk,j->ik", regression.inertia_slope, acceleration)
    regressor = slope - running.force[1, :, 1:]
    used = (span > 0) & (running.age > _SETTLING / b)
    share = jnp.where(used, jnp.minimum(span / regression.correlation, 1.0), 0.0)
    weight = share / running.variance

    keep = jnp.exp(-span / regression.memory)
    faded = keep * running.information + (1 - keep) * regression.prior
    vector = keep * running.vector
    information = faded + (regressor.T * weight) @ regressor
    before = jnp.linalg.inv(faded)
    predicted = before @ vector
    vector = vector + (regressor.T * weight) @ target
    after = jnp.linalg.inv(information)

    error = target - regressor @ predicted
    known = jnp.sum((regressor @ before) * regressor, axis=1) / running.variance
    square = error**2 / (1 + known)
    samples = keep * running.samples + share
    pooled = (keep * running.samples * running.variance + share * square) / samples
    variance = jnp.where(regression.fixed, running.variance, pooled)
    white = jnp.where(used, error / jnp.sqrt(running.variance * (1 + known)), 0.0)
    residual = Residual(
        target, regressor, weight, white, jnp.full(3, share),
        after @ vector - predicted, jnp.maximum(jnp.diag(before) - jnp.diag(after), 0.0),
    )  # fmt: skip
    fields = lambda r: (r.information, r.vector, r.variance, r.samples)
    return eqx.tree_at(fields, running, (information, vector, variance, samples)), residual


def _at(
    vessel: Vessel, parameters: tuple[Parameter, ...], coordinates: Float[Array, "parameter"]
) -> Vessel:
    return replace(vessel, {p.name: p.decode(coordinates[k]) for k, p in enumerate(parameters)})


def _force(
    vessel: Vessel, motion: Float[Array, "6"], executed: dict[str, Scalar], t: Scalar
) -> Float[Array, "3"]:
    forces = vessel.breakdown(State(*motion), executed, vessel.environment, t).values()
    return sum(forces, Force()).stacked


def _columns(
    regression: Regression, motion: Float[Array, "6"], executed: dict[str, Scalar], t: Scalar
) -> Float[Array, "3 column"]:
    """The force at the prior mean and its derivative by every coordinate."""

    def force(coordinates: Float[Array, "parameter"]) -> tuple:
        made = _force(regression.at(coordinates), motion, executed, t)
        return made, made

    slope, made = jax.jacfwd(force, has_aux=True)(jnp.zeros(len(regression.parameters)))
    return jnp.concatenate([made[:, None], slope], axis=1)


def _through_water(vessel: Vessel, motion: Float[Array, "6"]) -> Float[Array, "3"]:
    water = through_water(State(*motion), vessel.environment)
    return jnp.stack([water.u, water.v, water.r])


def _filtered(
    stages: Float[Array, "2 ..."],
    begin: Float[Array, "..."],
    end: Float[Array, "..."],
    span: Scalar,
    b: Scalar,
) -> Float[Array, "2 ..."]:
    """Two equal lags in a row, exactly for an input that goes straight from begin to end."""
    slope = (end - begin) / jnp.where(span > 0, span, 1.0)
    decay = jnp.exp(-b * span)
    first = stages[0] - begin + slope / b
    second = stages[1] - begin + 2 * slope / b
    return jnp.stack([
        end - slope / b + first * decay,
        end - 2 * slope / b + (second + b * span * first) * decay,
    ])  # fmt: skip


def _first_guess(vessel: Vessel) -> Float[Array, "3"]:
    """Force that changes the speed by 1 % of that at Froude number 0.3 within sqrt(L / g)."""
    length = float(vessel.rigid_body.length)
    time = time_scale(length)
    rate = 0.01 * 0.3 * froude_speed(length) / time
    return jnp.diag(vessel.mass_matrix()) * rate * jnp.array([1.0, 1.0, 2 / length])


def _check_linear(vessel: Vessel, parameters: tuple[Parameter, ...]) -> None:
    """Compare Phi where one parameter after the other has been moved by its prior's spread."""
    count = len(parameters)
    motions, accelerations, executed = _samples(vessel)

    @jax.jit
    def jacobian(coordinates: Array) -> Array:
        def left(coordinates: Array, motion: Array, acceleration: Array, held: dict) -> Array:
            at = _at(vessel, parameters, coordinates)
            return at.mass_matrix() @ acceleration - _force(at, motion, held, 0.0)

        slope = jax.jacfwd(left)
        return jax.vmap(lambda m, a, e: slope(coordinates, m, a, e))(
            motions, accelerations, executed
        )

    nominal = np.asarray(jacobian(jnp.zeros(count)))
    size = np.abs(nominal).max((0, 1))
    for k, parameter in enumerate(parameters):
        if size[k] == 0:
            raise UserError(
                f"the equations of motion do not contain {parameter.name!r} (it may act within "
                "a servo or a sensor), so recursive least squares cannot estimate it; use the "
                "extended Kalman filter"
            )
    for j, moved in enumerate(parameters):
        there = np.asarray(jacobian(jnp.zeros(count).at[j].set(moved.spread)))
        change = np.abs(there - nominal).max((0, 1)) / size
        k = int(np.argmax(change))
        if change[k] > _LINEAR:
            together = "" if k == j else f" together with {parameters[k].name!r}"
            raise UserError(
                f"the equations of motion are not linear in {moved.name!r}{together}, which "
                "recursive least squares needs; hold it fixed or use the extended Kalman filter"
            )


def _samples(vessel: Vessel, count: int = 16) -> tuple[Array, Array, dict[str, Array]]:
    """Random motions, accelerations and actuation of this vessel's size."""
    rng = np.random.default_rng(0)
    length = float(vessel.rigid_body.length)
    speed = froude_speed(length, 0.3)
    sizes = np.array([length, length, 3.0, speed, 0.3 * speed, speed / length])
    motions = sizes * rng.uniform(-1, 1, (count, 6))
    accelerations = (
        sizes[3:] / time_scale(float(vessel.rigid_body.length)) * rng.uniform(-1, 1, (count, 3))
    )
    executed = {
        c: (1.0 if s.upper is None else float(s.upper)) * rng.uniform(-1, 1, count)
        for c, s in vessel.servos.items()
    }
    return jnp.asarray(motions), jnp.asarray(accelerations), jax.tree.map(jnp.asarray, executed)
