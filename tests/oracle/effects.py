"""Effects: what each entry of the catalogue does to hull, thrusters, forces or sensors.

current               V_c = speed (cos, sin)(direction), where it flows to;
                      p_dot = R(psi) nu_r + V_c
wind                  air velocity w = -speed (cos, sin)(direction), direction it comes from;
                      (u_rw, v_rw) = R' w - (u, v) over ground, V = hypot(u_rw, v_rw);
                      X = 1/2 rho_a A_F C_X V u_rw, Y = 1/2 rho_a A_L C_Y V v_rw,
                      N = 1/2 rho_a A_L L C_N 2 u_rw v_rw;  rho_a = 1.225,
                      C_X 0.7, C_Y 0.85, C_N 0.1, A_F beam x draught, A_L length x draught;
                      less the same in still air (w = 0), unless `still_air` is 1
wave-force            bias + amplitude sin(2 pi frequency t + phase) newtons towards
                      `direction`, fixed in the earth, at amidships
crossflow-drag        strip theory with cd, or derivatives Y_vv ... added
quadratic-damping, sway-yaw-coupling, speed-dependent-damping, added-mass-coupling:
                      keys added to the hull's
drag-change           derivative damping x (1 + factor) from `time`
thrust-change         thrust x (1 + factor) from `time`
thrust-lag, thrust-delay, deadband: added to the thruster's own
rate-limit, thrust-saturation: the lower of effect and thruster holds
thrust-asymmetry      port (y < 0) x (1 - ratio), starboard x (1 + ratio), after the clip
thruster-misalignment angle added to every thruster
thrust-loss-with-speed x (1 - slope u_r);  thrust-loss-in-turns  x (1 - slope |r|)
sensors               see `sensors.py`
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field

from . import hull as H
from .actuators import Thruster


AIR_DENSITY = 1.225  # kg/m^3
ADDED = (
    "quadratic-damping",
    "sway-yaw-coupling",
    "speed-dependent-damping",
    "added-mass-coupling",
)
SENSORS = ("heading-offset", "hard-iron", "gyro-bias", "sensor-latency", "lever-arm")


@dataclass
class Model:
    """A vessel with every effect worked in."""

    hull: dict
    thrusters: list[Thruster]
    current: tuple[float, float] = (0.0, 0.0)  # north, east [m/s]
    forces: list = field(default_factory=list)  # f(t, psi, u, v, u_r, v_r, r) -> (X, Y, N)
    sensors: list[dict] = field(default_factory=list)
    drag_steps: list[tuple[float, float]] = field(default_factory=list)
    thrust_steps: list[tuple[float, float]] = field(default_factory=list)
    crossflow: bool = False


def listed(vessel: dict, environment: dict | None) -> list[dict]:
    """Effects of the vessel file, then of the environment {name: parameters}."""
    extra = [{"name": name, **values} for name, values in (environment or {}).items()]
    return [*vessel.get("effect", []), *extra]


def build(vessel: dict, environment: dict | None = None) -> Model:
    """The model of a parsed vessel file in an environment."""
    for kind in ("azimuth_thruster", "propeller", "rudder", "tunnel_thruster"):
        if vessel.get(kind):
            raise ValueError(f"the oracle has fixed thrusters only, not {kind}")
    data = copy.deepcopy({"hull": vessel["hull"], "thruster": vessel.get("thruster", [])})
    model = Model(data["hull"], [])
    for effect in listed(vessel, environment):
        apply(model, data["thruster"], effect)
    model.thrusters = [Thruster(t) for t in data["thruster"]]
    return model


def apply(model: Model, thrusters: list[dict], effect: dict) -> None:
    """Work one effect into the model."""
    name, hull = effect["name"], model.hull
    values = {k: v for k, v in effect.items() if k != "name"}
    if name in ADDED or (name == "crossflow-drag" and "cd" not in values):
        for key, value in values.items():
            hull[key] = hull.get(key, 0.0) + value
    elif name == "crossflow-drag":
        model.crossflow = True
        model.forces.append(crossflow_force(hull, values["cd"]))
    elif name == "current":
        north, east = polar(values["speed"], values["direction"])
        model.current = (model.current[0] + north, model.current[1] + east)
    elif name == "wind":
        model.forces.append(wind_force(hull, values))
    elif name == "wave-force":
        model.forces.append(wave_force(values))
    elif name in ("drag-change", "thrust-change"):
        steps = model.drag_steps if name == "drag-change" else model.thrust_steps
        steps.append((values["time"], 1.0 + values["factor"]))
    elif name in SENSORS:
        model.sensors.append(effect)
    else:
        for thruster in thrusters:
            change_thruster(thruster, name, values)


def change_thruster(t: dict, name: str, values: dict) -> None:
    """Effects on actuators, on the thruster's own keys."""
    if name in ("thrust-lag", "thrust-delay", "deadband", "thruster-misalignment"):
        key, parameter = {
            "thrust-lag": ("time_constant", "time_constant"),
            "thrust-delay": ("delay", "delay"),
            "deadband": ("deadband", "width"),
            "thruster-misalignment": ("angle", "angle"),
        }[name]
        t[key] = t.get(key, 0.0) + values[parameter]
    elif name == "rate-limit":
        t["rate_limit"] = min(t.get("rate_limit") or math.inf, values["rate_limit"])
    elif name == "thrust-saturation":
        t["max_force"] = min(t.get("max_force", math.inf), values["limit"])
        t["min_force"] = max(t.get("min_force", -math.inf), -values["limit"])
    elif name == "thrust-asymmetry":
        side = (t["y"] > 0) - (t["y"] < 0)
        t["gain"] = t.get("gain", 1.0) * (1.0 + side * values["ratio"])
    elif name == "thrust-loss-with-speed":
        t["loss_speed"] = t.get("loss_speed", 0.0) + values["slope"]
    elif name == "thrust-loss-in-turns":
        t["loss_turn"] = t.get("loss_turn", 0.0) + values["slope"]
    else:
        raise ValueError(f"the oracle does not have the effect {name}")


def polar(size: float, direction: float) -> tuple[float, float]:
    """(north, east) of a vector towards `direction`."""
    return size * math.cos(direction), size * math.sin(direction)


def to_body(north: float, east: float, psi: float) -> tuple[float, float]:
    """R(psi)' (north, east): forward and starboard components."""
    c, s = math.cos(psi), math.sin(psi)
    return c * north + s * east, c * east - s * north


def crossflow_force(hull: dict, cd: float):
    def force(t, psi, u, v, u_r, v_r, r):
        y, n = H.crossflow(hull, cd, v_r, r)
        return 0.0, y, n

    return force


def wind_force(hull: dict, values: dict):
    L, B, T = hull["length"], hull["beam"], hull["draught"]
    front = values.get("frontal_area", B * T)
    side = values.get("lateral_area", L * T)
    q = 0.5 * values.get("air_density", AIR_DENSITY)
    kx = q * front * values.get("C_X", 0.7)
    ky = q * side * values.get("C_Y", 0.85)
    kn = q * side * L * values.get("C_N", 0.1)
    north, east = polar(-values["speed"], values["direction"])
    calm = 1.0 - values.get("still_air", 0.0)

    def force(t, psi, u, v, u_r, v_r, r):
        a, b = to_body(north, east, psi)
        a, b = a - u, b - v
        V, S = math.hypot(a, b), calm * math.hypot(u, v)
        return kx * (V * a + S * u), ky * (V * b + S * v), kn * 2 * (a * b - calm * u * v)

    return force


def wave_force(values: dict):
    omega = 2 * math.pi * values.get("frequency", 0.0)
    phase, direction = values.get("phase", 0.0), values.get("direction", 0.0)
    bias, amplitude = values.get("bias", 0.0), values.get("amplitude", 0.0)

    def force(t, psi, u, v, u_r, v_r, r):
        F = bias + amplitude * math.sin(omega * t + phase)
        return F * math.cos(direction - psi), F * math.sin(direction - psi), 0.0

    return force
