"""What a mission is: vessel and model, controller, path or timed steps, weather, sensors.

Numbers that a grid or a tuning changes may be traced.
"""

import dataclasses
from collections.abc import Mapping

from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


@dataclasses.dataclass(frozen=True)
class HeadingLaw:
    """A heading law, `pid` or `pd`, and those of its numbers that are stated."""

    law: str = "pid"
    numbers: Mapping[str, Scalar] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Controller:
    """What steers: its kind, the numbers that are stated, and limits of its orders by channel."""

    kind: str
    numbers: Mapping[str, Scalar]
    heading: HeadingLaw = HeadingLaw()
    speed_law: Mapping[str, Scalar] = dataclasses.field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    feedforward: bool = False  # of the current and wind in the vessel that it believes in


@dataclasses.dataclass(frozen=True)
class Waypoint:
    """A point of the path, m north and east, and when to be there (s), if that matters."""

    x: float
    y: float
    time: float | None = None


@dataclasses.dataclass(frozen=True)
class TimedStep:
    """What holds from a time (s) on: heading (rad) and speed (m/s), or orders by channel; or the
    place (m north and east) and heading that are due at that time."""

    time: float
    heading: float = 0.0
    speed: float = 0.0
    x: float = 0.0
    y: float = 0.0
    orders: Mapping[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Flow:
    """A current (direction it flows to) or a wind (direction it comes from), by straight lines.

    Attributes:
        times: s; before the first and after the last nothing changes.
        speeds: m/s.
        directions: rad.
    """

    times: tuple[float, ...]
    speeds: tuple[Scalar, ...]
    directions: tuple[Scalar, ...]


@dataclasses.dataclass(frozen=True)
class Weather:
    """Water and air of a mission.

    Attributes:
        gusts: standard deviation (m/s) of each component of the wind about its mean.
        gust_time: s, time constant of the gusts.
        superstructure: what the wind acts on, as in a vessel's effect `wind`.
        wave: as a vessel's effect `wave-force`.
    """

    current: Flow | None = None
    wind: Flow | None = None
    gusts: Scalar = 0.0
    gust_time: float = 20.0
    superstructure: Mapping[str, float] = dataclasses.field(default_factory=dict)
    wave: Mapping[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class SensorErrors:
    """What the controller sees of the state: noise as standard deviations, offsets, one delay."""

    position: float = 0.0  # m
    heading: float = 0.0  # rad
    velocity: float = 0.0  # m/s
    yaw_rate: float = 0.0  # rad/s
    heading_offset: float = 0.0  # rad
    gyro_bias: float = 0.0  # rad/s
    delay: float = 0.0  # s


@dataclasses.dataclass(frozen=True)
class OnlineEstimator:
    """An estimator of the model's parameters that runs with the controller.

    Attributes:
        kind: `kalman` or `least-squares`.
        free: parameters of the model; the hull's derivatives where it is empty.
        drift: random walk of the filter's parameters, share per sqrt(s).
        memory: time constant with which least squares forget, s.
        adapt: whether the controller works with what passes the gate.
    """

    kind: str
    free: tuple[str, ...] = ()
    drift: float | None = None
    memory: float | None = None
    adapt: bool = True


@dataclasses.dataclass(frozen=True)
class Mission:
    """A mission with everything that its file states; None takes a default by the vessel's size."""

    name: str
    vessel: Vessel
    model: Vessel  # that the controller believes in
    controller: Controller
    waypoints: tuple[Waypoint, ...] = ()
    steps: tuple[TimedStep, ...] = ()
    start: Mapping[str, float] = dataclasses.field(default_factory=dict)
    weather: Weather = Weather()
    sensors: SensorErrors | None = None
    estimator: OnlineEstimator | None = None
    seed: int = 0
    seconds: float | None = None
    period: float | None = None
    time_step: float | None = None
