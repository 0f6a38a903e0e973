"""Thrusters: fixed, azimuth and tunnel, ordered in newtons or, with a thrust curve, in rev/s."""

import math
from typing import ClassVar

import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.scales import HARD_OVER
from diffsea.types import Scalar, State
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


_FORCES = ("min_force", "max_force")  # keys of limits, N


class FixedThruster(AbstractPropulsor):
    """A thruster of fixed direction, commanded in N, or in rev/s with a thrust curve.

    With a curve, `T = c V n + d |n| n` where V is the speed through the water at the
    thruster along its axis (Blanke 1981 after Fossen 2021, eq. 9.7). Thrusters of both sides
    steer by their difference: angle / 35 deg is the difference of port and starboard thrust
    over their sum.
    """

    differential: ClassVar[bool] = True
    diameter: ClassVar[None] = None

    servos: dict[str, Servo]
    x: Scalar = 0.0  # m forward of amidships
    y: Scalar = 0.0  # m to starboard
    angle: Scalar = 0.0  # rad, direction of push from ahead, clockwise
    curve: tuple[Scalar, Scalar] | None = None  # c in N s^2/m, d in N s^2
    losses: Losses = Losses()

    @property
    def channels(self) -> dict[str, CommandChannel]:
        unit = "N" if self.curve is None else "rev/s"
        return dict.fromkeys(self.servos, CommandChannel("propulsion", unit))

    @property
    def bollard_coefficient(self) -> Scalar | None:
        return None if self.curve is None else self.curve[1]

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        share = 1 + -jnp.sign(self.y) * angle / HARD_OVER
        if self.curve is None:
            return dict.fromkeys(self.servos, throttle * share)
        # Thrust goes with |n| n, so a share of the thrust is a root of the speed.
        speed = throttle * jnp.sign(share) * jnp.sqrt(jnp.abs(share) + 1e-16)
        return dict.fromkeys(self.servos, speed)

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (thrust,) = (executed[channel] for channel in self.servos)
        if self.curve is not None:
            (c, d), n = self.curve, thrust
            along = water.u - self.y * water.r
            across = water.v + self.x * water.r
            advance = along * jnp.cos(self.angle) + across * jnp.sin(self.angle)
            thrust = c * advance * n + d * jnp.abs(n) * n
        return Force.of_thrust(thrust * self.losses.factor(water), self.x, self.y, self.angle)

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "FixedThruster":
        """As of its base.

        With a curve, limits are speeds (rev/s); stated as forces (N) they hold for the thrust at
        rest.
        """
        where, curve = f"[[thruster]] {name!r}", None
        places, limits, speeds = ("x", "y", "angle"), _FORCES, ("min_speed", "max_speed")
        known = ("name", *Servo.KEYS, *Losses.KEYS, *places, "curve", *_FORCES)
        check_keys(table, (*known, *speeds) if "curve" in table else known, where)
        if "curve" in table:
            given, limits = table["curve"], speeds
            if not isinstance(given, dict) or set(given) != {"c", "d"}:
                raise UserError(f"{where}: curve = {{c = .., d = ..}} for T = c V n + d |n| n")
            curve = needed(given, "c", where), positive(given, "d", where)
            forces = numbers(table, _FORCES, where).items()
            at_rest = {
                key.replace("force", "speed"): math.copysign(math.sqrt(abs(F) / curve[1]), F)
                for key, F in forces
            }
            table = at_rest | table
        return cls(
            {name: Servo.from_table(table, where, *limits)},
            curve=curve,
            losses=Losses.from_table(table, where),
            **numbers(table, places, where),
        )


class AzimuthThruster(AbstractPropulsor):
    """A thruster that turns: channels force (N) and angle (rad clockwise from ahead).

    It turns as a rudder would in control allocation: against the angle ahead of amidships.
    """

    diameter: ClassVar[None] = None
    bollard_coefficient: ClassVar[None] = None

    servos: dict[str, Servo]  # "<name>.force" and "<name>.angle", in any order
    x: Scalar = 0.0  # m forward of amidships
    y: Scalar = 0.0  # m to starboard
    losses: Losses = Losses()

    @property
    def force_channel(self) -> str:
        """The channel that orders its force."""
        # By name: trees of arrays do not keep the order of a dictionary.
        return next(channel for channel in self.servos if channel.endswith(".force"))

    @property
    def angle_channel(self) -> str:
        """The channel that orders its angle."""
        return next(channel for channel in self.servos if channel.endswith(".angle"))

    @property
    def channels(self) -> dict[str, CommandChannel]:
        return {
            self.force_channel: CommandChannel("propulsion", "N"),
            self.angle_channel: CommandChannel("steering", "rad"),
        }

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        return {self.force_channel: throttle, self.angle_channel: jnp.sign(self.x) * angle}

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        thrust = executed[self.force_channel] * self.losses.factor(water)
        return Force.of_thrust(thrust, self.x, self.y, executed[self.angle_channel])

    @classmethod
    def from_table(cls, name: str, table: Table, vessel: Vessel) -> "AzimuthThruster":
        """As of its base; the angle has stages of its own and the delay of the force."""
        where = f"[[azimuth_thruster]] {name!r}"
        stages = {"upper": "max_angle", "lower": "min_angle"}
        stages |= {"time_constant": "angle_time_constant", "rate_limit": "angle_rate_limit"}
        keys = ("name", *Servo.KEYS, *Losses.KEYS, "x", "y", *_FORCES[::-1])
        check_keys(table, (*keys, *stages.values()), where)
        force = Servo.from_table(table, where, *_FORCES)
        read = {stage: optional_number(table, key, where) for stage, key in stages.items()}
        return cls(
            {f"{name}.force": force, f"{name}.angle": Servo(delay=force.delay, **read)},
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
        check_keys(table, ("name", *Servo.KEYS, *_FORCES, "x", *optional), where)
        return cls(
            {name: Servo.from_table(table, where, *_FORCES)},
            x=needed(table, "x", where),
            **numbers(table, optional, where),
        )
