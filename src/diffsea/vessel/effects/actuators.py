"""Effects on the way from an order to what is executed, by kind of channel."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from diffsea.scales import GRAVITY, froude_speed
from diffsea.types import Scalar
from diffsea.vessel.base import AbstractActuator, Vessel
from diffsea.vessel.effects.entry import Bound, Coordinates, Effect, time_scale
from diffsea.vessel.servo import Servo


KINDS = ("propulsion", "steering")
COMMANDED = "N or rev/s"  # the unit of a number on any vessel's propulsion
SIDES = {"port": -1, "starboard": 1}  # sign of y


def channels_of(vessel: Vessel, kind: str) -> tuple[str, ...]:
    """Channels that push (thrusts and shaft speeds), or that steer (angles), or push on a side."""
    if kind in SIDES:
        pushing, parts = channels_of(vessel, "propulsion"), vessel.actuators.values()
        beside = [part for part in parts if SIDES[kind] * float(part.y) > 0]
        return tuple(c for part in beside for c in part.servos if c in pushing)
    return tuple(
        channel
        for part in vessel.actuators.values()
        for channel in part.servos
        if (part.channels[channel].role == "steering") == (kind == "steering")
    )


def full(vessel: Vessel, channels: Iterable[str]) -> Scalar:
    """The largest order of some channels: their widest limit, or a plausible number."""
    servos = vessel.servos
    limits = [
        jnp.abs(end)
        for channel in channels
        for end in (servos[channel].lower, servos[channel].upper)
        if end is not None
    ]
    if not limits:
        return _plausible(vessel, tuple(channels))
    return functools.reduce(jnp.maximum, limits)


def _plausible(vessel: Vessel, channels: tuple[str, ...]) -> Scalar:
    """0.6 rad, the shaft speed for Froude number 0.3, or a twentieth of the weight."""
    if set(channels) <= set(channels_of(vessel, "steering")):
        return 0.6
    body = vessel.rigid_body
    for part in vessel.propulsors.values():
        if part.diameter is not None and set(part.servos) & set(channels):
            return froude_speed(body.length, 0.3) / (0.7 * part.diameter)
    return 0.05 * GRAVITY * body.mass


def on_channels(
    vessel: Vessel, channels: Iterable[str], change: Callable[[Servo, AbstractActuator], Servo]
) -> Vessel:
    """The vessel with the servos of some channels changed; `change` sees their actuator, too."""
    chosen = set(channels)

    def changed(actuator: AbstractActuator) -> AbstractActuator:
        servos = {c: change(s, actuator) if c in chosen else s for c, s in actuator.servos.items()}
        return eqx.tree_at(lambda a: a.servos, actuator, servos)

    parts = {name: changed(actuator) for name, actuator in vessel.actuators.items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, parts)


@dataclasses.dataclass(frozen=True)
class Stage:
    """An effect that is a stage of a servo: how a size of it changes the servo.

    `size` is what would be noticeable, for channels with a largest order on a vessel with a time
    scale. A file says some stages by the inverse of their size: a rate limit, a limit.
    """

    name: str
    parameter: str
    timed: bool  # its unit is s, the same for all channels; otherwise that of the orders
    change: Callable[[Servo, Scalar, Scalar], Servo]  # of the servo, the size, the largest order
    size: Callable[[Scalar, float], Scalar]  # of the largest order and the time scale
    law: str
    confusables: tuple[str, ...]
    stated: Callable[[Servo, Scalar], Servo]  # the servo with what a file says
    positive: bool = True
    finite: tuple[float, ...] = ()
    flat: bool = False
    limited: bool = False  # only where limits are stated
    in_orders: bool = False  # its coordinate counts orders, and cannot be more than the largest

    def apply(
        self, vessel: Vessel, channels: tuple[str, ...], value: Scalar, side: int = 0
    ) -> Vessel:
        """The vessel with the stage on some channels; `value` is the coordinate.

        `side` restricts it to actuators whose y has that sign.
        """
        largest = full(vessel, channels)

        def change(servo: Servo, actuator: AbstractActuator) -> Servo:
            if side == 0:
                return self.change(servo, value, largest)
            beside = jnp.sign(actuator.y) == side
            return self.change(servo, jnp.where(beside, value, 0.0), largest)

        return on_channels(vessel, channels, change)

    def say(self, vessel: Vessel, channels: tuple[str, ...], value: Scalar) -> Vessel:
        """The vessel with what a file says of the stage on some channels."""
        return on_channels(vessel, channels, lambda servo, _: self.stated(servo, value))

    def to_file(self, value: Any, vessel: Vessel, channels: tuple[str, ...]) -> Any:
        """What a file says, from the coordinate."""
        if self.name == "rate-limit":
            own = vessel.servos[channels[0]].slew
            return 1 / ((0.0 if own is None else own) + value)
        return full(vessel, channels) / (1 + value) if self.name == "thrust-saturation" else value

    def effect(self, kind: str) -> Effect:
        """The catalogue's entry for channels of one kind."""

        def channels(vessel: Vessel) -> tuple[str, ...]:
            return channels_of(vessel, "propulsion" if kind in SIDES else kind)

        def decode(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
            return {self.parameter: self.to_file(at[0], vessel, channels(vessel))}

        def bounds(vessel: Vessel) -> tuple[Bound, ...]:
            largest = float(full(vessel, channels(vessel))) if self.in_orders else math.inf
            return ((-largest, largest),)

        def possible(vessel: Vessel) -> bool:
            servos = [vessel.servos[c] for c in channels(vessel)]
            stated = any(s.upper is not None or s.lower is not None for s in servos)
            there = bool(servos) and (kind not in SIDES or bool(channels_of(vessel, kind)))
            return there and (stated or not self.limited)

        return Effect(
            f"{self.name}:{kind}", "actuator", {self.parameter: self._unit(kind)},
            lambda v, at: self.apply(v, channels(v), at[0], SIDES.get(kind, 0)),
            lambda v: (self.size(full(v, channels(v)), time_scale(v)),),
            possible, self.positive, bounds=bounds, decode=decode, coordinate_names=("size",),
            finite=self.finite, flat=self.flat, where={"kind": kind}, law=self.law,
            confusables=self.confusables,
        )  # fmt: skip

    def _unit(self, kind: str) -> str:
        if self.timed:
            return "s"
        unit = "rad" if kind == "steering" else COMMANDED
        return f"{unit} per s" if self.name == "rate-limit" else unit


def _plus(field: str) -> Callable[[Servo, Scalar, Scalar], Servo]:
    """Adds to one number of a servo, which starts from zero where it is None."""

    def change(servo: Servo, by: Scalar, largest: Scalar) -> Servo:
        now = getattr(servo, field)
        return dataclasses.replace(servo, **{field: (0.0 if now is None else now) + by})

    return change


def _limited(servo: Servo, limit: Scalar) -> Servo:
    upper = limit if servo.upper is None else jnp.minimum(servo.upper, limit)
    lower = -limit if servo.lower is None else jnp.maximum(servo.lower, -limit)
    return dataclasses.replace(servo, upper=upper, lower=lower)


def _slowed(servo: Servo, rate_limit: Scalar) -> Servo:
    """The lower of the rate limit and the servo's own holds."""
    own = 0.0 if servo.rate_limit is None else 1 / servo.rate_limit
    more = jnp.maximum(1 / rate_limit - own, 0.0)
    now = 0.0 if servo.slowness is None else servo.slowness
    return dataclasses.replace(servo, slowness=jnp.maximum(now, more))


def _added(field: str) -> Callable[[Servo, Scalar], Servo]:
    return lambda servo, value: _plus(field)(servo, value, value)


def _clipped(servo: Servo, by: Scalar, largest: Scalar) -> Servo:
    limit = largest / (1 + by)
    upper = None if servo.upper is None else jnp.minimum(servo.upper, limit)
    lower = None if servo.lower is None else jnp.maximum(servo.lower, -limit)
    return dataclasses.replace(servo, upper=upper, lower=lower)


# A response that is late by several rows is nothing like the derivative for one that is not.
LATE = (0.3, 1.0, 3.0)

STAGES = {
    stage.name: stage
    for stage in (
        Stage(
            "thrust-lag", "time_constant", True, _plus("time_constant"), lambda n, t: t,
            "dn/dt = (order - n) / time_constant, exact for orders that hold between samples",
            ("thrust-delay", "rate-limit", "backlash", "sensor-latency", "clock-drift"),
            _added("time_constant"), finite=LATE,
        ),
        Stage(
            "thrust-delay", "delay", True, _plus("delay"), lambda n, t: t,
            "an order takes effect `delay` later",
            ("thrust-lag", "clock-drift", "sensor-latency", "rate-limit"), _added("delay"),
            finite=LATE,
        ),
        Stage(
            "rate-limit", "rate_limit", False, _plus("slowness"), lambda n, t: t / n,
            "|dn/dt| <= rate_limit; the coordinate is its inverse, zero for none",
            ("thrust-lag", "thrust-delay", "backlash"), _slowed, finite=LATE,
        ),
        Stage(
            "deadband", "width", False, _plus("deadband"), lambda n, t: 0.05 * n,
            "no action for |order| < width, order - width sign(order) beyond",
            ("backlash", "thrust-loss-with-speed", "drag-change"), _added("deadband"),
            in_orders=True,
        ),
        Stage(
            "backlash", "width", False, _plus("backlash"), lambda n, t: 0.05 * n,
            "play operator: the actuator stays while the order is within `width` of it",
            ("deadband", "thrust-lag", "rate-limit"), _added("backlash"), finite=LATE,
            in_orders=True,
        ),
        Stage(
            "thrust-saturation", "limit", False, _clipped, lambda n, t: 0.3,
            "realised values clip at +-limit below the stated one (first coordinate: stated limit "
            "over limit less one)",
            ("thrust-loss-with-speed", "drag-change", "thrust-change"), _limited,
            finite=(0.3, 1.0, 3.0), flat=True, limited=True,
        ),
        Stage(
            "actuator-bias", "bias", False, _plus("bias"), lambda n, t: 0.03 * n,
            "orders act as order + bias: rudder trim, a thruster's neutral point",
            ("thrust-asymmetry", "thruster-misalignment", "gyro-bias", "wind"), _added("bias"),
            positive=False, in_orders=True,
        ),
    )
}  # fmt: skip

# A fault of one side is as likely as one of all where an actuator's neutral point is concerned.
ACTUATORS = tuple(
    stage.effect(kind)
    for stage in STAGES.values()
    for kind in ((*KINDS, *SIDES) if stage.name == "actuator-bias" else KINDS)
)
