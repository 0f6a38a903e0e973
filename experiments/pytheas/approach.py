# pyright: reportArgumentType=false
"""How close a boat comes to its waypoint, without keeping the run: for design and for sweeps."""

from typing import NamedTuple

from experiments.pytheas.boat import at_rest, boat, disturbed

import jax
import jax.numpy as jnp
from jaxtyping import Array

from diffsea import Environment, Vessel
from diffsea.simulation.control.waypoints import WaypointLogic, waypoint_logic
from diffsea.simulation.integrate import SimulationState, advance, begin
from diffsea.types import Scalar


RANGE, TOLERANCE = 20.0, 2.5  # m: the waypoint lies north
PERIOD = 0.05  # s, of the controller and of integration


class Approach(NamedTuple):
    """What a run is remembered by."""

    closest: Scalar  # m, in the first attempt: until the boat is `TOLERANCE` further off again
    missed: Scalar  # one once the first attempt is over, else zero
    time: Scalar  # s, when it was first within the tolerance; infinite if not in that attempt


class Loop(NamedTuple):
    """What one step of a run hands to the next."""

    motion: SimulationState
    memory: Array
    found: Approach


def start(vessel: Vessel, logic: WaypointLogic) -> Loop:
    """At rest, with the first orders."""
    _, orders = logic.step(logic.init(), at_rest(), jnp.zeros(()), PERIOD)
    motion = begin(vessel, at_rest(), orders, dict.fromkeys(vessel.channels, 1))
    return Loop(
        motion, logic.init(), Approach(jnp.asarray(RANGE), jnp.zeros(()), jnp.asarray(jnp.inf))
    )


def step(vessel: Vessel, logic: WaypointLogic, loop: Loop, number: Scalar) -> Loop:
    """One period further."""
    t = number * PERIOD
    memory, orders = logic.step(loop.memory, loop.motion.state, t, PERIOD)
    motion = advance(vessel, loop.motion, orders, Environment(), t, PERIOD)
    state, found = motion.state, loop.found
    # The small constant keeps the root differentiable at the waypoint.
    distance = jnp.sqrt((RANGE - state.x) ** 2 + state.y**2 + 1e-12)
    now = (distance <= TOLERANCE) & jnp.isinf(found.time) & (found.missed == 0)
    time = jnp.where(now, t + PERIOD, found.time)
    closest = jnp.where(found.missed > 0, found.closest, jnp.minimum(found.closest, distance))
    missed = jnp.where(distance > closest + TOLERANCE, 1.0, found.missed)
    return Loop(motion, memory, Approach(closest, missed, time))


def approach(
    thrust: Scalar,
    lever: Scalar,
    bias: Scalar,
    direction: Scalar,
    seconds: float,
    sharpness: float | None = None,
    D: Scalar | None = None,
) -> Approach:
    """Closest approach of one design to the waypoint in one disturbance within `seconds`.

    The logic never stops here, so that the distance goes on having a derivative within the
    tolerance. `sharpness` None is the published logic.
    """
    vessel = disturbed(boat(thrust, lever, D=D), bias, direction)
    logic = waypoint_logic(vessel, [[RANGE, 0.0]], tolerance=0.0, sharpness=sharpness)
    count = round(seconds / PERIOD)

    def body(loop: Loop, number: Scalar) -> tuple[Loop, None]:
        return step(vessel, logic, loop, number), None

    loop, _ = jax.lax.scan(body, start(vessel, logic), jnp.arange(count, dtype=float))
    return loop.found
