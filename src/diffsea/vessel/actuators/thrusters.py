"""Thrusters: fixed, azimuth and tunnel."""

import abc
import dataclasses
import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from diffsea.scales import HARD_OVER
from diffsea.types import Scalar, State
from diffsea.vessel.actuators.thrust_curve import FORCES, SPEEDS, Drive, read_drive
from diffsea.vessel.actuators.thrust_curve import KEYS as DRIVE_KEYS
from diffsea.vessel.base import (
    AbstractActuator,
    AbstractPropulsor,
    CommandChannel,
    Jet,
    Losses,
    Vessel,
)
from diffsea.vessel.forces import Force
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, check_keys, needed, numbers, optional_number, positive


MOST_TRANSVERSE = 0.5  # cosine of the angle below which a thruster pushes across: 60 deg off
TURN_ROUNDING = 1e-3  # rad: how exactly a file says half a turn to both sides


class AbstractThruster(AbstractPropulsor):
    """A thruster that is ordered in one of several units, and makes thrust of it by its `drive`."""

    diameter: ClassVar[None] = None
    drive: eqx.AbstractVar[Drive]

    @property
    @abc.abstractmethod
    def force_channel(self) -> str:
        """The channel that orders its thrust."""

    @property
    def bollard_coefficient(self) -> Scalar | None:
        return None if self.drive.curve is None else self.drive.curve[1]

    @property
    def full_throttle(self) -> Scalar | None:
        servo = self.servos[self.force_channel]
        limit = servo.lower if self.drive.reversed else servo.upper
        return None if limit is None else self.drive.throttle(limit, servo.neutral)

    def thrust_at_rest(self, executed: Scalar) -> Scalar:
        return self.drive.thrust(executed, self.servos[self.force_channel].neutral)

    def order_of(self, throttle: Scalar) -> Scalar:
        """The order of its thrust for a throttle of its own, N or rev/s."""
        return self.drive.order(throttle, self.servos[self.force_channel].neutral)

    def push(
        self, executed: dict[str, Scalar], water: State, x: Scalar, y: Scalar, angle: Scalar
    ) -> Force:
        """The force (N, N m) of its thrust at (x, y) m, `angle` rad clockwise from ahead."""
        along, across = water.u - y * water.r, water.v + x * water.r
        advance = 0.0
        if self.drive.curve is not None:
            advance = along * jnp.cos(angle) + across * jnp.sin(angle)
        neutral = self.servos[self.force_channel].neutral
        thrust = self.drive.thrust(executed[self.force_channel], neutral, advance)
        return Force.of_thrust(thrust * self.losses.factor(water), x, y, angle)


class FixedThruster(AbstractThruster):
    """A thruster of fixed direction.

    Thrusters of both sides steer by their difference: angle / 35 deg is the difference of port and
    starboard thrust over their sum. A transverse one is left alone by control allocation, as a
    tunnel thruster is.
    """

    servos: dict[str, Servo]
    x: Scalar = 0.0  # m forward of amidships
    y: Scalar = 0.0  # m to starboard
    angle: Scalar = 0.0  # rad, direction of push from ahead, clockwise
    drive: Drive = Drive()
    losses: Losses = Losses()
    transverse: bool = eqx.field(static=True, default=False)  # pushes rather across than along

    @property
    def differential(self) -> bool:
        return not self.transverse

    @property
    def takes_throttle(self) -> bool:
        return not self.transverse

    @property
    def force_channel(self) -> str:
        return next(iter(self.servos))

    @property
    def channels(self) -> dict[str, CommandChannel]:
        return dict.fromkeys(self.servos, CommandChannel("propulsion", self.drive.unit))

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        if self.transverse:
            return {self.force_channel: self.order_of(0.0)}
        share = 1 + -jnp.sign(self.y) * angle / HARD_OVER
        if self.drive.takes_speed:
            # Thrust goes with |n| n, so a share of the thrust is a root of the speed.
            share = jnp.sign(share) * jnp.sqrt(jnp.abs(share) + 1e-16)
        return {self.force_channel: self.order_of(throttle * share)}

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        return self.push(executed, water, self.x, self.y, self.angle)

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "FixedThruster":
        where, places = f"[[thruster]] {name!r}", ("x", "y", "angle")
        _check_thruster_keys(table, places, where)
        drive, scale = read_drive(table, where)
        at = numbers(table, places, where)
        return cls(
            {name: dataclasses.replace(Servo.from_table(table, where), **scale)},
            drive=drive,
            losses=Losses.from_table(table, where),
            transverse=abs(math.cos(at.get("angle", 0.0))) < MOST_TRANSVERSE,
            **at,
        )


def _check_thruster_keys(table: Table, own: tuple[str, ...], where: str) -> None:
    """Refuse a key that is none of a thruster's, nor its `own`."""
    known = ("name", *Servo.KEYS, *Losses.KEYS, *own, *DRIVE_KEYS)
    check_keys(table, (*known, *SPEEDS) if "curve" in table else known, where)


class AzimuthThruster(AbstractThruster):
    """A thruster that turns: channels force and angle (rad clockwise from ahead).

    It turns as a rudder would in control allocation: against the angle ahead of amidships. Where
    its limits leave it a whole turn it goes the short way from one angle to another.
    """

    servos: dict[str, Servo]  # "<name>.force" and "<name>.angle", in any order
    x: Scalar = 0.0  # m forward of amidships
    y: Scalar = 0.0  # m to starboard
    drive: Drive = Drive()
    losses: Losses = Losses()

    @property
    def force_channel(self) -> str:
        # By name: trees of arrays do not keep the order of a dictionary.
        return next(channel for channel in self.servos if channel.endswith(".force"))

    @property
    def angle_channel(self) -> str:
        """The channel that orders its angle."""
        return next(channel for channel in self.servos if channel.endswith(".angle"))

    @property
    def channels(self) -> dict[str, CommandChannel]:
        return {
            self.force_channel: CommandChannel("propulsion", self.drive.unit),
            self.angle_channel: CommandChannel("steering", "rad"),
        }

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        turned = jnp.sign(self.x) * angle
        return {self.force_channel: self.order_of(throttle), self.angle_channel: turned}

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        return self.push(executed, water, self.x, self.y, executed[self.angle_channel])

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "AzimuthThruster":
        """As of its base; the angle has stages of its own and the delay of the force.

        A curve without c is one whose thrust does not change with the speed of advance.
        """
        where = f"[[azimuth_thruster]] {name!r}"
        stages = {"upper": "max_angle", "lower": "min_angle"}
        stages |= {"time_constant": "angle_time_constant", "rate_limit": "angle_rate_limit"}
        _check_thruster_keys(table, ("x", "y", *stages.values()), where)
        if isinstance(table.get("curve"), dict):
            table = table | {"curve": {"c": 0.0} | table["curve"]}
        drive, scale = read_drive(table, where)
        force = dataclasses.replace(Servo.from_table(table, where), **scale)
        read: dict[str, Any] = {
            stage: optional_number(table, key, where) for stage, key in stages.items()
        }
        low = -math.inf if read["lower"] is None else read["lower"]
        high = math.inf if read["upper"] is None else read["upper"]
        endless = high - low > 2 * math.pi - TURN_ROUNDING and math.isinf(low) == math.isinf(high)
        angle = Servo(delay=force.delay, endless=endless, **read)
        return cls(
            {f"{name}.force": force, f"{name}.angle": angle},
            drive=drive,
            losses=Losses.from_table(table, where),
            **numbers(table, ("x", "y"), where),
        )


class TunnelThruster(AbstractActuator):
    """A transverse thruster commanded in N to starboard; it fades with forward speed.

    The factor is `1 / (1 + (u_r / fading_speed)^2)`; no fading where that is None. Control
    allocation leaves it alone: it is for manoeuvres at low speed.
    """

    command: ClassVar[CommandChannel] = CommandChannel("side thrust", "N")
    y: ClassVar[float] = 0.0

    servos: dict[str, Servo]
    x: Scalar  # m forward of amidships
    fading_speed: Scalar | None = None  # m/s, half the force is left here
    effectiveness: Scalar = 1.0  # force at rest over the ordered one

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (thrust,) = (self.effectiveness * executed[channel] for channel in self.servos)
        if self.fading_speed is not None:
            thrust = thrust / (1 + (water.u / self.fading_speed) ** 2)
        return Force(0.0, thrust, self.x * thrust)

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "TunnelThruster":
        where, optional = f"[[tunnel_thruster]] {name!r}", ("fading_speed", "effectiveness")
        check_keys(table, ("name", *Servo.KEYS, *FORCES, "x", *optional), where)
        if "fading_speed" in table:
            positive(table, "fading_speed", where)
        return cls(
            {name: Servo.from_table(table, where, *FORCES)},
            x=needed(table, "x", where),
            **numbers(table, optional, where),
        )
