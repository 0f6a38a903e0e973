"""The two halves of the filter's step: time update and measurement update.

In Joseph's form, one measured channel at a time, so that no matrix is inverted.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.identification.filter.process_noise import GustPropagation


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


def measurement_update(
    P: Float[Array, "9 9"],
    H: Float[Array, "6 9"],
    R: Float[Array, "6"],
    used: Bool[Array, "6"],
    Q: Float[Array, "9 9"],
    rows_late: Float[Array, "6"],
) -> MeasurementUpdate:
    """Kalman's measurement update, one channel after the other.

    Sensors are independent, so six scalar updates equal the joint one (Bierman 1977), and their
    innovations are the whitened ones, without any factorisation. The correction by the joint
    innovation is built up channel by channel.

    A delayed channel knows nothing of the process noise since, `Q` in each row of its delay. Of
    the variance of what it measures, P now, only a share P / (P + rows Q) was there then: its
    innovation varies by as much less, and its noise counts as that much larger. Of what the
    state's variance would lose by the update, the share that is newer stays: in the steady state
    of a random walk measured late, gain and variance are exactly those of one measured at once.
    """

    def update_by_channel(carry: tuple[Array, Array], channel: tuple[Array, ...]) -> tuple:
        C, P = carry
        h, noise, known, unit, late = channel
        h = jnp.where(known, h, 0.0)
        Ph = jnp.sum(P * h, axis=1)
        now, since = jnp.sum(h * Ph), late * jnp.sum(h * jnp.sum(Q * h, axis=1))
        old = jnp.where(since > 0, now / (now + since), 1.0)
        noise = noise / old
        s = jnp.where(known, now + noise, 1.0)
        fresh = jnp.where(known, unit - jnp.sum(h[:, None] * C, axis=0), 0.0)
        gain = Ph / s
        C = C + gain[:, None] * fresh[None, :]
        # Joseph form: stays positive definite however small the sensor noise.
        left = P - gain[:, None] * Ph[None, :]
        spare = jnp.sum(left * h, axis=1) - noise * gain
        variance = jnp.where(known, s * old, 1.0)
        P = left - gain[:, None] * (spare - (1 - old) * Ph)[None, :]
        return (C, P), (fresh / jnp.sqrt(variance), variance)

    channels = H, R, used, jnp.eye(6), rows_late
    start = jnp.zeros((9, 6)), P
    (C, P), (whitening, variances) = jax.lax.scan(update_by_channel, start, channels)
    return MeasurementUpdate(C, whitening, P, variances)


def matrix_vector(matrix: Float[Array, "n m"], vector: Float[Array, "m"]) -> Float[Array, "n"]:
    """Matrix times vector as fused multiplications: a library call per row costs far more."""
    return jnp.sum(matrix * vector, axis=-1)


def matrix_product(a: Float[Array, "k n"], b: Float[Array, "n m"]) -> Float[Array, "k m"]:
    """Matrix product as fused multiplications, for the reason of `matrix_vector`."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)
