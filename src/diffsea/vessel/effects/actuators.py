"""Effects on the way from an order to what is executed, by kind of channel."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp

from diffsea.errors import UserError, nearest
from diffsea.scales import GRAVITY, froude_speed
from diffsea.types import Scalar
from diffsea.vessel.base import AbstractActuator, AbstractPropulsor, Vessel
from diffsea.vessel.effects.coordinates import Bound, Size, vessel_time
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    Place,
    read_names,
)
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, needed


Kind = Literal["propulsion", "steering", "port", "starboard", "fore", "aft"]
KINDS: tuple[Kind, ...] = ("propulsion", "steering")
SIDES: dict[Kind, int] = {"port": -1, "starboard": 1}  # sign of y
ENDS: dict[Kind, int] = {"fore": 1, "aft": -1}  # sign of x
EACH_SIDE = (*KINDS, *SIDES)  # of what one side alone is as likely to have as all
ORDER_UNIT = "N or rev/s"  # the unit of a number on any vessel's propulsion
RUDDER_ANGLE = 0.6  # rad, the largest of a vessel that states none: 35 deg
FROUDE_NUMBER = 0.3  # of a vessel that needs all the revolutions that its propeller makes
ADVANCE_RATIO = 0.7  # of a propeller at that speed
THRUST_TO_WEIGHT = 0.05  # of a vessel that states no largest thrust


@dataclasses.dataclass(frozen=True)
class OrderedChannels(Place):
    """Channels that push (thrusts, shaft speeds), or steer (angles), or push on one side or end."""

    kind: Kind

    def all_on(self, vessel: Vessel) -> tuple[str, ...]:
        """Their names on a vessel."""
        side, end = SIDES.get(self.kind, 0), ENDS.get(self.kind, 0)
        steers = self.kind == "steering"
        return tuple(
            channel
            for part in vessel.actuators.values()
            for channel in part.servos
            if (part.channels[channel].role == "steering") == steers
            and (side == 0 or side * float(part.y) > 0)
            and (end == 0 or isinstance(part, AbstractPropulsor) and end * float(part.x) > 0)
        )

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """Them by name, where the vessel has others."""
        channels = self.all_on(vessel)
        return {} if len(channels) == len(vessel.channels) else {"actuators": list(channels)}

    def unit_on(self, vessel: Vessel, unit: str) -> str:
        """The unit in which they are ordered in the place of `ORDER_UNIT`, if they share one."""
        own = {vessel.units[channel] for channel in self.all_on(vessel)}
        return unit.replace(ORDER_UNIT, own.pop()) if len(own) == 1 else unit


def largest_order(vessel: Vessel, channels: Sequence[str]) -> Scalar:
    """The widest limit of some channels, from neutral, or a plausible number where none is stated.

    That is 0.6 rad, the shaft speed for Froude number 0.3, or a twentieth of the weight.
    """
    servos = [vessel.servos[channel] for channel in channels]
    ends = [end for servo in servos for end in _limits(servo) if end is not None]
    if ends:
        return functools.reduce(jnp.maximum, [jnp.abs(end) for end in ends])
    if set(channels) <= set(OrderedChannels("steering").all_on(vessel)):
        return RUDDER_ANGLE
    body = vessel.rigid_body
    for part in vessel.propulsors.values():
        if part.diameter is not None and set(part.servos) & set(channels):
            return froude_speed(body.length, FROUDE_NUMBER) / (ADVANCE_RATIO * part.diameter)
    return THRUST_TO_WEIGHT * GRAVITY * body.mass


def _limits(servo: Servo) -> tuple[Scalar | None, Scalar | None]:
    """The limits of a servo from its neutral."""
    ends = servo.lower, servo.upper
    if servo.neutral is None:
        return ends
    lower, upper = (None if end is None else end - servo.neutral for end in ends)
    return lower, upper


def change_servos(
    vessel: Vessel, channels: Iterable[str], change: Callable[[Servo, AbstractActuator], Servo]
) -> Vessel:
    """The vessel with the servos of some channels changed; `change` sees their actuator, too."""
    chosen, parts = set(channels), {}
    for name, actuator in vessel.actuators.items():
        servos = {c: change(s, actuator) if c in chosen else s for c, s in actuator.servos.items()}
        parts[name] = eqx.tree_at(lambda a: a.servos, actuator, servos)
    return eqx.tree_at(lambda v: v.actuators, vessel, parts)


def chosen_channels(vessel: Vessel, table: Table, where: str, in_order_units: str = "") -> set[str]:
    """Channels of the actuators that a table names, of all of them where it names none.

    Arguments:
        in_order_units: a key of the table whose number is in the unit of the orders, if any is.

    Raises:
        UserError: there is no such actuator; or thrusts and angles share a number in the unit of
            the orders.
    """
    known = {name: tuple(part.servos) for name, part in vessel.actuators.items()}
    known = {c: (c,) for c in vessel.channels} | known
    names = read_names(table, "actuators", where)
    names = vessel.channels if names is None else names
    for name in names:
        if name not in known:
            raise UserError(f"{where}: no actuator {name!r}{nearest(name, known)}")
    channels = {channel for name in names for channel in known[name]}
    angles = channels & set(OrderedChannels("steering").all_on(vessel))
    if in_order_units and 0 < len(angles) < len(channels):
        raise UserError(
            f"{where}: {in_order_units} is in the unit of the orders, and the vessel has thrusts "
            "and angles; say which with actuators = [...] (it has: "
            f"{', '.join(vessel.channels)})"
        )
    return channels


# A response that is late by several rows is nothing like the derivative for one that is not.
_late_size = functools.partial(Size, positive=True, secants=(0.3, 1.0, 3.0))


@dataclasses.dataclass(frozen=True)
class Stage:
    """An effect that is a stage of a servo: how a size of it changes the servo.

    `add` takes the servo, the size and the largest order of the channels. `size` is what would be
    noticeable, for channels with a largest order on a vessel with a time scale (s); `kind_of_size`
    makes its coordinate. A file states most stages by their size, some by its inverse (a rate
    limit, a limit): these have `state`, the servo with what a file says, `inverse`, which makes
    that of the vessel, its channels and the size, and the `coordinate_unit`.
    """

    name: str
    key: str
    unit: str  # braces stand for that of the orders; without them it is one for all channels
    add: Callable[[Servo, Scalar, Scalar], Servo]
    size: Callable[[Scalar, Scalar], Scalar]
    law: str
    phrase: str
    confusables: tuple[str, ...]
    kind_of_size: Callable[..., Size] = _late_size
    kinds: tuple[Kind, ...] = KINDS
    limited: bool = False  # only where limits are stated
    state: Callable[[Servo, Scalar], Servo] | None = None
    inverse: Callable[[Vessel, Sequence[str], Scalar], Scalar] | None = None
    coordinate_unit: str = ""

    def effect(self, kind: Kind) -> Effect:
        """The catalogue's entry for channels of one kind."""
        place, side = OrderedChannels(kind), SIDES.get(kind, 0)
        alike = OrderedChannels("propulsion") if side else place
        order_unit = "rad" if kind == "steering" else ORDER_UNIT
        unit = self.unit.format(order_unit)

        def largest(vessel: Vessel) -> Scalar:
            return largest_order(vessel, alike.all_on(vessel))

        def apply(vessel: Vessel, at: CoordinateValues) -> Vessel:
            most = largest(vessel)

            def change(servo: Servo, actuator: AbstractActuator) -> Servo:
                # By `where`: under JAX an actuator's place is not known.
                own = jnp.where(jnp.sign(actuator.y) == side, at[0], 0.0) if side else at[0]
                return self.add(servo, own, most)

            return change_servos(vessel, alike.all_on(vessel), change)

        def size(vessel: Vessel) -> Scalar:
            return self.size(largest(vessel), vessel_time(vessel))

        def bounds(vessel: Vessel) -> Bound:
            # A coordinate that counts orders cannot be more than the largest.
            counts_orders = self.unit == "{}" and self.inverse is None
            end = float(largest(vessel)) if counts_orders else math.inf
            return -end, end

        def is_possible(vessel: Vessel) -> bool:
            servos = [vessel.servos[channel] for channel in alike.all_on(vessel)]
            stated = any(s.upper is not None or s.lower is not None for s in servos)
            return bool(servos and place.all_on(vessel)) and (stated or not self.limited)

        def decode(vessel: Vessel, at: CoordinateValues) -> Numbers:
            assert self.inverse is not None
            return {self.key: self.inverse(vessel, alike.all_on(vessel), at[0])}

        coordinate, form = (self.key, unit), None
        if self.inverse is not None:
            coordinate = ("size", self.coordinate_unit.format(order_unit))
            form = Parametrisation({self.key: unit}, decode, inverse=True)
        return Effect(
            f"{self.name}:{kind}",
            "actuator",
            (self.kind_of_size(*coordinate, size, bounds),),
            apply,
            self.law,
            self.phrase,
            self.confusables,
            is_possible,
            form,
            place,
            read=self.read,
        )

    def read(self, vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
        """The stage on the actuators that a table names, on all of them where it names none."""
        check_keys(table, ("name", self.key, "actuators"), where)
        value = needed(table, self.key, where)
        if variants[0].leading.positive and value < 0:
            raise UserError(f"{where}: {self.key} = {value:g} is negative")
        channels = chosen_channels(vessel, table, where, self.key if "{}" in self.unit else "")
        if value == 0 and self.inverse is not None:
            raise UserError(f"{where}: {self.key} must be positive; leave it out for none")

        def change(servo: Servo, actuator: AbstractActuator) -> Servo:
            return self.add(servo, value, value) if self.state is None else self.state(servo, value)

        return change_servos(vessel, channels, change)


def _plus(field: str) -> Callable[[Servo, Scalar, Scalar], Servo]:
    """Adds to one number of a servo, which starts from zero where it is None."""

    def add(servo: Servo, by: Scalar, largest: Scalar) -> Servo:
        now = getattr(servo, field)
        return dataclasses.replace(servo, **{field: (0.0 if now is None else now) + by})

    return add


def _with_rate_limit(servo: Servo, rate_limit: Scalar) -> Servo:
    """The lower of the rate limit and the servo's own holds."""
    own = 0.0 if servo.rate_limit is None else 1 / servo.rate_limit
    more = jnp.maximum(1 / rate_limit - own, 0.0)
    now = 0.0 if servo.slowness is None else servo.slowness
    return dataclasses.replace(servo, slowness=jnp.maximum(now, more))


def _rate_limit(vessel: Vessel, channels: Sequence[str], slowness: Scalar) -> Scalar:
    """The rate limit of which the coordinate adds to the inverse."""
    own = vessel.servos[channels[0]].slew
    # Of JAX: endless for none.
    return 1 / (jnp.asarray(0.0 if own is None else own) + slowness)


def _about(neutral: Scalar, limit: Scalar) -> tuple[Scalar, Scalar]:
    """So far below and above neutral."""
    return neutral - limit, neutral + limit


def _with_limit(servo: Servo, limit: Scalar) -> Servo:
    """Limits on both sides, the servo's own where these are narrower."""
    low, high = (-limit, limit) if servo.neutral is None else _about(servo.neutral, limit)
    upper = high if servo.upper is None else jnp.minimum(servo.upper, high)
    lower = low if servo.lower is None else jnp.maximum(servo.lower, low)
    return dataclasses.replace(servo, upper=upper, lower=lower)


def _narrow_limits(servo: Servo, by: Scalar, largest: Scalar) -> Servo:
    """Stated limits no wider than the largest order over one plus the size."""
    limit = largest / (1 + by)
    low, high = (-limit, limit) if servo.neutral is None else _about(servo.neutral, limit)
    upper = None if servo.upper is None else jnp.minimum(servo.upper, high)
    lower = None if servo.lower is None else jnp.maximum(servo.lower, low)
    return dataclasses.replace(servo, upper=upper, lower=lower)


def _limit(vessel: Vessel, channels: Sequence[str], size: Scalar) -> Scalar:
    """The limit of which the coordinate is the stated one over it, less one."""
    return largest_order(vessel, channels) / (1 + size)


STAGES = (
    Stage(
        "thrust-lag",
        "time_constant",
        "s",
        _plus("time_constant"),
        lambda order, time: time,
        law="dn/dt = (order - n) / time_constant, exact for orders that hold between samples",
        phrase="a lag with a time constant of {time_constant} in {actuators}",
        confusables=(
            *("thrust-delay", "rate-limit", "actuator-response"),
            *("backlash", "sensor-latency", "clock-drift"),
        ),
    ),
    Stage(
        "thrust-delay",
        "delay",
        "s",
        _plus("delay"),
        lambda order, time: time,
        law="an order takes effect `delay` later",
        phrase="a dead time of {delay} between order and action of {actuators}",
        confusables=(
            *("thrust-lag", "actuator-response", "clock-drift"),
            *("sensor-latency", "rate-limit"),
        ),
        kinds=EACH_SIDE,
    ),
    Stage(
        "rate-limit",
        "rate_limit",
        "{} per s",
        _plus("slowness"),
        lambda order, time: time / order,
        law="|dn/dt| <= rate_limit; the coordinate is its inverse, zero for none",
        phrase="a slew limit of {rate_limit} in {actuators}",
        confusables=("thrust-lag", "thrust-delay", "actuator-response", "backlash"),
        state=_with_rate_limit,
        inverse=_rate_limit,
        coordinate_unit="s per ({})",
    ),
    Stage(
        "deadband",
        "width",
        "{}",
        _plus("deadband"),
        lambda order, time: 0.05 * order,
        law="no action for |order| < width, order - width sign(order) beyond",
        phrase="a dead band of {width} in {actuators}",
        confusables=("backlash", "thrust-curve", "thrust-loss-with-speed", "drag-change"),
        kind_of_size=functools.partial(Size, positive=True),
    ),
    Stage(
        "backlash",
        "width",
        "{}",
        _plus("backlash"),
        lambda order, time: 0.05 * order,
        law="play operator: the actuator stays while the order is within `width` of it",
        phrase="a play of {width} in {actuators}",
        confusables=("deadband", "thrust-lag", "rate-limit"),
    ),
    Stage(
        "thrust-saturation",
        "limit",
        "{}",
        _narrow_limits,
        lambda order, time: 0.3,
        law="realised values clip at +-limit below the stated one (first coordinate: stated limit "
        "over limit less one)",
        phrase="thrust that clips at {limit}",
        confusables=("thrust-curve", "thrust-loss-with-speed", "drag-change", "thrust-change"),
        # A limit above all orders does nothing, however little above.
        kind_of_size=functools.partial(_late_size, tangent=False),
        limited=True,
        state=_with_limit,
        inverse=_limit,
        coordinate_unit="1",
    ),
    Stage(
        "actuator-bias",
        "bias",
        "{}",
        _plus("bias"),
        lambda order, time: 0.03 * order,
        law="orders act as order + bias: rudder trim, a thruster's neutral point",
        phrase="a neutral point of {actuators} that is off by {bias}",
        confusables=("thrust-asymmetry", "thruster-misalignment", "gyro-bias", "wind"),
        kind_of_size=Size,
        kinds=EACH_SIDE,
    ),
)

_STAGES = {stage.name: stage for stage in STAGES}
RESPONSE = tuple(_STAGES[name] for name in ("thrust-delay", "thrust-lag", "rate-limit"))


def _read_response(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """The stages of a late answer whose keys a table has, on the actuators that it names."""
    given = [stage for stage in RESPONSE if stage.key in table]
    check_keys(table, ("name", "actuators", *(stage.key for stage in RESPONSE)), where)
    if not given:
        keys = ", ".join(stage.key for stage in RESPONSE)
        raise UserError(f"{where}: say how the answer is late: {keys}, one or several of them")
    for stage in given:
        own = {key: table[key] for key in ("name", stage.key, "actuators") if key in table}
        vessel = stage.read(vessel, own, variants, where)
    return vessel


def _late_response(kind: Kind, variant: str, second: Stage, phrase: str) -> Effect:
    """A dead time with a lag, or with a slew limit, in channels of one kind.

    Not all three: without a lag or a slew limit the motion has a derivative by either, but beside a
    lag a slew limit that is too fast to act has none.
    """
    stages = RESPONSE[0], second
    singles = [stage.effect(kind) for stage in stages]

    def apply(vessel: Vessel, at: CoordinateValues) -> Vessel:
        for number, single in enumerate(singles):
            vessel = single.apply(vessel, at[number : number + 1])
        return vessel

    def decode(vessel: Vessel, at: CoordinateValues) -> Numbers:
        numbers = [single.decode(vessel, at[k : k + 1]) for k, single in enumerate(singles)]
        return {key: value for part in numbers for key, value in part.items()}

    return Effect(
        f"actuator-response:{kind}{variant}",
        "actuator",
        tuple(single.leading for single in singles),
        apply,
        "; ".join(stage.law for stage in stages),
        phrase,
        tuple({name: None for single in singles for name in single.confusables}),
        lambda vessel: all(single.possible(vessel) for single in singles),
        Parametrisation({k: u for single in singles for k, u in single.units.items()}, decode),
        singles[0].place,
        read=_read_response,
        parts=tuple(stage.name for stage in stages),
    )


_RESPONSES = (
    ("", _STAGES["thrust-lag"], "an answer of {actuators} that is {delay} late, with a time "
     "constant of {time_constant}"),
    ("-slew", _STAGES["rate-limit"], "an answer of {actuators} that is {delay} late, and changes "
     "by no more than {rate_limit}"),
)  # fmt: skip

ACTUATORS = (
    *(stage.effect(kind) for stage in STAGES for kind in stage.kinds),
    *(_late_response(kind, *response) for kind in EACH_SIDE for response in _RESPONSES),
)
