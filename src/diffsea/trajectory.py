"""One run, simulated or measured: the record that every layer shares.

SI units and radians throughout. Earth axes are NED (x north, y east, psi clockwise from
north); body axes are forward, starboard, down with the origin amidships.

Needs neither JAX nor Equinox, so that recordings are read and audited at once; `diffsea.types`
makes the record known to JAX.
"""

import dataclasses
import enum
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int


Series = Float[Any, "time"]  # of NumPy or JAX

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


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
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
    valid: Bool[Any, "time"]
    outcome: Int[Any, ""] | int = int(Outcome.COMPLETED)
    name: str = "run"
    provenance: tuple[str, ...] = ()

    def has(self, channel: str) -> bool:
        """Whether a motion channel (`x`, `y`, `psi`, `u`, `v`, `r`) has any sample."""
        return bool(np.any(np.isfinite(np.asarray(getattr(self, channel)))))
