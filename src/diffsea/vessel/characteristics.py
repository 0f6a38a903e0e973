"""Static characteristics of actuators: what a value becomes whatever was before it."""

import equinox as eqx
import jax.numpy as jnp

from diffsea.types import Scalar


SMALLEST_SHARE = 1e-6  # of full order: power laws are linear below, which no order resolves
SHARPNESS = 8  # of a limit: its knee is 2^(-1/8), 8 %, below; a tenth beyond the limit it is 5 %


def dead_zone(value: Scalar, width: Scalar) -> Scalar:
    """Zero within `width` of zero, and what is beyond: the value itself without a width."""
    # Without a width it is the value, at zero too.
    acts = (jnp.abs(value) > width) | (width <= 0)
    return jnp.where(acts, value - jnp.sign(value) * width, 0.0)


def power(share: Scalar, exponent: Scalar) -> Scalar:
    """`|s|^e`, constant within a millionth of zero, where it has derivatives by both."""
    return jnp.exp(exponent * jnp.log(jnp.maximum(jnp.abs(share), SMALLEST_SHARE)))


class Characteristic(eqx.Module):
    """How an actuator that is ordered n acts as if it were ordered n', where its law is not true.

    For n above neutral, positive ahead, and N the largest order: a limit L by a knee,
    `n_1 = n (1 + (|n| / L)^8)^(-1/8)`, with `(N / L)^8 = (1 + loss)^8 - 1`: the largest order loses
    `loss / (1 + loss)`; a dead band of half width b, `n_2 = sgn(n_1) max(|n_1| - b, 0)`; an
    exponent, `n_3 = N sgn(n_2) (|n_2| / N)^p`; and `n' = a n_3` astern, n_3 ahead. Absent to the
    last bit where `deadband`, `steepness` p - 1, `astern` a - 1 and `loss` are zero, with
    derivatives there.
    """

    largest: Scalar  # N, in the unit of the orders, from neutral
    deadband: Scalar = 0.0  # b, in the unit of the orders
    steepness: Scalar = 0.0
    astern: Scalar = 0.0
    loss: Scalar = 0.0
    reversed: bool = eqx.field(static=True, default=False)  # less than neutral is ahead

    def __call__(self, above: Scalar) -> Scalar:
        """n' above neutral, of n above neutral."""
        ahead = -above if self.reversed else above
        reach = ((1 + self.loss) ** SHARPNESS - 1) * (ahead / self.largest) ** SHARPNESS
        # A loss below zero, which a fit may try, keeps the knee finite.
        ahead = ahead * jnp.exp(-jnp.log1p(jnp.maximum(reach, -0.9)) / SHARPNESS)
        ahead = dead_zone(ahead, self.deadband)
        ahead = ahead * power(ahead / self.largest, self.steepness)
        ahead = ahead * jnp.where(ahead < 0, 1 + self.astern, 1.0)
        return -ahead if self.reversed else ahead


def loss_of_limit(limit: Scalar, largest: Scalar) -> Scalar:
    """The `loss` of a characteristic with a limit, in the unit of the orders."""
    return (1 + (largest / limit) ** SHARPNESS) ** (1 / SHARPNESS) - 1


def limit_of_loss(loss: Scalar, largest: Scalar) -> Scalar:
    """The inverse of `loss_of_limit`."""
    return largest * ((1 + loss) ** SHARPNESS - 1) ** (-1 / SHARPNESS)
