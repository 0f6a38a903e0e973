"""Recursive least squares on the equations of motion, with stabilised forgetting.

For parameters theta in which the equations of motion are linear,

    M(theta) nu_r_dot - tau(theta; nu_r, actuation) = 0   becomes   y = Phi theta.

Phi is the derivative of the left side by theta, so that every model of the library that is
linear in what is chosen can be used, hull derivatives and masses alike. Both sides pass the
same low-pass filter `b^2 / (s + b)^2` (state-variable filter: Young 1981, Automatica 17(1);
Garnier and Wang 2008, chapter 1): the filtered acceleration is then a difference of two
filter states, and no noise is differentiated. Left over is the bias of noise in the regressors,
about the square of the noise-to-signal ratio of the measured speeds.

Forgetting is the stabilised one of Kulhavy and Zarrop (1993, Int. J. Control 58(4)): the
geometric mean, with weights mu and 1 - mu, of what is known now and of the prior,

    R <- mu R + (1 - mu) R_0 + Phi' W Phi,   mu = exp(-dt / memory).

Plain exponential forgetting loses information that a straight run does not replace, and the next
manoeuvre throws the estimate anywhere (wind-up). Here the loss is made up from the prior: the
covariance never exceeds the prior's, in any direction, and what has not been excited for longer
than `memory` returns to the prior mean.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.online.estimator import (
    AbstractBelief,
    AbstractEstimator,
    Innovation,
    Measurement,
    Orders,
    ParameterChoice,
    decode_parameters,
    parameters_with_priors,
    with_measured_actuation,
    without_bounds,
)
from diffsea.kinematics import through_water
from diffsea.parameters import Parameter, replace
from diffsea.scales import froude_speed, time_scale
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.forces import Force
from diffsea.vessel.servo import OrderHistory


_SETTLING = 8.0  # over the bandwidth, s: 0.3 % of the filters' start is left
_PRIOR_SAMPLES = 5.0  # what the first guess of the noise counts
_ROUNDING = 1e-9  # relative change of a column of Phi that is rounding


class RegressionBelief(AbstractBelief):
    """Information on the parameters, and the filtered signals of the next row."""

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

    @property
    def coordinates(self) -> Float[Array, "parameter"]:
        return jnp.linalg.solve(self.information, self.vector)

    @property
    def parameter_covariance(self) -> Float[Array, "parameter parameter"]:
        return jnp.linalg.inv(self.information)


class EquationError(Innovation):
    """One row of the regression, filtered, and what it said."""

    target: Float[Array, "3"]  # y in N, N, N m
    regressor: Float[Array, "3 parameter"]  # Phi, per unit of coordinate
    weight: Float[Array, "3"]  # inverse variance times the row's share; zero where not used


class RecursiveLeastSquares(AbstractEstimator[RegressionBelief]):
    """The regression of one vessel's equations of motion; made by `recursive_least_squares`."""

    channels: ClassVar[tuple[str, ...]] = ("surge force", "sway force", "yaw moment")

    inertia: Float[Array, "3 3"]  # mass matrix at the prior mean
    inertia_slope: Float[Array, "3 3 parameter"]
    prior: Float[Array, "parameter parameter"]  # information of the prior, 1 / spread^2
    memory: Scalar  # s; infinite for none forgotten
    bandwidth: Scalar  # rad/s
    correlation: Scalar  # s in which the residual becomes another one
    fixed: Bool[Array, ""]  # whether the noise stays as first given
    first_variance: Float[Array, "3"]  # of the residual, N^2, N^2, (N m)^2
    interval: float = eqx.field(static=True)  # s between measurements

    def init(
        self, start: State, *, orders: Mapping[str, Scalar] | None = None, t: float = 0.0
    ) -> RegressionBelief:
        """The belief before the first measurement, which takes the place of `start`."""
        motion = self.settled_motion(start, orders, self.interval)
        zero, count = jnp.zeros(()), len(self.parameters)
        return RegressionBelief(
            t=jnp.asarray(t, float),
            motion=jnp.zeros(6),
            executed=motion.executed,
            histories=motion.histories,
            since=zero,
            impulse=dict.fromkeys(self.vessel.channels, zero),
            age=jnp.asarray(-1.0),
            velocity=jnp.zeros((2, 3)),
            force=jnp.zeros((2, 3, count + 1)),
            information=self.prior,
            vector=jnp.zeros(count),
            variance=self.first_variance,
            samples=jnp.asarray(_PRIOR_SAMPLES),
            parameters=self.parameters,
        )

    def step(
        self, belief: RegressionBelief, orders: Orders, measurement: Measurement, dt: Scalar
    ) -> tuple[RegressionBelief, EquationError]:
        """Filtered signals `dt` s later; one row more if heading and velocities were measured."""

        def velocity_through_water(row: Float[Array, "6"]) -> Float[Array, "3"]:
            water = through_water(State(*row), self.vessel.environment)
            return jnp.stack([water.u, water.v, water.r])

        histories = {c: h.push(belief.t, orders[c]) for c, h in belief.histories.items()}
        servos, since = self.vessel.servos, belief.since + dt
        answer = {
            c: s.respond(belief.executed[c], histories[c], belief.t, dt) for c, s in servos.items()
        }
        impulse = {
            c: belief.impulse[c] + dt / 6 * (a.start + 4 * a.middle + a.end)
            for c, a in answer.items()
        }
        complete, first = jnp.all(jnp.isfinite(measurement[2:])), belief.age < 0
        mean: dict[str, Scalar] = {
            c: jnp.where(since > 0, i / jnp.where(since > 0, since, 1.0), answer[c].start)
            for c, i in impulse.items()
        }
        motion = jnp.where(complete, jnp.nan_to_num(measurement), belief.motion)
        before, after = (
            self._force_columns(row, mean, belief.t)
            for row in (jnp.where(first, motion, belief.motion), motion)
        )
        begin, end = (velocity_through_water(row) for row in (belief.motion, motion))
        velocity = _low_pass(belief.velocity, begin, end, since, self.bandwidth)
        velocity = jnp.where(first, jnp.stack([end, end]), velocity)
        force = _low_pass(belief.force, before, after, since, self.bandwidth)
        force = jnp.where(first, jnp.stack([after, after]), force)
        age = jnp.maximum(belief.age, 0.0) + jnp.where(first, 0.0, since)
        advanced = dataclasses.replace(
            belief,
            t=belief.t + dt,
            motion=motion,
            executed={c: a.final for c, a in answer.items()},
            histories=histories,
            since=jnp.where(complete, 0.0, since),
            impulse={c: jnp.where(complete, 0.0, i) for c, i in impulse.items()},
            age=jnp.where(complete, age, belief.age),
            velocity=jnp.where(complete, velocity, belief.velocity),
            force=jnp.where(complete, force, belief.force),
        )
        return self._update(advanced, jnp.where(complete & ~first, since, 0.0))

    def reset(
        self, belief: RegressionBelief, coordinates: Float[Array, "parameter"]
    ) -> RegressionBelief:
        # Forgetting still leads back to the prior mean.
        return dataclasses.replace(belief, information=self.prior, vector=self.prior @ coordinates)

    def _update(
        self, belief: RegressionBelief, span: Scalar
    ) -> tuple[RegressionBelief, EquationError]:
        """One row of the regression that stands for `span` s; nothing where that is zero."""
        b = self.bandwidth
        acceleration = b * (belief.velocity[0] - belief.velocity[1])
        target = belief.force[1, :, 0] - self.inertia @ acceleration
        slope = jnp.einsum("ijk,j->ik", self.inertia_slope, acceleration)
        regressor = slope - belief.force[1, :, 1:]
        used = (span > 0) & (belief.age > _SETTLING / b)
        share = jnp.where(used, jnp.minimum(span / self.correlation, 1.0), 0.0)
        weight = share / belief.variance

        keep = jnp.exp(-span / self.memory)
        faded = keep * belief.information + (1 - keep) * self.prior
        vector = keep * belief.vector
        information = faded + (regressor.T * weight) @ regressor
        before = jnp.linalg.inv(faded)
        predicted = before @ vector
        vector = vector + (regressor.T * weight) @ target
        after = jnp.linalg.inv(information)

        error = target - regressor @ predicted
        known = jnp.sum((regressor @ before) * regressor, axis=1) / belief.variance
        square = error**2 / (1 + known)
        samples = keep * belief.samples + share
        pooled = (keep * belief.samples * belief.variance + share * square) / samples
        variance = jnp.where(self.fixed, belief.variance, pooled)
        innovation = EquationError(
            target=target,
            regressor=regressor,
            weight=weight,
            white=jnp.where(used, error / jnp.sqrt(belief.variance * (1 + known)), 0.0),
            share=jnp.full(3, share),
            change=after @ vector - predicted,
            settled=jnp.maximum(jnp.diag(before) - jnp.diag(after), 0.0),
        )
        updated = dataclasses.replace(
            belief, information=information, vector=vector, variance=variance, samples=samples
        )
        return updated, innovation

    def _force_columns(
        self, motion: Float[Array, "6"], executed: dict[str, Scalar], t: Scalar
    ) -> Float[Array, "3 column"]:
        """The force at the prior mean and its derivative by every coordinate."""

        def force(coordinates: Float[Array, "parameter"]) -> tuple:
            total = _total_force(self.vessel_at(coordinates), motion, executed, t)
            return total, total

        slope, total = jax.jacfwd(force, has_aux=True)(jnp.zeros(len(self.parameters)))
        return jnp.concatenate([total[:, None], slope], axis=1)


def recursive_least_squares(
    vessel: Vessel,
    free: ParameterChoice,
    *,
    memory: float = math.inf,
    bandwidth: float | None = None,
    disturbance_memory: float | None = None,
    noise: tuple[float, float, float] | None = None,
    measured: tuple[str, ...] = (),
    interval: float = 0.2,
) -> RecursiveLeastSquares:
    """The recursive least squares of a vessel and some of its parameters.

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
        measured: channels whose executed value is measured. `step` takes it for their order.
        interval: time between measurements, s: how many orders a delay must remember.

    Raises:
        UserError: an unknown name, a parameter in which the equations of motion are not
            linear, alone or together with another, or which they do not contain.
    """
    vessel = with_measured_actuation(vessel, measured)
    parameters = tuple(without_bounds(p) for p in parameters_with_priors(vessel, free))
    if not memory > 0:
        raise UserError("the memory of the forgetting must be a positive number of seconds")
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    _check_linear(vessel, parameters)
    length = float(vessel.rigid_body.length)
    scale = time_scale(length)
    bandwidth = 1 / scale if bandwidth is None else bandwidth
    lasting = 5 * scale if disturbance_memory is None else disturbance_memory

    def inertia(coordinates: Float[Array, "parameter"]) -> Float[Array, "3 3"]:
        return replace(vessel, decode_parameters(parameters, coordinates)).mass_matrix()

    if noise is None:
        # Force that changes the speed by 1 % of that at Froude number 0.3 within sqrt(L / g).
        rate = 0.01 * 0.3 * froude_speed(length) / scale
        std = jnp.diag(vessel.mass_matrix()) * rate * jnp.array([1.0, 1.0, 2 / length])
    else:
        std = jnp.array(noise)
    zero = jnp.zeros(len(parameters))
    return RecursiveLeastSquares(
        vessel=vessel,
        parameters=parameters,
        inertia=inertia(zero),
        inertia_slope=jax.jacfwd(inertia)(zero),
        prior=jnp.diag(jnp.array([parameter.spread**-2 for parameter in parameters])),
        memory=jnp.asarray(memory, float),
        bandwidth=jnp.asarray(bandwidth, float),
        correlation=jnp.asarray(2 * lasting + 4 / bandwidth, float),
        fixed=jnp.asarray(noise is not None),
        first_variance=std**2,
        interval=interval,
    )


def _total_force(
    vessel: Vessel, motion: Float[Array, "6"], executed: dict[str, Scalar], t: Scalar
) -> Float[Array, "3"]:
    forces = vessel.breakdown(State(*motion), executed, vessel.environment, t).values()
    return sum(forces, Force()).stacked


def _low_pass(
    stages: Float[Array, "2 ..."], begin: Array, end: Array, span: Scalar, b: Scalar
) -> Float[Array, "2 ..."]:
    """Two equal lags in a row, exactly for an input that goes straight from begin to end."""
    slope = (end - begin) / jnp.where(span > 0, span, 1.0)
    decay = jnp.exp(-b * span)
    first = stages[0] - begin + slope / b
    second = stages[1] - begin + 2 * slope / b
    after = end - 2 * slope / b + (second + b * span * first) * decay
    return jnp.stack([end - slope / b + first * decay, after])


def _check_linear(vessel: Vessel, parameters: tuple[Parameter, ...]) -> None:
    """Compare Phi, at random motions of the vessel's size, with one parameter moved by its spread.

    Raises:
        UserError: the equations of motion do not contain a parameter, or are not linear in it.
    """
    rng = np.random.default_rng(0)
    length, count = float(vessel.rigid_body.length), 16
    speed = froude_speed(length, 0.3)
    sizes = np.array([length, length, 3.0, speed, 0.3 * speed, speed / length])
    motions = sizes * rng.uniform(-1, 1, (count, 6))
    accelerations = sizes[3:] / time_scale(length) * rng.uniform(-1, 1, (count, 3))
    executed = {}
    for c, s in vessel.servos.items():
        neutral = 0.0 if s.neutral is None else float(s.neutral)
        reach = 1.0 if s.upper is None else float(s.upper) - neutral
        executed[c] = neutral + reach * rng.uniform(-1, 1, count)
    rows = jax.tree.map(jnp.asarray, (motions, accelerations, executed))

    def left_side(coordinates: Array, motion: Array, rate: Array, executed: Orders) -> Array:
        at = replace(vessel, decode_parameters(parameters, coordinates))
        return at.mass_matrix() @ rate - _total_force(at, motion, executed, 0.0)

    @jax.jit
    def jacobian(coordinates: Array) -> Float[Array, "motion 3 parameter"]:
        return jax.vmap(lambda *row: jax.jacfwd(left_side)(coordinates, *row))(*rows)

    zero = jnp.zeros(len(parameters))
    nominal = np.asarray(jacobian(zero))
    size = np.abs(nominal).max((0, 1))
    for parameter, largest in zip(parameters, size, strict=True):
        if largest == 0:
            raise UserError(
                f"the equations of motion do not contain {parameter.name!r} (it may act within "
                "a servo or a sensor), so recursive least squares cannot estimate it; use the "
                "extended Kalman filter"
            )
    for j, moved in enumerate(parameters):
        there = np.asarray(jacobian(zero.at[j].set(moved.spread)))
        change = np.abs(there - nominal).max((0, 1)) / size
        k = int(np.argmax(change))
        if change[k] > _ROUNDING:
            together = "" if k == j else f" together with {parameters[k].name!r}"
            raise UserError(
                f"the equations of motion are not linear in {moved.name!r}{together}, which "
                "recursive least squares needs; hold it fixed or use the extended Kalman filter"
            )
