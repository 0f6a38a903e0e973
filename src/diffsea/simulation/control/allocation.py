"""From throttle and rudder angle to the orders of a vessel's actuators.

A throttle is a vessel's own measure of push: total thrust in N for thrusters, rev/s for
propellers and for thrusters with a thrust curve. Every trial speaks in throttle and
rudder angle, whatever the vessel is steered by.
"""

import equinox as eqx
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.scales import HARD_OVER
from diffsea.types import Scalar
from diffsea.vessel.actuators import (
    AzimuthThruster,
    DerivativeRudder,
    FixedThruster,
    Propeller,
    Rudder,
)
from diffsea.vessel.base import Vessel


class ControlAllocation(eqx.Module):
    """Allocation of throttle and rudder angle to a vessel's channels.

    Twin thrusters take rudder-equivalent angles: angle / 35 deg is the difference of port
    and starboard thrust over their sum. An azimuth thruster turns as a rudder would.
    """

    vessel: Vessel

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders by channel; positive `angle` (rad) turns to starboard."""
        orders = {channel: jnp.zeros(()) for channel in self.vessel.channels}
        for part in self.vessel.actuators.values():
            channels = tuple(part.servos)
            if isinstance(part, FixedThruster):
                orders[channels[0]] = self._thruster(part, throttle, angle)
            elif isinstance(part, Propeller):
                orders[channels[0]] = throttle
            elif isinstance(part, Rudder | DerivativeRudder):
                orders[channels[0]] = angle
            elif isinstance(part, AzimuthThruster):
                orders[part.force_channel] = throttle / self.count(AzimuthThruster)
                orders[part.angle_channel] = jnp.sign(part.x) * angle
        return {channel: jnp.asarray(order, float) for channel, order in orders.items()}

    def count(self, kind: type) -> int:
        return sum(isinstance(part, kind) for part in self.vessel.actuators.values())

    def _thruster(self, part: FixedThruster, throttle: Scalar, angle: Scalar) -> Scalar:
        turn = -jnp.sign(part.y) * angle / HARD_OVER
        if part.curve is None:
            return throttle / self.count(FixedThruster) * (1 + turn)
        # Thrust goes with |n| n, so a share of the thrust is a root of the speed.
        return throttle * jnp.sign(1 + turn) * jnp.sqrt(jnp.abs(1 + turn) + 1e-16)

    @property
    def steerable(self) -> bool:
        """Whether an angle changes anything."""
        sided = [p for p in self.vessel.actuators.values() if isinstance(p, FixedThruster)]
        turned = (Rudder, DerivativeRudder, AzimuthThruster)
        return any(float(abs(p.y)) > 0 for p in sided) or any(map(self.count, turned))

    @property
    def propelled(self) -> bool:
        """Whether a throttle changes anything."""
        return any(map(self.count, (FixedThruster, Propeller, AzimuthThruster)))


def require_steering(vessel: Vessel, manoeuvre: str) -> None:
    """Raise `UserError` if a vessel cannot be steered through a manoeuvre."""
    if not ControlAllocation(vessel).steerable:
        raise UserError(
            f"{vessel.name!r} cannot be steered, so it cannot run a {manoeuvre}: it has no rudder, "
            "no azimuth thruster and no thruster off the centreline"
        )
