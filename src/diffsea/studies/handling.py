"""What a vessel is like to handle: top speed, stability on a straight course, turning, lags."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.simulation import planning
from diffsea.simulation.control import ControlAllocation, settled_acceleration, throttle_for
from diffsea.trajectory import Outcome
from diffsea.vessel.base import Vessel


@dataclasses.dataclass(frozen=True)
class Handling:
    """How a vessel moves through still water.

    The motion is linearised about a straight run at `speed`. A time constant is that in which a
    deviation falls to 1/e of itself, negative where it grows.

    Attributes:
        top_speed: m/s at full throttle; infinite where nothing limits it.
        speed: m/s, at which the rest is said.
        surge_time: s, of the speed under an unchanged throttle.
        course_times: s, of sway and yaw with the helm amidships, the slower one first; equal ones
            where they swing.
        course_period: s, of that swinging; None where there is none.
        turning_diameter: m, tactical, at 35 deg of rudder or rudder-equivalent angle; None where
            the vessel cannot be steered or does not turn by 180 deg.
        turning_outcome: how that turn ended, in words; empty where it was not run.
    """

    top_speed: float
    speed: float
    surge_time: float
    course_times: tuple[float, float]
    course_period: float | None
    turning_diameter: float | None
    turning_outcome: str

    @property
    def is_course_stable(self) -> bool:
        """Whether it comes back to a straight course, though another one, without helm."""
        return all(time > 0 for time in self.course_times)

    def as_dict(self) -> dict[str, Any]:
        """The numbers by name, and `course_stable`."""
        return dataclasses.asdict(self) | {"course_stable": self.is_course_stable}


def handling(vessel: Vessel) -> Handling:
    """How a vessel handles at its default speed: Froude number 0.2, or what its set refers to.

    The linear equations of manoeuvring, `d(v, r)/dt = A (v, r)` (Fossen 2021, section 7.2).

    Raises:
        UserError: it cannot run at that speed.
    """
    speed = planning.default_speed(vessel)
    throttle = throttle_for(vessel, speed)

    def rates(motion: jax.Array) -> jax.Array:
        u, v, r = motion
        return jnp.stack(settled_acceleration(vessel, u, v, r, throttle, jnp.zeros(())))

    slopes = np.asarray(jax.jacfwd(rates)(jnp.array([speed, 0.0, 0.0])))
    poles = np.linalg.eigvals(slopes[1:, 1:])
    times = sorted((_time_constant(pole.real) for pole in poles), key=_slowness, reverse=True)
    swing = float(np.abs(poles.imag).max())
    diameter, outcome = _turn(vessel)
    return Handling(
        top_speed=planning.top_speed(vessel) if vessel.propulsors else math.inf,
        speed=speed,
        surge_time=_time_constant(slopes[0, 0]),
        course_times=(times[0], times[1]),
        course_period=2 * math.pi / swing if swing > 0 else None,
        turning_diameter=diameter,
        turning_outcome=outcome,
    )


def _time_constant(rate: float) -> float:
    """Of a deviation that grows at a relative rate (1/s)."""
    return -1 / float(rate) if rate else math.inf


def _slowness(time: float) -> float:
    """What grows counts as slower than all that falls, the faster it grows the less."""
    return time if time > 0 else math.inf


def _turn(vessel: Vessel) -> tuple[float | None, str]:
    """Tactical diameter (m) at 35 deg to starboard, and how the turn ended."""
    if not ControlAllocation(vessel).steerable:
        return None, ""
    plan = planning.plan_trial(vessel, "turning-circle")
    trial, numbers = planning.run_and_measure(vessel, plan)
    found = float(numbers["tactical_diameter"])
    outcome = Outcome(int(trial.trajectory.outcome))
    return (found if math.isfinite(found) else None), outcome.sentence
