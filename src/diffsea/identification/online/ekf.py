# pyright: reportArgumentType=false
# Equinox leaves abstract variables out of the order of arguments, which pyright cannot follow.
"""Extended Kalman filter of a vessel's motion and its parameters together.

The state is `(x, y, psi, u, v, r)`, three accelerations of lasting gusts, the executed
values of channels that lag their orders, and the coordinates of the parameters. Parameters
are those of `diffsea.parameters`: a coordinate is zero at the prior mean and keeps the number
within its bounds. The steady current counts among them (`current_north`, `current_east`).

Process noise, all of it:

- white and lasting gusts on `u`, `v`, `r`, as in the offline fit (`filter.process_noise`);
- a random walk of each coordinate, `drift` per square root of a second. Zero holds a parameter
  to be constant; otherwise what was learned t seconds ago counts with `drift^2 t` added to its
  variance, which is how the filter forgets;
- none on position and heading, which follow from the speeds, and none on executed actuation.

Time and measurement updates are the textbook's (Jazwinski 1970, section 8.3), the Jacobians
exact, the covariance updated in Joseph's form one channel after the other (Bierman 1977).
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.filter.process_noise import Noise, gust_propagation
from diffsea.identification.filter.updates import matrix_product
from diffsea.identification.online.estimator import (
    AbstractBelief,
    AbstractEstimator,
    AbstractInnovation,
    ParameterChoice,
    parameters_with_priors,
    with_measured_actuation,
)
from diffsea.kinematics import wrap
from diffsea.parameters import Parameter
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

    t: Scalar  # s
    mean: Float[Array, "n"]
    covariance: Float[Array, "n n"]
    histories: dict[str, OrderHistory]
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    @property
    def state(self) -> State:
        """Position and motion (m, rad, m/s, rad/s)."""
        return State(*self.mean[:6])

    @property
    def coordinates(self) -> Float[Array, "parameter"]:
        """The parameters' coordinates, each in its own prior's unit."""
        return self.mean[self.mean.size - len(self.parameters) :]

    @property
    def parameter_covariance(self) -> Float[Array, "parameter parameter"]:
        """Covariance of the coordinates."""
        first = self.mean.size - len(self.parameters)
        return self.covariance[first:, first:]


class KalmanInnovation(AbstractInnovation):
    """What one measurement said beyond what was expected of it."""

    residual: Float[Array, "6"]  # measured less expected (m, rad, m/s, rad/s); zero where missing
    white: Float[Array, "6"]  # the same, each channel given those before it, in unit variance
    used: Bool[Array, "6"]
    share: Float[Array, "6"]  # independent samples in every channel: one where it was measured
    change: Float[Array, "parameter"]  # of the coordinates, by this measurement
    settled: Float[Array, "parameter"]  # variance of the coordinates that it took away

    @property
    def nis(self) -> Scalar:
        """Normalised innovation squared, `e' S^-1 e`: chi-squared, `used` degrees of freedom."""
        return jnp.sum(self.white**2)


class ExtendedKalmanFilter(AbstractEstimator[KalmanBelief]):
    """The filter of one vessel; made by `kalman_filter`."""

    channels: ClassVar[tuple[str, ...]] = MOTION_CHANNELS

    vessel: Vessel
    noise: Noise
    drift: Float[Array, "parameter"]  # of the coordinates, per square root of a second
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    lagging: tuple[str, ...] = eqx.field(static=True)  # channels that lag their orders
    interval: float = eqx.field(static=True)  # s, longest time between measurements
    substeps: int = eqx.field(static=True)

    def init(
        self, start: State, *, orders: Mapping[str, float] | None = None, t: float = 0.0
    ) -> KalmanBelief:
        """The belief before the first measurement.

        Its standard deviations are half a ship's length, half a radian and the speeds of a Froude
        number of 0.5 about `start`, and those of the priors.
        """
        motion = self.settled_motion(start, orders, self.interval / self.substeps)
        mean = self._stack(motion, jnp.zeros(3), jnp.zeros(len(self.parameters)))
        variance = jnp.concatenate(
            [
                first_variance(self.vessel),
                jnp.exp(2 * self.noise.slow),
                jnp.zeros(len(self.lagging)),
                self.prior_std**2,
            ]
        )
        t0 = jnp.asarray(t, float)
        return KalmanBelief(t0, mean, jnp.diag(variance), motion.histories, self.parameters)

    def step(
        self,
        belief: KalmanBelief,
        orders: dict[str, Scalar],
        measurement: Float[Array, "6"],
        dt: Scalar,
    ) -> tuple[KalmanBelief, KalmanInnovation]:
        """Prediction over `dt` s and update by the measurement at their end."""
        return self.update(self.predict(belief, orders, dt), orders, measurement)

    def predict(self, belief: KalmanBelief, orders: dict[str, Scalar], dt: Scalar) -> KalmanBelief:
        """The belief `dt` s later under these orders, nothing measured."""
        row = jnp.asarray(dt, float)[None]
        gusts, Q = jax.tree.map(lambda leaf: leaf[0], gust_propagation(self.noise, row))

        def propagate(z: Float[Array, "n"]) -> tuple:
            coordinates = z[self._first :]
            vessel = self.vessel_at(coordinates)
            impulse = gusts.half * z[_GUSTS]
            motion = self._simulation_state(
                vessel, z.at[_SPEEDS].add(impulse), belief.histories, orders
            )
            part = dt / self.substeps
            for k in range(self.substeps):
                t = belief.t + k * part
                motion = advance(vessel, motion, orders, vessel.environment, t, part)
            after = self._stack(motion, gusts.decay * z[_GUSTS], coordinates)
            after = after.at[_SPEEDS].add(impulse)
            return after, (after, motion.histories)

        F, (mean, histories) = jax.jacfwd(propagate, has_aux=True)(belief.mean)
        walk = jnp.diag(jnp.concatenate([jnp.zeros(len(self.lagging)), self.drift**2 * dt]))
        P = matrix_product(matrix_product(F, belief.covariance), F.T)
        P = P.at[:9, :9].add(Q).at[9:, 9:].add(walk)
        return KalmanBelief(belief.t + dt, mean, 0.5 * (P + P.T), histories, belief.parameters)

    def update(
        self, belief: KalmanBelief, orders: dict[str, Scalar], measurement: Float[Array, "6"]
    ) -> tuple[KalmanBelief, KalmanInnovation]:
        """The belief after a measurement (NaN where missing) at the same instant."""

        def expect(z: Float[Array, "n"]) -> tuple:
            """What the sensors show; their latencies need the state's first two derivatives."""
            vessel = self.vessel_at(z[self._first :])
            motion = self._simulation_state(vessel, z, belief.histories, orders)

            def rate(at: State) -> State:
                return vessel.rate(at, motion.executed, vessel.environment, 0.0)

            state = jax.tree.map(jnp.asarray, motion.state)
            first, second = jax.jvp(rate, (state,), (rate(state),))
            reading = vessel.sensors.measure(state, first, second)
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
        after = KalmanBelief(belief.t, mean, P, belief.histories, belief.parameters)
        lost = jnp.diag(belief.parameter_covariance) - jnp.diag(after.parameter_covariance)
        change = after.coordinates - belief.coordinates
        return after, KalmanInnovation(
            residual=innovation,
            white=jnp.stack(white),
            used=used,
            share=used.astype(float),
            change=change,
            settled=jnp.maximum(lost, 0.0),
        )

    def reset(self, belief: KalmanBelief, coordinates: Float[Array, "parameter"]) -> KalmanBelief:
        """The same motion, the parameters back at `coordinates` with their prior's uncertainty."""
        first = self._first
        prior = jnp.diag(jnp.asarray(self.prior_std) ** 2)
        mean = belief.mean.at[first:].set(coordinates)
        P = belief.covariance.at[first:, :].set(0.0).at[:, first:].set(0.0)
        P = P.at[first:, first:].set(prior)
        return KalmanBelief(belief.t, mean, P, belief.histories, belief.parameters)

    @property
    def _first(self) -> int:
        """Where the coordinates begin in the state."""
        return 9 + len(self.lagging)

    def _stack(
        self,
        motion: SimulationState,
        gusts: Float[Array, "3"],
        coordinates: Float[Array, "parameter"],
    ) -> Float[Array, "n"]:
        numbers = [getattr(motion.state, c) for c in MOTION_CHANNELS]
        numbers = [*numbers, *gusts, *(motion.executed[c] for c in self.lagging), *coordinates]
        return jnp.stack([jnp.asarray(number, float) for number in numbers])

    def _simulation_state(
        self,
        vessel: Vessel,
        z: Float[Array, "n"],
        histories: dict[str, OrderHistory],
        orders: dict[str, Scalar],
    ) -> SimulationState:
        executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
        executed |= {c: z[9 + k] for k, c in enumerate(self.lagging)}
        return SimulationState(State(*z[:6]), executed, histories)


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
            whose clock is off: measurements come with the orders of their moment here.
    """
    if vessel.sensors.clock is not None:
        raise UserError(
            "the vessel has the effect clock-drift; online, stamp measurements with the clock of "
            "the orders and take the effect out of the vessel file"
        )
    parameters = parameters_with_priors(vessel, free)
    names = [parameter.name for parameter in parameters]
    drifts = drift if isinstance(drift, Mapping) else dict.fromkeys(names, drift)
    unknown = [name for name in drifts if name not in names]
    if unknown:
        raise UserError(f"drift is given for {unknown[0]!r}, which is not estimated")
    walks = [float(drifts.get(name, 0.0)) for name in names]
    if any(not (math.isfinite(walk) and walk >= 0) for walk in walks):
        raise UserError("a drift is a standard deviation per sqrt(s): zero or more")
    vessel = with_measured_actuation(vessel, measured)
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    lagging = tuple(c for c, servo in vessel.servos.items() if not servo.direct)
    substeps = max(1, math.ceil(interval / (0.3 * time_scale(float(vessel.rigid_body.length)))))
    return ExtendedKalmanFilter(
        vessel, noise, jnp.array(walks), parameters, lagging, interval, substeps
    )
