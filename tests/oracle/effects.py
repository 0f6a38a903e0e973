"""Effects: what each entry of the catalogue does to hull, actuators, forces or sensors.

current               V_c = speed (cos, sin)(direction), where it flows to;
                      p_dot = R(psi) nu_r + V_c
wind                  air velocity w = -speed (cos, sin)(direction), direction it comes from;
                      (u_rw, v_rw) = R' w - (u, v) over ground, V = hypot(u_rw, v_rw);
                      X = 1/2 rho_a A_F C_X V u_rw, Y = 1/2 rho_a A_L C_Y V v_rw,
                      N = -1/2 rho_a A_L L C_N 2 u_rw v_rw;  rho_a = 1.225,
                      C_X 0.7, C_Y 0.85, C_N 0.1, A_F beam x draught, A_L length x draught;
                      less the same in still air (w = 0), unless `still_air` is 1
wave-force            bias + amplitude sin(2 pi frequency t + phase) newtons towards
                      `direction`, fixed in the earth, at amidships
shallow-water         q = draught / depth: added masses x (1 - q)^(-1/2), derivative damping and
                      cross-flow drag x (1 - q)^(-1/4) in X, x (1 - q)^(-1) in Y and N
crossflow-drag        strip theory with cd, or derivatives Y_vv ... added
quadratic-damping, sway-yaw-coupling, speed-dependent-damping, added-mass-coupling:
                      keys added to the hull's
munk-moment           N += size u_r v_r, the size named "Y_vdot - X_udot"
roll-coupling         Y += Y_phi phi, N += N_phi phi, phi(t) given to the simulator as `heel`
drag-change           derivative damping and cross-flow drag x (1 + factor) from `time`, in X
                      alone where `degrees_of_freedom` is ["surge"]
mass-change           mass more at x (amidships) from `time`, the velocity unbroken
thrust-change         forces of thrusters and propellers, or of some, x (1 + factor) from `time`
thrust-lag, thrust-delay, deadband, backlash, actuator-bias: added to the channel's own
actuator-response     thrust-delay, thrust-lag, rate-limit, as far as its keys are given
rate-limit, thrust-saturation: the lower of effect and channel holds
thrust-curve          orders act as others, see `actuators.py`
thrust-asymmetry      port (y < 0) x (1 - ratio), starboard x (1 + ratio), after the clip
thruster-misalignment angle added to every thruster
thrust-loss-with-speed x (1 - slope u_r);  thrust-loss-in-turns  x (1 - slope |r|)
propeller-side-force, rudder-interaction: see `screw.py`
sensors               see `sensors.py`

Effects on channels act on the actuators named under `actuators`. Without it: an actuator-bias
and rate-limit, thrust-lag, thrust-delay, deadband, backlash, thrust-saturation on thrusters
where there are any, else on propellers and rudders.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from . import hull as H
from .actuators import Thruster
from .environment import polar, wave_force, wind_force
from .screw import Propeller, Rudder


ADDED = (
    "quadratic-damping",
    "sway-yaw-coupling",
    "speed-dependent-damping",
    "added-mass-coupling",
)
SENSORS = (
    "heading-offset",
    "hard-iron",
    "gyro-bias",
    "sensor-latency",
    "lever-arm",
    "clock-drift",
)
ADDED_MASSES = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
KINDS = ("thruster", "propeller", "rudder")
# Effect: its parameter, the channel's key, and how the two combine.
CHANNEL_EFFECTS = {
    "thrust-lag": ("time_constant", "time_constant", "sum"),
    "thrust-delay": ("delay", "delay", "sum"),
    "deadband": ("width", "deadband", "sum"),
    "backlash": ("width", "backlash", "sum"),
    "actuator-bias": ("bias", "bias", "sum"),
    "rate-limit": ("rate_limit", "rate_limit", "least"),
    "thrust-saturation": ("limit", "limit", "least"),
}
RESPONSE = {"delay": "thrust-delay", "time_constant": "thrust-lag", "rate_limit": "rate-limit"}
# Effects on the force of fixed thrusters: parameter and key.
THRUST_EFFECTS = {
    "thruster-misalignment": ("angle", "angle"),
    "thrust-loss-with-speed": ("slope", "loss_speed"),
    "thrust-loss-in-turns": ("slope", "loss_turn"),
}


@dataclass
class Model:
    """A vessel with every effect worked in."""

    hull: dict
    actuators: list = field(default_factory=list)
    current: tuple[float, float] = (0.0, 0.0)  # north, east [m/s]
    forces: list = field(default_factory=list)  # f(t, psi, u, v, u_r, v_r, r) -> (X, Y, N)
    late_forces: list = field(default_factory=list)  # time from which it acts, such a force
    sensors: list[dict] = field(default_factory=list)
    drag_steps: list[tuple[float, float]] = field(default_factory=list)  # time, factor
    thrust_steps: list[tuple[float, float, list[str] | None]] = field(default_factory=list)
    mass_steps: list[tuple[float, float, float]] = field(default_factory=list)  # s, kg more, m
    crossflow: float = 0.0  # cd
    shallow: float = 0.0  # draught / depth
    heel: Callable[[float], float] | None = None  # phi(t) [rad]

    @property
    def thrusters(self) -> list[Thruster]:
        return [a for a in self.actuators if isinstance(a, Thruster)]


def listed(vessel: dict, environment: dict | None) -> list[dict]:
    """Effects of the vessel file, then of the environment {name: parameters}."""
    extra = [{"name": name, **values} for name, values in (environment or {}).items()]
    return [*vessel.get("effect", []), *extra]


def build(vessel: dict, environment: dict | None = None) -> Model:
    """The model of a parsed vessel file in an environment."""
    for kind in ("azimuth_thruster", "tunnel_thruster"):
        if vessel.get(kind):
            raise ValueError(f"the oracle has thrusters, propellers and rudders, not {kind}")
    data = copy.deepcopy({kind: vessel.get(kind, []) for kind in KINDS})
    model = Model(copy.deepcopy(vessel["hull"]))
    for effect in listed(vessel, environment):
        apply(model, data, effect)
    for key in ADDED_MASSES:  # after the effects that add to them
        if key in model.hull:
            model.hull[key] *= (1.0 - model.shallow) ** -0.5
    propellers = [Propeller(p, model.hull) for p in data["propeller"]]
    model.actuators += [Thruster(t) for t in data["thruster"]] + propellers
    model.actuators += [Rudder(r, model.hull, propellers) for r in data["rudder"]]
    return model


def apply(model: Model, data: dict[str, list[dict]], effect: dict) -> None:
    """Work one effect into the model or the actuators' data."""
    name, hull = effect["name"], model.hull
    values = {k: v for k, v in effect.items() if k != "name"}
    if name in ADDED or (name == "crossflow-drag" and "cd" not in values):
        for key, value in values.items():
            hull[key] = hull.get(key, 0.0) + value
    elif name == "crossflow-drag":
        model.crossflow += values["cd"]
    elif name == "current":
        north, east = polar(values["speed"], values["direction"])
        model.current = (model.current[0] + north, model.current[1] + east)
    elif name == "wind":
        model.forces.append(wind_force(hull, values))
    elif name == "wave-force":
        model.forces.append(wave_force(values))
    elif name == "shallow-water":
        model.shallow = hull["draught"] / values["depth"]
        if not 0.0 <= model.shallow < 1.0:
            raise ValueError("the water must be deeper than the draught")
    elif name == "munk-moment":
        model.forces.append(munk_moment(values["Y_vdot - X_udot"]))
    elif name == "roll-coupling":
        model.forces.append(roll_force(model, values.get("Y_phi", 0.0), values.get("N_phi", 0.0)))
    elif name == "drag-change":
        if values.get("degrees_of_freedom") == ["surge"]:
            model.late_forces.append((values["time"], more_resistance(model, values["factor"])))
        else:
            model.drag_steps.append((values["time"], 1.0 + values["factor"]))
    elif name == "thrust-change":
        changed = values["time"], 1.0 + values["factor"], values.get("actuators")
        model.thrust_steps.append(changed)
    elif name == "mass-change":
        model.mass_steps.append((values["time"], values["mass"], values.get("x", 0.0)))
    elif name in SENSORS:
        model.sensors.append(effect)
    else:
        change_actuators(data, name, values)


def change_actuators(data: dict[str, list[dict]], name: str, values: dict) -> None:
    """Effects on actuators, on the actuators' own keys."""
    if name in CHANNEL_EFFECTS:
        parameter, key, how = CHANNEL_EFFECTS[name]
        for actuator in chosen(data, values.get("actuators")):
            own = actuator.get(key)
            if how == "sum":
                actuator[key] = (own or 0.0) + values[parameter]
            else:
                actuator[key] = min(own or math.inf, values[parameter])
    elif name == "actuator-response":
        for parameter in RESPONSE.keys() & values.keys():
            change_actuators(data, RESPONSE[parameter], values)
    elif name in THRUST_EFFECTS:
        parameter, key = THRUST_EFFECTS[name]
        for t in data["thruster"]:
            t[key] = t.get(key, 0.0) + values[parameter]
    elif name == "thrust-curve":
        curve = {key: values[key] for key in values.keys() - {"gain", "slope", "actuators"}}
        for t in chosen(data, values.get("actuators")):
            t["acts_as"] = curve
            t["gain"] = t.get("gain", 1.0) * values.get("gain", 1.0)
            t["loss_speed"] = t.get("loss_speed", 0.0) + values.get("slope", 0.0)
    elif name == "thrust-asymmetry":
        for t in data["thruster"]:
            side = (t["y"] > 0) - (t["y"] < 0)
            t["gain"] = t.get("gain", 1.0) * (1.0 + side * values["ratio"])
    elif name == "propeller-side-force":
        for p in data["propeller"]:
            for sign in ("ahead", "astern"):
                p[f"side_{sign}"] = [values.get(f"{axis}_{sign}", 0.0) for axis in "YN"]
    elif name == "rudder-interaction":
        for r in data["rudder"]:
            r.update({key: values[key] for key in ("a_H", "x_H") if key in values})
            if "gamma_R" in values:
                r["gamma_R_port"] = r["gamma_R_starboard"] = values["gamma_R"]
    else:
        raise ValueError(f"the oracle does not have the effect {name}")


def chosen(data: dict[str, list[dict]], names) -> list[dict]:
    """The actuators named, or thrusters where there are any, else all."""
    if names is None:
        return data["thruster"] or [a for kind in KINDS for a in data[kind]]
    found = [a for kind in KINDS for a in data[kind] if a["name"] in names]
    if len(found) != len(names):
        raise ValueError(f"no such actuators: {names}")
    return found


def hull_drag(model: Model, terms, u: float, v: float, r: float) -> list[float]:
    """Derivative damping and cross-flow drag [N, N, N m], grown in shallow water."""
    X, Y, N = H.damping(terms, u, v, r)
    if model.crossflow:
        y, n = H.crossflow(model.hull, model.crossflow, v, r)
        Y, N = Y + y, N + n
    room = 1.0 - model.shallow
    return [X * room**-0.25, Y / room, N / room]


def more_resistance(model: Model, share: float):
    terms = H.damping_terms(model.hull)

    def force(t, psi, u, v, u_r, v_r, r):
        return share * hull_drag(model, terms, u_r, v_r, r)[0], 0.0, 0.0

    return force


def munk_moment(size: float):
    def force(t, psi, u, v, u_r, v_r, r):
        return 0.0, 0.0, size * u_r * v_r

    return force


def roll_force(model: Model, y: float, n: float):
    def force(t, psi, u, v, u_r, v_r, r):
        if model.heel is None:
            raise ValueError("roll-coupling needs the heel phi(t)")
        phi = float(model.heel(t))
        return 0.0, y * phi, n * phi

    return force
