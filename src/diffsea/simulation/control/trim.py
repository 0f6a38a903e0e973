"""The trim of a straight run: what keeps a vessel on a course in a steady current and wind."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from diffsea.kinematics import to_body
from diffsea.simulation.control.allocation import ControlAllocation, throttle_for
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel


_PASSES = 60  # where a quadratic drag has no slope an error is but halved in a pass
_TOLERANCE = 1e-6  # rad, and shares of U^2 / L
# Of the sway force against the drift, over U^2 / L: those of other hulls lead to the balance of
# this one, and one that is as good as none is left where there is no other.
_GUIDING_SLOPES, _LEAST_SLOPE = np.array([3.0, 1.0, 0.3, 0.1]), 1e-4
_CRAB_PASSES = 6
_LARGEST_CRAB = 1.0  # rad: beyond it a vessel is blown along rather than trimmed


class Trim(NamedTuple):
    """A steady straight run. Zero, with the throttle of still water, where none is `found`."""

    crab: Scalar  # rad, heading less course
    sway: Scalar  # m/s over ground, to starboard
    angle: Scalar  # rad, of the rudder, positive to starboard
    throttle: Scalar
    found: Bool[Array, ""]


def straight_trim(vessel: Vessel, speed: Scalar, course: Scalar) -> Trim:
    """Trim of a vessel that makes `speed` (m/s, forward, over ground) on a course (rad).

    The heading, rudder angle and throttle at which no acceleration is left and the track lies on
    the course, in the current and wind of the vessel's own environment; actuators answer at once.
    Differentiable by the implicit-function theorem.
    """
    still, propelled = throttle_for(vessel, speed), ControlAllocation(vessel).propelled
    speed, course = jnp.asarray(speed, float), jnp.asarray(course, float)
    # Crab angles are counted from the one that meets the current alone: at no drift through the
    # water a quadratic drag has no slope, and that angle could not be solved for or differentiated.
    drifting = _crab_in_current(vessel.environment, speed, course)

    def accelerations(unknown: Float[Array, "unknown"], at: tuple) -> Float[Array, "unknown"]:
        """What is left of the accelerations, over U^2 / L and U^2 / L^2."""
        (vessel, speed, course, still, drifting), least_slope = at
        crab, throttle = drifting + unknown[0], still
        if propelled:
            throttle = still * (1.0 + unknown[2])
        orders = ControlAllocation(vessel).orders(throttle, unknown[1])
        executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
        zero = jnp.zeros(())
        state = State(zero, zero, course + crab, speed, -speed * jnp.tan(crab), zero)
        surge, sway, turn = vessel.acceleration(state, executed, vessel.environment, zero)
        length = vessel.rigid_body.length
        left = jnp.stack([sway, turn * length, surge]) * length / speed**2
        return left[: unknown.size].at[0].add(least_slope * unknown[0])

    given = vessel, speed, course, still, drifting

    def solved(start: Float[Array, "unknown"], least_slope: Scalar) -> optx.Solution:
        """The balance with a least slope of the sway force against the drift."""
        solver = optx.Dogleg(rtol=_TOLERANCE, atol=_TOLERANCE)
        at = given, least_slope
        return optx.root_find(accelerations, solver, start, at, max_steps=_PASSES, throw=False)

    unknown = jnp.zeros(3 if propelled else 2)
    begin, _ = jax.lax.scan(lambda at, s: (solved(at, s).value, None), unknown, _GUIDING_SLOPES)
    end = solved(jax.lax.stop_gradient(begin), _LEAST_SLOPE)
    crab = drifting + end.value[0]
    found = (end.result == optx.RESULTS.successful) & (jnp.abs(crab) < _LARGEST_CRAB)
    crab, angle = jnp.where(found, crab, 0.0), jnp.where(found, end.value[1], 0.0)
    more = jnp.where(found, end.value[2], 0.0) if propelled else 0.0
    return Trim(crab, -speed * jnp.tan(crab), angle, still * (1.0 + more), found)


def _crab_in_current(environment: Environment, speed: Scalar, course: Scalar) -> Scalar:
    """Heading less course (rad) of a vessel that drifts with the water, by Newton's method.

    Its forward speed over ground is `speed`, and its sway the water's own to starboard.
    """
    along, abeam = to_body(environment.current_north, environment.current_east, course)
    crab = -jnp.arcsin(jnp.clip(abeam / speed, -0.9, 0.9))
    for _ in range(_CRAB_PASSES):
        cosine, sine = jnp.cos(crab), jnp.sin(crab)
        off = speed * sine + (abeam * cosine - along * sine) * cosine
        slope = speed * cosine - along * jnp.cos(2 * crab) - abeam * jnp.sin(2 * crab)
        crab = crab - off / jnp.where(slope == 0, 1.0, slope)
    return crab
