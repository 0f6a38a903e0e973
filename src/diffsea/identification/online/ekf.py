"""Extended Kalman filter of a vessel's motion and its parameters together.

The state is `(x, y, psi, u, v, r)`, three accelerations of lasting gusts, the executed
values of channels that lag their orders, and the coordinates of the parameters. Parameters
are those of `diffsea.parameters`: a coordinate is zero at the prior mean and keeps the number
within its bounds. The steady current counts among them (`current_north`, `current_east`).

Process noise are white and lasting gusts on `u`, `v`, `r`, as in the offline fit
(`filter.process_noise`), and a random walk of each coordinate: what was learned t seconds ago
counts with `drift^2 t` added to its variance, which is how the filter forgets. There is none on
position and heading, which follow from the speeds, and none on executed actuation.

Time and measurement updates are the textbook's (Jazwinski 1970, section 8.3), the Jacobians
exact, the covariance updated in Joseph's form one channel after the other (Bierman 1977).
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
from diffsea.identification.filter.covariance import Noise, gust_propagation, matrix_product
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.online.estimator import (
    AbstractBelief,
    AbstractEstimator,
    Innovation,
    Measurement,
    Orders,
    ParameterChoice,
    parameters_with_priors,
    prior_std,
    with_measured_actuation,
)
from diffsea.kinematics import wrap
from diffsea.scales import time_scale
from diffsea.simulation.integrate import SimulationState, advance
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import OrderHistory


_IS_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")
_SPEEDS, _GUSTS = slice(3, 6), slice(6, 9)  # where they stand in the filter's state


class KalmanBelief(AbstractBelief):
    """Normal distribution of motion, lasting gusts, lagging actuation and coordinates."""

    mean: Float[Array, "n"]
    covariance: Float[Array, "n n"]
    histories: dict[str, OrderHistory]

    @property
    def coordinates(self) -> Float[Array, "parameter"]:
        return self.mean[self.mean.size - len(self.parameters) :]

    @property
    def parameter_covariance(self) -> Float[Array, "parameter parameter"]:
        first = self.mean.size - len(self.parameters)
        return self.covariance[first:, first:]


class KalmanInnovation(Innovation):
    """What one measurement said beyond what was expected of it."""

    used: Bool[Array, "6"]

    @property
    def nis(self) -> Scalar:
        """Normalised innovation squared, `e' S^-1 e`: chi-squared, `used` degrees of freedom."""
        return jnp.sum(self.white**2)


class ExtendedKalmanFilter(AbstractEstimator[KalmanBelief]):
    """The filter of one vessel; made by `kalman_filter`."""

    channels: ClassVar[tuple[str, ...]] = MOTION_CHANNELS

    noise: Noise
    drift: Float[Array, "parameter"]  # of the coordinates, per square root of a second
    lagging: tuple[str, ...] = eqx.field(static=True)  # channels that lag their orders
    interval: float = eqx.field(static=True)  # s, longest time between measurements
    substeps: int = eqx.field(static=True)

    def init(
        self, start: State, *, orders: Mapping[str, Scalar] | None = None, t: float = 0.0
    ) -> KalmanBelief:
        """The belief before the first measurement.

        Its standard deviations are half a ship's length, half a radian and the speeds of a Froude
        number of 0.5 about `start`, and those of the priors.
        """
        motion = self.settled_motion(start, orders, self.interval / self.substeps)
        mean = self._stack(motion, jnp.zeros(3), jnp.zeros(len(self.parameters)))
        motion_variance, gusts = first_variance(self.vessel), jnp.exp(2 * self.noise.slow)
        lags, prior = jnp.zeros(len(self.lagging)), prior_std(self.parameters) ** 2
        covariance = jnp.diag(jnp.concatenate([motion_variance, gusts, lags, prior]))
        now = jnp.asarray(t, float)
        return KalmanBelief(now, self.parameters, mean, covariance, motion.histories)

    def step(
        self, belief: KalmanBelief, orders: Orders, measurement: Measurement, dt: Scalar
    ) -> tuple[KalmanBelief, KalmanInnovation]:
        """Prediction over `dt` s and update by the measurement at their end."""
        return self.update(self.predict(belief, orders, dt), orders, measurement)

    def predict(self, belief: KalmanBelief, orders: Orders, dt: Scalar) -> KalmanBelief:
        """The belief `dt` s later under these orders, nothing measured."""
        row = jnp.asarray(dt, float)[None]
        gusts, Q = jax.tree.map(lambda leaf: leaf[0], gust_propagation(self.noise, row))

        def propagate(z: Float[Array, "n"]) -> tuple:
            impulse = gusts.half * z[_GUSTS]
            pushed = z.at[_SPEEDS].add(impulse)
            vessel, motion = self._vessel_and_motion(pushed, belief.histories, orders)
            part = dt / self.substeps
            for k in range(self.substeps):
                t = belief.t + k * part
                motion = advance(vessel, motion, orders, vessel.environment, t, part)
            after = self._stack(motion, gusts.decay * z[_GUSTS], z[self._first :])
            after = after.at[_SPEEDS].add(impulse)
            return after, (after, motion.histories)

        F, (mean, histories) = jax.jacfwd(propagate, has_aux=True)(belief.mean)
        walk = jnp.diag(jnp.concatenate([jnp.zeros(len(self.lagging)), self.drift**2 * dt]))
        P = matrix_product(matrix_product(F, belief.covariance), F.T)
        P = P.at[:9, :9].add(Q).at[9:, 9:].add(walk)
        return dataclasses.replace(
            belief, t=belief.t + dt, mean=mean, covariance=0.5 * (P + P.T), histories=histories
        )

    def update(
        self, belief: KalmanBelief, orders: Orders, measurement: Measurement
    ) -> tuple[KalmanBelief, KalmanInnovation]:
        """The belief after a measurement (NaN where missing) at the same instant."""

        def expect(z: Float[Array, "n"]) -> tuple:
            """What the sensors show; their latencies need the state's first two derivatives."""
            vessel, motion = self._vessel_and_motion(z, belief.histories, orders)

            def rate(at: State) -> State:
                return vessel.rate(at, motion.executed, vessel.environment, 0.0)

            state = jax.tree.map(jnp.asarray, motion.state)
            first, second = jax.jvp(rate, (state,), (rate(state),))
            reading = vessel.sensors.measure(state, first, second)
            reading = reading + vessel.sensors.steps(belief.t, self.interval)
            return reading, reading

        H, reading = jax.jacfwd(expect, has_aux=True)(belief.mean)
        used = jnp.isfinite(measurement)
        innovation = jnp.where(used, measurement, 0.0) - reading
        innovation = jnp.where(_IS_HEADING, wrap(innovation), innovation)
        innovation = jnp.where(used, innovation, 0.0)
        R = jnp.exp(2 * self.noise.sensor)
        shift, P, white = jnp.zeros_like(belief.mean), belief.covariance, []
        for j in range(6):
            h = jnp.where(used[j], H[j], 0.0)
            Ph = jnp.sum(P * h, axis=1)
            s = jnp.where(used[j], jnp.sum(h * Ph) + R[j], 1.0)
            fresh = innovation[j] - jnp.sum(h * shift)
            gain = Ph / s
            shift = shift + gain * fresh
            left = P - gain[:, None] * Ph
            spare = jnp.sum(left * h, axis=1) - R[j] * gain
            P = left - spare[:, None] * gain
            white.append(fresh / jnp.sqrt(s))
        mean, P = belief.mean + shift, 0.5 * (P + P.T)
        after = dataclasses.replace(belief, mean=mean, covariance=P)
        lost = jnp.diag(belief.parameter_covariance) - jnp.diag(after.parameter_covariance)
        return after, KalmanInnovation(
            white=jnp.stack(white),
            share=used.astype(float),
            change=after.coordinates - belief.coordinates,
            settled=jnp.maximum(lost, 0.0),
            used=used,
        )

    def reset(self, belief: KalmanBelief, coordinates: Float[Array, "parameter"]) -> KalmanBelief:
        first = self._first
        P = belief.covariance.at[first:, :].set(0.0).at[:, first:].set(0.0)
        P = P.at[first:, first:].set(jnp.diag(jnp.asarray(prior_std(self.parameters)) ** 2))
        mean = belief.mean.at[first:].set(coordinates)
        return dataclasses.replace(belief, mean=mean, covariance=P)

    @property
    def _first(self) -> int:
        """Where the coordinates begin in the state."""
        return 9 + len(self.lagging)

    def _stack(self, motion: SimulationState, gusts: Array, coordinates: Array) -> Array:
        """The filter's state, (n,)."""
        numbers = [getattr(motion.state, c) for c in MOTION_CHANNELS]
        numbers = [*numbers, *gusts, *(motion.executed[c] for c in self.lagging), *coordinates]
        return jnp.stack([jnp.asarray(number, float) for number in numbers])

    def _vessel_and_motion(
        self, z: Float[Array, "n"], histories: dict[str, OrderHistory], orders: Orders
    ) -> tuple[Vessel, SimulationState]:
        """What a state of the filter says, channels that do not lag executing their orders."""
        vessel = self.vessel_at(z[self._first :])
        executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
        executed |= {c: z[9 + k] for k, c in enumerate(self.lagging)}
        return vessel, SimulationState(State(*z[:6]), executed, histories)


def kalman_filter(
    vessel: Vessel,
    free: ParameterChoice,
    noise: Noise,
    *,
    drift: float | Mapping[str, float] = 0.0,
    measured: tuple[str, ...] = (),
    interval: float = 0.2,
) -> ExtendedKalmanFilter:
    """The extended Kalman filter of a vessel and some of its parameters.

    Arguments:
        free: the parameters to estimate, by name (prior about the vessel's own number) or as
            `Parameter`. At least one number of mass or thrust must stay fixed: motion and
            orders leave a common factor of mass, drag and thrust undetermined.
        noise: gust and sensor noise, from an offline fit or `noise_prior`.
        drift: random walk of the coordinates per square root of a second, one for all or by
            name; a parameter kept positive or negative has its logarithm as coordinate, so
            that 0.01 lets it change by 10 % in 100 s.
        measured: channels whose executed value is measured. `step` takes it for their order.
        interval: longest time between measurements, s; only the integration's step depends on it.

    Raises:
        UserError: an unknown name, a parameter without a scale, a drift below zero, or a vessel
            whose clock is off or whose heading is an estimator's: measurements come with the orders
            of their moment, and by themselves, here.
    """
    if vessel.sensors.clock is not None:
        raise UserError(
            "the vessel has the effect clock-drift; online, stamp measurements with the clock of "
            "the orders and take the effect out of the vessel file"
        )
    if vessel.sensors.estimated_headings:
        raise UserError(
            "the vessel has the effect hard-iron of an estimator's heading; online, give compass "
            "and the gyro as they are and take the effect out of the vessel file"
        )
    parameters = parameters_with_priors(vessel, free)
    names = [parameter.name for parameter in parameters]
    drifts = drift if isinstance(drift, Mapping) else dict.fromkeys(names, drift)
    for name in drifts:
        if name not in names:
            raise UserError(f"drift is given for {name!r}, which is not estimated")
    walks = [float(drifts.get(name, 0.0)) for name in names]
    if any(not (math.isfinite(walk) and walk >= 0) for walk in walks):
        raise UserError("a drift is a standard deviation per sqrt(s): zero or more")
    vessel = with_measured_actuation(vessel, measured)
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    lagging = tuple(c for c, servo in vessel.servos.items() if not servo.direct)
    substeps = max(1, math.ceil(interval / (0.3 * time_scale(float(vessel.rigid_body.length)))))
    return ExtendedKalmanFilter(
        vessel, parameters, noise, jnp.array(walks), lagging, interval, substeps
    )
