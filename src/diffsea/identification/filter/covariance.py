"""Process and sensor noise, and the covariance of a Kalman filter that knows of both.

The filter's state is the vessel's six numbers and three accelerations by gusts that last:
first-order Gauss-Markov processes, besides gusts that are white. Were lasting gusts taken for
white ones, the fit would bend the vessel until its own dynamics had their autocorrelation (a
thruster's lag comes out a quarter too short).

Fixes err slowly, too: those of a satellite receiver wander by decimetres within a minute. As no
force depends on the position, the position of the filter is the one that the fixes wander with: a
random walk is added to it, which is what an error of a first-order Gauss-Markov process does in
less than its memory. Taken for motion, it would bend the vessel with intervals far too narrow.

Time and measurement updates are in Joseph's form, one measured channel at a time, so that no
matrix is inverted.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


class Noise(eqx.Module):
    """Logarithms of the noise scales."""

    gust: Float[Array, "3"]  # white, of u (m/s), v (m/s), r (rad/s), per square root of a second
    slow: Float[Array, "3"]  # lasting, standard deviation of the acceleration (m/s^2, rad/s^2)
    memory: Float[Array, "3"]  # time constant (s) of the lasting ones
    sensor: Float[Array, "6"]  # white, of x, y (m), psi (rad), u, v (m/s), r (rad/s)
    walk: Float[Array, "1"]  # random walk of fixes on either axis, m per square root of a second

    @staticmethod
    def of(scales: Float[Array, "16"] | Float[np.ndarray, "16"]) -> "Noise":
        """From all logarithms in one array."""
        parts = jnp.split(jnp.asarray(scales), (3, 6, 9, 15))
        return Noise(*(jnp.asarray(part) for part in parts))

    @property
    def scales(self) -> Float[Array, "16"]:
        """All logarithms in one array."""
        return jnp.concatenate([self.gust, self.slow, self.memory, self.sensor, self.walk])


class GustPropagation(eqx.Module):
    """What gusts do within each row, exactly for constant velocity of the vessel."""

    decay: Float[Array, "row 3"]  # share of a lasting acceleration left at the end
    half: Float[Array, "row 3"]  # half the speed it gives, per unit at the start (s)


def gust_propagation(
    noise: Noise, dt: Float[Array, "row"]
) -> tuple[GustPropagation, Float[Array, "row 9 9"]]:
    """Propagation of lasting gusts over each row, and the covariance that is added.

    Exact integrals of a first-order Gauss-Markov acceleration and of the speed it gives
    (Jazwinski 1970, section 4.9); as the memory shrinks they become those of white noise.
    Positions walk with the fixes.
    """
    memory = jnp.exp(noise.memory)
    share = dt[:, None] / memory
    decay = jnp.exp(-share)
    power = jnp.exp(2 * noise.slow)
    speed = power * memory**2 * (2 * share - 3 + 4 * decay - decay**2)
    speed = speed + jnp.exp(2 * noise.gust) * dt[:, None]
    both = power * memory * (1 - decay) ** 2
    left = power * (1 - decay**2)
    still = jnp.zeros_like(speed)
    walk = jnp.array([1.0, 1.0, 0.0]) * jnp.exp(2 * noise.walk) * dt[:, None]
    diagonal = jnp.concatenate([walk, speed, left], axis=1)
    beside = jnp.concatenate([still, both], axis=1)
    upper = jax.vmap(lambda row: jnp.diag(row, 3))(beside)
    Q = jax.vmap(jnp.diag)(diagonal) + upper + upper.mT
    return GustPropagation(decay, 0.5 * memory * (1 - decay)), Q


class MeasurementUpdate(NamedTuple):
    """What measurements of one instant do to the filter's state and covariance."""

    correction: Float[Array, "9 6"]  # C: the state's change from the joint innovation
    whitening: Float[Array, "6 6"]  # joint innovation to unit covariance; zero where unused
    covariance: Float[Array, "9 9"]
    variance: Float[Array, "6"]  # of the sequential innovations; one where unused


def time_update(
    P: Float[Array, "9 9"], F: Float[Array, "6 6"], gust: GustPropagation, Q: Float[Array, "9 9"]
) -> Float[Array, "9 9"]:
    """Covariance at the end of a row: gusts act half before and half after the vessel moves.

    F is the derivative of the vessel's next state by its state, Q what gusts add.
    """

    def add_half_impulse(M: Array) -> Array:
        return jnp.concatenate([M[:3], M[3:6] + gust.half[:, None] * M[6:], M[6:]])

    def transition(M: Array) -> Array:
        M = add_half_impulse(M)
        M = add_half_impulse(jnp.concatenate([matrix_product(F, M[:6]), M[6:]]))
        return jnp.concatenate([M[:6], gust.decay[:, None] * M[6:]])

    return transition(transition(P).T) + Q


class ScalarUpdate(NamedTuple):
    """What the measurement of one channel does to the filter's state and covariance."""

    h: Float[Array, "9"]  # the state to the channel; zero where unused
    gain: Float[Array, "9"]  # the state's change from the channel's innovation
    covariance: Float[Array, "9 9"]
    variance: Float[Array, ""]  # of the innovation; one where unused


def scalar_update(
    P: Float[Array, "9 9"],
    h: Float[Array, "9"],
    noise: Float[Array, ""],
    used: Bool[Array, ""],
    Q: Float[Array, "9 9"],
    late: Float[Array, ""],
) -> ScalarUpdate:
    """Kalman's measurement update by one channel, in Joseph's form.

    A sample of before the update knows nothing of the process noise since, with which the state is
    correlated (Bar-Shalom, Li and Kirubarajan 2001, section 8.3). The walk of fixes is no such
    noise: a receiver adds it when it shows them.

    Arguments:
        noise: variance of the channel's noise.
        Q: what the last row added.
        late: share of that row that the sample lies before its end.
    """
    h = jnp.where(used, h, 0.0)
    Ph, moving = jnp.sum(P * h, axis=1), jnp.concatenate([jnp.zeros(2), h[2:]])
    since = late * jnp.sum(Q * moving, axis=1)
    missing = jnp.sum(moving * since)
    s = jnp.where(used, jnp.sum(h * Ph) - missing + noise, 1.0)
    gain = (Ph - since) / s
    # Joseph form: stays positive definite however small the sensor noise.
    left = P - gain[:, None] * Ph[None, :]
    beside = since - missing * gain
    spare = jnp.sum(left * h, axis=1) - (noise + missing) * gain - beside
    P = left - spare[:, None] * gain[None, :] + gain[:, None] * beside[None, :]
    return ScalarUpdate(h, gain, P, s)


def measurement_update(
    P: Float[Array, "9 9"],
    H: Float[Array, "6 9"],
    R: Float[Array, "6"],
    used: Bool[Array, "6"],
    Q: Float[Array, "9 9"],
    late: Float[Array, "6"],
) -> MeasurementUpdate:
    """Kalman's measurement update, one channel after the other, as `scalar_update` has it.

    Sensors are independent, so six scalar updates equal the joint one (Bierman 1977), and their
    innovations are the whitened ones, without any factorisation. The correction by the joint
    innovation is built up channel by channel.
    """

    def update_by_channel(carry: tuple[Array, Array], channel: tuple[Array, ...]) -> tuple:
        C, P = carry
        h, noise, known, unit, part = channel
        one = scalar_update(P, h, noise, known, Q, part)
        fresh = jnp.where(known, unit - jnp.sum(one.h[:, None] * C, axis=0), 0.0)
        C = C + one.gain[:, None] * fresh[None, :]
        return (C, one.covariance), (fresh / jnp.sqrt(one.variance), one.variance)

    channels = H, R, used, jnp.eye(6), late
    start = jnp.zeros((9, 6)), P
    (C, P), (whitening, variances) = jax.lax.scan(update_by_channel, start, channels)
    return MeasurementUpdate(C, whitening, P, variances)


def matrix_vector(matrix: Float[Array, "n m"], vector: Float[Array, "m"]) -> Float[Array, "n"]:
    """Matrix times vector as fused multiplications: a library call per row costs far more."""
    return jnp.sum(matrix * vector, axis=-1)


def matrix_product(a: Float[Array, "k n"], b: Float[Array, "n m"]) -> Float[Array, "k m"]:
    """Matrix product as fused multiplications, for the reason of `matrix_vector`."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)
