"""The catalogue of effects: physics that can be added to a vessel by name.

An effect is an ordinary part of the vessel once applied: a force, a servo stage, a field
of the environment or a term of the sensors. Its `coordinates` are numbers that are zero
when it is absent and in which the motion has a derivative there; its `parameters` are
what people and files say (a current's speed and direction).
"""

import abc
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.kinematics import components_towards, speed_and_direction
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.environment import EarthForce, Wind
from diffsea.vessel.hull import CrossFlowDrag, Damping
from diffsea.vessel.servo import Servo


Coordinates = Float[Array, "coordinate"] | Float[np.ndarray, "coordinate"]


class AbstractEffect(abc.ABC):
    """One entry of the catalogue."""

    name: str
    units: dict[str, str]  # parameter name to unit, in order
    group: str  # "sensor", "environment", "actuator" or "hull"
    positive: bool  # only non-negative values are physical

    @abc.abstractmethod
    def sizes(self, vessel: Vessel) -> tuple[float, ...]:
        """Size of each coordinate that would be noticeable on this vessel (its prior)."""

    @abc.abstractmethod
    def apply(self, vessel: Vessel, coordinates: Coordinates) -> Vessel:
        """The vessel with the effect; exactly the same motion at zero coordinates."""

    @abc.abstractmethod
    def parameters(self, coordinates: Coordinates) -> dict[str, Scalar]:
        """What a file says, from coordinates."""

    @abc.abstractmethod
    def coordinates(self, parameters: dict[str, float]) -> tuple[float, ...]:
        """Coordinates, from what a file says."""

    @abc.abstractmethod
    def possible(self, vessel: Vessel) -> bool:
        """Whether the vessel could have it and does not have it in its base model."""


@dataclasses.dataclass(frozen=True)
class Plain(AbstractEffect):
    """An effect whose coordinates are its parameters."""

    name: str
    group: str
    units: dict[str, str]
    add: Callable[[Vessel, Coordinates], Vessel]
    size: Callable[[Vessel], tuple[float, ...]]
    when: Callable[[Vessel], bool] = lambda vessel: True
    positive: bool = False

    def sizes(self, vessel: Vessel) -> tuple[float, ...]:
        return self.size(vessel)

    def apply(self, vessel: Vessel, coordinates: Coordinates) -> Vessel:
        return self.add(vessel, coordinates)

    def parameters(self, coordinates: Coordinates) -> dict[str, Scalar]:
        return dict(zip(self.units, coordinates, strict=True))

    def coordinates(self, parameters: dict[str, float]) -> tuple[float, ...]:
        return tuple(parameters.get(name, 0.0) for name in self.units)

    def possible(self, vessel: Vessel) -> bool:
        return self.when(vessel)


@dataclasses.dataclass(frozen=True)
class Flow(AbstractEffect):
    """A uniform flow, named by speed and direction, moved by its components."""

    name: str
    towards: bool  # whether the direction is where it flows to, or where it comes from
    add: Callable[[Vessel, Coordinates], Vessel]
    size: float  # m/s
    group: str = "environment"
    units: dict[str, str] = dataclasses.field(
        default_factory=lambda: {"speed": "m/s", "direction": "rad"}
    )
    positive: bool = False

    def sizes(self, vessel: Vessel) -> tuple[float, ...]:
        return self.size, self.size

    def apply(self, vessel: Vessel, coordinates: Coordinates) -> Vessel:
        return self.add(vessel, coordinates)

    def parameters(self, coordinates: Coordinates) -> dict[str, Scalar]:
        turn = 0.0 if self.towards else jnp.pi
        speed, direction = speed_and_direction(coordinates[0], coordinates[1])
        return {"speed": speed, "direction": jnp.mod(direction + turn, 2 * jnp.pi)}

    def coordinates(self, parameters: dict[str, float]) -> tuple[float, ...]:
        turn = 0.0 if self.towards else np.pi
        speed, direction = parameters.get("speed", 0.0), parameters.get("direction", 0.0)
        north, east = components_towards(speed, direction + turn)
        return float(north), float(east)

    def possible(self, vessel: Vessel) -> bool:
        return True


def _speed_scale(vessel: Vessel) -> float:
    """A tenth of the speed at Froude number 0.3, m/s."""
    return 0.03 * float(np.sqrt(9.81 * vessel.rigid_body.length))


def _time_scale(vessel: Vessel) -> float:
    """The time gravity takes over a ship's length, s."""
    return float(np.sqrt(vessel.rigid_body.length / 9.81))


def _shifted(vessel: Vessel, where: Callable, by: Scalar) -> Vessel:
    return eqx.tree_at(where, vessel, replace_fn=lambda value: value + by)


def _current(vessel: Vessel, flow: Coordinates) -> Vessel:
    vessel = _shifted(vessel, lambda v: v.environment.current_north, flow[0])
    return _shifted(vessel, lambda v: v.environment.current_east, flow[1])


def _wind(vessel: Vessel, flow: Coordinates) -> Vessel:
    if "wind" not in vessel.forces:
        vessel = _with_force(vessel, "wind", default_wind(vessel))
    vessel = _shifted(vessel, lambda v: v.environment.wind_north, flow[0])
    return _shifted(vessel, lambda v: v.environment.wind_east, flow[1])


def default_wind(vessel: Vessel) -> Wind:
    """Wind areas of a vessel that states none: as much above the water as below."""
    body = vessel.rigid_body
    return Wind(body.beam * body.draught, body.length * body.draught, body.length)


def _with_force(vessel: Vessel, name: str, force: eqx.Module) -> Vessel:
    return eqx.tree_at(lambda v: v.forces, vessel, vessel.forces | {name: force})


def _cross_flow(vessel: Vessel, cd: Coordinates) -> Vessel:
    if "crossflow-drag" in vessel.forces:
        return _shifted(vessel, lambda v: v.forces["crossflow-drag"].cd, cd[0])
    body = vessel.rigid_body
    drag = CrossFlowDrag(cd[0], body.length, body.draught, body.water_density)
    return _with_force(vessel, "crossflow-drag", drag)


def _derivatives(effect: str, names: tuple[str, ...]) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, values: Coordinates) -> Vessel:
        before = getattr(vessel.forces.get(effect), "derivatives", dict.fromkeys(names, 0.0))
        extra = {name: before[name] + value for name, value in zip(names, values, strict=True)}
        return _with_force(vessel, effect, Damping(extra))

    return add


def _derivative_sizes(names: tuple[str, ...]) -> Callable[[Vessel], tuple[float, ...]]:
    """A tenth of the inertia terms of the same kind at Froude number 0.2."""

    def sizes(vessel: Vessel) -> tuple[float, ...]:
        body = vessel.rigid_body
        length, mass = float(body.length), float(body.mass)
        speed = 0.2 * np.sqrt(9.81 * length)

        def size(name: str) -> float:
            axis, letters = name.split("_")
            force = 0.3 * mass * speed**2 / length * (length if axis == "N" else 1.0)
            per = {"u": speed, "v": 0.3 * speed, "r": 0.3 * speed / length}
            return float(force / np.prod([per[letter] for letter in letters]))

        return tuple(size(name) for name in names)

    return sizes


def _without(names: tuple[str, ...], force: str = "") -> Callable[[Vessel], bool]:
    """Whether the base hull lacks these derivatives, and the vessel that force."""

    def when(vessel: Vessel) -> bool:
        hull = vessel.forces.get("damping")
        derivatives = getattr(hull, "derivatives", {})
        return force not in vessel.forces and not any(name in derivatives for name in names)

    return when


def _map_servos(vessel: Vessel, change: Callable[[Servo], Servo]) -> Vessel:
    def changed(actuator: eqx.Module) -> eqx.Module:
        servos = {channel: change(servo) for channel, servo in actuator.servos.items()}
        return eqx.tree_at(lambda a: a.servos, actuator, servos)

    parts = {name: changed(actuator) for name, actuator in vessel.actuators.items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, parts)


def _add_to_stage(stage: str) -> Callable[[Vessel, Coordinates], Vessel]:
    """Adds to one number of every servo, which starts from zero where it is None."""

    def add(vessel: Vessel, by: Coordinates) -> Vessel:
        def change(servo: Servo) -> Servo:
            now = getattr(servo, stage)
            return dataclasses.replace(servo, **{stage: (0.0 if now is None else now) + by[0]})

        return _map_servos(vessel, change)

    return add


def _sided(vessel: Vessel) -> bool:
    """Whether thrusters stand on both sides of the centreline."""
    sides = [float(getattr(part, "y", 0.0)) for part in _thrusters(vessel).values()]
    return any(y < 0 for y in sides) and any(y > 0 for y in sides)


def _thrusters(vessel: Vessel) -> dict[str, eqx.Module]:
    return {n: part for n, part in vessel.actuators.items() if hasattr(part, "losses")}


def _map_thrusters(vessel: Vessel, change: Callable[[eqx.Module], eqx.Module]) -> Vessel:
    parts = vessel.actuators | {n: change(part) for n, part in _thrusters(vessel).items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, parts)


def _asymmetry(vessel: Vessel, ratio: Coordinates) -> Vessel:
    def change(part: eqx.Module) -> eqx.Module:
        by = jnp.sign(part.y) * ratio[0]
        return eqx.tree_at(lambda p: p.losses.asymmetry, part, part.losses.asymmetry + by)

    return _map_thrusters(vessel, change)


def _misalignment(vessel: Vessel, angle: Coordinates) -> Vessel:
    def change(part: eqx.Module) -> eqx.Module:
        if not hasattr(part, "angle"):
            return part
        return eqx.tree_at(lambda p: p.angle, part, part.angle + angle[0])

    return _map_thrusters(vessel, change)


def _loss(field: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, slope: Coordinates) -> Vessel:
        def change(part: eqx.Module) -> eqx.Module:
            now = getattr(part.losses, field)
            return eqx.tree_at(lambda p: getattr(p.losses, field), part, now + slope[0])

        return _map_thrusters(vessel, change)

    return add


def _sensor(*fields: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, by: Coordinates) -> Vessel:
        for field, value in zip(fields, by, strict=True):
            vessel = _shifted(vessel, lambda v, f=field: getattr(v.sensors, f), value)
        return vessel

    return add


def _wave(vessel: Vessel, values: Coordinates) -> Vessel:
    """One more wave train: unlike other effects, several do not add up to one."""
    number = sum(isinstance(force, EarthForce) for force in vessel.forces.values())
    name = "wave-force" if number == 0 else f"wave-force {number + 1}"
    return _with_force(vessel, name, EarthForce(*values))


def _latency(channel: str) -> Plain:
    return Plain(
        f"sensor-latency:{channel}", "sensor", {"delay": "s"}, _sensor(f"latency_{channel}"),
        lambda v: (_time_scale(v),), positive=True,
    )  # fmt: skip


_COUPLING = ("Y_r", "N_v")
_QUADRATIC = ("X_uu", "Y_vv", "N_rr")

EFFECTS: dict[str, AbstractEffect] = {
    effect.name: effect
    for effect in (
        Flow("current", True, _current, 0.3),
        Flow("wind", False, _wind, 5.0),
        Plain(
            "wave-force", "environment",
            {"bias": "N", "amplitude": "N", "frequency": "Hz", "phase": "rad", "direction": "rad"},
            _wave, lambda v: (1.0, 1.0, 0.1, 1.0, 1.0), lambda v: False,
        ),
        Plain("crossflow-drag", "hull", {"cd": "1"}, _cross_flow, lambda v: (1.0,),
              _without(("Y_vv", "Y_vr", "Y_rr", "Y_vvv", "Y_vvr"), "crossflow-drag"), True),
        Plain("sway-yaw-coupling", "hull", {"Y_r": "N s/rad", "N_v": "N s"},
              _derivatives("sway-yaw-coupling", _COUPLING), _derivative_sizes(_COUPLING),
              _without(_COUPLING, "sway-yaw-coupling")),
        Plain("quadratic-damping", "hull",
              {"X_uu": "N s^2/m^2", "Y_vv": "N s^2/m^2", "N_rr": "N m s^2/rad^2"},
              _derivatives("quadratic-damping", _QUADRATIC), _derivative_sizes(_QUADRATIC),
              lambda v: False),
        Plain("thrust-lag", "actuator", {"time_constant": "s"}, _add_to_stage("time_constant"),
              lambda v: (_time_scale(v),), positive=True),
        Plain("thrust-delay", "actuator", {"delay": "s"}, _add_to_stage("delay"),
              lambda v: (_time_scale(v),), positive=True),
        Plain("thrust-asymmetry", "actuator", {"ratio": "1"}, _asymmetry, lambda v: (0.1,), _sided),
        Plain("thruster-misalignment", "actuator", {"angle": "rad"}, _misalignment,
              lambda v: (0.05,), _sided),
        Plain("thrust-loss-with-speed", "actuator", {"slope": "s/m"}, _loss("with_speed"),
              lambda v: (0.02 / _speed_scale(v),), lambda v: False),
        Plain("thrust-loss-in-turns", "actuator", {"slope": "s/rad"}, _loss("in_turns"),
              lambda v: (0.3,), lambda v: False),
        Plain("heading-offset", "sensor", {"angle": "rad"}, _sensor("heading_offset"),
              lambda v: (0.05,)),
        Plain("gyro-bias", "sensor", {"bias": "rad/s"}, _sensor("gyro_bias"), lambda v: (0.01,)),
        _latency("position"), _latency("heading"), _latency("velocity"), _latency("yaw_rate"),
    )
}  # fmt: skip

LATENCY_CHANNELS = {
    "position": ("x", "y"), "heading": ("psi",), "velocity": ("u", "v"), "yaw_rate": ("r",),
}  # fmt: skip


def find_effect(name: str) -> AbstractEffect:
    """The catalogue's entry of that name.

    Raises:
        UserError: no such entry, with the nearest one.
    """
    if name not in EFFECTS:
        known = sorted({effect.split(":")[0] for effect in EFFECTS})
        raise UserError(
            f"unknown effect {name!r}{nearest(name, known)}; the catalogue has: {', '.join(known)}"
        )
    return EFFECTS[name]
