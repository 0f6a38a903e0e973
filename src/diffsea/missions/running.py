"""A mission run in closed loop."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.kinematics import speed_and_direction
from diffsea.simulation import planning
from diffsea.simulation.closed_loop import ClosedLoop, run_controlled
from diffsea.missions.controllers import controller_of, speed_of
from diffsea.missions.record import Mission, SensorErrors
from diffsea.missions.surroundings import (
    Instrumented,
    WeatherSeries,
    in_weather,
    instrumented,
    weather_series,
)
from diffsea.trajectory import MOTION_CHANNELS, Outcome, Trajectory
from diffsea.types import State, as_inputs
from diffsea.vessel.base import Vessel


PERIOD_STEPS = 5  # steps of integration in a period of the controller, by default
SLOWNESS = 3.0  # times as long as the path takes at the mission's speed, before it is given up
_LARGEST_RUN = 2e6  # steps
_DELAY_MARGIN = 1.5  # longest delay over the vessel's own, as in trials


@dataclasses.dataclass(frozen=True)
class MissionSetup:
    """Everything that a closed loop is run with; the times are in s."""

    vessel: Vessel
    controller: Instrumented
    start: State
    weather: WeatherSeries
    seconds: float
    period: float
    time_step: float
    longest_delay: float | None


@dataclasses.dataclass(frozen=True)
class MissionRun:
    """A mission as it was run.

    `true` is the motion, `recorded` the same as the sensors showed it to the controller.
    """

    mission: Mission
    setup: MissionSetup
    true: Trajectory
    recorded: Trajectory

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
        """Lowest and highest order: the narrower of what mission and actuator allow."""
        low, high = self.mission.controller.limits.get(channel, (-math.inf, math.inf))
        servo = self.mission.vessel.servos[channel]
        lower = low if servo.lower is None else max(low, float(servo.lower))
        upper = high if servo.upper is None else min(high, float(servo.upper))
        return lower, upper


def setup(mission: Mission) -> MissionSetup:
    """A mission with every number settled.

    Raises:
        UserError: a controller that the vessel cannot have, or a run that is too long.
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
    rows = math.floor(seconds / period + 1e-9) + 1
    vessel = in_weather(mission.vessel, mission.weather)
    delays = [float(servo.delay) for servo in vessel.servos.values() if servo.delay is not None]
    errors, limits = mission.sensors or SensorErrors(), dict(mission.controller.limits)
    controller = controller_of(mission, period)
    return MissionSetup(
        vessel,
        instrumented(controller, vessel, errors, limits, rows, period, mission.seed),
        _start(mission),
        weather_series(mission.weather, vessel, rows, period, mission.seed),
        seconds,
        period,
        step,
        _DELAY_MARGIN * max(delays) if delays else None,
    )


def _longest(mission: Mission) -> float:
    """When a path is given up, s."""
    points = np.array([(one.x, one.y) for one in mission.waypoints])
    path = float(np.hypot(*np.diff(points, axis=0).T).sum())
    room = 20 * float(mission.model.rigid_body.length)
    return planning.round_up(SLOWNESS * (path + room) / speed_of(mission))


def _start(mission: Mission) -> State:
    """As stated; else at the first waypoint, on the first leg's course, at the mission's speed."""
    usual = dict.fromkeys(MOTION_CHANNELS, 0.0)
    if mission.controller.kind != "orders":
        usual["u"] = speed_of(mission)
    if mission.waypoints:
        first, second = mission.waypoints[:2]
        course = math.atan2(second.y - first.y, second.x - first.x)
        usual |= {"x": first.x, "y": first.y, "psi": course}
    elif mission.controller.kind == "course":
        usual["psi"] = mission.steps[0].heading
    return State(*(jnp.asarray((usual | dict(mission.start))[c], float) for c in MOTION_CHANNELS))


_compiled_run = eqx.filter_jit(run_controlled)


def run(mission: Mission) -> MissionRun:
    """Run a mission; `run_controlled` of its `setup` is the same as a pure function.

    Raises:
        UserError: as `setup`, or the run diverged.
    """
    made = setup(mission)
    vessel, start = as_inputs(made.vessel), made.start
    times = made.seconds, made.period, made.time_step
    loop = _compiled_run(vessel, made.controller, start, *times, made.weather, made.longest_delay)
    if Outcome(int(loop.trajectory.outcome)) is Outcome.DIVERGED:
        raise UserError(
            f"{mission.name}: {Outcome.DIVERGED.sentence}. Try a time_step below "
            f"{made.time_step:g}, or other gains"
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
    )


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
