"""What the simulator simulates: a hull, its actuators and everything that acts on them.

`Model` is built from a vessel document (the parsed TOML) with true numbers; `effects.py` and
`outside.py` then change its fields. All SI, body axes forward / starboard, yaw rate positive to
starboard, origin amidships.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field


WATER, AIR = 1025.0, 1.225  # kg/m^3
HEEL = 5.0  # rad for a sideways acceleration of g, in a steady turn


@dataclass
class Channel:
    """One ordered quantity (N, rev/s or rad) and what its actuator makes of an order."""

    low: float = -math.inf
    high: float = math.inf
    delay: float = 0.0  # s
    bias: float = 0.0  # unit of the order
    deadband: float = 0.0  # half width, unit of the order
    backlash: float = 0.0  # half width, unit of the order
    lag: float = 0.0  # s
    rate: float = math.inf  # unit of the order per s


@dataclass
class Actuator:
    """A force-making device: its channels by role, its place, and what weakens it."""

    name: str
    kind: str  # thruster | azimuth | propeller | rudder
    data: dict
    channels: dict[str, Channel]
    gain: float = 1.0
    loss_speed: float = 0.0  # s/m
    loss_turn: float = 0.0  # s/rad
    bend: float = 0.0  # relative excess of thrust at half of full order (benign misfit)


@dataclass
class Sensing:
    """Errors of the instruments, exactly absent at zero."""

    heading_offset: float = 0.0
    iron_amplitude: float = 0.0
    iron_phase: float = 0.0
    gyro_bias: float = 0.0
    latency: dict[str, float] = field(default_factory=dict)  # s, by channel
    lever: tuple[float, float] = (0.0, 0.0)
    clock_rate: float = 0.0
    clock_offset: float = 0.0
    # Outside the catalogue: windows of t in which the position log is late by so much.
    late_windows: list[tuple[float, float, float]] = field(default_factory=list)

    def ahead(self, end: float) -> float:
        """How far past its end a clock that gains reads a run of `end` seconds, s."""
        return max(-(self.clock_offset + self.clock_rate * end), 0.0)


@dataclass
class Model:
    """A vessel, its surroundings and its instruments."""

    hull: dict
    actuators: list[Actuator]
    current: tuple[float, float] = (0.0, 0.0)  # north, east, m/s
    wind: tuple[float, float] = (0.0, 0.0)  # velocity of the air, north, east, m/s
    superstructure: tuple[float, float, float] = (0.7, 0.85, 0.1)  # C_X, C_Y, C_N
    wave: dict | None = None
    ratio_of_depth: float = 0.0  # draught over depth of water
    strip_cd: float = 0.0
    munk: float = 0.0  # kg
    side: dict = field(default_factory=dict)  # propeller side force
    roll: dict = field(default_factory=dict)  # Y_phi, N_phi
    steps: list[tuple[float, str, float]] = field(default_factory=list)  # time, what, size
    sensing: Sensing = field(default_factory=Sensing)
    # Functions of (t, x, y, psi, u, v, r) to (X, Y, N) that no catalogue has, and one that
    # scales all thrust at time t.
    extra_forces: list[Callable] = field(default_factory=list)
    thrust_scale: Callable | None = None
    slosh: dict | None = None

    def copy(self) -> "Model":
        """An independent copy."""
        return copy.deepcopy(self)

    def channel(self, label: str) -> Channel:
        """The channel of an order's label, `name` or `name.role`."""
        name, _, role = label.partition(".")
        found = next(a for a in self.actuators if a.name == name)
        return found.channels[role]

    def labels(self) -> list[str]:
        """Labels of all orders, in the order of the vessel's document."""
        return [f"{a.name}.{c}" if c else a.name for a in self.actuators for c in a.channels]


def build(document: dict) -> Model:
    """The model of a parsed vessel file."""
    actuators = []
    for data in document.get("thruster", []):
        curve = data.get("curve")
        top = math.sqrt(data["max_force"] / curve["d"]) if curve else data["max_force"]
        low = -math.sqrt(-data["min_force"] / curve["d"]) if curve else data["min_force"]
        actuators.append(_actuator(data, "thruster", {"": _channel(data, low, top)}))
    for data in document.get("azimuth_thruster", []):
        force = _channel(data, data.get("min_force", 0.0), data["max_force"])
        actuators.append(_actuator(data, "azimuth", {"force": force, "angle": Channel()}))
    for data in document.get("propeller", []):
        channel = _channel(data, data["min_speed"], data["max_speed"])
        actuators.append(_actuator(data, "propeller", {"": channel}))
    for data in document.get("rudder", []):
        channel = _channel(data, -data["max_angle"], data["max_angle"])
        actuators.append(_actuator(data, "rudder", {"": channel}))
    return Model(dict(document["hull"]), actuators)


def _actuator(data: dict, kind: str, channels: dict[str, Channel]) -> Actuator:
    return Actuator(data["name"], kind, dict(data), channels)


def _channel(data: dict, low: float, high: float) -> Channel:
    return Channel(
        low, high, data.get("delay", 0.0), 0.0, data.get("deadband", 0.0), 0.0,
        data.get("time_constant", 0.0), data.get("rate_limit", math.inf),
    )  # fmt: skip


def density(hull: dict) -> float:
    """Of the water, kg/m^3."""
    return hull.get("water_density", WATER)
