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
from diffsea.kinematics import wrap
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.actuators.thrusters import TURN_ROUNDING, AzimuthThruster
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import Servo


Motion = Float[Array, "3"]  # u, v (m/s), r (rad/s)
Shares = Float[Array, "share"]
Limits = Mapping[str, tuple[Scalar, Scalar]]  # lowest and highest order by channel

_HALF = 0.5  # of its effect, at which an effector's slope is taken
_SAMPLES = 33  # of the curve of an effect between its limits
_QUICKEST = 0.25  # periods: an actuator that answers sooner is taken to answer so
_QUARTER = np.pi / 2  # rad, of its way an azimuth thruster turns at its largest rate
_STAYS = 0.05  # of its push, below which an azimuth thruster is not turned: noise would turn it
_NONE = 1e-12  # of an effect, or an effect: as good as none


class AbstractEffector(eqx.Module):
    """What one actuator does for shares of its effect."""

    lag: eqx.AbstractVar[Scalar]  # s, delays included

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """How many shares it takes."""

    @abc.abstractmethod
    def orders(self, shares: Shares, before: Mapping[str, Scalar]) -> dict[str, Scalar]:
        """The orders by which it does what it can of these shares, by channel.

        `before` has the angles (rad) that were ordered last, by channel.
        """

    @abc.abstractmethod
    def possible(self, shares: Shares) -> Shares:
        """The shares, as far as it can bear them."""

    @property
    def first_angles(self) -> dict[str, Scalar]:
        """Angles (rad) that it begins with, by channel: of what turns all the way round."""
        return {}

    def inputs(self, answer: Callable[[dict[str, Scalar]], Motion]) -> Float[Array, "3 share"]:
        """Accelerations (m/s^2, m/s^2, rad/s^2) by its shares, from those by its orders."""

        def column(unit: Shares) -> Motion:
            weaker, stronger = (self.possible(side * _HALF * unit) for side in (-1.0, 1.0))
            apart = jnp.maximum(jnp.sum((stronger - weaker) * unit), 1e-6)
            more, less = (answer(self.orders(one, self.first_angles)) for one in (stronger, weaker))
            return (more - less) / apart

        return jnp.stack([column(unit) for unit in jnp.eye(self.count)], axis=1)


class ChannelEffector(AbstractEffector):
    """An actuator's channel: what its orders come to, as shares of the largest effect."""

    channel: str = eqx.field(static=True)
    values: Float[Array, "sample"]  # orders
    shares: Float[Array, "sample"]  # of these orders; ascending, within -1 and 1
    lag: Scalar

    @property
    def count(self) -> int:
        return 1

    def order(self, share: Scalar) -> Scalar:
        """The order with a share of the effect; the nearest limit where there is none."""
        return jnp.interp(share, self.shares, self.values)

    def orders(self, shares: Shares, before: Mapping[str, Scalar]) -> dict[str, Scalar]:
        return {self.channel: self.order(shares[0])}

    def possible(self, shares: Shares) -> Shares:
        return jnp.clip(shares, self.shares[0], self.shares[-1])


class AzimuthEffector(AbstractEffector):
    """An azimuth thruster that turns all the way round: its push ahead and to starboard.

    It pushes one way, ahead of itself, and turns. Where next to nothing is asked for it stays as
    it is turned, and pushes as much as helps there.
    """

    force: ChannelEffector  # from none to all that it pushes ahead
    angle_channel: str = eqx.field(static=True)
    lowest: Scalar | None  # rad, of its angle; None where it turns on and on
    lag: Scalar

    @property
    def count(self) -> int:
        return 2

    @property
    def first_angles(self) -> dict[str, Scalar]:
        return {self.angle_channel: self._within(jnp.zeros(()), jnp.zeros(()))}

    def orders(self, shares: Shares, before: Mapping[str, Scalar]) -> dict[str, Scalar]:
        last, (ahead, starboard) = before[self.angle_channel], shares
        size = jnp.sqrt(ahead**2 + starboard**2 + _NONE**2)
        stays = size < _STAYS
        angle = jnp.arctan2(starboard, jnp.where(stays, 1.0, ahead))
        angle = jnp.where(stays, last, self._within(angle, last))
        push = jnp.maximum(ahead * jnp.cos(last) + starboard * jnp.sin(last), 0.0)
        force = self.force.order(jnp.where(stays, push, size))
        return {self.force.channel: force, self.angle_channel: angle}

    def _within(self, angle: Scalar, last: Scalar) -> Scalar:
        """The same direction: nearest to the last one, or within the limits."""
        if self.lowest is None:
            return jnp.asarray(last + wrap(angle - last))
        return self.lowest + jnp.mod(angle - self.lowest, 2 * jnp.pi)

    def possible(self, shares: Shares) -> Shares:
        size = jnp.sqrt(jnp.sum(shares**2) + _NONE**2)
        return shares * jnp.minimum(1.0, 1.0 / size)


def effectors_of(vessel: Vessel, period: float, limits: Limits) -> tuple[AbstractEffector, ...]:
    """The effectors of all of a vessel's actuators, for a law that acts every `period` s.

    Raises:
        UserError: an actuator without limits of what it can be ordered.
    """
    turning = {
        part.force_channel: part.angle_channel
        for part in vessel.actuators.values()
        if isinstance(part, AzimuthThruster) and _turns_round(vessel, part.angle_channel, limits)
    }
    return tuple(
        _azimuth_effector(vessel, channel, turning[channel], period, limits)
        if channel in turning
        else _channel_effector(vessel, channel, period, limits)
        for channel in vessel.channels
        if channel not in turning.values()
    )


def _turns_round(vessel: Vessel, channel: str, limits: Limits) -> bool:
    """Whether an azimuth thruster goes to any direction, by its own limits and others."""
    lowest, highest = _limits(vessel, channel, limits)
    known = not isinstance(highest - lowest, Tracer)
    whole = known and float(highest - lowest) > 2 * np.pi - TURN_ROUNDING
    return vessel.servos[channel].endless and (whole or channel not in limits)


def _channel_effector(
    vessel: Vessel, channel: str, period: float, limits: Limits
) -> ChannelEffector:
    """The curve of a channel's effect at rest; in proportion to the order where there is none."""
    rest, length = orders_at_rest(vessel)[channel], vessel.rigid_body.length
    ends = _ends(vessel, channel, limits)
    orders = jnp.linspace(*ends, _SAMPLES)
    answers = _answers(vessel, channel, orders) * jnp.array([1.0, 1.0, length])
    # The small constant keeps the root differentiable where an order does nothing.
    sizes = jnp.sqrt(jnp.sum(answers**2, axis=1) + 1e-30)
    largest = jnp.argmax(sizes)
    towards = answers[largest] * jnp.where(orders[largest] < rest, -1.0, 1.0)
    along = answers @ towards / sizes[largest] ** 2
    plain = (orders - rest) / jnp.max(jnp.abs(orders - rest))
    shares = jnp.where(sizes[largest] > _NONE, along, plain)
    lag = _lag(vessel.servos[channel], 0.25 * (ends[1] - ends[0]), period)
    return ChannelEffector(channel=channel, values=orders, shares=_ascending(shares), lag=lag)


def _azimuth_effector(
    vessel: Vessel, channel: str, angle_channel: str, period: float, limits: Limits
) -> AzimuthEffector:
    """The curve of its push ahead, from its neutral to the end of its orders that gives it."""
    rest, ends = orders_at_rest(vessel)[channel], jnp.stack(_ends(vessel, channel, limits))
    ahead = ends[jnp.argmax(_answers(vessel, channel, ends)[:, 0])]
    orders = jnp.linspace(rest, ahead, _SAMPLES)
    push = _answers(vessel, channel, orders)[:, 0]
    shares = push / jnp.maximum(push[-1], _NONE)
    servo, angle = vessel.servos[channel], vessel.servos[angle_channel]
    lag = _lag(servo, 0.25 * jnp.abs(ahead - rest), period)
    force = ChannelEffector(channel=channel, values=orders, shares=_ascending(shares), lag=lag)
    lowest = (
        angle.lower if angle_channel not in limits else _limits(vessel, angle_channel, limits)[0]
    )
    lag = jnp.maximum(lag, _lag(angle, _QUARTER, period))
    return AzimuthEffector(force=force, angle_channel=angle_channel, lowest=lowest, lag=lag)


def _answers(
    vessel: Vessel, channel: str, orders: Float[Array, "order"]
) -> Float[Array, "order 3"]:
    """Accelerations at rest by orders of one channel, beyond those by none."""
    rest, still = orders_at_rest(vessel), jnp.zeros(3)
    answer = lambda order: acceleration(vessel, still, rest | {channel: order})
    return jax.vmap(answer)(orders) - acceleration(vessel, still, rest)


def _ascending(shares: Float[Array, "sample"]) -> Float[Array, "sample"]:
    """A rise too small to see keeps flat parts, a dead band's, in order."""
    return jax.lax.cummax(shares) + 1e-9 * jnp.arange(float(_SAMPLES))


def _limits(vessel: Vessel, channel: str, limits: Limits) -> tuple[Scalar, Scalar]:
    """The narrower of an actuator's and other limits of its orders; infinite without any."""
    servo, (lower, upper) = vessel.servos[channel], limits.get(channel, (-jnp.inf, jnp.inf))
    lower = lower if servo.lower is None else jnp.maximum(lower, servo.lower)
    upper = upper if servo.upper is None else jnp.minimum(upper, servo.upper)
    return jnp.asarray(lower, float), jnp.asarray(upper, float)


def _ends(vessel: Vessel, channel: str, limits: Limits) -> tuple[Scalar, Scalar]:
    """Lowest and highest order of a channel.

    Raises:
        UserError: nothing limits it.
    """
    lower, upper = _limits(vessel, channel, limits)
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
