"""Effectors: actuators as positioning sees them, by shares of what each can do at rest.

The usual split of control allocation (Johansen and Fossen 2013, Control allocation - a survey): a
law asks for shares of effects, which act in proportion, and each effector finds the orders. An
azimuth thruster that turns all the way round has two shares, ahead and to starboard; whatever else
takes an order has one.
"""

import abc
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.actuators.thrusters import AzimuthThruster
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import Servo


Motion = Float[Array, "3"]  # u, v (m/s), r (rad/s)
Shares = Float[Array, "share"]
Limits = Mapping[str, tuple[Scalar, Scalar]]  # lowest and highest order by channel

_HALF = 0.5  # of its effect, at which an effector's slope is taken
_SAMPLES = 33  # of the curve of an effect between its limits
_QUICKEST = 0.25  # periods: an actuator that answers sooner is taken to answer so
_QUARTER = np.pi / 2  # rad, of its way an azimuth thruster turns at its largest rate
_NONE = 1e-12  # of the largest effect: a direction of so little is none


class AbstractEffector(eqx.Module):
    """What one actuator does for shares of its effect."""

    lag: eqx.AbstractVar[Scalar]  # s, delays included

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """How many shares it takes."""

    @abc.abstractmethod
    def orders(self, shares: Shares) -> dict[str, Scalar]:
        """The orders by which it does what it can of these shares, by channel."""

    @abc.abstractmethod
    def possible(self, shares: Shares) -> Shares:
        """The shares, as far as it can bear them."""

    def inputs(self, answer: Callable[[dict[str, Scalar]], Motion]) -> Float[Array, "3 share"]:
        """Accelerations (m/s^2, m/s^2, rad/s^2) by its shares, from those by its orders."""

        def column(unit: Shares) -> Motion:
            weaker, stronger = (self.possible(side * _HALF * unit) for side in (-1.0, 1.0))
            apart = jnp.maximum(jnp.sum((stronger - weaker) * unit), 1e-6)
            return (answer(self.orders(stronger)) - answer(self.orders(weaker))) / apart

        return jnp.stack([column(unit) for unit in jnp.eye(self.count)], axis=1)


class ChannelEffector(AbstractEffector):
    """An actuator's channel: what its orders come to, as shares of the largest effect."""

    channel: str = eqx.field(static=True)
    values: Float[Array, "sample"]  # orders, ascending
    shares: Float[Array, "sample"]  # of these orders; ascending, within -1 and 1
    lag: Scalar

    @property
    def count(self) -> int:
        return 1

    def order(self, share: Scalar) -> Scalar:
        """The order with a share of the effect; the nearest limit where there is none."""
        return jnp.interp(share, self.shares, self.values)

    def orders(self, shares: Shares) -> dict[str, Scalar]:
        return {self.channel: self.order(shares[0])}

    def possible(self, shares: Shares) -> Shares:
        return jnp.clip(shares, self.shares[0], self.shares[-1])


class AzimuthEffector(AbstractEffector):
    """An azimuth thruster that turns all the way round: its push ahead and to starboard.

    It pushes one way and turns; its reverse is left alone. Where nothing is asked for it points
    ahead.
    """

    force: ChannelEffector  # as it points ahead
    angle_channel: str = eqx.field(static=True)
    lag: Scalar

    @property
    def count(self) -> int:
        return 2

    def orders(self, shares: Shares) -> dict[str, Scalar]:
        size, (ahead, starboard) = _length(shares), shares
        ahead = jnp.where(size > _NONE, ahead, 1.0)
        angle = jnp.arctan2(starboard, ahead)
        return {self.force.channel: self.force.order(size), self.angle_channel: angle}

    def possible(self, shares: Shares) -> Shares:
        return shares * jnp.minimum(
            1.0, self.force.shares[-1] / jnp.maximum(_length(shares), _NONE)
        )


def _length(shares: Shares) -> Scalar:
    """Of the vector of shares, with a derivative at none."""
    return jnp.sqrt(jnp.sum(shares**2) + _NONE**2)


def effectors_of(vessel: Vessel, period: float, limits: Limits) -> tuple[AbstractEffector, ...]:
    """The effectors of all of a vessel's actuators, for a law that acts every `period` s.

    Raises:
        UserError: an actuator without limits of what it can be ordered.
    """
    turning = {
        part.force_channel: part.angle_channel
        for part in vessel.actuators.values()
        if isinstance(part, AzimuthThruster) and vessel.servos[part.angle_channel].endless
    }
    found: list[AbstractEffector] = []
    for channel in vessel.channels:
        if channel in turning.values():
            continue
        one = _channel_effector(vessel, channel, period, limits)
        if channel in turning:
            angle = vessel.servos[turning[channel]]
            lag = jnp.maximum(one.lag, _lag(angle, _QUARTER, period))
            one = AzimuthEffector(force=one, angle_channel=turning[channel], lag=lag)
        found.append(one)
    return tuple(found)


def _channel_effector(
    vessel: Vessel, channel: str, period: float, limits: Limits
) -> ChannelEffector:
    """The curve of a channel's effect at rest; in proportion to the order where there is none."""
    rest, still = orders_at_rest(vessel), jnp.zeros(3)
    length = vessel.rigid_body.length

    def answer(order: Scalar) -> Motion:
        return acceleration(vessel, still, rest | {channel: order})

    ends = _ends(vessel, channel, limits.get(channel, (-jnp.inf, jnp.inf)))
    orders = jnp.linspace(*ends, _SAMPLES)
    more = jax.vmap(answer)(orders) - acceleration(vessel, still, rest)
    answers = more * jnp.array([1.0, 1.0, length])
    # The small constant keeps the root differentiable where an order does nothing.
    sizes = jnp.sqrt(jnp.sum(answers**2, axis=1) + 1e-30)
    largest = jnp.argmax(sizes)
    towards = answers[largest] * jnp.where(orders[largest] < rest[channel], -1.0, 1.0)
    along = answers @ towards / sizes[largest] ** 2
    plain = (orders - rest[channel]) / jnp.max(jnp.abs(orders - rest[channel]))
    shares = jnp.where(sizes[largest] > 1e-12, along, plain)
    # A rise too small to see keeps flat parts, a dead band's, in order.
    shares = jax.lax.cummax(shares) + 1e-9 * jnp.arange(float(_SAMPLES))
    lag = _lag(vessel.servos[channel], 0.25 * (ends[1] - ends[0]), period)
    return ChannelEffector(channel=channel, values=orders, shares=shares, lag=lag)


def _ends(vessel: Vessel, channel: str, limits: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """Lowest and highest order of a channel: the narrower of the actuator's and other limits."""
    servo = vessel.servos[channel]
    lower = limits[0] if servo.lower is None else jnp.maximum(limits[0], servo.lower)
    upper = limits[1] if servo.upper is None else jnp.minimum(limits[1], servo.upper)
    if not isinstance(lower + upper, Tracer) and not bool(jnp.isfinite(upper - lower)):
        raise UserError(
            f"positioning needs limits of every actuator's orders, and {channel!r} of "
            f"{vessel.name!r} has none: state them in the vessel file or the mission"
        )
    return lower, upper


def _lag(servo: Servo, way: Scalar, period: float) -> Scalar:
    """How late (s) an actuator is: lag, delay, and a usual `way` at its largest rate."""
    parts = [part for part in (servo.time_constant, servo.delay) if part is not None]
    if servo.rate_limit is not None:
        parts.append(way / servo.rate_limit)
    return jnp.maximum(jnp.asarray(sum(parts), float), _QUICKEST * period)


def orders_at_rest(vessel: Vessel) -> dict[str, Scalar]:
    """Orders by which no actuator does anything: neutral in its unit."""
    neutral = {channel: servo.neutral for channel, servo in vessel.servos.items()}
    return {c: jnp.asarray(0.0 if at is None else at, float) for c, at in neutral.items()}


def acceleration(vessel: Vessel, motion: Motion, orders: Mapping[str, Scalar]) -> Motion:
    """Accelerations in still water with actuators settled to orders, heading north."""
    zero = jnp.zeros(())
    executed = {
        c: servo.target(jnp.asarray(orders[c], float)) for c, servo in vessel.servos.items()
    }
    state = State(zero, zero, zero, *motion)
    return jnp.stack(vessel.acceleration(state, executed, Environment(), zero))
