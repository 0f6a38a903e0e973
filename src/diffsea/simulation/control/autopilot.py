"""Controllers: from a vessel's state to the orders of its actuators.

An autopilot is assembled from guidance, a heading law, a speed law and an allocation. Anything with
`init`, `step` and `is_finished` is a controller and runs in `simulation.closed_loop`.
"""

import abc
from typing import Generic

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from diffsea.simulation.control.allocation import ControlAllocation, require_steering
from diffsea.simulation.control.guidance import AbstractGuidance, Course
from diffsea.simulation.control.laws import (
    AbstractHeadingLaw,
    AbstractSpeedLaw,
    Memory,
    heading_hold,
    speed_hold,
)
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


class AbstractController(eqx.Module, Generic[Memory]):
    """Orders from the state, at the controller's own period."""

    @abc.abstractmethod
    def init(self) -> Memory:
        """Memory at the start."""

    @abc.abstractmethod
    def step(
        self, memory: Memory, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Memory, dict[str, Scalar]]:
        """Next memory, and the orders by channel that hold until the next step, `dt` s later."""

    @abc.abstractmethod
    def is_finished(self, memory: Memory) -> Bool[Array, ""]:
        """Whether the task is done: the run ends there."""


class Steering(eqx.Module):
    """Guidance, heading law and speed law: throttle and rudder angle for any vessel."""

    guidance: AbstractGuidance
    heading: AbstractHeadingLaw
    speed: AbstractSpeedLaw

    def init(self) -> tuple:
        """Memories of the three."""
        return self.guidance.init(), self.heading.init(), self.speed.init()

    def step(self, memory: tuple, state: State, dt: Scalar) -> tuple[tuple, tuple[Scalar, Scalar]]:
        """Next memory, and the throttle and rudder angle (rad) to order now."""
        guidance, wanted = self.guidance.step(memory[0], state, dt)
        heading, angle = self.heading.step(memory[1], state, wanted.heading, dt)
        speed, throttle = self.speed.step(memory[2], state, wanted.share, dt)
        return (guidance, heading, speed), (throttle, angle)


class Autopilot(AbstractController[tuple]):
    """Steers a vessel: throttle and rudder angle, allocated to its channels.

    With `stop`, all orders are zero once the path is finished.
    """

    steering: Steering
    allocation: ControlAllocation
    stop: bool = eqx.field(static=True, default=True)

    def init(self) -> tuple:
        return self.steering.init()

    def step(
        self, memory: tuple, state: State, t: Scalar, dt: Scalar
    ) -> tuple[tuple, dict[str, Scalar]]:
        memory, (throttle, angle) = self.steering.step(memory, state, dt)
        over = self.is_finished(memory) & self.stop
        return memory, self.allocation.orders(
            jnp.where(over, 0.0, throttle), jnp.where(over, 0.0, angle)
        )

    def is_finished(self, memory: tuple) -> Bool[Array, ""]:
        return self.steering.guidance.is_finished(memory[0])


def autopilot(
    vessel: Vessel,
    speed: Scalar,
    guidance: AbstractGuidance | None = None,
    heading: AbstractHeadingLaw | None = None,
) -> Autopilot:
    """An autopilot that suits a vessel at `speed` m/s: holds heading zero without guidance.

    Raises `UserError` for a vessel that cannot be steered.
    """
    require_steering(vessel, "path under an autopilot")
    law = heading_hold(vessel, speed) if heading is None else heading
    steering = Steering(guidance or Course(), law, speed_hold(vessel, speed))
    return Autopilot(steering, ControlAllocation(vessel))
