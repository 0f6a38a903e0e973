"""The vocabulary that every layer shares: states, environments, trajectories and outcomes.

SI units and radians throughout. Earth axes are NED (x north, y east, psi clockwise from
north); body axes are forward, starboard, down with the origin amidships.
"""

import enum

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int


Scalar = Float[Array, ""] | Float[np.ndarray, ""] | float
Series = Float[Array, "time"] | Float[np.ndarray, "time"]

MOTION_CHANNELS = ("x", "y", "psi", "u", "v", "r")


class Outcome(enum.IntEnum):
    """How a run ended. `sentence` says it in words."""

    COMPLETED = 0
    TIME_LIMIT = 1
    DIVERGED = 2
    APPROACH_UNSTEADY = 3

    @property
    def sentence(self) -> str:
        """The outcome as a sentence for a message or a report."""
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.COMPLETED: "the manoeuvre was completed",
    Outcome.TIME_LIMIT: "the time limit was reached before the manoeuvre was completed",
    Outcome.DIVERGED: "the run diverged: speed, yaw rate or position left every plausible range",
    Outcome.APPROACH_UNSTEADY: "the approach never became steady, so nothing was executed",
}


class State(eqx.Module):
    """Position and motion of one vessel at one instant.

    `u` and `v` are velocities over ground in body axes, so that they are what a
    satellite receiver measures; forces see the velocity through the water.
    """

    x: Scalar  # m, north
    y: Scalar  # m, east
    psi: Scalar  # rad, clockwise from north, not wrapped
    u: Scalar  # m/s over ground, forward
    v: Scalar  # m/s over ground, to starboard
    r: Scalar  # rad/s, positive to starboard


class Environment(eqx.Module):
    """Water and air around one run, steady and uniform, in earth axes.

    Components rather than speed and direction: they have a derivative at zero.
    """

    current_north: Scalar = 0.0  # m/s, where the water flows to
    current_east: Scalar = 0.0  # m/s
    wind_north: Scalar = 0.0  # m/s, where the air moves to
    wind_east: Scalar = 0.0  # m/s
    shallowness: Scalar = 0.0  # -ln(1 - T / h) of the vessel's draught and the depth, 0 is deep
    heel: Scalar = 0.0  # rad, to starboard; where it was recorded it changes within a run


class Trajectory(eqx.Module):
    """One run, simulated or measured: motion, commands and executed actuation.

    A channel that was not measured is filled with NaN; so is a missing sample. Commanded
    and executed actuation hold from their time stamp until the next and are never mixed.
    `valid` marks the rows that count: a jitted simulation has spare ones.
    """

    t: Series  # s
    x: Series  # m, north
    y: Series  # m, east
    psi: Series  # rad, unwrapped
    u: Series  # m/s over ground
    v: Series  # m/s over ground
    r: Series  # rad/s
    commanded: dict[str, Series]  # by actuator channel, in that actuator's unit
    executed: dict[str, Series]
    extra: dict[str, Series]  # wind_speed m/s, wind_direction rad (from), phi rad, p rad/s
    valid: Bool[Array, "time"] | Bool[np.ndarray, "time"]
    outcome: Int[Array, ""] | int = int(Outcome.COMPLETED)
    name: str = eqx.field(static=True, default="run")
    provenance: tuple[str, ...] = eqx.field(static=True, default=())

    def has(self, channel: str) -> bool:
        """Whether a motion channel (`x`, `y`, `psi`, `u`, `v`, `r`) has any sample."""
        return bool(np.any(np.isfinite(np.asarray(getattr(self, channel)))))
