"""Feedback of dynamic positioning, scheduled by the speed ahead.

Thrusters fade with speed, and a rudder acts by it alone, so that the gain is found for several
speeds ahead and interpolated between them (Fossen 2021, chapter 16, on linear-quadratic control).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.simulation.control.effectors import (
    AbstractEffector,
    Motion,
    acceleration,
    orders_at_rest,
)
from diffsea.simulation.control.lqr import discrete_lqr, discretise
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


_DOUBLINGS = 14  # 2^14 periods: a positioned vessel has settled by then


class Weights(eqx.Module):
    """What is as bad as all of an actuator's effect (Bryson's rule)."""

    position: Scalar  # m
    heading: Scalar  # rad
    integral_time: Scalar  # s, for which such an error is as bad again


class PositioningGains(eqx.Module):
    """Gains and allocation by the speed ahead, linear between speeds and held beyond them.

    `gain` is of the errors of velocity, pose and integrals and of the shares on their way, 9 in all
    and the shares; `allocation` has the least shares for an acceleration (m/s^2, rad/s^2).
    """

    speeds: Float[Array, "speed"]  # m/s, ascending
    gain: Float[Array, "speed share state"]
    allocation: Float[Array, "speed share 3"]

    def at(self, speed: Scalar) -> tuple[Float[Array, "share state"], Float[Array, "share 3"]]:
        """Gain and allocation at a speed ahead (m/s)."""
        last = len(self.speeds) - 1
        place = (speed - self.speeds[0]) / (self.speeds[-1] - self.speeds[0]) * float(last)
        place = jnp.clip(place, 0.0, float(last))
        below = jnp.clip(jnp.floor(place), 0.0, last - 1.0)
        share, below = place - below, below.astype(int)

        def between(values: Float[Array, "speed *rest"]) -> Float[Array, "*rest"]:
            return (1 - share) * values[below] + share * values[below + 1]

        return between(self.gain), between(self.allocation)


def positioning_gains(
    vessel: Vessel,
    effectors: tuple[AbstractEffector, ...],
    lags: Float[Array, "share"],
    weights: Weights,
    period: float,
    speeds: Float[Array, "speed"],
) -> PositioningGains:
    """The gains of a vessel by linear-quadratic control at each of the speeds ahead (m/s)."""

    def one(speed: Scalar) -> tuple[Float[Array, "share state"], Float[Array, "share 3"]]:
        B = inputs(vessel, effectors, speed)
        gain = _gain(vessel, B, lags, weights, period, speed)
        return gain, B.T @ jnp.linalg.inv(B @ B.T)

    return PositioningGains(speeds, *jax.vmap(one)(speeds))


def inputs(
    vessel: Vessel, effectors: tuple[AbstractEffector, ...], speed: Scalar
) -> Float[Array, "3 share"]:
    """Accelerations (m/s^2, m/s^2, rad/s^2) by the shares of all effectors, at a speed ahead."""
    motion = jnp.stack([speed, jnp.zeros(()), jnp.zeros(())])
    rest = orders_at_rest(vessel)
    answer = lambda orders: acceleration(vessel, motion, rest | orders)
    return jnp.concatenate([one.inputs(answer) for one in effectors], axis=1)


def _gain(
    vessel: Vessel,
    B: Float[Array, "3 share"],
    lags: Float[Array, "share"],
    weights: Weights,
    period: float,
    speed: Scalar,
) -> Float[Array, "share state"]:
    zero, rest = jnp.zeros(()), orders_at_rest(vessel)

    def rates(motion: Motion) -> Motion:
        return acceleration(vessel, motion, rest)

    shares = B.shape[1]
    A = jnp.zeros((9 + shares, 9 + shares))
    A = A.at[:3, :3].set(jax.jacfwd(rates)(jnp.stack([speed, zero, zero])))
    A = A.at[3:6, :3].set(jnp.eye(3)).at[4, 5].set(speed).at[6:9, 3:6].set(jnp.eye(3))
    A = A.at[:3, 9:].set(B).at[9:, 9:].set(-jnp.diag(1 / lags))
    ordered = jnp.zeros((9 + shares, shares)).at[9:].set(jnp.diag(1 / lags))
    bad = jnp.stack([weights.position, weights.position, weights.heading])
    Q = jnp.concatenate(
        [jnp.zeros(3), bad**-2.0, (bad * weights.integral_time) ** -2.0, jnp.zeros(shares)]
    )
    A, ordered = discretise(A, ordered, period)
    return discrete_lqr(A, ordered, jnp.diag(Q), jnp.eye(shares), _DOUBLINGS)
