"""ArduPilot's mixers: what its throttle and steering order of a vessel's actuators (AP_MotorsUGV).

Thrusters of both sides get throttle plus and minus steering, a rudder the share of its largest
angle, a thruster that turns the angle at which its side force is the steering. Outputs are from
-1 to 1, of thrust; the thrust curve `MOT_THST_EXPO` makes orders of them.
"""

import dataclasses
import math
from collections.abc import Callable

import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.vessel.actuators import AzimuthThruster, FixedThruster, Propeller
from diffsea.vessel.base import AbstractPropulsor, Vessel


_SMALLEST_SHARE = 1e-9  # of a thrust: at none a turning thruster points ahead

Orders = dict[str, float]


@dataclasses.dataclass(frozen=True)
class Mixer:
    """How ArduPilot's outputs become the orders of a vessel's channels.

    Attributes:
        kind: "skid", "rudder" or "vectored".
        expo: `MOT_THST_EXPO`, of a thrust `(1 - e) o + e o^2` at an output o.
        asymmetry: thrust at full order ahead over that astern.
        largest_angle: rad, of a rudder or of a thruster that turns.
        orders: of the channels for a throttle and a steering, from -1 to 1.
    """

    kind: str
    expo: float
    asymmetry: float
    largest_angle: float | None
    orders: Callable[[float, float], Orders]

    def steering_range(self, throttle: float) -> float:
        """The largest steering at a throttle that takes nothing from the throttle."""
        if self.kind == "skid":
            return min(1 - throttle, throttle + 1 / max(self.asymmetry, 1.0))
        if self.kind == "vectored":
            assert self.largest_angle is not None
            return min(1.0, throttle * math.tan(self.largest_angle))
        return 1.0


def mixer_of(vessel: Vessel) -> Mixer:
    """How ArduPilot would drive a vessel.

    Raises:
        UserError: it has no such frame, or the vessel's file states no limits.
    """
    parts = vessel.actuators.values()
    steered = [
        c for part in parts for c, channel in part.channels.items() if channel.role == "steering"
    ]
    turning = [part for part in vessel.driving if isinstance(part, AzimuthThruster)]
    sides = [part for part in vessel.driving if isinstance(part, FixedThruster) and float(part.y)]
    if turning:
        if len(vessel.driving) > 1:
            raise UserError("--to ardupilot: of vectored thrust ArduPilot has one thruster")
        return _vectored(vessel, turning[0])
    if steered and vessel.driving:
        return _with_rudder(vessel, steered)
    on_both_sides = {float(p.y) > 0 for p in sides} == {True, False}
    if on_both_sides and len(sides) == len(vessel.driving):
        return _skid(vessel)
    raise UserError(
        f"--to ardupilot: {vessel.name!r} has none of the frames that ArduPilot steers: thrusters "
        "on both sides, a propulsor with a rudder, or one thruster that turns"
    )


def _ends(vessel: Vessel, part: AbstractPropulsor) -> tuple[str, float, float, float]:
    """A propulsor's channel, and its orders at rest, full ahead and full astern.

    Raises:
        UserError: the vessel's file states no limits.
    """
    channel = next(c for c, of in part.channels.items() if of.role == "propulsion")
    servo = vessel.servos[channel]
    if servo.upper is None or servo.lower is None:
        raise UserError(
            f"--to ardupilot: nothing says what full throttle of {channel!r} is; state its limits "
            "ahead and astern (max_force and min_force, or max_speed and min_speed)"
        )
    neutral = 0.0 if servo.neutral is None else float(servo.neutral)
    ends = float(servo.upper), float(servo.lower)
    drive = getattr(part, "drive", None)
    ahead, astern = reversed(ends) if drive is not None and drive.reversed else ends
    return channel, neutral, ahead, astern


def _exponent(part: AbstractPropulsor) -> float:
    """Of thrust at rest against the order."""
    drive = getattr(part, "drive", None)
    if drive is not None and drive.thrust_curve is not None:
        return float(drive.thrust_curve.exponent)
    return 2.0 if isinstance(part, Propeller) or part.bollard_coefficient is not None else 1.0


def expo_of(exponent: float) -> float:
    """The e of `(1 - e) o + e o^2` that is nearest to `o^exponent` in [0, 1], least squares."""
    nearest = 30 * (1 / (exponent + 3) - 1 / (exponent + 2) + 1 / 12)
    return min(max(round(nearest, 9), -1.0), 1.0)


def _propulsion(vessel: Vessel) -> tuple[float, float, Callable[[AbstractPropulsor, float], float]]:
    """Expo, asymmetry of thrust, and the order of a propulsor for a thrust's share."""
    parts = vessel.driving
    expo = expo_of(_exponent(parts[0]))
    _, _, *both = _ends(vessel, parts[0])
    ahead, astern = (abs(float(parts[0].thrust_at_rest(jnp.asarray(end)))) for end in both)
    asymmetry = ahead / astern if astern > 0 else math.inf
    stretch = max(asymmetry, 1.0)

    def order(part: AbstractPropulsor, share: float) -> float:
        _, neutral, full_ahead, full_astern = _ends(vessel, part)
        share = share * stretch if share < 0 and math.isfinite(stretch) else share
        # What AP_MotorsUGV::get_scaled_throttle makes of it, in a form without a singularity.
        size = abs(share)
        if size > 0:
            size = 2 * size / (1 - expo + math.sqrt((1 - expo) ** 2 + 4 * expo * size))
        end = full_astern if share < 0 else full_ahead
        return neutral + size * (end - neutral)

    return expo, asymmetry, order


def _at_rest(vessel: Vessel) -> Orders:
    """Every channel's neutral, as of thrusters that push across."""
    neutral = {channel: servo.neutral for channel, servo in vessel.servos.items()}
    return {channel: 0.0 if at is None else float(at) for channel, at in neutral.items()}


def _skid(vessel: Vessel) -> Mixer:
    """Thrusters of both sides: throttle plus steering to port, minus to starboard."""
    expo, asymmetry, order = _propulsion(vessel)

    def orders(throttle: float, steering: float) -> Orders:
        return _at_rest(vessel) | {
            channel: order(part, throttle - (steering if float(part.y) > 0 else -steering))
            for part in vessel.driving
            for channel in part.servos
        }

    return Mixer("skid", expo, asymmetry, None, orders)


def _with_rudder(vessel: Vessel, steered: list[str]) -> Mixer:
    """Propulsors by the throttle, rudders by a share of their largest angle."""
    expo, asymmetry, order = _propulsion(vessel)
    limits = [vessel.servos[channel].upper for channel in steered]
    if any(limit is None for limit in limits):
        raise UserError("--to ardupilot: nothing says how far the rudder turns; state max_angle")
    largest = float(min(limits))  # pyright: ignore[reportArgumentType]

    def orders(throttle: float, steering: float) -> Orders:
        drive = {_ends(vessel, part)[0]: order(part, throttle) for part in vessel.driving}
        return _at_rest(vessel) | drive | dict.fromkeys(steered, steering * largest)

    return Mixer("rudder", expo, asymmetry, largest, orders)


def _vectored(vessel: Vessel, part: AzimuthThruster) -> Mixer:
    """A thruster that turns: the side force of its thrust is the steering."""
    expo, asymmetry, order = _propulsion(vessel)
    upper = vessel.servos[part.angle_channel].upper
    if upper is None:
        raise UserError("--to ardupilot: nothing says how far the thruster turns; state max_angle")
    largest = min(float(upper), math.radians(89.0))

    def orders(throttle: float, steering: float) -> Orders:
        angle = math.atan2(steering, max(throttle, _SMALLEST_SHARE))
        share = throttle / math.cos(angle)
        turned = math.copysign(1.0, float(part.x)) * angle
        own = {part.force_channel: order(part, share), part.angle_channel: turned}
        return _at_rest(vessel) | own

    return Mixer("vectored", expo, asymmetry, largest, orders)
