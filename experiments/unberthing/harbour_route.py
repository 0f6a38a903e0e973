"""The five-step plan: sideways off the quay, ahead to 3 kn, and a turn while gaining 8 kn.

Figure 6 of the paper with its waypoints is not in the text; what the text says is kept (40 m to
port, 300 m ahead, a change of course, 3 and 8 kn), the rest is chosen here.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffsea import State
from diffsea.kinematics import wrap
from diffsea.types import Scalar


from experiments.unberthing.harbour_ship import KNOT  # isort: skip

SIDEWAYS, AHEAD = 40.0, 300.0  # m, published
CLOSE = 3.0  # m from the line at which Step 1 is done ...
LONGEST_STEP_1 = 300.0  # s, ... or this later
RADIUS, TURN = 500.0, jnp.pi / 4  # of Step 4, to starboard; chosen
STRAIGHT_3, STRAIGHT_5 = 300.0, 700.0  # m, chosen
FAST = (0.0, 3 * KNOT, 4.5 * KNOT, 6 * KNOT, 8 * KNOT)  # target speed of each step
DONE = 6  # number of the step after the last


class Place(eqx.Module):
    """Where a ship is with respect to the step she is in."""

    along: Scalar  # m made good in this step
    cross: Scalar  # m to starboard of the route: the error that is scored
    X_d: Scalar  # m ahead of where she should be (Step 1 only)
    Y_d: Scalar  # m to starboard of the target line
    psi_d: Scalar  # rad to starboard of the route's course
    curvature: Scalar  # 1/m, to starboard
    speed: Scalar  # m/s aimed at


def line(step: int, count: int = 50) -> Float[np.ndarray, "point 2"]:
    """Points of the route of a step (1 to 5), m north and east of the berth, in order."""
    share = np.linspace(0.0, 1.0, count)
    straight = np.zeros(count)
    if step == 1:
        return np.stack([straight, -SIDEWAYS * share], axis=1)
    if step in (2, 3):
        begin, length = (0.0, AHEAD) if step == 2 else (AHEAD, STRAIGHT_3)
        return np.stack([begin + length * share, straight - SIDEWAYS], axis=1)
    turned = float(TURN) * (share if step == 4 else straight + 1)
    north = AHEAD + STRAIGHT_3 + RADIUS * np.sin(turned)
    east = -SIDEWAYS + RADIUS * (1 - np.cos(turned))
    if step == 5:
        north = north + STRAIGHT_5 * share * np.cos(TURN)
        east = east + STRAIGHT_5 * share * np.sin(TURN)
    return np.stack([north, east], axis=1)


def _of_step(step: Scalar, *values: Scalar) -> Scalar:
    return jnp.select([step == k for k in range(1, 5)], values[:-1], values[-1])


def place(step: Scalar, state: State) -> Place:
    """Errors in a step (1 to 5); the initial heading is north, the quay to starboard."""
    x, y = state.x, state.y
    ahead = AHEAD + STRAIGHT_3
    centre = ahead, -SIDEWAYS + RADIUS
    off_x, off_y = x - centre[0], y - centre[1]
    swept = jnp.arctan2(off_x, -off_y)  # rad of the turn made good
    arc = RADIUS - jnp.hypot(off_x, off_y)
    end = ahead + RADIUS * jnp.sin(TURN), centre[1] - RADIUS * jnp.cos(TURN)
    cos, sin = jnp.cos(TURN), jnp.sin(TURN)
    last_along = cos * (x - end[0]) + sin * (y - end[1])
    last_cross = cos * (y - end[1]) - sin * (x - end[0])
    sideways = y + SIDEWAYS

    def by_step(*values: Scalar) -> Scalar:
        return _of_step(step, *values)

    # Uniform acceleration to 3 kn over Step 2, from a speed that gets her going.
    gained = jnp.sqrt(jnp.clip(x / AHEAD, 0.05, 1.0)) * FAST[1]
    return Place(
        along=by_step(-y, x, x - AHEAD, RADIUS * swept, last_along),
        cross=by_step(x, sideways, sideways, arc, last_cross),
        X_d=by_step(x, 0.0, 0.0, 0.0, 0.0),
        Y_d=by_step(sideways, sideways, sideways, arc, last_cross),
        psi_d=wrap(state.psi - by_step(0.0, 0.0, 0.0, swept, TURN)),
        curvature=by_step(0.0, 0.0, 0.0, 1 / RADIUS, 0.0),
        speed=by_step(FAST[0], gained, *FAST[2:]),
    )


def next_step(step: Scalar, at: Place, t: Scalar) -> Scalar:
    """The number of the step from now on."""
    arrived = at.along >= _of_step(step, 0.0, AHEAD, STRAIGHT_3, RADIUS * TURN, STRAIGHT_5)
    beside = (jnp.abs(at.Y_d) < CLOSE) | (t > LONGEST_STEP_1)
    over = jnp.where(step == 1, beside, arrived)
    return jnp.minimum(step + over, DONE)
