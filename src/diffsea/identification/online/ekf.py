"""Extended Kalman filter of a vessel's motion and its parameters together.

The state is `(x, y, psi, u, v, r)`, three accelerations of gusts that last, the executed
values of channels that lag their orders, and the coordinates of the parameters. Parameters
are those of `diffsea.parameters`: a coordinate is zero at the prior mean and keeps the number
within its bounds. The steady current counts among them (`current_north`, `current_east`).

Process noise, all of it:

- white and lasting gusts on `u`, `v`, `r`, as in the offline fit (`identification.gusts`);
- a random walk of each coordinate, `drift` per square root of a second. Zero holds a parameter
  to be constant; otherwise what was learned t seconds ago counts with `drift^2 t` added to its
  variance, which is how the filter forgets;
- none on position and heading, which follow from the speeds, and none on executed actuation.

Time and measurement updates are the textbook's (Jazwinski 1970, section 8.3), the Jacobians
exact, the covariance updated in Joseph's form one channel after the other (Bierman 1977).
"""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.filter.process_noise import Noise, gust_propagation
from diffsea.identification.filter.updates import matrix_product
from diffsea.identification.online.choice import Choice, chosen
from diffsea.kinematics import wrap
from diffsea.parameters import Parameter, replace
from diffsea.scales import time_scale
from diffsea.simulation.integrate import SimulationState, advance, begin, history_length
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import change_servos
from diffsea.vessel.servo import OrderHistory, Servo


_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")
_GUSTS = slice(6, 9)


class Filter(eqx.Module):
    """What does not change while the filter runs."""

    vessel: Vessel
    noise: Noise
    drift: Float[Array, "parameter"]  # of the coordinates, per square root of a second
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    lagging: tuple[str, ...] = eqx.field(
        static=True
    )  # channels with an executed value of their own
    substeps: int = eqx.field(static=True)

    @property
    def spread(self) -> Float[np.ndarray, "parameter"]:
        """Prior standard deviation of every coordinate."""
        return np.array([parameter.spread for parameter in self.parameters])

    @property
    def first(self) -> int:
        """Where the coordinates begin in the state."""
        return 9 + len(self.lagging)

    def at(self, coordinates: Float[Array, "parameter"]) -> Vessel:
        """The vessel with its parameters at these coordinates."""
        return replace(
            self.vessel, {p.name: p.decode(coordinates[k]) for k, p in enumerate(self.parameters)}
        )


class Belief(eqx.Module):
    """What the filter holds true at one instant."""

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
    def spread(self) -> Float[Array, "parameter parameter"]:
        """Covariance of the coordinates."""
        first = self.mean.size - len(self.parameters)
        return self.covariance[first:, first:]

    @property
    def values(self) -> dict[str, Scalar]:
        """The parameters in SI units."""
        return {p.name: p.decode(c) for p, c in zip(self.parameters, self.coordinates, strict=True)}


class Innovation(eqx.Module):
    """What one measurement said beyond what was expected of it."""

    residual: Float[Array, "6"]  # measured less expected (m, rad, m/s, rad/s); zero where missing
    white: Float[Array, "6"]  # the same, each channel given those before it, in unit variance
    used: Bool[Array, "6"]
    change: Float[Array, "parameter"]  # of the coordinates, by this measurement
    settled: Float[Array, "parameter"]  # variance of the coordinates that it took away

    @property
    def share(self) -> Float[Array, "6"]:
        """Independent samples in every channel: one where it was measured."""
        return self.used.astype(float)

    @property
    def nis(self) -> Scalar:
        """Normalised innovation squared, `nu' S^-1 nu`: chi-squared, `used` degrees of freedom."""
        return jnp.sum(self.white**2)


def init(
    vessel: Vessel,
    free: Choice,
    noise: Noise,
    start: State,
    *,
    drift: float | Mapping[str, float] = 0.0,
    orders: Mapping[str, float] | None = None,
    measured: tuple[str, ...] = (),
    interval: float = 0.2,
    t: float = 0.0,
) -> tuple[Filter, Belief]:
    """A filter and what it believes before the first measurement.

    Arguments:
        free: the parameters to estimate, by name (prior about the vessel's own number) or as
            `Parameter`. At least one number of mass or thrust must stay fixed: motion and
            orders leave a common factor of mass, drag and thrust undetermined.
        noise: gust and sensor noise, from an offline fit or `noise_prior`.
        start: rough guess of the first state; its standard deviations are half a ship's
            length, half a radian and the speeds of a Froude number of 0.5.
        drift: random walk of the coordinates per square root of a second, one for all or by
            name; a parameter kept positive or negative has its logarithm as coordinate, so
            that 0.01 lets it change by 10 % in 100 s.
        orders: orders under which the actuators have settled; zero by default.
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
    parameters = chosen(vessel, free)
    held = with_direct(vessel, measured)
    held = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), held)
    lagging = tuple(c for c, servo in held.servos.items() if not servo.direct)
    substeps = max(1, math.ceil(interval / (0.3 * time_scale(float(vessel.rigid_body.length)))))
    filter = Filter(held, noise, _drifts(parameters, drift), parameters, lagging, substeps)
    settled = {c: jnp.asarray(float((orders or {}).get(c, 0.0))) for c in vessel.channels}
    step = interval / substeps
    lengths = {c: history_length(servo, step, 3.0) for c, servo in held.servos.items()}
    motion = begin(held, start, settled, lengths)
    mean = _packed(motion, jnp.zeros(3), jnp.zeros(len(parameters)), lagging)
    variance = jnp.concatenate(
        [first_variance(held), jnp.exp(2 * noise.slow), jnp.zeros(len(lagging)), filter.spread**2]
    )
    belief = Belief(jnp.asarray(t, float), mean, jnp.diag(variance), motion.histories, parameters)
    return filter, belief


def step(
    filter: Filter,
    belief: Belief,
    orders: dict[str, Scalar],
    measurement: Float[Array, "6"],
    dt: Scalar,
) -> tuple[Belief, Innovation]:
    """The belief `dt` s later, after a measurement there.

    Pure, for `jit` and `lax.scan`.

    Arguments:
        orders: what held since the last step, by channel in that channel's unit; the executed
            value for a channel that `init` was told is measured.
        measurement: (x, y, psi, u, v, r) in m, rad, m/s, rad/s; NaN where there is none, so
            that sensors of different rates and lost samples need nothing special.
        dt: s since the last step; zero for the first measurement of a run.
    """
    return updated(filter, predicted(filter, belief, orders, dt), orders, measurement)


def predicted(filter: Filter, belief: Belief, orders: dict[str, Scalar], dt: Scalar) -> Belief:
    """The belief `dt` s later under these orders, nothing measured."""
    gusts, Q = (jax.tree.map(lambda leaf: leaf[0], part) for part in _gusts(filter, dt))

    def moved(z: Float[Array, "n"]) -> tuple:
        vessel = filter.at(z[filter.first :])
        kick = gusts.half * z[_GUSTS]
        motion = _motion(filter, vessel, z.at[3:6].add(kick), belief.histories, orders)
        part = dt / filter.substeps
        for k in range(filter.substeps):
            motion = advance(vessel, motion, orders, vessel.environment, belief.t + k * part, part)
        gust = gusts.decay * z[_GUSTS]
        z = _packed(motion, gust, z[filter.first :], filter.lagging)
        return z.at[3:6].add(kick), (z.at[3:6].add(kick), motion.histories)

    F, (mean, histories) = jax.jacfwd(moved, has_aux=True)(belief.mean)
    walk = jnp.diag(jnp.concatenate([jnp.zeros(len(filter.lagging)), filter.drift**2 * dt]))
    P = matrix_product(matrix_product(F, belief.covariance), F.T)
    P = P.at[:9, :9].add(Q).at[9:, 9:].add(walk)
    return Belief(belief.t + dt, mean, 0.5 * (P + P.T), histories, belief.parameters)


def updated(
    filter: Filter, belief: Belief, orders: dict[str, Scalar], measurement: Float[Array, "6"]
) -> tuple[Belief, Innovation]:
    """The belief after a measurement (NaN where missing) at the same instant."""

    def expected(z: Float[Array, "n"]) -> tuple:
        shown = _expected(filter, z, belief.histories, orders)
        return shown, shown

    H, shown = jax.jacfwd(expected, has_aux=True)(belief.mean)
    used = jnp.isfinite(measurement)
    nu = jnp.where(used, measurement, 0.0) - shown
    nu = jnp.where(used, jnp.where(_HEADING, wrap(nu), nu), 0.0)
    R = jnp.exp(2 * filter.noise.sensor)
    shift, P, white = jnp.zeros_like(belief.mean), belief.covariance, []
    for j in range(6):
        h = jnp.where(used[j], H[j], 0.0)
        Ph = jnp.sum(P * h, axis=1)
        s = jnp.where(used[j], jnp.sum(h * Ph) + R[j], 1.0)
        fresh = nu[j] - jnp.sum(h * shift)
        gain = Ph / s
        shift = shift + gain * fresh
        left = P - gain[:, None] * Ph
        spare = jnp.sum(left * h, axis=1) - R[j] * gain
        P = left - spare[:, None] * gain
        white.append(fresh / jnp.sqrt(s))
    after = Belief(
        belief.t, belief.mean + shift, 0.5 * (P + P.T), belief.histories, belief.parameters
    )
    settled = jnp.maximum(jnp.diag(belief.spread) - jnp.diag(after.spread), 0.0)
    change = after.coordinates - belief.coordinates
    return after, Innovation(nu, jnp.stack(white), used, change, settled)


def reset(filter: Filter, belief: Belief, coordinates: Float[Array, "parameter"]) -> Belief:
    """The same motion, the parameters back at `coordinates` with their prior's uncertainty."""
    first = filter.first
    mean = belief.mean.at[first:].set(coordinates)
    P = belief.covariance.at[first:, :].set(0.0).at[:, first:].set(0.0)
    P = P.at[first:, first:].set(jnp.diag(jnp.asarray(filter.spread) ** 2))
    return Belief(belief.t, mean, P, belief.histories, belief.parameters)


def with_direct(vessel: Vessel, measured: tuple[str, ...]) -> Vessel:
    """Channels whose executed value is measured do at once what they are told."""
    for channel in measured:
        if channel not in vessel.channels:
            raise UserError(
                f"{channel!r} is said to be measured, but the vessel has no such actuator "
                f"channel; it has: {', '.join(vessel.channels)}"
            )
    return change_servos(vessel, measured, lambda servo, actuator: Servo())


def _drifts(
    parameters: tuple[Parameter, ...], drift: float | Mapping[str, float]
) -> Float[Array, "parameter"]:
    names = [parameter.name for parameter in parameters]
    if isinstance(drift, Mapping):
        unknown = [name for name in drift if name not in names]
        if unknown:
            raise UserError(f"drift is given for {unknown[0]!r}, which is not estimated")
        drifts = [float(drift.get(name, 0.0)) for name in names]
    else:
        drifts = [float(drift)] * len(names)
    if any(not (math.isfinite(value) and value >= 0) for value in drifts):
        raise UserError("a drift is a standard deviation per sqrt(s): zero or more")
    return jnp.array(drifts)


def _gusts(filter: Filter, dt: Scalar) -> tuple:
    return gust_propagation(filter.noise, jnp.asarray(dt, float)[None])


def _packed(
    motion: SimulationState,
    gusts: Float[Array, "3"],
    coordinates: Float[Array, "parameter"],
    lagging: tuple[str, ...],
) -> Float[Array, "n"]:
    numbers = [getattr(motion.state, c) for c in MOTION_CHANNELS]
    numbers = [*numbers, *gusts, *(motion.executed[c] for c in lagging), *coordinates]
    return jnp.stack([jnp.asarray(number, float) for number in numbers])


def _motion(
    filter: Filter,
    vessel: Vessel,
    z: Float[Array, "n"],
    histories: dict[str, OrderHistory],
    orders: dict[str, Scalar],
) -> SimulationState:
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    executed |= {c: z[9 + k] for k, c in enumerate(filter.lagging)}
    return SimulationState(State(*z[:6]), executed, histories)


def _expected(
    filter: Filter,
    z: Float[Array, "n"],
    histories: dict[str, OrderHistory],
    orders: dict[str, Scalar],
) -> Float[Array, "6"]:
    """What the sensors should show; their latencies need the state's first two derivatives."""
    vessel = filter.at(z[filter.first :])
    motion = _motion(filter, vessel, z, histories, orders)

    def rate(at: State) -> State:
        return vessel.rate(at, motion.executed, vessel.environment, 0.0)

    state = jax.tree.map(jnp.asarray, motion.state)
    first, second = jax.jvp(rate, (state,), (rate(state),))
    return vessel.sensors.measure(state, first, second)
