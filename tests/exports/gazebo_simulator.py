"""Gazebo's planar motion of a model file, from published equations: forward, port, up; east, north.

- Newton and Euler's equations with the link's mass matrix plus `fluid_added_mass`
  (SDFormat's proposal "Fluid added mass"; Featherstone 2008, chapter 2): what DART solves.
- `gz::sim::systems::Hydrodynamics`: linear damping `xU u`, products `xUV u v` and `xUabsV u |v|` of
  the velocity relative to the current, applied at the link's origin.
- `gz::sim::systems::Thruster`: a force along the joint's axis, of a command in N, or
  `rho K_T D^4 |w| w` of one in rad/s; clamped.
"""

import math
from xml.etree import ElementTree

import numpy as np


AXES, LETTERS = "xyn", "UVR"


class GazeboModel:
    """A model file of one hull with thrusters."""

    def __init__(self, text):
        self.model = ElementTree.fromstring(text).find("model")
        assert self.model is not None
        links = {link.get("name"): link for link in self.model.findall("link")}
        self.places = {name: numbers(link, "pose") for name, link in links.items()}
        self.M = sum(self.spatial(link) for link in links.values())
        systems = self.model.findall("plugin")
        (self.water,) = [s for s in systems if s.get("name") == "gz::sim::systems::Hydrodynamics"]
        assert self.water.findtext("disable_added_mass") == "true"
        assert self.water.findtext("disable_coriolis") == "true"
        self.thrusters = [s for s in systems if s.get("name") == "gz::sim::systems::Thruster"]
        self.joints = {joint.get("name"): joint for joint in self.model.findall("joint")}

    def spatial(self, link):
        """Mass matrix of a link about the model's origin, in surge, sway and yaw."""
        body = link.find("inertial")
        names = ("mass", "inertia/ixx", "inertia/iyy", "inertia/izz")
        mass, ixx, iyy, izz = (float(body.findtext(name, "nan")) for name in names)
        assert 0 < izz <= ixx + iyy and ixx <= iyy + izz and iyy <= ixx + izz  # a possible body
        x, y = (numbers(link, "pose") + numbers(body, "pose"))[:2]
        about = izz + mass * (x * x + y * y)
        M = np.array([[mass, 0, -mass * y], [0, mass, mass * x], [-mass * y, mass * x, about]])
        added = body.find("fluid_added_mass")
        if added is not None:
            value = lambda name, of=added: float(of.findtext(name, "0"))
            M += np.array([[value("xx"), value("xy"), value("xr")],
                           [value("xy"), value("yy"), value("yr")],
                           [value("xr"), value("yr"), value("rr")]])  # fmt: skip
        return M

    def coefficient(self, name):
        return float(self.water.findtext(name, "0"))

    def damping(self, nu):
        force = np.zeros(3)
        for i, axis in enumerate(AXES):
            for j, first in enumerate(LETTERS):
                gain = self.coefficient(axis + first)
                for k, second in enumerate(LETTERS):
                    gain += self.coefficient(f"{axis}{first}{second}") * nu[k]
                    gain += self.coefficient(f"{axis}{first}abs{second}") * abs(nu[k])
                force[i] += gain * nu[j]
        return force

    def thrust(self, commands):
        """Force of commands by joint."""
        total = np.zeros(3)
        for system in self.thrusters:
            joint = system.findtext("joint_name")
            child = self.joints[joint].findtext("child")
            assert self.joints[joint].findtext("axis/xyz") == "1 0 0"
            value = lambda name, default, of=system: float(of.findtext(name) or default)
            order = min(commands[joint], value("max_thrust_cmd", "1000"))
            order = max(order, value("min_thrust_cmd", "-1000"))
            if system.findtext("use_angvel_cmd") == "true":
                gain = value("fluid_density", "1000") * value("thrust_coefficient", "1")
                order = gain * value("propeller_diameter", "0.02") ** 4 * abs(order) * order
            x, y, _, _, _, yaw = self.places[child]
            X, Y = order * math.cos(yaw), order * math.sin(yaw)
            total += [X, Y, x * Y - y * X]
        return total

    def rate(self, state, commands):
        """Time derivative of east, north, yaw, and forward, port and yaw velocity."""
        yaw, nu = state[2], state[3:]
        cos, sin = math.cos(yaw), math.sin(yaw)
        east, north, _ = numbers(self.water, "default_current", 3)
        relative = nu - [cos * east + sin * north, cos * north - sin * east, 0.0]
        p = self.M @ nu
        inertial = np.array([nu[2] * p[1], -nu[2] * p[0], nu[1] * p[0] - nu[0] * p[1]])
        force = inertial + self.damping(relative) + self.thrust(commands)
        u, v, r = nu
        return np.array([cos * u - sin * v, sin * u + cos * v, r, *np.linalg.solve(self.M, force)])

    def run(self, state, commands, seconds, step=0.01):
        """The state after some time of constant commands."""
        for _ in range(round(seconds / step)):
            k1 = self.rate(state, commands)
            k2 = self.rate(state + step / 2 * k1, commands)
            k3 = self.rate(state + step / 2 * k2, commands)
            k4 = self.rate(state + step * k3, commands)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return state


def numbers(parent, name, count=6):
    text = parent.findtext(name)
    return np.zeros(count) if text is None else np.array(text.split(), float)


def to_gazebo(state):
    """A state in north, east, heading and forward, starboard, down in Gazebo's axes."""
    x, y, psi, u, v, r = state
    return np.array([y, x, math.pi / 2 - psi, u, -v, -r])


def rate_to_gazebo(rate):
    x, y, psi, u, v, r = rate
    return np.array([y, x, -psi, u, -v, -r])
