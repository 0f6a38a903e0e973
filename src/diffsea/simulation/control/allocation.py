"""Control allocation: from throttle and rudder angle to the orders of a vessel's actuators.

A throttle is a vessel's own measure of push: total thrust in N for thrusters, rev/s for
propellers and for thrusters with a thrust curve. Every trial speaks in throttle and
rudder angle, whatever the vessel is steered by.
"""

import equinox as eqx
import jax.numpy as jnp

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import AbstractActuator, Vessel


class ControlAllocation(eqx.Module):
    """Allocation of throttle and rudder angle to a vessel's channels.

    Actuators know what they take of either (`AbstractActuator.orders`); a throttle in N is
    divided among all of a kind before.
    """

    vessel: Vessel

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders by channel; positive `angle` (rad) turns to starboard."""
        orders: dict[str, Scalar] = {}
        for part in self.vessel.actuators.values():
            orders |= part.orders(throttle / self.sharing(part), angle)
        return {channel: jnp.asarray(orders[channel], float) for channel in self.vessel.channels}

    def sharing(self, part: AbstractActuator) -> int:
        """How many actuators divide a throttle of its kind: all alike where it is in N."""
        in_newtons = any(c.role == "propulsion" and c.unit == "N" for c in part.channels.values())
        parts = self.vessel.actuators.values()
        return sum(type(other) is type(part) for other in parts) if in_newtons else 1

    @property
    def steerable(self) -> bool:
        """Whether an angle changes anything."""
        return any(
            any(channel.role == "steering" for channel in part.channels.values())
            or (part.differential and float(abs(part.y)) > 0)
            for part in self.vessel.actuators.values()
        )

    @property
    def propelled(self) -> bool:
        """Whether a throttle changes anything."""
        return bool(self.vessel.propulsors)


def require_steering(vessel: Vessel, manoeuvre: str) -> None:
    """Raise `UserError` if a vessel cannot be steered through a manoeuvre."""
    if not ControlAllocation(vessel).steerable:
        raise UserError(
            f"{vessel.name!r} cannot be steered, so it cannot run a {manoeuvre}: it has no rudder, "
            "no azimuth thruster and no thruster off the centreline"
        )
