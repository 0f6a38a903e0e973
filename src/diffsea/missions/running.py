"""A mission run in closed loop."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from diffsea.errors import UserError
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.noise_fit import noise_prior
from diffsea.identification.online.guarded import GuardedEstimator, OnlineRun, online_run
from diffsea.kinematics import speed_and_direction
from diffsea.missions.adaptation import (
    AdaptiveController,
    adaptive_controller,
    estimator_beside,
)
from diffsea.missions.controllers import controller_of, require_controllable, speed_of
from diffsea.missions.record import Mission, SensorErrors
from diffsea.missions.surroundings import (
    Instrumented,
    WeatherSeries,
    in_weather,
    instrumented,
    weather_series,
)
from diffsea.simulation import planning
from diffsea.simulation.closed_loop import ClosedLoop, run_controlled
from diffsea.simulation.control import AbstractController
from diffsea.trajectory import MOTION_CHANNELS, Outcome, Samples, Trajectory
from diffsea.types import Scalar, State, as_inputs
from diffsea.vessel.base import Vessel


PERIOD_STEPS = 5  # steps of integration in a period of the controller, by default
SLOWNESS = 3.0  # times as long as the path takes at the mission's speed, before it is given up
_LARGEST_RUN = 2e6  # steps
_DELAY_MARGIN = 1.5  # longest delay over the vessel's own, as in trials


class DivergedError(UserError):
    """A run left every plausible range."""


class Timing(NamedTuple):
    """How long a mission is run and in which steps, s."""

    seconds: float
    period: float
    time_step: float
    longest_delay: float | None

    @property
    def rows(self) -> int:
        """How often the controller acts."""
        return math.floor(self.seconds / self.period + 1e-9) + 1


class MissionSetup(eqx.Module):
    """Everything that a closed loop is run with."""

    vessel: Vessel
    controller: Instrumented
    start: State
    weather: WeatherSeries
    times: Timing = eqx.field(static=True)


@dataclasses.dataclass(frozen=True)
class MissionRun:
    """A mission as it was run.

    `true` is the motion, `recorded` the same as the sensors showed it to the controller.
    """

    mission: Mission
    setup: MissionSetup
    true: Trajectory
    recorded: Trajectory
    estimates: OnlineRun | None = None  # of the online estimator, where there is one

    @property
    def outcome(self) -> Outcome:
        """How it ended; timed steps are completed where their time is over."""
        outcome = Outcome(int(self.true.outcome))
        timed = outcome is Outcome.TIME_LIMIT and bool(self.mission.steps)
        return Outcome.COMPLETED if timed else outcome

    @property
    def sentence(self) -> str:
        """How it ended, in words."""
        if self.mission.steps:
            return "the timed steps were run to their end"
        if self.outcome is Outcome.COMPLETED:
            return "the end of the path was reached"
        return "the time was up before the end of the path was reached"

    def limits(self, channel: str) -> tuple[float, float]:
        """Lowest and highest order of a channel."""
        low, high = order_limits(self.mission, channel)
        return float(low), float(high)


def order_limits(mission: Mission, channel: str) -> tuple[Scalar, Scalar]:
    """Lowest and highest order: the narrower of what mission and actuator allow."""
    low, high = mission.controller.limits.get(channel, (-math.inf, math.inf))
    servo = mission.vessel.servos[channel]
    lower = low if servo.lower is None else jnp.maximum(low, servo.lower)
    upper = high if servo.upper is None else jnp.minimum(high, servo.upper)
    return lower, upper


def timing(mission: Mission) -> Timing:
    """The times that a mission states, or those that suit it.

    Raises:
        UserError: a run that is too short or too long.
    """
    length = float(mission.vessel.rigid_body.length)
    step = mission.time_step or planning.default_step(length)
    period = mission.period or PERIOD_STEPS * step
    seconds = mission.seconds or _longest(mission)
    if seconds < period:
        raise UserError(f"seconds = {seconds:g} is less than one period of {period:g} s")
    if max(seconds / min(step, period), seconds / period) > _LARGEST_RUN:
        raise UserError(
            f"{seconds:g} s in steps of {min(step, period):g} s are too many: take a longer "
            "time_step and period, or fewer seconds"
        )
    servos = mission.vessel.servos.values()
    delays = [float(servo.delay) for servo in servos if servo.delay is not None]
    return Timing(seconds, period, step, _DELAY_MARGIN * max(delays) if delays else None)


def _longest(mission: Mission) -> float:
    """When a path is given up, s."""
    points = np.array([(one.x, one.y) for one in mission.waypoints])
    path = float(np.hypot(*np.diff(points, axis=0).T).sum())
    room = 20 * float(mission.model.rigid_body.length)
    return planning.round_up(SLOWNESS * (path + room) / float(speed_of(mission)))


def assemble(
    mission: Mission, times: Timing, guard: GuardedEstimator | None = None
) -> MissionSetup:
    """Everything that the closed loop of a mission needs; pure in the mission's numbers.

    Arguments:
        guard: the estimator beside the controller, where the mission has one (`estimator_of`).

    Raises:
        UserError: a controller for other thrusters than the vessel has.
    """
    vessel, start = in_weather(mission.vessel, mission.weather), _start(mission)
    errors, limits = mission.sensors or SensorErrors(), dict(mission.controller.limits)
    if mission.estimator is None:
        controller = controller_of(mission, times.period)
    else:
        assert guard is not None
        controller = adaptive_controller(mission, times.period, start, guard)
    drawn = times.rows, times.period, mission.seed
    return MissionSetup(
        vessel,
        instrumented(controller, vessel, errors, limits, *drawn),
        start,
        weather_series(mission.weather, vessel, *drawn),
        times,
    )


def estimator_of(mission: Mission, times: Timing) -> GuardedEstimator | None:
    """The estimator of a mission, with its gate; None where it has none.

    The noise of a Kalman filter is that of gusts which suit the vessel and of sensors as the
    mission run without estimator shows them, as a trial trip would.

    Raises:
        UserError: parameters that cannot be estimated so.
    """
    if mission.estimator is None:
        return None
    noise = None
    if mission.estimator.kind == "kalman":
        trip = run(dataclasses.replace(mission, estimator=None)).recorded
        noise = Noise.of(noise_prior(mission.model, make_dataset(mission.model, [trip])).mean)
    return estimator_beside(mission, times.period, noise)


def _start(mission: Mission) -> State:
    """As stated; else at the first waypoint, on the first leg's course, at the mission's speed, or
    at rest in the first pose."""
    usual: dict[str, Scalar] = dict.fromkeys(MOTION_CHANNELS, 0.0)
    if mission.controller.kind not in ("orders", "positioning"):
        usual["u"] = speed_of(mission)
    if mission.waypoints:
        first, second = mission.waypoints[:2]
        course = math.atan2(second.y - first.y, second.x - first.x)
        usual |= {"x": first.x, "y": first.y, "psi": course}
    elif mission.controller.kind == "course":
        usual["psi"] = mission.steps[0].heading
    elif mission.controller.kind == "positioning":
        first = mission.steps[0]
        usual |= {"x": first.x, "y": first.y, "psi": first.heading}
    return State(*(jnp.asarray((usual | dict(mission.start))[c], float) for c in MOTION_CHANNELS))


def setup(mission: Mission) -> MissionSetup:
    """A mission with every number settled.

    Raises:
        UserError: a controller that the vessel cannot have, or a run that is too long.
    """
    require_controllable(mission)
    times = timing(mission)
    return assemble(mission, times, estimator_of(mission, times))


def closed_loop(made: MissionSetup) -> ClosedLoop:
    """The closed loop of a mission. Pure: jit, vmap and differentiate it."""
    times, loop = made.times, (made.vessel, made.controller, made.start)
    steps = times.seconds, times.period, times.time_step
    return run_controlled(*loop, *steps, made.weather, times.longest_delay)


_compiled_loop = eqx.filter_jit(closed_loop)


def run(mission: Mission) -> MissionRun:
    """Run a mission; `closed_loop` of its `setup` is the same as a pure function.

    Raises:
        UserError: as `setup`.
        DivergedError: the run diverged.
    """
    made = setup(mission)
    loop = _compiled_loop(dataclasses.replace(made, vessel=as_inputs(made.vessel)))
    if Outcome(int(loop.trajectory.outcome)) is Outcome.DIVERGED:
        raise DivergedError(
            f"{mission.name}: {Outcome.DIVERGED.sentence}. Try a time_step below "
            f"{made.times.time_step:g}, or other gains"
        )
    true = _with_weather(loop, made).counted()
    valid = np.asarray(loop.trajectory.valid)
    shown = np.asarray(loop.memory.shown)[valid]  # type: ignore[attr-defined]
    seen = dict(zip(MOTION_CHANNELS, shown.T, strict=True))
    name = mission.name
    return MissionRun(
        mission,
        made,
        dataclasses.replace(true, name=f"{name}, true motion"),
        dataclasses.replace(true, **seen, name=name),
        _estimates(made.controller.inner, loop.memory, true.t, valid),
    )


def _estimates(
    controller: AbstractController, memory: Any, t: Samples, valid: Bool[np.ndarray, "period"]
) -> OnlineRun | None:
    """What the estimator beside the controller reported at `t` s; None without one."""
    if not isinstance(controller, AdaptiveController):
        return None
    steps = jax.tree.map(lambda leaf: np.asarray(leaf)[valid], memory.inner.told)
    return online_run(t, steps, controller.guard)


def _with_weather(loop: ClosedLoop, made: MissionSetup) -> Trajectory:
    """The run with the wind in it, where there is any."""
    run = loop.trajectory
    if isinstance(made.weather.wind_north, float):
        return run
    north, east = (getattr(made.weather, f"wind_{way}")[: len(run.t)] for way in ("north", "east"))
    speed, towards = speed_and_direction(north, east)
    wind = {
        "wind_speed": np.asarray(speed),
        "wind_direction": np.mod(np.asarray(towards) + math.pi, 2 * math.pi),
    }
    return dataclasses.replace(run, extra=wind)
